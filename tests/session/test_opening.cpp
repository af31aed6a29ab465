// Hands that open one by one, and vertices that are chosen by where they lie.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "session/towel_session.hpp"
#include "session/twin.hpp"
#include "simulation/fold.hpp"
#include "simulation/hand_limits.hpp"
#include "simulation/seen_vertex.hpp"
#include "simulation/start_shape.hpp"
#include "weft/hands.hpp"

namespace weft {
namespace {

const std::vector<std::string> kOpening = {"manipulation.opens_at=[0.5, 1]"};

/// Sessions in which hand 0 opens half way.
class Opening : public Session {
 protected:
  /// The task with these overrides, and a host that lives as long.
  Task task_of(const std::vector<std::string>& overrides) {
    config_ = ConfigNode::load(folder_ / "task.yaml");
    for (const auto& assignment : overrides) config_ = apply_override(config_, assignment);
    SessionParams params;
    read_params(config_, params);
    return make_task(params.task, config_, *host_);
  }
  std::string refusal(const std::string& opens_at) {
    return test::message_of<ConfigError>([&] { task_of({"manipulation.opens_at=" + opens_at}); });
  }
  std::unique_ptr<Host> host_ = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
};

TEST_F(Opening, AHandOpensAtTheEndOfTheSegmentThatReachesIt) {
  const Task task = task_of(kOpening);
  const Trajectory& trajectory = *task.trajectory;
  Vector state = trajectory.initial_state(task.manipulation);
  Index opened = 0;
  for (Index j = 0; !trajectory.released(state); ++j) {
    const double before = trajectory.progress(state);
    EXPECT_EQ(trajectory.holding(task.manipulation, state),
              before < 0.5 ? (std::vector<Index>{0, 1}) : std::vector<Index>{1});
    const auto path = trajectory.segment(task.manipulation, state, trajectory.default_controls(1).row(0).transpose());
    state = path.end_state;
    const bool is_here = before < 0.5 && trajectory.progress(state) >= 0.5;
    EXPECT_EQ(path.opening, is_here ? std::vector<Index>{0} : std::vector<Index>()) << j;
    opened += is_here ? 1 : 0;
  }
  EXPECT_EQ(opened, 1);
  // Reached only with the release: nothing opens before it.
  Task late = task;
  late.manipulation.opens_at[0] = 0.999;
  state = trajectory.initial_state(task.manipulation);
  while (!trajectory.released(state)) {
    const auto path = trajectory.segment(late.manipulation, state, trajectory.default_controls(1).row(0).transpose());
    EXPECT_TRUE(path.opening.empty());
    state = path.end_state;
  }
}

TEST_F(Opening, WithoutItNothingIsDifferent) {
  const Task plain = task_of({}), all_at_the_end = task_of({"manipulation.opens_at=[1, 1]"});
  EXPECT_EQ(plain.manipulation.opens_at.size(), 0);
  EXPECT_EQ(all_at_the_end.manipulation.opens_at.size(), 0);
}

TEST_F(Opening, WrongNumbersAreRefused) {
  for (const char* wrong : {"[0.5]", "[0.5, 0.6]", "[1, 0.5, 1]"})
    EXPECT_NE(refusal(wrong).find("manipulation.opens_at"), std::string::npos) << wrong;
  EXPECT_NE(refusal("[0, 1]").find("must be in [0.01, 1]"), std::string::npos);
}

class OpeningOf : public Opening, public testing::WithParamInterface<const char*> {};

/// Whatever the fabric: at rest its centre of mass is below the corner that is held.
TEST_P(OpeningOf, TheSheetThenHangsFromTheOtherHand) {
  const Task task = task_of({"simulator={plugin: " + std::string(GetParam()) + "}",
                             "material=" WEFT_SOURCE_DIR "/configs/fabrics/basic_isotropic.yaml"});
  const Garment& garment = *task.garment;
  const auto simulator = host_->create<Simulator>(task.simulator);
  begin(*simulator, task, task.material.at(MaterialProperties::Constant(0.5)));
  Positions targets = task.manipulation.grasp_points;
  const auto move = [&](Index frames, double rise) {
    for (Index k = 0; k < frames; ++k) {
      targets.col(2).array() += rise;
      move_hands(*simulator, task.manipulation, targets);
    }
  };
  move(90, 0.01);
  const auto row = [&](Index hand) {
    return simulator->positions().row(task.manipulation.grasp_vertices[hand]).eval();
  };
  open_hands(*simulator, task.manipulation, {0});
  open_hands(*simulator, task.manipulation, {0});  // it is open
  EXPECT_EQ(simulator->grasped(), std::vector<Index>{task.manipulation.grasp_vertices[1]});
  const double before = row(0).z();
  for (Index k = 0; k < 30; ++k) {
    move(1, 0.0);
    EXPECT_LT((row(1) - targets.row(1)).norm(), 1e-12);
  }
  EXPECT_LT(row(0).z(), before - 0.1);
  EXPECT_TRUE(simulator->settle({.speed = 0.005, .hold_frames = 40, .max_frames = 2000}).settled);
  EXPECT_LT((row(1) - targets.row(1)).norm(), 1e-12);
  Vec2 moment = Vec2::Zero();
  double weight = 0.0;
  for (Index f = 0; f < garment.faces.rows(); ++f) {
    Vec2 centre = Vec2::Zero();
    Eigen::Matrix<double, 3, 2> rest;
    for (int k = 0; k < 3; ++k) {
      centre += simulator->positions().row(garment.faces(f, k)).head<2>().transpose() / 3.0;
      rest.row(k) = garment.rest.row(garment.faces(f, k));
    }
    const Eigen::RowVector2d a = rest.row(1) - rest.row(0), b = rest.row(2) - rest.row(0);
    const double area = 0.5 * std::abs(a.x() * b.y() - a.y() * b.x());
    moment += area * centre;
    weight += area;
  }
  EXPECT_LT((moment / weight - targets.row(1).head<2>().transpose()).norm(), 0.005);
}

INSTANTIATE_TEST_SUITE_P(Simulators, OpeningOf, testing::Values("cloth", "bullet"),
                         [](const auto& tried) { return std::string(tried.param); });

TEST_F(Opening, ASessionLetsOneCornerGoAndCarriesTheOtherOn) {
  const SessionResult result = run(kOpening);
  ASSERT_TRUE(result.released);
  ASSERT_EQ(result.opened_after.size(), 2u);
  ASSERT_TRUE(result.opened_after[0]);
  EXPECT_FALSE(result.opened_after[1]);
  const Index segments = std::ssize(result.rounds), opened = *result.opened_after[0];
  ASSERT_LT(opened, segments);
  const auto file = folder_ / "session.h5";
  record(file, result);
  const SessionRecord session = read_session(file);
  EXPECT_EQ(session.opened_after, (std::vector<Index>{opened, segments}));
  EXPECT_EQ(session.held_until(0), opened * kFramesPerSegment);
  EXPECT_EQ(session.held_until(1), segments * kFramesPerSegment);
  EXPECT_EQ(nlohmann::json::parse(session.summary)["hands"]["opened_after"], nlohmann::json({opened, nullptr}));
  const Task known = task();
  const auto& held = known.manipulation.grasp_vertices;
  for (Index j = 0; j < segments; ++j) {
    const auto path = known.trajectory->segment(known.manipulation, session.rounds[j].state,
                                                session.rounds[j].controls.row(0).transpose());
    const Positions& shape = session.frames[session.segment_frame(j + 1)];
    for (const Index hand : {0, 1}) {
      const double off = (shape.row(held[hand]) - path.targets.back().row(hand)).norm();
      const bool holds = hand == 1 || j < opened;
      EXPECT_EQ(off < 1e-6, holds) << j << ": " << off;
      EXPECT_EQ(off > 0.01, !holds) << j << ": " << off;
    }
    // The plan's path of a hand ends where it opens.
    const auto& targets = session.rounds[j].targets;
    if (j + 1 == opened) {
      EXPECT_EQ(targets.back().row(0), targets[kFramesPerSegment - 1].row(0));
    }
    EXPECT_NE(targets.back().row(1), targets.front().row(1));
  }
  const SessionResult together = run();
  EXPECT_TRUE(std::none_of(together.opened_after.begin(), together.opened_after.end(),
                           [](const auto& after) { return after.has_value(); }));
  record(file, together);
  EXPECT_TRUE(read_session(file).opened_after.empty());
}

TEST_F(Opening, RolloutPredictsWhatThenHappens) {
  const SessionResult result = run(with(kOpening, {"planning={replan: false}"}));
  ASSERT_TRUE(result.released);
  const auto& plan = result.rounds.front().plan;
  ASSERT_EQ(std::ssize(plan.shapes), std::ssize(result.rounds));
  EXPECT_LT(mean_distance_mm(plan.shapes.back().mean, result.final_shape), 0.1);
  EXPECT_LT(result.error_mm, result.default_error_mm);
}

TEST_F(Opening, CorrectionsSimulateIt) {
  const SessionResult result =
      run(with(kOpening, {"correction={simulations: 3, iterations: 2, later_simulations: 2}"}));
  ASSERT_TRUE(result.opened_after[0]);
  EXPECT_NEAR(result.rounds.back().plan.predicted_error_mm, result.error_mm, 0.1);
}

TEST_F(Opening, EstimatesKnowOfIt) {
  const SessionResult result = run(with(kOpening, kEstimate));
  ASSERT_FALSE(result.estimates.empty());
  EXPECT_LT(result.estimates.back().knowledge.width.mean(), 1.0);
}

TEST_F(Opening, TheTwinFollowsFromAnySegment) {
  const Task cloth = task_of(kOpening);
  const Twin twin(cloth, {}, *host_);
  const MaterialProperties q = MaterialProperties::Constant(0.3);
  const Controls controls = cloth.trajectory->default_controls(14);
  const FoldResult whole = simulate_fold(*host_->create<Simulator>(cloth.simulator), cloth, q, controls);
  const FoldResult together = simulate_fold(*host_->create<Simulator>(cloth.simulator), task_of({}), q, controls);
  EXPECT_GT(mean_distance_mm(whole.shapes.back(), together.shapes.back()), 1.0);
  TwinState state = twin.start(q);
  for (Index j = 0; j < 6; ++j) {
    state = twin.advance(state, controls.row(j).transpose());
    EXPECT_EQ(state.positions, whole.shapes[j + 1]);
    EXPECT_EQ(twin.fold(state, controls.bottomRows(controls.rows() - j - 1)).shapes.back(), whole.shapes.back()) << j;
    // From positions and velocities alone: the contacts are found again, so the bits differ.
    TwinState seen = state;
    seen.snapshot = nullptr;
    const FoldResult rest = twin.fold(seen, controls.bottomRows(controls.rows() - j - 1));
    EXPECT_LT(mean_distance_mm(rest.shapes.back(), whole.shapes.back()), 1.0) << j;
  }
}

TEST_F(Opening, AnOpenHandHasNoLimits) {
  // Hand 0 leaves the box in the second half of its way. Hand 1, which starts to the right of it, ends to the left.
  Task task = task_of({});
  task.manipulation.grasp_points(1, 0) += 0.2;
  const Vector start = task.trajectory->initial_state(task.manipulation);
  const Controls controls = task.trajectory->default_controls(14);
  const Index u = task.trajectory->release_segment(task.manipulation, start, controls);
  Vector state = start;
  double inside = 0.0, beyond = 0.0;  // the largest x of hand 1 and of hand 0 before it opens, and of hand 0 after that
  for (Index j = 0; j < u; ++j) {
    const bool is_first = task.trajectory->progress(state) < 0.5;
    const auto path = task.trajectory->segment(task.manipulation, state, controls.row(j).transpose());
    state = path.end_state;
    for (const auto& targets : path.targets) {
      inside = std::max(inside, targets(1, 0));
      (is_first ? inside : beyond) = std::max(is_first ? inside : beyond, targets(0, 0));
    }
  }
  ASSERT_GT(beyond, inside + 0.05);
  task.hands.upper = {inside + 0.01, 9.0, 9.0};
  EXPECT_NE(within_limits(task, start, {}, controls).controls, controls);
  EXPECT_GT(limit_residuals(task, start, {}, controls, u, nullptr).maxCoeff(), 0.0);
  task.manipulation.opens_at = Vector(Eigen::Vector2d(0.5, 1.0));
  EXPECT_EQ(within_limits(task, start, {}, controls).controls, controls);
  EXPECT_EQ(limit_residuals(task, start, {}, controls, u, nullptr).maxCoeff(), 0.0);

  HandMotionMeter meter(task.hands, task.manipulation.grasp_points, {});
  meter.open({0});
  Positions away = task.manipulation.grasp_points;
  away.row(0).array() += 5.0;
  meter.add(away);
  EXPECT_EQ(meter.motion().outside, 0.0);
  EXPECT_EQ(meter.motion().speed, 0.0);
  EXPECT_EQ(meter.motion().acceleration, 0.0);
}

TEST(SeenVertex, IsTheNearestOfTheUpperLayer) {
  // A square of 2 x 2 faces whose right half lies over the left one.
  Positions shape(6, 3);
  shape << 0, 0, 0.001, 0, 1, 0.001, 1, 0, 0.001, 1, 1, 0.001, 0.1, 0, 0.003, 0.1, 1, 0.003;
  Faces faces(4, 3);
  faces << 0, 2, 1, 2, 3, 1, 2, 4, 3, 4, 5, 3;
  EXPECT_EQ(nearest_seen_vertex(shape, faces, {0.02, 0.1}), 0);
  EXPECT_EQ(nearest_seen_vertex(shape, faces, {0.08, 0.1}), 4);
  shape(0, 0) = 0.2;  // now it lies under the other half
  EXPECT_EQ(nearest_seen_vertex(shape, faces, {0.2, 0.0}), 4);
  shape.col(2) *= -1.0;  // seen from the other side
  EXPECT_EQ(nearest_seen_vertex(shape, faces, {0.2, 0.0}), 0);
}

TEST_F(Opening, AVertexCanBeChosenByItsPlace) {
  const Task named = task_of({});
  const Positions& flat = named.garment->positions;
  const Index corner = named.garment->vertex("right_top");
  const auto near_corner = [&](double x, double y) {
    return "manipulation.grasp=[left_bottom, \"nearest(" + std::to_string(x) + ", " + std::to_string(y) + ")\"]";
  };
  const Task chosen = task_of({near_corner(flat(corner, 0) + 0.01, flat(corner, 1) - 0.01)});
  EXPECT_EQ(chosen.manipulation.grasp_vertices[1], corner);
  const Index left = named.garment->vertex("left_bottom");
  EXPECT_NE(test::message_of<ConfigError>([&] {
              task_of({near_corner(flat(left, 0), flat(left, 1))});
            }).find("another hand holds already"),
            std::string::npos);
  for (const char* wrong : {"nearest(0.1)", "nearest(0.1, 0.2", "nearest(0.1, nan)", "nearest(0.1, 0.2) of all"})
    EXPECT_NE(test::message_of<ConfigError>([&] {
                task_of({"manipulation.grasp=[left_bottom, \"" + std::string(wrong) + "\"]"});
              }).find(std::string(wrong) + "\" (a text), must be nearest(x, y) with two numbers"),
              std::string::npos)
        << wrong;
}

TEST_F(Opening, TheNextFoldTakesWhatIsSeen) {
  // The left edge was folded over to the right: it lies on the right edge, and above it.
  const SessionResult first = run();
  const auto file = folder_ / "first.h5";
  record(file, first);
  const Positions& seen = first.rounds.back().observed;
  const Task flat = task();
  const Index above = flat.garment->vertex("left_top");
  std::string at = "nearest(" + std::to_string(seen(above, 0)) + ", " + std::to_string(seen(above, 1)) + ")";
  const Task next = task_of({"start.session=" + file.string(), "manipulation.grasp=[\"" + at + "\", right_bottom]",
                             "manipulation.displacement_m=[0, 0.2]"});
  EXPECT_EQ(next.manipulation.grasp_vertices[0], above);
  EXPECT_EQ(next.manipulation.grasp_points.row(0).head<2>(), seen.row(above).head<2>());
}

}  // namespace
}  // namespace weft
