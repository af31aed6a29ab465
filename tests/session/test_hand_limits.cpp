// The limits of the hands: what plans execute, the penalty, and sessions.
#include <gtest/gtest.h>

#include <cmath>

#include "session/towel_session.hpp"
#include "simulation/hand_limits.hpp"
#include "simulation/random_controls.hpp"
#include "trajectory/arc/arc.hpp"
#include "unit/serial_host.hpp"
#include "unit/test_support.hpp"
#include "weft/config.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

/// Two hands 0.4 m apart that fold over 0.5 m; a trajectory plugin by name.
Task hands_task(const std::string& trajectory, Host& host) {
  Task task;
  task.manipulation.grasp_vertices = {0, 1};
  task.manipulation.grasp_points.resize(2, 3);
  task.manipulation.grasp_points << 0.0, 0.2, 0.002, 0.03, -0.2, 0.002;
  task.manipulation.displacement = {0.5, 0.05};
  task.manipulation.contact_height = 0.002;
  task.trajectory = host.create<Trajectory>(ConfigNode::parse("{plugin: " + trajectory + "}", "test"));
  return task;
}

/// Executes controls until the release, as a session does.
HandMotion executed(const Task& task, const Controls& controls) {
  const auto& trajectory = *task.trajectory;
  Vector state = trajectory.initial_state(task.manipulation);
  HandMotionMeter meter(task.hands, trajectory.targets(task.manipulation, state), {});
  for (Index j = 0; j < controls.rows() && !trajectory.released(state); ++j) {
    const SegmentPath path = trajectory.segment(task.manipulation, state, controls.row(j).transpose());
    for (const auto& targets : path.targets) meter.add(targets);
    state = path.end_state;
  }
  return meter.motion();
}

struct Case {
  const char* name;
  const char* trajectory;
  HandLimits limits;
};

HandLimits limits(double speed, double acceleration, double distance = 0.0) {
  return {.speed = speed, .acceleration = acceleration, .distance = distance};
}

HandLimits boxed(HandLimits hands, const Vec3& lower, const Vec3& upper) {
  hands.lower = lower;
  hands.upper = upper;
  return hands;
}

class HandLimitsOf : public testing::TestWithParam<Case> {
 protected:
  std::shared_ptr<Host> host_ = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
};

TEST_P(HandLimitsOf, HoldOnEveryFrameOfAThousandRandomPlans) {
  Task task = hands_task(GetParam().trajectory, *host_);
  const HandLimits& hands = task.hands = GetParam().limits;
  const Vector start = task.trajectory->initial_state(task.manipulation);
  Index exceeding = 0, released = 0;
  for (std::uint64_t seed = 0; seed < 1000; ++seed) {
    RandomStream random(seed, stream_key("hand"));
    RandomControlsParams wild;
    wild.drift = 2.0;
    wild.walk = 2.0;
    const Controls controls = random_controls(*task.trajectory, 24, wild, random);
    const HandMotion unlimited = executed(task, controls);
    if (unlimited.speed > hands.speed || unlimited.acceleration > hands.acceleration || unlimited.outside > 0.0 ||
        unlimited.distance < hands.distance)
      ++exceeding;
    const LimitedControls limited = within_limits(task, start, {}, controls);
    ASSERT_TRUE(limited.kept);
    const HandMotion motion = executed(task, limited.controls);
    EXPECT_LE(motion.speed, 1.001 * hands.speed) << seed;
    EXPECT_LE(motion.acceleration, 1.001 * hands.acceleration) << seed;
    EXPECT_EQ(motion.outside, 0.0) << seed;
    EXPECT_GE(motion.distance, hands.distance) << seed;
    const Controls states = task.trajectory->segment_states(task.manipulation, start, limited.controls);
    released += task.trajectory->released(states.bottomRows(1).transpose()) ? 1 : 0;
  }
  EXPECT_GT(exceeding, 500) << "the limits are so wide that the test shows little";
  EXPECT_GT(released, 0) << "nothing gets to the end";
}

INSTANTIATE_TEST_SUITE_P(
    Trajectories, HandLimitsOf,
    testing::Values(Case{"Both", "arc", limits(0.3, 10.0)},
                    Case{"All", "arc", boxed(limits(0.3, 15.0, 0.1), {-0.02, -0.3, 0.0}, {0.55, 0.3, 0.22})},
                    Case{"Fling", "fling", limits(1.0, 10.0)}, Case{"Drag", "drag", limits(0.5, 5.0)},
                    Case{"Keyframes", "keyframes", limits(0.5, 5.0)},
                    Case{"Spline", "spline", boxed(limits(0.3, 15.0, 0.1), {-0.02, -0.3, 0.0}, {0.55, 0.3, 0.22})}),
    [](const auto& tried) { return tried.param.name; });

TEST(HandLimits, ControlsWithinThemStayAsTheyAre) {
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  Task task = hands_task("arc", *host);
  task.hands = boxed(limits(2.0, 100.0, 0.1), {-1, -1, 0}, {1, 1, 1});
  const Controls controls = task.trajectory->default_controls(12);
  const LimitedControls limited = within_limits(task, task.trajectory->initial_state(task.manipulation), {}, controls);
  EXPECT_EQ(limited.controls, controls);
  EXPECT_TRUE(limited.kept);
}

TEST(HandLimits, SlowedControlsTakeTheSameWay) {
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  Task task = hands_task("arc", *host);
  const Controls controls = task.trajectory->default_controls(40);
  const Vector start = task.trajectory->initial_state(task.manipulation);
  const Index u = task.trajectory->release_segment(task.manipulation, start, controls);
  task.hands = limits(0.2, 10.0);
  const LimitedControls limited = within_limits(task, start, {}, controls);
  EXPECT_GT(task.trajectory->release_segment(task.manipulation, start, limited.controls), u);
  // Where the parts of a row end, the hands are where the whole row would have brought them.
  const Controls before = task.trajectory->segment_states(task.manipulation, start, controls);
  const Controls after = task.trajectory->segment_states(task.manipulation, start, limited.controls);
  for (Index j = 0; j + 1 < 40 && limited.rows[j] < u; ++j) {
    if (limited.rows[j + 1] == limited.rows[j]) continue;
    EXPECT_LT((before.row(limited.rows[j]) - after.row(j)).cwiseAbs().maxCoeff(), 1e-9) << j;
  }
}

TEST(HandLimits, SpeedIsCarriedOverFromTheFrameBefore) {
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  Task task = hands_task("arc", *host);
  task.hands = limits(HandLimits::kNone, 12.0);
  const Controls controls = task.trajectory->default_controls(12);
  const Vector start = task.trajectory->initial_state(task.manipulation);
  const Controls states = task.trajectory->segment_states(task.manipulation, start, controls);
  const Vector middle = states.row(2).transpose();
  const Positions step = last_step(task, states.row(1).transpose(), controls.row(2).transpose());
  // It goes on as before: nothing to slow. From rest it must begin slowly.
  EXPECT_EQ(within_limits(task, middle, step, controls.topRows(3)).parts.front(), 1);
  EXPECT_GT(within_limits(task, middle, {}, controls.topRows(3)).parts.front(), 1);
  // Backwards at once: no speed of the first row helps.
  EXPECT_FALSE(within_limits(task, middle, -4.0 * step, controls.topRows(3)).kept);
}

TEST(HandLimits, GradientsOfThePenalty) {
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  Task task = hands_task("arc", *host);
  task.hands = boxed(limits(0.2, 8.0, 0.45), {-0.02, -0.25, 0.0}, {0.3, 0.3, 0.12});
  const Vector start = task.trajectory->initial_state(task.manipulation);
  RandomStream random(3, stream_key("hand"));
  const Controls controls = random_controls(*task.trajectory, 6, {}, random);
  const Positions step = Positions::Constant(2, 3, 1e-3);
  std::vector<Controls> gradients;
  const Vector at = limit_residuals(task, start, step, controls, 5, &gradients);
  ASSERT_EQ(at.size(), 24);
  for (int kind = 0; kind < 4; ++kind) {
    double most = 0.0;
    for (Index j = 0; j < 5; ++j) most = std::max(most, at(4 * j + kind));
    EXPECT_GT(most, 0.01) << "kind " << kind << " is not exceeded";
  }
  EXPECT_EQ(at.tail(4), Vector::Zero(4));
  const auto variables = task.trajectory->controls();
  for (Index j = 0; j < 5; ++j) {
    for (Index c = 0; c < controls.cols(); ++c) {
      const double h = 1e-5 * variables[c].scale;
      Controls up = controls, down = controls;
      up(j, c) += h;
      down(j, c) -= h;
      const Vector change =
          (limit_residuals(task, start, step, up, 5, nullptr) - limit_residuals(task, start, step, down, 5, nullptr)) /
          (2.0 * h);
      for (Index i = 0; i < at.size(); ++i) {
        const double found = gradients[i].size() == 0 ? 0.0 : gradients[i](j, c);
        EXPECT_NEAR(found * variables[c].scale, change(i) * variables[c].scale, 1e-4 * (1.0 + std::abs(at(i))))
            << "residual " << i << ", control " << j << ", " << c;
      }
    }
  }
}

class HandSession : public Session {};

TEST_F(HandSession, PlansAndCorrectionsKeepThem) {
  const std::vector<std::string> slow = {
      "manipulation.limits={speed_m_per_s: 0.5, acceleration_m_per_s2: 15, workspace_m: [-1, -1, 0, 1, 1, 0.17]}",
      "planning.iterations=2", "goal.horizon=40", "planning.horizon=25", "max_segments=30"};
  for (const auto& more : {std::vector<std::string>{}, {"correction={simulations: 2, later_simulations: 2}"}}) {
    const SessionResult result = run(with(slow, more));
    EXPECT_TRUE(result.released);
    EXPECT_LE(result.hands.speed, 0.5 * 1.001);
    EXPECT_LE(result.hands.acceleration, 15.0 * 1.001);
    EXPECT_EQ(result.hands.outside, 0.0);
    EXPECT_GT(result.hands.speed, 0.1);
  }
  EXPECT_GT(run({"planning.iterations=2"}).hands.acceleration, 15.0);
}

TEST_F(HandSession, HandsThatGraspOutsideTheirLimitsAreRefused) {
  const auto refused = [&](const std::string& limits) {
    return test::message_of<ConfigError>([&] { run({"manipulation.limits=" + limits}); });
  };
  EXPECT_NE(refused("{workspace_m: [5, 5, 0, 6, 6, 1]}").find("does not hold a grasped vertex"), std::string::npos);
  EXPECT_NE(refused("{distance_m: 3}").find("manipulation.limits.distance_m"), std::string::npos);
}

}  // namespace
}  // namespace weft
