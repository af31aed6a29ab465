#include "conformance/conformance.hpp"

#include <algorithm>

#include "conformance/kit.hpp"
#include "weft/config.hpp"
#include "weft/optimiser.hpp"

namespace weft {
namespace conformance {
namespace {

const std::vector<Law>& laws_of(const std::string& kind) {
  if (kind == "simulator") return simulator_laws();
  if (kind == "predictor") return predictor_laws();
  if (kind == "trajectory") return trajectory_laws();
  if (kind == "optimiser") return optimiser_laws();
  throw ConfigError("conformance: kind '" + kind + "', must be simulator, predictor, trajectory or optimiser");
}

void prepare(const std::string& kind, const Bench& bench) {
  if (kind == "simulator") bench.make<Simulator>();
  if (kind == "trajectory") bench.make<Trajectory>();
  if (kind == "optimiser") bench.make<Optimiser>();
  if (kind == "predictor") bench.make<Predictor>()->bind(predictor_task(bench));
  if (kind != "predictor" && !bench.task.is_null()) bench.task.fail("is for predictors; this is a " + kind);
}

void probe(const std::string& kind, const Bench& bench) {
  if (kind == "simulator") probe_simulator(bench);
  if (kind == "trajectory") probe_trajectory(bench);
  if (kind == "optimiser") probe_optimiser(bench);
  if (kind == "predictor") probe_predictor(bench);
}

LawResult blank(const Law& law) {
  LawResult result;
  result.law = law.name;
  result.text = law.text;
  result.bound = law.bound;
  return result;
}

}  // namespace

std::shared_ptr<const Garment> towel(Index n, double size, double z) {
  Mesh mesh;
  mesh.source = "conformance towel";
  mesh.positions.resize(n * n, 3);
  mesh.rest.resize(n * n, 2);
  mesh.faces.resize(2 * (n - 1) * (n - 1), 3);
  const double edge = size / static_cast<double>(n - 1);
  for (Index v = 0; v < n * n; ++v) {
    mesh.rest.row(v) << static_cast<double>(v % n) * edge, static_cast<double>(v / n) * edge;
    mesh.positions.row(v) << mesh.rest.row(v), z;
  }
  Index f = 0;
  for (Index r = 0; r + 1 < n; ++r) {
    for (Index c = 0; c + 1 < n; ++c) {
      const int a = static_cast<int>(r * n + c), b = a + 1, d = a + static_cast<int>(n), e = d + 1;
      mesh.faces.row(f++) << a, b, e;
      mesh.faces.row(f++) << a, e, d;
    }
  }
  return std::make_shared<const Garment>(make_garment(
      mesh, "towel", {{"near_left", 0}, {"near_right", n - 1}, {"far_left", n * (n - 1)}, {"far_right", n * n - 1}}));
}

Fabric plain_fabric() {
  Fabric fabric;
  fabric.name = "conformance";
  fabric.stretch_shear_n_per_m = 0.5 * fabric.stretch_warp_n_per_m;  // isotropic: E / (2 (1 + nu)) with nu = 0
  return fabric;
}

}  // namespace conformance

std::vector<LawResult> list_laws(const std::string& kind) {
  std::vector<LawResult> results;
  for (const auto& law : conformance::laws_of(kind)) results.push_back(conformance::blank(law));
  return results;
}

std::vector<LawResult> planned_laws(const std::string& kind, const ConfigNode& tolerances,
                                    const std::vector<std::string>& only) {
  const auto& laws = conformance::laws_of(kind);
  std::vector<std::string> names;
  for (const auto& law : laws) names.emplace_back(law.name);
  for (const auto& name : only) {
    if (std::find(names.begin(), names.end(), name) == names.end())
      throw ConfigError("conformance: no law of " + kind + " is called '" + name + "'" + nearest_hint(name, names));
  }
  auto keys = names;
  keys.insert(keys.end(), {"params", "task"});
  if (!tolerances.is_null()) tolerances.refuse_unknown_keys(keys);

  std::vector<LawResult> results;
  for (const auto& law : laws) {
    LawResult result = conformance::blank(law);
    if (const auto given = tolerances.find(law.name)) {
      given->refuse_unknown_keys({"bound", "reason"});
      result.bound = given->at("bound").as_double();
      if (!given->has("reason") || given->at("reason").as_string().empty())
        given->fail("has no reason; a bound that replaces the kit's needs one");
    }
    if (only.empty() || std::find(only.begin(), only.end(), result.law) != only.end()) results.push_back(result);
  }
  return results;
}

std::vector<LawResult> check_conformance(Host& host, const std::string& kind, const ConfigNode& slot,
                                         const ConfigNode& tolerances, const std::vector<std::string>& only) {
  std::vector<LawResult> results = planned_laws(kind, tolerances, only);
  const auto& laws = conformance::laws_of(kind);
  ConfigNode full = slot.is_scalar() ? ConfigNode::mapping({{"plugin", slot}}) : slot;
  if (const auto params = tolerances.find("params"))
    full = full.with("params", full.has("params") ? params->merged(full.at("params")) : *params);
  const conformance::Bench bench{host, full, tolerances.find("task").value_or(ConfigNode())};

  std::string unusable;
  try {
    conformance::prepare(kind, bench);
  } catch (const ConfigError&) {
    throw;  // a wrong parameter or task is the user's error and fails no law
  } catch (const PluginError&) {
    throw;
  } catch (const std::exception& error) {
    unusable = error.what();
  }

  for (auto& result : results) {
    const auto& law =
        *std::find_if(laws.begin(), laws.end(), [&](const conformance::Law& one) { return result.law == one.name; });
    conformance::Outcome outcome;
    try {
      if (!unusable.empty()) throw Error(unusable);
      conformance::probe(kind, bench);
      outcome = law.check(bench);
    } catch (const std::exception& error) {
      outcome = conformance::failed(std::string("threw: ") + error.what());
    } catch (...) {
      outcome = conformance::failed("threw something that is not a std::exception");
    }
    result.measured = outcome.measured;
    result.detail = outcome.detail;
    result.passed = outcome.measured <= result.bound;  // false for NaN
  }
  return results;
}

}  // namespace weft
