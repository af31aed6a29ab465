// The physics suite (configs/experiments/physics.yaml) with its bounds, on the cloth plugin as it is loaded for folds.
#include <gtest/gtest.h>

#include "experiments/physics/suite.hpp"
#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "meshes/intersections.hpp"
#include "simulation/scene.hpp"
#include "simulation/task_config.hpp"

namespace weft {
namespace {

/// @param with parameters of the simulator, in addition to those of the configuration.
void check(const std::string& which, const ConfigNode& with) {
  const auto registry =
      std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_BINARY_DIR "/lib/weft/plugins"});
  const auto host = make_host(registry, HostOptions{.threads = 1, .checks = PluginChecks::none});
  const ConfigNode config = ConfigNode::load(WEFT_SOURCE_DIR "/configs/experiments/physics.yaml");
  std::shared_ptr<const Task> task;
  if (which == "garment crease" || which == "folds" || which == "paired folds" || which == "properties") {
    TaskParams params;
    read_params(ConfigNode::mapping({{"garment", config.at("garment")},
                                     {"material", config.at("material")},
                                     {"manipulation", config.at("manipulation")},
                                     {"simulator", config.at("simulator")},
                                     {"trajectory", config.at("trajectory")}}),
                params);
    task = std::make_shared<const Task>(make_task(params, config, *host));
  }
  PhysicsParams params;
  read_params(config.at("physics"), params);
  params.tests = {which};
  params.folds.count = 6;   // `weft evaluate physics` runs 200
  params.folds.paired = 1;  // with its finer self
  if (which == "drape" || which == "bending length" || which == "tensile")
    params.fabric = ConfigNode::quoted(WEFT_SOURCE_DIR "/configs/fabrics/cotton_plain.yaml");
  const auto variant = [&](const char* name, const char* key) {
    return SimulatorVariant{name,
                            [&host, slot = config.at(key).merged(with)] { return host->create<Simulator>(slot); }};
  };
  const std::vector<SimulatorVariant> variants{variant("default", "simulator"), variant("finer", "finer")};
  const auto cases = physics_cases(params, task);
  ASSERT_FALSE(cases.empty());
  for (const auto& one : cases)
    for (const auto& row : run_physics_case(one, variants)) {
      std::puts(format_physics_row(row).c_str());
      EXPECT_TRUE(row.passed) << format_physics_row(row);
    }
}

struct Physics : testing::TestWithParam<std::string> {};
TEST_P(Physics, IsWithinItsBounds) { check(GetParam(), ConfigNode::parse("{}", "test")); }

struct ScaledPhysics : testing::TestWithParam<std::string> {};
TEST_P(ScaledPhysics, IsWithinTheSameBounds) {
  check(GetParam(), ConfigNode::parse("{params: {inertia_length_m: 0.01}}", "test"));
}

// A towel of 0.3 mm falls on its hem at 4 m/s and crumples: ground friction and fast contact between layers at once.
TEST(Drape, TowelThatCrumplesOnTheGroundNeverPassesThroughItself) {
  const auto registry =
      std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_BINARY_DIR "/lib/weft/plugins"});
  const auto host = make_host(registry, HostOptions{.threads = 1, .checks = PluginChecks::none});
  const SceneRun run = read_scene(ConfigNode::load(WEFT_SOURCE_DIR "/configs/experiments/scenes/drape.yaml"));
  run_scene(run, *host, [&](const Simulator& simulator, Index frame) {
    EXPECT_EQ(count_intersections(simulator.positions(), run.garment->faces), 0) << "frame " << frame;
  });
}

const auto name_of = [](const testing::TestParamInfo<std::string>& which) {
  std::string name = which.param;
  std::replace(name.begin(), name.end(), ' ', '_');
  return name;
};
INSTANTIATE_TEST_SUITE_P(Suite, Physics, testing::ValuesIn(physics_test_names()), name_of);
// The cases that inertia enters, and those that it must not change.
INSTANTIATE_TEST_SUITE_P(Suite, ScaledPhysics,
                         testing::Values("incline", "cloth on cloth", "garment crease", "folds", "rest", "momentum",
                                         "energy"),
                         name_of);

}  // namespace
}  // namespace weft
