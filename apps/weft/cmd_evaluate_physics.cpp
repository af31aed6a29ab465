#include <cmath>
#include <cstdio>
#include <iostream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <sstream>

#include "context.hpp"
#include "output.hpp"
#include "weft/physics.hpp"
#include "weft/session.hpp"

namespace weft::app {
namespace {

struct PhysicsExperiment {
  SessionParams session;
  PhysicsParams physics;
  ConfigNode finer;
  template <class Visitor>
  void visit(Visitor& v) {
    session.visit(v);
    v.group("physics", physics, "The suite's meshes and fabric.");
    v("finer", finer, PluginSlot{"simulator"}, "The simulator at a finer step, for what must not depend on it.");
  }
};

nlohmann::ordered_json number(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
}

int evaluate(Context& context, const std::string& file) {
  const ConfigNode config = context.load(file);
  PhysicsExperiment params;
  const ConfigNode resolved = read_params(config, params);
  if (context.jobs == 0) context.jobs = static_cast<int>(params.session.threads);
  const auto registry = context.registry(config);
  const auto seed = static_cast<std::uint64_t>(params.session.seed);
  const auto host = context.host(registry, seed);
  const auto task = std::make_shared<const Task>(make_task(params.session.task, config, *host));
  const auto variant = [&](const char* name, const ConfigNode& slot) {
    return SimulatorVariant{name, [&host, slot] { return host->create<Simulator>(slot); }};
  };
  std::vector<SimulatorVariant> variants{variant("default", params.session.task.simulator)};
  if (!params.finer.is_null()) variants.push_back(variant("finer", params.finer));
  const auto cases = physics_cases(params.physics, task);
  const auto out = output_folder(context, "evaluate-physics-" + std::filesystem::path(file).stem().string());
  const ConfigNode saved = self_contained(resolved, *task, *registry, out);

  std::vector<std::vector<PhysicsRow>> results(cases.size());
  std::mutex printing;
  host->parallel_for(static_cast<std::int64_t>(cases.size()), [&](std::int64_t i) {
    const auto at = static_cast<std::size_t>(i);
    if (host->cancelled()) throw Error("cancelled");
    results[at] = run_physics_case(cases[at], variants);
    const std::lock_guard lock(printing);
    for (const auto& row : results[at]) context.say(format_physics_row(row));
  });

  std::size_t total = 0, failed = 0;
  auto rows = nlohmann::ordered_json::array();
  std::ostringstream csv;
  csv.precision(9);
  csv << "test,variant,case,quantity,reference,measured,error,bound,passed,note\n";
  for (const auto& group : results)
    for (const auto& row : group) {
      ++total;
      if (!row.passed) ++failed;
      rows.push_back({{"test", row.test},
                      {"variant", row.variant},
                      {"case", row.name},
                      {"quantity", row.quantity},
                      {"reference", number(row.reference)},
                      {"measured", number(row.measured)},
                      {"error", number(row.error)},
                      {"bound", number(row.bound)},
                      {"passed", row.passed},
                      {"note", row.note}});
      csv << row.test << ',' << row.variant << ",\"" << row.name << "\"," << row.quantity << ',' << row.reference << ','
          << row.measured << ',' << row.error << ',' << row.bound << ',' << (row.passed ? 1 : 0) << ",\"" << row.note
          << "\"\n";
    }
  const std::string json = nlohmann::ordered_json{{"rows", rows}, {"total", total}, {"failed", failed}}.dump(2) + "\n";
  write_text(out / "config.yaml", saved.to_yaml());
  write_text(out / "provenance.json", provenance_json(*registry, *host, seed));
  write_text(out / "physics.csv", csv.str());
  write_text(out / "physics.json", json);
  if (context.json) std::cout << json;
  char line[100];
  std::snprintf(line, sizeof line, "%zu of %zu comparisons within their bounds", total - failed, total);
  context.say(line);
  context.say("results in " + out.string());
  return failed == 0 ? 0 : 1;
}

}  // namespace

void register_evaluate_physics(CLI::App& app, Context& context) {
  CLI::App* command =
      app.add_subcommand("physics", "A simulator against closed forms: elastica, catenary, friction, creases, ...");
  add_common_options(*command, context);
  auto file = std::make_shared<std::string>();
  command->add_option("config", *file, "Suite file, such as configs/experiments/physics.yaml")->required();
  command->callback([&context, file] { context.action = [&context, file] { return evaluate(context, *file); }; });
}

}  // namespace weft::app
