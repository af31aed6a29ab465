// Whole sessions on a coarse towel, with the plugins that ship.
#include <cmath>
#include <nlohmann/json.hpp>

#include "unit/test_support.hpp"
#include "weft/garment_generator.hpp"
#include "weft/hdf5_file.hpp"
#include "weft/session.hpp"

namespace weft {
namespace {

/// A towel of 80 mm edges and a plan that costs a second.
std::string task_text() {
  return "garment: towel.yaml\n"
         "material: " WEFT_SOURCE_DIR
         "/configs/fabrics/basic.yaml\n"
         "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
         "simulator: {plugin: cloth}\n"
         "trajectory: {plugin: arc}\n"
         "predictor: {plugin: rollout}\n"
         "planning: {instances: 2, iterations: 3, replan_iterations: 1, horizon: 14}\n"
         "goal: {random: {min_distance_mm: 20}}\n"
         "settle: {max_frames: 60}\n"
         "seed: 4\n";
}

class Session : public testing::Test {
 protected:
  Session() {
    const auto towel = generate_mesh(towel_outline({}), {.edge_m = 0.08});
    write_obj(folder_ / "towel.obj", towel.mesh, true);
    std::string vertices;
    for (const auto& [name, index] : towel.vertices) vertices += "  " + name + ": " + std::to_string(index) + "\n";
    folder_.write("towel.yaml", "name: towel\nmesh: towel.obj\nvertices:\n" + vertices);
  }

  /// The task of the last run's file.
  Task task() {
    const ConfigNode config = ConfigNode::load(folder_ / "task.yaml");
    SessionParams params;
    read_params(config, params);
    const auto registry = std::make_shared<PluginRegistry>();
    return make_task(params.task, config, *make_host(registry, {.threads = 1}));
  }

  SessionResult run(const std::vector<std::string>& overrides = {}, int threads = 2) {
    ConfigNode config = ConfigNode::load(folder_.write("task.yaml", task_text()));
    for (const auto& assignment : overrides) config = apply_override(config, assignment);
    SessionParams params;
    resolved_ = read_params(config, params);
    const auto registry = std::make_shared<PluginRegistry>();
    const auto host = make_host(registry, {.threads = threads, .seed = 4});
    return run_session(params, config, *host);
  }

  test::Folder folder_;
  ConfigNode resolved_;
};

TEST_F(Session, ComesCloserToTheGoalThanTheDefaultControl) {
  const SessionResult result = run();
  EXPECT_TRUE(result.released);
  EXPECT_GE(result.default_error_mm, 20.0);
  EXPECT_LT(result.error_mm, 0.7 * result.default_error_mm);
  EXPECT_LE(result.rounds.size(), 14u);
  EXPECT_EQ(result.frames.size(), 1 + result.rounds.size() * kFramesPerSegment + 1);
}

TEST_F(Session, SameSeedSameBitsWhateverTheNumberOfThreads) {
  const SessionResult one = run({}, 1), two = run({}, 2);
  EXPECT_EQ(one.final_shape, two.final_shape);
  EXPECT_EQ(one.error_mm, two.error_mm);
  ASSERT_EQ(one.rounds.size(), two.rounds.size());
  for (std::size_t i = 0; i < one.rounds.size(); ++i) {
    EXPECT_EQ(one.rounds[i].plan.controls, two.rounds[i].plan.controls) << i;
    EXPECT_EQ(one.rounds[i].plan.losses, two.rounds[i].plan.losses) << i;
  }
}

TEST_F(Session, AnotherSeedIsAnotherGoalAndAnotherFabric) {
  const SessionResult a = run({"planning.iterations=0", "planning.replan_iterations=0"});
  const SessionResult b = run({"planning.iterations=0", "planning.replan_iterations=0", "seed=5"});
  EXPECT_NE(a.goal, b.goal);
  EXPECT_NE(a.true_material, b.true_material);
}

TEST_F(Session, AnotherPlanningHorizonIsNoOtherGoal) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.replan_iterations=0",
                                          "planning.instances=1"};
  auto longer = quick, other = quick;
  longer.push_back("planning.horizon=20");
  other.push_back("goal.horizon=12");
  const SessionResult a = run(quick), b = run(longer), c = run(other);
  EXPECT_EQ(a.goal, b.goal);
  EXPECT_EQ(a.default_shape, b.default_shape);
  EXPECT_NE(a.goal, c.goal);
}

TEST_F(Session, HorizonFollowsThePaper) {
  const SessionResult result = run({"planning.iterations=0", "planning.replan_iterations=0", "planning.instances=1"});
  EXPECT_EQ(result.rounds[0].plan.horizon, 14);
  for (std::size_t i = 1; i < result.rounds.size(); ++i) {
    // The preceding plan minus its executed segment, plus the leeway of 5.
    const Index before = result.rounds[i - 1].plan.controls.rows() - 1;
    EXPECT_EQ(result.rounds[i].plan.horizon, std::max<Index>(1, before) + 5);
  }
  EXPECT_LT(result.rounds.back().plan.controls.rows(), 2);  // the executed segment was the one that released
}

TEST_F(Session, GoalsByControlsByObjAndByRecordedSession) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.replan_iterations=0",
                                          "planning.instances=1"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.end(), quick.begin(), quick.end());
    return run(more);
  };
  // The goal that the default control makes is reached by the default control, exactly.
  const SessionResult by_controls = with({"goal.controls=[2, 0, 0, 0, 0]"});
  EXPECT_EQ(by_controls.default_error_mm, 0.0);
  EXPECT_EQ(by_controls.error_mm, 0.0);
  const Task same = task();
  const Garment& garment = *same.garment;
  write_obj(folder_ / "goal.obj", {by_controls.goal, garment.faces, garment.rest, "goal"}, true);
  const SessionResult by_obj = with({"goal.obj=" + (folder_ / "goal.obj").string()});
  EXPECT_EQ(by_obj.goal, by_controls.goal);
  write_session(folder_ / "session.h5", by_controls, task(), resolved_, "{}");
  const SessionResult by_example = with({"goal.example=" + (folder_ / "session.h5").string()});
  EXPECT_EQ(by_example.goal, by_controls.final_shape);
}

TEST_F(Session, RefusesBadGoalsAndMaterialsBeforeAnyWork) {
  const auto message = [&](const std::vector<std::string>& overrides) {
    return test::message_of<ConfigError>([&] { run(overrides); });
  };
  EXPECT_THAT(message({"true_material=[0.5, 0.5]"}), testing::HasSubstr("list of 4 numbers"));
  EXPECT_THAT(message({"goal.controls=[1, 2]"}), testing::HasSubstr("has 2 numbers, must have 5"));
  EXPECT_THAT(message({"goal.controls=[2,0,0,0,0]", "goal.obj=x.obj"}), testing::HasSubstr("at most one"));
  EXPECT_THAT(message({"manipulation.displacement_m=[0, 0]"}), testing::HasSubstr("displacement"));
  EXPECT_THAT(message({"manipulation.grasp=[left_botom, left_top]"}), testing::HasSubstr("left_bottom"));
  EXPECT_THAT(message({"knowledge=given"}), testing::HasSubstr("given_centre"));
}

TEST_F(Session, SessionFileHoldsWhatTheSummarySays) {
  const SessionResult result = run({"planning.iterations=1"});
  write_session(folder_ / "session.h5", result, task(), resolved_, "{}");
  const auto file = Hdf5File::open(folder_ / "session.h5");
  EXPECT_EQ(file.read_positions("/final_shape"), result.final_shape);
  EXPECT_EQ(file.list("/rounds").size(), result.rounds.size());
  EXPECT_EQ(file.shape("/frames"),
            (std::vector<Index>{static_cast<Index>(result.frames.size()), result.goal.rows(), 3}));
  const auto summary = nlohmann::json::parse(file.read_text("/summary"));
  EXPECT_EQ(summary["error_mm"].get<double>(),
            mean_distance_mm(file.read_positions("/final_shape"), file.read_positions("/goal")));
  EXPECT_EQ(summary["plan_seconds"].size(), result.rounds.size());
  EXPECT_EQ(summary["knowledge"].size(), result.rounds.size());
  EXPECT_EQ(file.read_text("/config"), resolved_.to_yaml());
}

}  // namespace
}  // namespace weft
