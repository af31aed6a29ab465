// Goals that are places: the flat garment elsewhere, an edge on a line, and coverage.
#include <gtest/gtest.h>

#include "session/placed_goal.hpp"
#include "session/session_file.hpp"
#include "session/shape_errors.hpp"
#include "session/towel_session.hpp"

namespace weft {
namespace {

class PlacedGoal : public Session {
 protected:
  std::string refused(const std::vector<std::string>& overrides) {
    return test::message_of<std::exception>([&] { run(overrides); });
  }
  const std::vector<std::string> quick_ = {"planning.iterations=1", "planning.replan_iterations=0",
                                           "planning.instances=1", "true_material=[0.5, 0.5, 0.5, 0.2]"};
};

TEST_F(PlacedGoal, TheFlatGarmentIsMovedAndTurnedOnTheWorkSurface) {
  const SessionResult result = run(with(quick_, {"goal={flat: {move_m: [0.1, -0.05], turn_deg: 90}}"}));
  const Positions& goal = result.goal;
  // Of the cloth's own thickness: 0.5 + 0.2 (4 - 0.5) mm.
  EXPECT_NEAR(goal.col(2).maxCoeff(), 0.0012, 1e-12);
  const Task flat = task();
  const Positions& rest = flat.garment->positions;
  const auto middle = [](const Positions& p) -> Eigen::RowVector2d {
    return 0.5 * (p.colwise().minCoeff() + p.colwise().maxCoeff()).head<2>();
  };
  EXPECT_LT((middle(goal) - middle(rest) - Eigen::RowVector2d(0.1, -0.05)).norm(), 1e-12);
  for (Index v = 0; v < goal.rows(); ++v) {
    const Eigen::RowVector2d was = rest.row(v).head<2>() - middle(rest), is = goal.row(v).head<2>() - middle(goal);
    EXPECT_LT((is - Eigen::RowVector2d(-was.y(), was.x())).norm(), 1e-12);
  }
  EXPECT_NEAR(coverage(goal, *flat.garment), 1.0, 0.01);
  EXPECT_LT(result.errors.coverage, 0.8) << "a folded towel covers less";
}

TEST_F(PlacedGoal, OnlyAnEdgeCounts) {
  const std::string edge =
      "goal={edge: {vertices: [left_bottom, left_top], to_m: [0.3, -0.2, 0.003, 0.35, 0.2, 0.003]}}";
  const SessionResult result = run(with(quick_, {edge}));
  const auto kept = task().garment;
  const Garment& garment = *kept;
  ASSERT_EQ(std::ssize(result.goal_counts), garment.vertex_count());
  Index counted = 0;
  double sum = 0.0;
  const double left = garment.positions.col(0).minCoeff();
  for (Index v = 0; v < garment.vertex_count(); ++v) {
    EXPECT_EQ(result.goal_counts[v], garment.positions(v, 0) < left + 1e-9) << "the left edge is the shorter way";
    if (!result.goal_counts[v]) continue;
    ++counted;
    sum += (result.final_shape.row(v) - result.goal.row(v)).norm();
  }
  EXPECT_GT(counted, 3);
  EXPECT_NEAR(result.error_mm, 1000.0 * sum / static_cast<double>(counted), 1e-9);
  EXPECT_EQ(result.goal.row(garment.vertex("left_top")), Eigen::RowVector3d(0.35, 0.2, 0.003));
  // Others may be anywhere: the loss of a plan does not see them.
  EXPECT_LT(result.rounds.front().plan.predicted_error_mm, result.default_error_mm + 1e-6);

  const auto file = folder_ / "session.h5";
  record(file, result);
  const SessionRecord record = read_session(file);
  EXPECT_EQ(record.goal_counts, result.goal_counts);
  EXPECT_NEAR(record.goal_distance_mm(result.final_shape), result.error_mm, 1e-3);
}

TEST_F(PlacedGoal, EdgesThatAreNoneAreRefused) {
  EXPECT_NE(refused({"goal={edge: {vertices: [left_bottom, left_bottom], to_m: [0, 0, 0, 0, 1, 0]}}"})
                .find("no open edge of the garment joins left_bottom and left_bottom"),
            std::string::npos);
  EXPECT_NE(refused({"goal={edge: {vertices: [left_bottom], to_m: [0, 0, 0, 0, 1, 0]}}"}).find("2 names of vertices"),
            std::string::npos);
  EXPECT_NE(refused({"goal={edge: {vertices: [left_bottom, left_top]}}"}).find("goal.edge.to_m"), std::string::npos);
  EXPECT_NE(
      refused({"goal={edge: {vertices: [left_bottom, left_top], to_m: [0, 0, 0, 0, 1, 0]}}", "planning.loss=chamfer"})
          .find("of which only the edge counts"),
      std::string::npos);
}

TEST_F(PlacedGoal, CoverageIsPlannedForWithoutGradients) {
  const std::vector<std::string> unfolded = {"goal={flat: {move_m: [0, 0]}}", "planning.loss=coverage",
                                             "optimiser={plugin: mppi, params: {samples: 4}}", "planning.iterations=4",
                                             "planning.instances=1"};
  const SessionResult result = run(unfolded);
  const Plan& plan = result.rounds.front().plan;
  // 10^4 (1 - coverage)^2 besides what the activity costs; the search finds a fold that covers more than the first one.
  const double share = coverage(plan.shapes.back().mean, *task().garment);
  EXPECT_GE(plan.loss, 1e4 * (1.0 - share) * (1.0 - share) - 1e-6);
  EXPECT_LT(plan.loss, plan.curves.front().front());
  EXPECT_NE(refused({"goal={flat: {move_m: [0, 0]}}", "planning.loss=coverage"}).find("has no gradient"),
            std::string::npos);
}

}  // namespace
}  // namespace weft
