// The rollout predictor on a simulator whose every derivative is known.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>

#include "predictor/rollout/rollout.cpp"  // the classes are compiled in: what is tested here does not need the loader
#include "trajectory/arc/arc.cpp"
#include "unit/serial_host.hpp"
#include "unit/test_support.hpp"

namespace weft::rollout {
namespace {

/// Linear in the targets and smooth in the material: every frame each vertex goes a share of the way to the mean
/// target; the share depends on the vertex and on the fabric. Release halves all heights.
class ToySimulator final : public Simulator {
 public:
  struct Snapshot final : SimulatorSnapshot {
    Positions positions;
    bool holds = false;
  };
  ToySimulator(bool snapshots, std::atomic<int>& steps, double diverge_above, std::vector<Index>& settled)
      : snapshots_(snapshots), steps_(steps), diverge_above_(diverge_above), settled_(settled) {}

  SimulatorCapabilities capabilities() const override { return {.snapshots = snapshots_}; }
  void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene&) override {
    positions_ = garment->positions;
    velocities_ = Positions::Zero(positions_.rows(), 3);
    friction_ = fabric.friction;
    thickness_ = fabric.thickness_m;
  }
  void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) override {
    positions_ = positions;
    velocities_ = velocities;
    holds_ = !grasped.empty();
  }
  void grasp(std::span<const Index>) override { holds_ = true; }
  std::vector<Index> grasped() const override { return {0, 1}; }
  void step(const Positions& targets) override {
    ++steps_;
    if (targets.col(0).maxCoeff() > diverge_above_) throw Diverged("toy: frame 1: not finite");
    const Eigen::RowVector3d goal = targets.colwise().mean();
    for (Index v = 0; v < positions_.rows(); ++v) {
      const double share = 0.02 * static_cast<double>(v + 1) * friction_ + 5.0 * thickness_ * thickness_ * 1e3;
      positions_.row(v) += share * (goal - positions_.row(v));
    }
  }
  void release(std::span<const Index>) override { holds_ = false; }
  void release() override { holds_ = false; }
  SettleResult settle(const SettleCriterion& criterion) override {
    const Index frames = std::min<Index>(criterion.max_frames, 40);
    positions_.col(2) *= std::pow(0.9, static_cast<double>(frames));
    settled_.push_back(frames);
    return {.frames = frames, .settled = criterion.max_frames >= 40};
  }
  const Positions& positions() const override { return positions_; }
  const Positions& velocities() const override { return velocities_; }
  Index frame() const override { return 0; }
  SimulatorDiagnostics diagnostics() const override { return {}; }
  std::shared_ptr<const SimulatorSnapshot> save() const override {
    if (!snapshots_) return Simulator::save();
    auto copy = std::make_shared<Snapshot>();
    copy->positions = positions_;
    copy->holds = holds_;
    return copy;
  }
  void restore(const SimulatorSnapshot& snapshot) override {
    if (!snapshots_) Simulator::restore(snapshot);
    positions_ = static_cast<const Snapshot&>(snapshot).positions;
    holds_ = static_cast<const Snapshot&>(snapshot).holds;
  }

 private:
  bool snapshots_;
  std::atomic<int>& steps_;
  double diverge_above_;
  std::vector<Index>& settled_;
  Positions positions_, velocities_;
  double friction_ = 0, thickness_ = 0;
  bool holds_ = false;
};

class ToyHost final : public test::SerialHost {
 public:
  bool snapshots = true;
  double diverge_above = 1e9;
  std::atomic<int> steps{0};
  std::vector<Index> settled;  ///< frames of every settle()

 protected:
  std::shared_ptr<void> create_erased(const std::string&, const ConfigNode&) override {
    return std::static_pointer_cast<void>(
        std::static_pointer_cast<Simulator>(std::make_shared<ToySimulator>(snapshots, steps, diverge_above, settled)));
  }
};

Task toy_task() {
  Garment garment;
  garment.positions.resize(4, 3);
  garment.positions << 0, 0, 0, 0, 0.4, 0, 0.4, 0, 0, 0.4, 0.4, 0;
  garment.rest = garment.positions.leftCols<2>();
  garment.faces.resize(2, 3);
  garment.faces << 0, 2, 1, 2, 3, 1;
  Task task;
  task.garment = std::make_shared<const Garment>(garment);
  task.material.ranges[0] = {0.1, 1.0, false};
  task.material.ranges[1] = {0.1, 10.0, true};
  task.material.ranges[2] = {0.2, 5.0, true};
  task.material.ranges[3] = {0.0005, 0.004, false};
  task.manipulation.grasp_vertices = {0, 1};
  task.manipulation.grasp_points = garment.positions.topRows(2);
  task.manipulation.displacement = {0.8, 0.0};
  task.trajectory = std::make_shared<arc::Arc>(arc::Params());
  task.simulator = ConfigNode::parse("{plugin: toy}", "test");
  return task;
}

PredictionCase toy_case(const Task& task, Index horizon = 12) {
  PredictionCase one;
  one.shape = std::make_shared<const Positions>(task.garment->positions);
  one.state = task.trajectory->initial_state(task.manipulation);
  one.controls = task.trajectory->default_controls(horizon);
  for (Index j = 0; j < horizon; ++j) {
    one.controls(j, 0) = 1.6 + 0.05 * static_cast<double>(j);
    one.controls(j, 2) = 0.1 * std::sin(static_cast<double>(j));
    one.controls(j, 3) = 2e-4;
  }
  one.knowledge.centre << 0.4, 0.5, 0.6, 0.3;
  one.knowledge.width << 0.3, 0.2, 0.4, 0.2;
  one.segments = {2, 5, task.trajectory->release_segment(task.manipulation, one.state, one.controls)};
  return one;
}

/// A loss that weighs mean and sigma of all requested shapes.
double loss_of(const std::vector<ShapeDistribution>& shapes, std::vector<ShapeCotangent>* cotangents) {
  double loss = 0.0;
  if (cotangents) cotangents->clear();
  for (std::size_t k = 0; k < shapes.size(); ++k) {
    const Positions& mean = shapes[k].mean;
    const Positions& sigma = shapes[k].sigma;
    loss += mean.squaredNorm() + 3.0 * sigma.sum();
    if (cotangents) cotangents->push_back({2.0 * mean, Positions::Constant(sigma.rows(), 3, 3.0)});
  }
  return loss;
}

struct Bound {
  ToyHost host;
  std::unique_ptr<RolloutPredictor> predictor;
  Task task = toy_task();
  explicit Bound(Params params, bool snapshots = true) {
    host.snapshots = snapshots;
    predictor = std::make_unique<RolloutPredictor>(params, host);
    predictor->bind(task);
  }
};

Params fine(std::int64_t samples) {
  Params params;
  params.samples = samples;
  params.step = 1e-3;
  params.knowledge_step = 1e-4;
  params.difference_settle_frames = 0;
  params.difference = "central";
  return params;
}

TEST(Rollout, PullbackEqualsDerivativeOfPredict) {
  Bound toy(fine(5));
  const PredictionCase one = toy_case(toy.task);
  const auto prediction = toy.predictor->predict({one}, {.gradients = true});
  std::vector<ShapeCotangent> cotangents;
  loss_of(prediction->shapes()[0], &cotangents);
  const CaseGradient gradient = prediction->pullback({cotangents})[0];
  const auto loss_with = [&](const PredictionCase& changed) {
    return loss_of(toy.predictor->predict({changed}, {})->shapes()[0], nullptr);
  };
  const auto variables = toy.task.trajectory->controls();
  double largest = 0.0;
  for (Index j = 0; j < one.segments.back(); ++j) {
    for (Index c = 0; c < one.controls.cols(); ++c) {
      const double h = 1e-4 * variables[c].scale;
      PredictionCase up = one, down = one;
      up.controls(j, c) += h;
      down.controls(j, c) -= h;
      const double expected = (loss_with(up) - loss_with(down)) / (2 * h);
      const double scale = variables[c].scale;
      EXPECT_NEAR(gradient.controls(j, c) * scale, expected * scale, 1e-5) << "segment " << j << " control " << c;
      largest = std::max(largest, std::abs(expected * scale));
    }
  }
  EXPECT_GT(largest, 1e-2);  // the comparison is about numbers that differ from zero
  for (Index p = 0; p < 4; ++p) {
    for (auto member : {&MaterialKnowledge::centre, &MaterialKnowledge::width}) {
      PredictionCase up = one, down = one;
      (up.knowledge.*member)(p) += 1e-5;
      (down.knowledge.*member)(p) -= 1e-5;
      const double expected = (loss_with(up) - loss_with(down)) / 2e-5;
      const double got = member == &MaterialKnowledge::centre ? gradient.centre(p) : gradient.width(p);
      EXPECT_NEAR(got, expected, 1e-5) << "property " << p;
    }
  }
}

TEST(Rollout, JvpEqualsDerivativeOfPredict) {
  Bound toy(fine(5));
  const PredictionCase one = toy_case(toy.task);
  const auto variables = toy.task.trajectory->controls();
  RandomStream random(3);
  std::vector<CaseDirection> directions(3);
  for (auto& d : directions) d.controls = Controls::Zero(one.controls.rows(), one.controls.cols());
  directions[0].controls(4, 3) = variables[3].scale;  // one control of a late segment
  for (Index j = 0; j < one.controls.rows(); ++j)
    for (Index c = 0; c < one.controls.cols(); ++c)
      for (std::size_t d : {1u, 2u}) directions[d].controls(j, c) = variables[c].scale * random.normal();
  directions[2].centre << 0.3, -0.2, 0.1, 0.4;
  directions[2].width << -0.1, 0.2, 0.3, -0.4;
  const auto slopes = toy.predictor->predict({one}, {.gradients = true})->jvp({directions})[0];
  ASSERT_EQ(slopes.size(), 3u);
  for (std::size_t d = 0; d < 3; ++d) {
    ASSERT_EQ(slopes[d].size(), 3u);
    const double h = 1e-5;
    std::vector<PredictionCase> sides(2, one);
    for (std::size_t side : {0u, 1u}) {
      const double step = side == 0 ? h : -h;
      sides[side].controls += step * directions[d].controls;
      sides[side].knowledge.centre += step * directions[d].centre;
      sides[side].knowledge.width += step * directions[d].width;
    }
    const auto there = toy.predictor->predict(sides, {});
    for (std::size_t s = 0; s < 3; ++s) {
      const Positions mean = (there->shapes()[0][s].mean - there->shapes()[1][s].mean) / (2 * h);
      const Positions sigma = (there->shapes()[0][s].sigma - there->shapes()[1][s].sigma) / (2 * h);
      EXPECT_LT((slopes[d][s].mean - mean).norm(), 1e-4 * (mean.norm() + 1e-3)) << d << " " << s;
      EXPECT_LT((slopes[d][s].sigma - sigma).norm(), 1e-3 * (sigma.norm() + 1e-3)) << d << " " << s;
    }
    EXPECT_GT(slopes[d].back().mean.norm(), 1e-3);
  }
  EXPECT_TRUE(slopes[0][0].mean.isZero(0.0));  // segment 2 comes before the control of segment 5
}

TEST(Rollout, JvpSimulatesOnlyWhatADirectionChanges) {
  Params params;  // forward differences, one sample
  Bound toy(params);
  const PredictionCase one = toy_case(toy.task);
  const Index u = one.segments.back();
  const auto prediction = toy.predictor->predict({one}, {.gradients = true, .knowledge_gradients = false});
  const auto steps_of = [&](Index segment) {
    CaseDirection d;
    d.controls = Controls::Zero(one.controls.rows(), one.controls.cols());
    d.controls(segment, 2) = 1.0;
    toy.host.steps = 0;
    const auto slopes = prediction->jvp({{d}});
    EXPECT_EQ(slopes[0][0].back().mean.isZero(0.0), segment >= u);
    return toy.host.steps.load();
  };
  EXPECT_EQ(steps_of(0), kFramesPerSegment * u);
  EXPECT_EQ(steps_of(u - 1), kFramesPerSegment);
  EXPECT_EQ(steps_of(u), 0);  // after the release
}

TEST(Rollout, JvpStepsInwardsAtABound) {
  Params params;
  Bound toy(params);
  PredictionCase one = toy_case(toy.task);
  const auto variables = toy.task.trajectory->controls();
  one.controls(1, 3) = variables[3].upper;
  CaseDirection d;
  d.controls = Controls::Zero(one.controls.rows(), one.controls.cols());
  d.controls(1, 3) = 2.0 * variables[3].scale;
  const auto prediction = toy.predictor->predict({one}, {.gradients = true});
  PredictionCase inside = one;
  inside.controls(1, 3) -= params.step * variables[3].scale;
  const Positions there = toy.predictor->predict({inside}, {})->shapes()[0].back().mean;
  const Positions wanted = (prediction->shapes()[0].back().mean - there) / (0.5 * params.step);
  EXPECT_LT((prediction->jvp({{d}})[0][0].back().mean - wanted).norm(), 1e-9 * wanted.norm());
}

TEST(Rollout, SnapshotsChangeNothingButTheCost) {
  Bound with(fine(2), true), without(fine(2), false);
  const PredictionCase one = toy_case(with.task);
  std::vector<CaseGradient> gradients;
  for (Bound* toy : {&with, &without}) {
    toy->host.steps = 0;
    const auto prediction = toy->predictor->predict({one}, {.gradients = true, .knowledge_gradients = false});
    std::vector<ShapeCotangent> cotangents;
    loss_of(prediction->shapes()[0], &cotangents);
    gradients.push_back(prediction->pullback({cotangents})[0]);
  }
  EXPECT_EQ(gradients[0].controls, gradients[1].controls);
  EXPECT_LT(with.host.steps, 0.7 * without.host.steps);
}

TEST(Rollout, DifferencesAreTakenBeforeTheClothHasSettled) {
  Params params;
  params.difference_settle_frames = 12;
  Bound toy(params), settled(fine(1));
  const PredictionCase one = toy_case(toy.task);
  CaseDirection d;
  d.controls = Controls::Zero(one.controls.rows(), one.controls.cols());
  d.controls(1, 1) = 1.0;  // dr: moves the hands up and sideways, linearly
  const auto prediction = toy.predictor->predict({one}, {.gradients = true, .knowledge_gradients = false});
  const auto whole = settled.predictor->predict({one}, {.gradients = true, .knowledge_gradients = false});
  const auto slope = prediction->jvp({{d}})[0][0], whole_slope = whole->jvp({{d}})[0][0];
  // The unperturbed run settles to the end, its 12 first frames counted; the perturbed one ends after 12.
  EXPECT_EQ(toy.host.settled, (std::vector<Index>{12, 40, 12}));
  const Positions &early = slope.back().mean, &late = whole_slope.back().mean;
  EXPECT_LT((early.col(0) - late.col(0)).norm(), 1e-6 * late.col(0).norm());
  EXPECT_GT(late.col(2).norm(), 1e-6);
  // In the toy only the heights settle. In derivatives they are 12 frames old, those of shapes and those of values
  // alike.
  EXPECT_LT((std::pow(0.9, 28) * early.col(2) - late.col(2)).norm(), 1e-6 * late.col(2).norm());
  for (std::size_t s = 0; s + 1 < slope.size(); ++s)
    EXPECT_LT((slope[s].mean - whole_slope[s].mean).norm(), 1e-6 * (whole_slope[s].mean.norm() + 1e-6));
  // pullback() takes the same differences.
  std::vector<ShapeCotangent> cotangents(one.segments.size());
  cotangents.back().mean = Positions::Constant(4, 3, 0.7);
  const double pulled = prediction->pullback({cotangents})[0].controls(1, 1);
  EXPECT_NEAR(pulled, cotangents.back().mean.cwiseProduct(early).sum(), 1e-9 * std::abs(pulled));
}

TEST(Rollout, SegmentsAfterReleaseKeepTheSettledShape) {
  Bound toy(fine(1));
  PredictionCase one = toy_case(toy.task);
  const Index u = one.segments.back();
  ASSERT_LT(u, one.controls.rows());
  one.segments = {u, one.controls.rows()};
  const auto prediction = toy.predictor->predict({one}, {});
  EXPECT_EQ(prediction->shapes()[0][0].mean, prediction->shapes()[0][1].mean);
}

TEST(Rollout, SigmaGrowsWithTheWidthOfKnowledge) {
  Bound toy(fine(16));
  PredictionCase narrow = toy_case(toy.task), wide = narrow;
  narrow.knowledge.width.setZero();
  wide.knowledge.width.setConstant(0.8);
  const auto prediction = toy.predictor->predict({narrow, wide}, {});
  const Params defaults;
  EXPECT_NEAR(prediction->shapes()[0].back().sigma.maxCoeff(), defaults.sigma_m, 1e-12);
  EXPECT_GT(prediction->shapes()[1].back().sigma.maxCoeff(), 2 * defaults.sigma_m);
}

TEST(Rollout, DivergenceCostsOnlyItsCase) {
  Bound toy(fine(1));
  toy.host.diverge_above = 1.2;
  toy.predictor->bind(toy.task);
  const PredictionCase good = toy_case(toy.task);
  PredictionCase bad = good;
  bad.controls.col(3).setConstant(0.02);
  const auto prediction = toy.predictor->predict({bad, good}, {.gradients = true, .knowledge_gradients = false});
  EXPECT_THAT(prediction->failure(0), testing::HasSubstr("not finite"));
  EXPECT_TRUE(prediction->shapes()[0].empty());
  EXPECT_EQ(prediction->failure(1), "");
  std::vector<std::vector<ShapeCotangent>> cotangents(2);
  cotangents[0].resize(3);
  loss_of(prediction->shapes()[1], &cotangents[1]);
  const auto gradients = prediction->pullback(cotangents);
  EXPECT_TRUE(gradients[0].controls.isZero(0.0));
  EXPECT_GT(gradients[1].controls.norm(), 0.0);
  std::vector<CaseDirection> to_the_hole(1);
  to_the_hole[0].controls = Controls::Zero(good.controls.rows(), good.controls.cols());
  to_the_hole[0].controls(0, 3) = 1.0;
  toy.host.diverge_above = 0.0;  // from the next bind() on, no step is possible
  toy.predictor->bind(toy.task);
  EXPECT_THAT(test::message_of<Diverged>([&] {
                prediction->jvp({to_the_hole, to_the_hole});
              }),
              testing::HasSubstr("no difference has a result: "));
  EXPECT_THAT(test::message_of<Diverged>([&] { prediction->pullback(cotangents); }),
              testing::HasSubstr("no difference has a result: "));
}

/// A difference that diverges on one side is made on the other side.
TEST(Rollout, ADifferenceUsesTheSideThatDoesNotDiverge) {
  Bound toy(fine(1));
  const PredictionCase one = toy_case(toy.task);
  std::vector<CaseDirection> up(1);
  up[0].controls = Controls::Zero(one.controls.rows(), one.controls.cols());
  up[0].controls(0, 3) = 1.0;
  const auto slope_below = [&](double height) {
    toy.host.diverge_above = height;
    toy.predictor->bind(toy.task);
    const auto prediction =
        toy.predictor->predict({one}, {.gradients = true, .control_gradients = true, .knowledge_gradients = false});
    EXPECT_EQ(prediction->failure(0), "");
    return prediction->jvp({up})[0][0].back().mean;
  };
  const Positions free = slope_below(1e9);
  double farthest = 0.0;  // x of the hands, beyond which the toy diverges
  Vector state = one.state;
  for (Index j = 0; j < one.segments.back(); ++j) {
    const SegmentPath path =
        toy.task.trajectory->segment(toy.task.manipulation, state, one.controls.row(j).transpose());
    for (const auto& targets : path.targets) farthest = std::max(farthest, targets.col(0).maxCoeff());
    state = path.end_state;
  }
  const Positions one_sided = slope_below(farthest + 1e-9);
  EXPECT_TRUE(one_sided.allFinite());
  EXPECT_LT((one_sided - free).cwiseAbs().maxCoeff(), 0.05 * free.cwiseAbs().maxCoeff());
  EXPECT_NE(one_sided, free) << "nothing diverged";
}

TEST(Rollout, RefusesWrongInput) {
  Bound toy(fine(1));
  const PredictionCase good = toy_case(toy.task);
  PredictionCase bad = good;
  bad.segments = {3, 3};
  EXPECT_THROW(toy.predictor->predict({bad}, {}), ShapeError);
  bad = good;
  bad.state.conservativeResize(2);
  EXPECT_THROW(toy.predictor->predict({bad}, {}), ShapeError);
  bad = good;
  bad.controls(0, 0) = std::nan("");
  EXPECT_THROW(toy.predictor->predict({bad}, {}), Error);
  const auto prediction = toy.predictor->predict({good}, {});
  EXPECT_THROW(prediction->pullback({std::vector<ShapeCotangent>(3)}), Unsupported);
  std::vector<CaseDirection> one(1);
  one[0].controls = Controls::Zero(2, 5);
  EXPECT_THROW(prediction->jvp({one}), Unsupported);
  EXPECT_THROW(toy.predictor->predict({good}, {.gradients = true})->jvp({one}), ShapeError);
  EXPECT_THROW(toy.predictor->predict({good}, {.gradients = true})->jvp({}), ShapeError);
  EXPECT_THROW(RolloutPredictor(fine(1), toy.host).predict({good}, {}), Error);
}

}  // namespace
}  // namespace weft::rollout
