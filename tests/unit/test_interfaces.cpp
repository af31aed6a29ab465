#include "unit/test_support.hpp"
#include "unit/toy_trajectory.hpp"
#include "weft/error.hpp"
#include "weft/optimiser.hpp"
#include "weft/predictor.hpp"
#include "weft/simulator.hpp"

namespace weft {
namespace {

using test::message_of;
using test::ToyTrajectory;

Manipulation two_hands() {
  Manipulation m;
  m.grasp_points = Positions::Zero(2, 3);
  m.grasp_points(1, 0) = 0.4;
  return m;
}

TEST(Trajectory, SegmentGivesTheTargetsAfterEachFrame) {
  const ToyTrajectory toy;
  const SegmentPath path = toy.segment(two_hands(), Vector::Constant(1, 0.5), Vector::Constant(1, 0.01));
  ASSERT_EQ(path.targets.size(), static_cast<std::size_t>(kFramesPerSegment));
  EXPECT_NEAR(path.targets.front()(0, 2), 0.51, 1e-12);
  EXPECT_NEAR(path.targets.back()(1, 2), 0.62, 1e-12);
  EXPECT_EQ(path.targets.back()(1, 0), 0.4);
  EXPECT_NEAR(path.end_state[0], 0.62, 1e-12);
}

TEST(Trajectory, SegmentStatesChainTheSegments) {
  const ToyTrajectory toy;
  Controls controls(3, 1);
  controls << 0.01, 0.0, 0.02;
  const Controls states = toy.segment_states(two_hands(), Vector::Zero(1), controls);
  ASSERT_EQ(states.rows(), 3);
  EXPECT_NEAR(states(0, 0), 0.12, 1e-12);
  EXPECT_NEAR(states(1, 0), 0.12, 1e-12);
  EXPECT_NEAR(states(2, 0), 0.36, 1e-12);
  Vector state = Vector::Zero(1);
  for (Index j = 0; j < 3; ++j) {
    state = toy.segment(two_hands(), state, controls.row(j).transpose()).end_state;
    EXPECT_EQ(states(j, 0), state[0]) << "the same sum in the same order";
  }
}

TEST(Trajectory, ReleaseSegmentIsTheFirstThatReachesItOrTheLast) {
  const ToyTrajectory toy;  // progress is the height; 0.12 m per segment at 0.01 m per frame
  const auto release = [&](double start, Index segments) {
    return toy.release_segment(two_hands(), Vector::Constant(1, start), toy.default_controls(segments));
  };
  EXPECT_EQ(release(0.0, 20), 9);  // 8 segments: 0.96 m, 9: 1.08 m
  EXPECT_EQ(release(0.9, 20), 1);
  EXPECT_EQ(release(5.0, 20), 1);
  EXPECT_EQ(release(0.0, 4), 4);
  EXPECT_THROW(release(0.0, 0), ShapeError);
}

TEST(Trajectory, DefaultControlsRepeatTheDefaultControl) {
  EXPECT_EQ(ToyTrajectory().default_controls(2), Controls::Constant(2, 1, 0.01));
  EXPECT_EQ(ToyTrajectory().default_controls(0).rows(), 0);
}

/// Only what has no default.
class BareSimulator final : public Simulator {
 public:
  SimulatorCapabilities capabilities() const override { return {}; }
  void reset(std::shared_ptr<const Garment>, const Fabric&, const Scene&) override {}
  void set_state(const Positions&, const Positions&, std::span<const Index>) override {}
  void grasp(std::span<const Index>) override {}
  std::vector<Index> grasped() const override { return {}; }
  void step(const Positions&) override {}
  void release(std::span<const Index>) override {}
  void release() override {}
  SettleResult settle(const SettleCriterion&) override { return {}; }
  const Positions& positions() const override { return none_; }
  const Positions& velocities() const override { return none_; }
  Index frame() const override { return 0; }
  SimulatorDiagnostics diagnostics() const override { return {}; }

 private:
  Positions none_;
};

class BarePrediction final : public Prediction {
 public:
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return shapes_; }
  const std::string& failure(std::size_t) const override { return failure_; }
  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>&) const override { return {}; }

 private:
  std::vector<std::vector<ShapeDistribution>> shapes_;
  std::string failure_;
};

TEST(Trajectory, DecisionsAreTheControlsRowByRowUnlessOverridden) {
  const ToyTrajectory toy;
  const Vector state = Vector::Zero(1), x = Vector::LinSpaced(3, 0.01, 0.03);
  EXPECT_EQ(toy.decision_size(3), 3);
  EXPECT_EQ(toy.decode(x, 3, state), Controls(x));
  EXPECT_EQ(toy.encode(Controls(x), state), x);
  EXPECT_EQ(toy.decode_pullback(x, 3, state, Controls(2.0 * x)), 2.0 * x);
  EXPECT_EQ(toy.decision_bounds(3).upper, Vector::Constant(3, 0.1));
  EXPECT_EQ(toy.decision_scale(3), Vector::Constant(3, 0.01));
  EXPECT_THROW(toy.decision_size(-1), ShapeError);
  EXPECT_THROW(toy.decode(x, 2, state), ShapeError);
  EXPECT_THROW(toy.decode(x, 3, Vector::Zero(2)), ShapeError);
  EXPECT_THROW(toy.decode_pullback(x, 3, state, Controls::Zero(2, 1)), ShapeError);
  EXPECT_THROW(toy.encode(Controls::Zero(3, 2), state), ShapeError);
  EXPECT_THROW(toy.advance({}, state, Vector::Zero(2)), ShapeError);
}

/// Bends the sum, so that every frame has its own derivative: s' = s + c (1 + s), c constant in a segment.
class Growing final : public ToyTrajectory {
 public:
  Vector advance(const Manipulation&, ConstVec state, ConstVec control) const override {
    return state + control * (1.0 + state[0]);
  }
  void advance_pullback(const Manipulation&, ConstVec state, ConstVec control, ConstVec d_next, Vector& d_state,
                        Vector& d_control) const override {
    d_state = d_next * (1.0 + control[0]);
    d_control = d_next * (1.0 + state[0]);
  }
};

TEST(Trajectory, PullbackOfStatesIsTheChainThroughAllFrames) {
  const Growing growing;
  const Vector start = Vector::Constant(1, 0.2), weight = Vector::LinSpaced(3, 1.0, -2.0);
  Controls controls(3, 1);
  controls << 0.01, 0.03, -0.02;
  // L = sum_j weight_j s_j + 5 c_0
  const auto loss = [&](const Vector& from, const Controls& c) {
    return growing.segment_states({}, from, c).col(0).dot(weight) + 5.0 * c(0, 0);
  };
  Controls gradient = Controls::Zero(4, 1);  // a row more than there are segments
  gradient(0, 0) = 5.0;
  gradient(3, 0) = 7.0;
  const auto add = [&](Index j, Vector& d_state) { d_state[0] += weight[j]; };
  const Vector d_start = growing.pullback_states({}, start, controls, add, gradient);
  constexpr double h = 1e-6;
  for (Index j = 0; j < 3; ++j) {
    Controls up = controls, down = controls;
    up(j, 0) += h;
    down(j, 0) -= h;
    EXPECT_NEAR(gradient(j, 0), (loss(start, up) - loss(start, down)) / (2.0 * h), 1e-6) << j;
  }
  EXPECT_EQ(gradient(3, 0), 7.0);
  const Vector step = Vector::Constant(1, h);
  EXPECT_NEAR(d_start[0], (loss(start + step, controls) - loss(start - step, controls)) / (2.0 * h), 1e-6);
  Controls short_gradient = Controls::Zero(2, 1);
  EXPECT_THROW(growing.pullback_states({}, start, controls, add, short_gradient), ShapeError);
}

TEST(Interfaces, UndeclaredAbilitiesThrowUnsupported) {
  BareSimulator simulator;
  EXPECT_THROW(simulator.save(), Unsupported);
  EXPECT_THROW(simulator.restore(SimulatorSnapshot()), Unsupported);
  EXPECT_THROW(BarePrediction().jvp({}), Unsupported);
}

TEST(Interfaces, EveryOptimiserStatusHasAName) {
  EXPECT_STREQ(to_string(OptimiserStatus::converged), "converged");
  EXPECT_STREQ(to_string(OptimiserStatus::budget_spent), "budget_spent");
  EXPECT_STREQ(to_string(OptimiserStatus::stopped), "stopped");
  EXPECT_STREQ(to_string(OptimiserStatus::diverged), "diverged");
  EXPECT_STREQ(to_string(OptimiserStatus::infeasible), "infeasible");
}

TEST(Interfaces, ErrorsAreErrorsAndSayGotAndWanted) {
  EXPECT_EQ(message_of<ShapeError>([] { require_shape("toy: x", 3, 5); }), "toy: x = 3, must be 5");
  EXPECT_NO_THROW(require_shape("toy: x", 5, 5));
  EXPECT_THROW(throw ShapeError("x"), Error);
  EXPECT_THROW(throw ConfigError("x"), Error);
  EXPECT_THROW(throw PluginError("x"), Error);
  EXPECT_THROW(throw Unsupported("x"), Error);
  EXPECT_THROW(throw Diverged("x"), Error);
}

TEST(Interfaces, KnowledgeIsAnIntervalClippedToTheUnitInterval) {
  const MaterialKnowledge none = MaterialKnowledge::none();
  EXPECT_EQ(none.lower(), PropertyVector::Zero());
  EXPECT_EQ(none.upper(), PropertyVector::Ones());
  MaterialKnowledge k;
  k.centre << 0.5, 0.05, 0.95, 0.4;
  k.width << 0.2, 0.2, 0.2, 0.0;
  EXPECT_TRUE(k.lower().isApprox(PropertyVector(0.4, 0.0, 0.85, 0.4)));
  EXPECT_TRUE(k.upper().isApprox(PropertyVector(0.6, 0.15, 1.0, 0.4)));
  EXPECT_EQ(MaterialKnowledge::certain(k.centre).lower(), k.centre);
}

TEST(Interfaces, PluginInfoHoldsKindNameVersionAndAbi) {
  constexpr WeftPluginInfo info = make_plugin_info<Trajectory>("toy", "1.2.3");
  EXPECT_STREQ(info.magic, "weftplu");
  EXPECT_STREQ(info.kind, "trajectory");
  EXPECT_STREQ(info.name, "toy");
  EXPECT_STREQ(info.version, "1.2.3");
  EXPECT_EQ(info.interface_version, Trajectory::kVersion);
  EXPECT_STREQ(info.abi_tag, WEFT_ABI_TAG);
}

}  // namespace
}  // namespace weft
