#include "experiments/physics/suite.hpp"

#include <algorithm>
#include <limits>

#include "experiments/physics/closed_forms.hpp"
#include "experiments/physics/folds.hpp"
#include "experiments/physics/obstacles.hpp"
#include "experiments/physics/sewn_cloth.hpp"
#include "experiments/physics/textiles.hpp"
#include "loader/where.hpp"
#include "weft/config.hpp"

namespace weft {

std::vector<std::string> physics_test_names() {
  return {"elastica", "orthotropy",     "hanging",    "catenary",     "incline",    "cloth on cloth", "thrown sheet",
          "crease",   "garment crease", "folds",      "paired folds", "properties", "free fall",      "rest",
          "momentum", "energy",         "refinement", "closed tube",  "two layers", "drape",          "bending length",
          "tensile",  "tilted box",     "capstan",    "table edge"};
}

std::vector<PhysicsCase> physics_cases(const PhysicsParams& params, std::shared_ptr<const Task> task,
                                       const ConfigNode& origin) {
  const auto known = physics_test_names();
  for (std::size_t i = 0; i < params.tests.size(); ++i) {
    const std::string& name = params.tests[i];
    if (std::find(known.begin(), known.end(), name) == known.end())
      place(origin, "physics.tests." + std::to_string(i))
          .fail("= " + name + ", must be " + one_of(known) + nearest_hint(name, known));
  }
  std::vector<PhysicsCase> all;
  physics::add_elastica(all, params);
  physics::add_hanging(all, params);
  physics::add_catenary(all, params);
  physics::add_incline(all, params);
  physics::add_crease(all, params, task);
  physics::add_folds(all, params, task);
  physics::add_dynamics(all, params);
  physics::add_sewn_cloth(all, params);
  physics::add_textiles(all, params);
  physics::add_obstacles(all, params);
  if (params.tests.empty()) return all;
  std::vector<PhysicsCase> chosen;
  for (auto& one : all)
    if (std::find(params.tests.begin(), params.tests.end(), one.test) != params.tests.end())
      chosen.push_back(std::move(one));
  if (chosen.empty()) {
    const ConfigNode tests = place(origin, "physics.tests");
    tests.fail("= " + shown(tests) + " leaves no case to run: physics.folds.count = " +
               std::to_string(params.folds.count) + ", physics.folds.paired = " + std::to_string(params.folds.paired));
  }
  return chosen;
}

SimulatorVariant simulator_variant(std::string name, Host& host, const ConfigNode& slot) {
  return {std::move(name), [&host, slot] { return host.create<Simulator>(slot); }};
}

std::vector<PhysicsRow> run_physics_case(const PhysicsCase& physics_case,
                                         const std::vector<SimulatorVariant>& variants) {
  const Step step(physics_case.test.c_str());
  try {
    return physics_case.run(variants);
  } catch (const std::exception& error) {
    PhysicsRow failed = physics::row(physics_case.test, variants.at(0), physics_case.name, "exception", 0.0, 0.0,
                                     std::numeric_limits<double>::infinity(), 0.0, error.what());
    return {failed};
  }
}

}  // namespace weft
