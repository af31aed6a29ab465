// The world of a session: constants of the fabric and a simulator that planner and estimator do not know.
#include "session/world.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "session/replay.hpp"
#include "session/session_file.hpp"
#include "session/towel_session.hpp"
#include "simulation/fold.hpp"

namespace weft {
namespace {

Task task_of(const std::string& fabric) {
  Task task;
  task.material.nominal = read_fabric(ConfigNode::parse(fabric, "fabric"));
  for (auto& range : task.material.ranges) range = {0.5, 2.0, true};
  task.simulator = ConfigNode::parse("{plugin: cloth}", "task");
  return task;
}
Task basic_task() {
  return task_of(
      "{density_kg_per_m2: 0.15, stretch_n_per_m: {warp: 110, weft: 165, shear: 55}, poisson: 0.2,"
      " bend_n_m: {warp: 1.6e-5, weft: 2.4e-5, bias: 1.8e-5}, friction: 0.5, self_friction: 0.3, thickness_m: 0.001,"
      " damping: {stretch_s: 0.001, bend_s: 0.015, air_per_s: 8}}");
}

double factor_of(const WorldRecord& record, const std::string& name) {
  for (const auto& [known, factor] : record.factors)
    if (known == name) return factor;
  ADD_FAILURE() << name << " is not recorded";
  return std::nan("");
}

TEST(World, IsTheTaskUnlessTheConfigSaysOtherwise) {
  const Task task = basic_task(), world = world_task(task, {}, 7);
  EXPECT_EQ(write_material_space(world.material).to_yaml(), write_material_space(task.material).to_yaml());
  EXPECT_EQ(world.simulator.to_yaml(), task.simulator.to_yaml());
  EXPECT_FALSE(world_record(task, {}, 7));
}

TEST(World, MultipliesTheConstantsByFactorsOfTheSeedAndLeavesTheEstimatedPropertiesAlone) {
  const Task task = basic_task();
  const Fabric& of_task = task.material.nominal;
  const WorldParams params{.spread = 0.2};
  std::vector<double> all;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    const Task world = world_task(task, params, seed);
    const Fabric& fabric = world.material.nominal;
    const WorldRecord record = world_record(task, params, seed).value();
    ASSERT_EQ(record.factors.size(), 7u);
    for (const auto& [name, factor] : record.factors) all.push_back(factor);
    EXPECT_DOUBLE_EQ(fabric.poisson, of_task.poisson * factor_of(record, "poisson"));
    EXPECT_DOUBLE_EQ(fabric.bend_bias_n_m, of_task.bend_bias_n_m * factor_of(record, "bend_bias"));
    EXPECT_DOUBLE_EQ(fabric.self_friction, of_task.self_friction * factor_of(record, "self_friction"));
    EXPECT_DOUBLE_EQ(fabric.damping_stretch_s, of_task.damping_stretch_s * factor_of(record, "damping_stretch"));
    EXPECT_DOUBLE_EQ(fabric.damping_bend_s, of_task.damping_bend_s * factor_of(record, "damping_bend"));
    EXPECT_DOUBLE_EQ(fabric.damping_air_per_s, of_task.damping_air_per_s * factor_of(record, "damping_air"));
    EXPECT_DOUBLE_EQ(fabric.density_kg_per_m2, of_task.density_kg_per_m2 * factor_of(record, "density"));
    EXPECT_EQ(fabric.friction, of_task.friction);
    EXPECT_EQ(fabric.thickness_m, of_task.thickness_m);
    EXPECT_EQ(fabric.bend_warp_n_m, of_task.bend_warp_n_m);
    EXPECT_EQ(fabric.stretch_weft_n_per_m, of_task.stretch_weft_n_per_m);
    EXPECT_EQ(fabric.stretch_shear_n_per_m, of_task.stretch_shear_n_per_m);
    // The factor on the self friction survives the material space, which ties it to the ground's.
    const MaterialProperties q(0.3, 0.5, 0.5, 0.5);
    EXPECT_NEAR(world.material.at(q).self_friction / task.material.at(q).self_friction,
                factor_of(record, "self_friction"), 1e-12);
    EXPECT_EQ(write_fabric(fabric).to_yaml(), write_fabric(world_task(task, params, seed).material.nominal).to_yaml());
  }
  // Uniform in [0.8, 1.2]: mean 1, standard deviation 0.4 / sqrt(12).
  double sum = 0.0, square = 0.0;
  for (const double factor : all) sum += factor, square += (factor - 1.0) * (factor - 1.0);
  const auto n = static_cast<double>(all.size());
  EXPECT_NEAR(sum / n, 1.0, 4.0 * 0.1155 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(square / n), 0.1155, 0.004);
  EXPECT_GE(*std::min_element(all.begin(), all.end()), 0.8);
  EXPECT_LE(*std::max_element(all.begin(), all.end()), 1.2);
}

TEST(World, LeavesConstantsThatAreKnownAndDrawsTheOthersAsWithoutThem) {
  const Task task = basic_task();
  const WorldParams all{.spread = 0.2}, weighed{.spread = 0.2, .known = {"density"}};
  const WorldRecord record = world_record(task, weighed, 3).value(), other = world_record(task, all, 3).value();
  EXPECT_EQ(factor_of(record, "density"), 1.0);
  EXPECT_NE(factor_of(other, "density"), 1.0);
  EXPECT_EQ(world_task(task, weighed, 3).material.nominal.density_kg_per_m2, task.material.nominal.density_kg_per_m2);
  for (const auto& [name, factor] : record.factors) {
    if (name == "density") continue;
    EXPECT_EQ(factor, factor_of(other, name)) << name;
  }
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  const ConfigNode config = ConfigNode::parse("world:\n  known: [poisson, densty]", "fold.yaml");
  EXPECT_THAT(test::message_of<ConfigError>([&] {
                check_world({.known = {"poisson", "densty"}}, task, config, *host);
              }),
              testing::AllOf(testing::HasSubstr("fold.yaml:2: world.known.1 = densty"), testing::HasSubstr("density")));
}

TEST(World, KeepsToFabricsThatMayBe) {
  // Poisson's ratio just below 0.5, and a bias just above the least one: a factor can break both.
  const Task task = task_of(
      "{stretch_n_per_m: {warp: 100, weft: 100}, poisson: 0.48, bend_n_m: {warp: 1e-5, weft: 4e-5, bias: 0.3e-5}}");
  bool is_clamped = false;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const Fabric fabric = world_task(task, {.spread = 0.9}, seed).material.nominal;
    EXPECT_LE(fabric.poisson, 0.49 + 1e-12);
    EXPECT_NO_THROW(read_fabric(write_fabric(fabric)));
    const WorldRecord record = world_record(task, {.spread = 0.9}, seed).value();
    EXPECT_DOUBLE_EQ(factor_of(record, "poisson") * 0.48, fabric.poisson);
    is_clamped |= std::abs(fabric.poisson - 0.49) < 1e-12;
  }
  EXPECT_TRUE(is_clamped);
}

TEST(World, ChangesTheTablesOfAMeasuredFabric) {
  Task task = basic_task();
  MaterialTables tables;
  for (auto& row : tables.stretching) row = {50.0, 10.0, 40.0, 20.0};
  for (auto& row : tables.bending) row = {1e-4, 2e-4, 3e-4, 4e-4, 5e-4};
  task.material.nominal.tables = std::make_shared<const MaterialTables>(tables);
  task.material.nominal = task.material.nominal.scaled(1.0, 1.0);
  const Fabric fabric = world_task(task, {.spread = 0.3}, 5).material.nominal;
  const WorldRecord record = world_record(task, {.spread = 0.3}, 5).value();
  for (const auto& row : fabric.tables->stretching) {
    EXPECT_DOUBLE_EQ(row[1], 10.0 * factor_of(record, "poisson"));
    EXPECT_EQ(row[0], 50.0);
  }
  EXPECT_DOUBLE_EQ(fabric.tables->bending[1][3], 4e-4 * factor_of(record, "bend_bias"));
  EXPECT_EQ(fabric.tables->bending[0], tables.bending[0]);
  EXPECT_EQ(fabric.tables->bending[2], tables.bending[2]);
  EXPECT_DOUBLE_EQ(fabric.poisson, 10.0 / 40.0 * factor_of(record, "poisson"));
  EXPECT_EQ(task.material.nominal.tables->bending[1][3], 4e-4) << "the task's tables are its own";
}

class SessionWorld : public Session {
 protected:
  const std::vector<std::string> quick_ = {"planning={instances: 1, iterations: 1, replan_iterations: 0, horizon: 10}"};

  /// What the session executed, simulated in this task's world.
  FoldResult executed(const SessionResult& result, const Task& in) {
    Controls controls(result.rounds.size(), result.rounds.front().plan.controls.cols());
    for (Index j = 0; j < controls.rows(); ++j) controls.row(j) = result.rounds[j].plan.controls.row(0);
    return fold(in, *result.true_material, controls);
  }
  FoldResult fold(const Task& in, const MaterialProperties& q, const Controls& controls) {
    const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
    return simulate_fold(*host->create<Simulator>(in.simulator), in, q, controls);
  }
};

TEST_F(SessionWorld, ByDefaultGoalAndFoldAreThoseOfTheTask) {
  const SessionResult result = run(quick_);
  const Task plain = task();
  EXPECT_EQ(result.goal, fold(plain, *result.true_material, result.goal_controls).shapes.back());
  const Controls by_default = plain.trajectory->default_controls(25);
  EXPECT_EQ(result.default_shape, fold(plain, *result.true_material, by_default).shapes.back());
  EXPECT_EQ(result.final_shape, executed(result, plain).shapes.back());
  EXPECT_FALSE(result.world);
  EXPECT_TRUE(nlohmann::json::parse(session_summary_json(result))["world"].is_null());
}

TEST_F(SessionWorld, MakesGoalAndFoldButNotThePlans) {
  const SessionResult result = run(with(quick_, {"world.spread=0.2"}));
  const Task plain = task(), world = world_task(plain, {.spread = 0.2}, 4);
  EXPECT_EQ(result.goal, fold(world, *result.true_material, result.goal_controls).shapes.back());
  EXPECT_NE(result.goal, fold(plain, *result.true_material, result.goal_controls).shapes.back());
  EXPECT_EQ(result.final_shape, executed(result, world).shapes.back());
  EXPECT_NE(result.final_shape, executed(result, plain).shapes.back());
  // The predictor is the simulator at the true properties. It knows the task's fabric alone.
  const Positions& predicted = result.rounds.front().plan.shapes.front().mean;
  EXPECT_LT((predicted - executed(result, plain).shapes[1]).cwiseAbs().maxCoeff(), 1e-9);
  EXPECT_GT((predicted - executed(result, world).shapes[1]).cwiseAbs().maxCoeff(), 1e-7);
  const auto summary = nlohmann::json::parse(session_summary_json(result));
  EXPECT_EQ(summary["world"]["spread"], 0.2);
  EXPECT_EQ(summary["world"]["simulator"], "cloth");
  ASSERT_EQ(summary["world"]["factors"].size(), 7u);
  EXPECT_DOUBLE_EQ(summary["world"]["factors"]["density"].get<double>() * plain.material.nominal.density_kg_per_m2,
                   world.material.nominal.density_kg_per_m2);
}

TEST_F(SessionWorld, MayBeAnotherSimulator) {
  const SessionResult result = run(with(quick_, {"world.simulator={plugin: bullet}"}));
  Task world = task();
  const Positions in_task = executed(result, world).shapes.back();
  world.simulator = ConfigNode::parse("{plugin: bullet}", "world");
  EXPECT_EQ(result.final_shape, executed(result, world).shapes.back());
  EXPECT_NE(result.final_shape, in_task);
  const auto summary = nlohmann::json::parse(session_summary_json(result));
  EXPECT_EQ(summary["world"]["simulator"], "bullet");
  EXPECT_TRUE(summary["world"]["factors"].empty());
}

TEST_F(SessionWorld, PlansAndEstimatesAloneAreMadeInIt) {
  const auto read = [&](const std::vector<std::string>& overrides, SessionParams& params) {
    ConfigNode config = ConfigNode::load(folder_.write("task.yaml", task_text()));
    for (const auto& assignment : with(quick_, overrides)) config = apply_override(config, assignment);
    read_params(config, params);
    return config;
  };
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  SessionParams plain, other;
  const ConfigNode plain_config = read({"estimation={instances: 1, iterations: 1, later_iterations: 0}"}, plain);
  const ConfigNode other_config =
      read({"estimation={instances: 1, iterations: 1, later_iterations: 0}", "world.spread=0.3"}, other);
  const LonePlan in_task = plan_alone(plain, plain_config, nullptr, 1, *host);
  const LonePlan in_world = plan_alone(other, other_config, nullptr, 1, *host);
  EXPECT_NE(in_world.goal, in_task.goal);
  EXPECT_EQ(in_world.goal, run(with(quick_, {"world.spread=0.3"})).goal);
  EXPECT_NE(estimate_alone(other, other_config, nullptr, *host).estimates.back().nll,
            estimate_alone(plain, plain_config, nullptr, *host).estimates.back().nll);
}

TEST_F(SessionWorld, RefusesWhatCannotBe) {
  const auto message = [&](const std::vector<std::string>& overrides) {
    return test::message_of<ConfigError>([&] { run(overrides); });
  };
  EXPECT_THAT(message({"world.spread=0.95"}), testing::HasSubstr("world.spread = 0.95, must be in [0, 0.9]"));
  EXPECT_THAT(test::message_of<PluginError>([&] { run({"world.simulator=nothing"}); }),
              testing::HasSubstr("world.simulator: no simulator plugin is called 'nothing'"));
  const std::vector<std::string> process = {"environment.command=[cat]", "knowledge=none"};
  EXPECT_THAT(message(with(process, {"world.spread=0.1"})),
              testing::HasSubstr("world.spread = 0.1, must be left out with environment.command"));
  EXPECT_THAT(message(with(process, {"world.simulator={plugin: bullet}"})),
              testing::HasSubstr("must be left out with environment.command"));
  const std::string broken = "world.simulator={plugin: cloth, params: {min_substeps: 2, max_substeps: 1}}";
  ConfigNode config = ConfigNode::load(folder_.write("task.yaml", task_text()));
  config = apply_override(config, broken);
  SessionParams params;
  read_params(config, params);
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  EXPECT_THAT(test::message_of<ConfigError>([&] { rehearse_session(params, config, *host); }),
              testing::HasSubstr("max_substeps"));
}

}  // namespace
}  // namespace weft
