// Folds that start where another one ended.
#include <gtest/gtest.h>

#include "session/sequence.hpp"
#include "session/towel_session.hpp"
#include "session/twin.hpp"

namespace weft {
namespace {

class Start : public Session {
 protected:
  /// A fold to the right, recorded.
  std::filesystem::path first_fold(const std::vector<std::string>& more = {}) {
    first_ = run(with({"true_material=[0.4, 0.5, 0.5, 0.3]"}, more));
    const auto file = folder_ / "first.h5";
    record(file, first_);
    return file;
  }
  /// Then one upwards.
  std::vector<std::string> second(const std::filesystem::path& file) {
    return {"start.session=" + file.string(), "true_material=[0.4, 0.5, 0.5, 0.3]",
            "goal={random: {min_distance_mm: 5}}",
            "manipulation={grasp: [right_bottom, left_bottom], displacement_m: [0, 0.3]}"};
  }
  SessionResult first_;
};

TEST_F(Start, BeginsWhereTheOtherEnded) {
  const auto file = first_fold();
  const SessionResult result = run(second(file));
  EXPECT_EQ(result.start, first_.final_shape);
  EXPECT_TRUE(result.released);
  EXPECT_GT(mean_distance_mm(result.start, result.final_shape), 20.0) << "it was folded again";
  EXPECT_LT(result.error_mm, result.default_error_mm);
  // Two folds: nothing of it is where it was when it lay flat, and it covers less than after one.
  EXPECT_LT(result.errors.coverage, 0.8 * first_.errors.coverage);
}

TEST_F(Start, TheTwinForecastsIt) {
  const auto file = first_fold();
  // A plan that is simulated at the true material from the true start is what then happens.
  const SessionResult result =
      run(with(second(file),
               {"correction={simulations: 3, iterations: 2, later_simulations: 2}", "goal.random.min_distance_mm=5"}));
  EXPECT_NEAR(result.rounds.back().plan.predicted_error_mm, result.error_mm, 0.1);
}

TEST_F(Start, ThePlannerKnowsWhatWasSeenAndTheWorldWhatIs) {
  const auto file = first_fold({"observation.noise_m=0.003"});
  EXPECT_NE(first_.rounds.back().observed, first_.final_shape);
  const SessionResult result = run(second(file));
  EXPECT_EQ(result.start, first_.final_shape);
  const Task next = task();
  ASSERT_TRUE(next.start);
  EXPECT_EQ(next.start->shape, first_.rounds.back().observed);
  EXPECT_EQ(next.manipulation.grasp_points.leftCols<2>().row(0),
            next.start->shape.row(next.manipulation.grasp_vertices[0]).leftCols<2>());
  EXPECT_GE(next.manipulation.contact_height, next.start->shape(next.manipulation.grasp_vertices[1], 2));
  // What is not seen is where the last fold left it.
  const SessionResult hidden = run(with(second(file), {"observation.lost_share=0.5", "planning.iterations=0"}));
  EXPECT_TRUE(hidden.released);
}

TEST_F(Start, IsEstimatedToo) {
  const auto file = first_fold();
  const SessionResult result = run(with(second(file), kEstimate));
  ASSERT_FALSE(result.estimates.empty());
  EXPECT_LT(result.estimates.back().knowledge.width.mean(), 1.0);
}

TEST_F(Start, TheHeightOfFoldsIsNotTakenForTheThickness) {
  const auto file = first_fold();
  const SessionResult result = run(with(second(file), kEstimate));
  const MaterialKnowledge& last = result.estimates.back().knowledge;
  EXPECT_NEAR(last.centre(3), 0.3, last.width(3) + 0.05);
}

TEST_F(Start, StepsOfOneSessionAreThoseOfSessionsOneByOne) {
  const auto file = first_fold();
  const SessionResult second_alone = run(second(file));
  const std::vector<std::string> both = {
      "true_material=[0.4, 0.5, 0.5, 0.3]",
      "manipulations=[{description: to the right}, {goal: {random: {min_distance_mm: 5}}, "
      "manipulation: {grasp: [right_bottom, left_bottom], displacement_m: [0, 0.3]}}]"};
  ConfigNode config = ConfigNode::load(folder_.write("both.yaml", task_text()));
  for (const auto& assignment : both) config = apply_override(config, assignment);
  SessionParams params;
  read_params(config, params);
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 2, .seed = 4});
  std::vector<SessionResult> steps;
  const SessionResult last = run_sequence(
      params, config, *host, {},
      [&](const SessionStep&, Index, const Task&, const SessionResult& result) { steps.push_back(result); });
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_EQ(steps[0].final_shape, first_.final_shape);
  EXPECT_EQ(steps[1].start, first_.final_shape);
  EXPECT_EQ(last.final_shape, second_alone.final_shape);
  ASSERT_EQ(last.steps.size(), 2u);
  EXPECT_EQ(last.steps[0].error_mm, first_.error_mm);
  EXPECT_EQ(last.steps[1].error_mm, last.error_mm);
}

TEST_F(Start, AStepCarriesTheEstimateOn) {
  const auto file = first_fold(kEstimate);
  const MaterialKnowledge known = first_.estimates.back().knowledge;
  const SessionResult result = run(with(second(file), kEstimate));
  EXPECT_EQ(result.rounds.front().knowledge.centre, known.centre);
  EXPECT_EQ(result.rounds.front().knowledge.width, known.width);
  for (const auto& round : result.rounds) EXPECT_LE(round.knowledge.width.mean(), known.width.mean());
}

TEST_F(Start, StepsWithKeysThatTheyCannotHaveAreRefused) {
  const auto refused = [&](const std::string& list) {
    const ConfigNode config =
        apply_override(ConfigNode::load(folder_.write("steps.yaml", task_text())), "manipulations=" + list);
    SessionParams params;
    read_params(config, params);
    return test::message_of<ConfigError>([&] { session_steps(params, config); });
  };
  EXPECT_NE(refused("[{garment: other.yaml}]").find("garment is not a known key"), std::string::npos);
  EXPECT_NE(refused("[{goal: {obj: goal.obj}}]").find("obj is not a known key"), std::string::npos);
  EXPECT_NE(refused("7").find("a list of mappings"), std::string::npos);
  EXPECT_NE(refused("[{max_segments: 0}]").find("max_segments"), std::string::npos);
}

TEST_F(Start, LimitsOfALaterStepAreCheckedWhereTheClothThenLies) {
  // Where two vertices are as far apart as these must be is known only after the first fold.
  const auto rehearsed = [&](const std::string& first, const std::string& later) {
    ConfigNode config = ConfigNode::load(folder_.write("steps.yaml", task_text()));
    config = apply_override(config, "manipulations=[{manipulation: {limits: {distance_m: " + first +
                                        "}}}, {manipulation: {limits: {distance_m: " + later + "}}}]");
    SessionParams params;
    read_params(config, params);
    const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
    rehearse_steps(session_steps(params, config), *host);
  };
  EXPECT_NE(test::message_of<ConfigError>([&] { rehearsed("3", "0"); }).find("distance_m"), std::string::npos);
  EXPECT_NO_THROW(rehearsed("0", "3"));
}

TEST_F(Start, OfAnotherGarmentIsRefused) {
  const auto file = first_fold();
  const std::string reason = test::message_of<ConfigError>(
      [&] { run(with(second(file), {"garment=" WEFT_SOURCE_DIR "/configs/garments/towel.yaml"})); });
  EXPECT_NE(reason.find("was recorded with another garment"), std::string::npos) << reason;
  EXPECT_NE(reason.find("start.session"), std::string::npos) << reason;
}

}  // namespace
}  // namespace weft
