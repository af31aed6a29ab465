// The planner (section 4) with the paper's trajectory and optimiser on a predictor that is a closed formula.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <numeric>
#include <thread>

#include "optimiser/rprop/rprop.cpp"
#include "session/planning_objective.hpp"
#include "trajectory/arc/arc.cpp"
#include "unit/serial_host.hpp"

namespace weft {
namespace {

/// The shape after segment j is the pair of grasp targets at that control state, so a goal is reached exactly by the
/// controls that made it, and the gradient is the chain of the trajectory's own pullbacks. A third vertex of the garment
/// lies between the two, 0.1 m in front of them.
class TargetsPrediction final : public Prediction {
 public:
  /// Sigma is 0.2 m + sigma_slope times the position.
  TargetsPrediction(const Task& task, const std::vector<PredictionCase>& cases, double sigma_slope)
      : task_(task), cases_(cases), sigma_slope_(sigma_slope) {
    for (const auto& one : cases) {
      const Controls states = task.trajectory->segment_states(task.manipulation, one.state, one.controls);
      std::vector<ShapeDistribution> shapes;
      for (const Index j : one.segments) {
        const Positions hands = task.trajectory->targets(task.manipulation, states.row(j - 1).transpose());
        Positions targets(task.garment->vertex_count(), 3);
        targets.topRows(2) = hands;
        if (targets.rows() == 3) targets.row(2) = 0.5 * (hands.row(0) + hands.row(1)) + Eigen::RowVector3d(0.1, 0, 0);
        shapes.push_back({targets, (0.2 + sigma_slope * targets.array()).matrix()});
      }
      shapes_.push_back(shapes);
    }
  }
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return shapes_; }
  const std::string& failure(std::size_t) const override { return none_; }
  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    std::vector<CaseGradient> result;
    const auto& trajectory = *task_.trajectory;
    for (std::size_t i = 0; i < cases_.size(); ++i) {
      const auto& one = cases_[i];
      CaseGradient gradient;
      gradient.controls = Controls::Zero(one.controls.rows(), one.controls.cols());
      std::vector<Vector> states{one.state};
      for (Index f = 0; f < one.controls.rows() * kFramesPerSegment; ++f) {
        states.push_back(
            trajectory.advance(task_.manipulation, states.back(), one.controls.row(f / kFramesPerSegment).transpose()));
      }
      for (std::size_t k = 0; k < one.segments.size(); ++k) {
        if (cotangents[i][k].mean.rows() == 0) continue;
        const Index last = one.segments[k] * kFramesPerSegment;
        Positions d_targets = cotangents[i][k].mean;
        if (cotangents[i][k].sigma.rows() > 0) d_targets += sigma_slope_ * cotangents[i][k].sigma;
        Positions d_hands = d_targets.topRows(2);
        if (d_targets.rows() == 3) d_hands.rowwise() += 0.5 * d_targets.row(2);
        Vector d = trajectory.targets_pullback(task_.manipulation, states[last], d_hands);
        for (Index f = last - 1; f >= 0; --f) {
          Vector d_state, d_control;
          trajectory.advance_pullback(task_.manipulation, states[f],
                                      one.controls.row(f / kFramesPerSegment).transpose(), d, d_state, d_control);
          gradient.controls.row(f / kFramesPerSegment) += d_control.transpose();
          d = d_state;
        }
      }
      result.push_back(gradient);
    }
    return result;
  }

 private:
  Task task_;
  std::vector<PredictionCase> cases_;
  double sigma_slope_;
  std::vector<std::vector<ShapeDistribution>> shapes_;
  std::string none_;
};

class TargetsPredictor final : public Predictor {
 public:
  bool has_gradients = true;
  double sigma_slope = 0.0;
  std::optional<Box> range;
  std::optional<Index> most;
  mutable Index longest = 0;  // controls that were asked about
  int stalls_at = 0;          // the call of predict() that takes stall_s; 0: none
  double stall_s = 0.0;
  PredictorCapabilities capabilities() const override { return {.gradients = has_gradients}; }
  std::optional<Box> control_range() const override { return range; }
  std::optional<Index> max_segments() const override { return most; }
  void bind(const Task& task) override { task_ = task; }
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest&) const override {
    for (const auto& one : cases) longest = std::max(longest, one.controls.rows());
    if (++calls_ == stalls_at) std::this_thread::sleep_for(std::chrono::duration<double>(stall_s));
    return std::make_unique<TargetsPrediction>(task_, cases, sigma_slope);
  }

 private:
  Task task_;
  mutable int calls_ = 0;
};

struct Bench {
  test::SerialHost host;
  Task task;
  std::shared_ptr<TargetsPredictor> predictor = std::make_shared<TargetsPredictor>();
  std::shared_ptr<Optimiser> optimiser = std::make_shared<rprop::Rprop>(rprop::Params());
  PlannerParams params;
  PlanRequest request;

  Bench() {
    Garment garment;
    garment.positions.resize(2, 3);
    garment.positions << 0, 0.2, 0.002, 0, -0.2, 0.002;
    task.garment = std::make_shared<const Garment>(garment);
    task.manipulation.grasp_vertices = {0, 1};
    task.manipulation.grasp_points = garment.positions;
    task.manipulation.displacement = {0.6, 0.0};
    task.manipulation.contact_height = 0.002;
    task.trajectory = std::make_shared<arc::Arc>(arc::Params());
    predictor->bind(task);
    request.shape = std::make_shared<const Positions>(garment.positions);
    request.state = task.trajectory->initial_state(task.manipulation);
    request.seed = 3;
    // A goal that other controls than the default's reach: turned, shifted, at another radius.
    Controls controls = task.trajectory->default_controls(25);
    controls.col(2).setConstant(0.15);
    controls.col(3).setConstant(3e-4);
    controls.col(4).setConstant(-2e-4);
    const Index u = task.trajectory->release_segment(task.manipulation, request.state, controls);
    const Controls states = task.trajectory->segment_states(task.manipulation, request.state, controls);
    request.goal =
        std::make_shared<const Positions>(task.trajectory->targets(task.manipulation, states.row(u - 1).transpose()));
    params.instances = 4;
    params.iterations = 120;
    params.activity_weight = 0.01;
  }
  Plan plan() { return Planner(task, predictor, optimiser, params, host).plan(request); }
};

TEST(Planner, ReachesAGoalOffTheDefaultTrajectory) {
  Bench setup;
  const Index default_u = setup.task.trajectory->release_segment(setup.task.manipulation, setup.request.state,
                                                                 setup.task.trajectory->default_controls(25));
  const Controls default_states = setup.task.trajectory->segment_states(setup.task.manipulation, setup.request.state,
                                                                        setup.task.trajectory->default_controls(25));
  const double default_error = mean_distance_mm(
      setup.task.trajectory->targets(setup.task.manipulation, default_states.row(default_u - 1).transpose()),
      *setup.request.goal);
  ASSERT_GT(default_error, 30.0);
  const Plan plan = setup.plan();
  EXPECT_LT(plan.predicted_error_mm, 2.0);
  EXPECT_TRUE(plan.releases);
}

TEST(Planner, PlanEndsWithItsReleaseSegment) {
  Bench setup;
  const Plan plan = setup.plan();
  EXPECT_EQ(plan.horizon, 25);
  EXPECT_EQ(plan.controls.rows(),
            setup.task.trajectory->release_segment(setup.task.manipulation, setup.request.state, plan.controls));
  EXPECT_LT(plan.controls.rows(), 25);
  EXPECT_EQ(static_cast<Index>(plan.shapes.size()), plan.controls.rows());
}

TEST(Planner, LaterPlansStartFromTheWarmStartWithLengthPlusLeeway) {
  Bench setup;
  setup.params.replan_iterations = 0;  // nothing but the starts: the un-noised warm start must be one of them
  setup.request.warm_start = setup.task.trajectory->default_controls(6);
  setup.request.warm_start.col(0).setConstant(2.6);
  setup.request.round = 1;
  const Plan plan = setup.plan();
  EXPECT_EQ(plan.horizon, 6 + setup.params.leeway);
  setup.params.instances = 1;
  const Plan bare = setup.plan();
  EXPECT_EQ(bare.controls.topRows(6), setup.request.warm_start);
  EXPECT_LE(plan.loss, bare.loss);
}

TEST(Planner, NoPlanIsLongerThanThePredictorTakes) {
  Bench setup;
  setup.params.iterations = setup.params.replan_iterations = 3;
  setup.predictor->most = 8;
  EXPECT_EQ(setup.plan().horizon, 8);
  EXPECT_EQ(setup.predictor->longest, 8);
  setup.request.round = 1;
  // Rows of the warm start, horizon: 4 + 5 would be too long, 12 are too many by themselves, 2 + 5 fit.
  for (const auto& [rows, horizon] : {std::pair<Index, Index>{4, 8}, {12, 8}, {2, 7}}) {
    setup.request.warm_start = setup.task.trajectory->default_controls(rows);
    for (Index j = 0; j < rows; ++j) setup.request.warm_start(j, 2) = 0.01 * static_cast<double>(j);
    setup.params.replan_iterations = 3;
    setup.params.instances = 4;
    EXPECT_EQ(setup.plan().horizon, horizon);
    EXPECT_LE(setup.predictor->longest, 8);
    // Without a search the plan is the warm start, as far as it goes.
    setup.params.replan_iterations = 0;
    setup.params.instances = 1;
    const Index kept = std::min(rows, horizon);
    EXPECT_EQ(setup.plan().controls.topRows(kept), setup.request.warm_start.topRows(kept));
  }
}

TEST(Planner, TheBestResidualLossWins) {
  Bench setup;
  setup.params.iterations = 5;
  setup.params.halvings = 0;
  const Plan plan = setup.plan();
  ASSERT_EQ(plan.losses.size(), 4u);
  EXPECT_EQ(plan.ended.status, OptimiserStatus::budget_spent) << plan.ended.message;
  EXPECT_EQ(plan.ended.instances, (std::map<OptimiserStatus, Index>{{OptimiserStatus::budget_spent, 4}}));
  EXPECT_EQ(plan.loss, *std::min_element(plan.losses.begin(), plan.losses.end()));
  EXPECT_EQ(plan.loss, plan.losses[plan.instance]);
}

TEST(Planner, TheWorseHalfOfTheSearchesEndsEarly) {
  Bench setup;
  setup.params.iterations = 40;
  setup.params.halvings = 0;
  const Plan all = setup.plan();
  setup.params.halvings = 2;
  const Plan halved = setup.plan();
  // Of four searches two end after 10 iterations and one of the others after 20. The one that is left is not disturbed.
  EXPECT_EQ(halved.ended.instances,
            (std::map<OptimiserStatus, Index>{{OptimiserStatus::budget_spent, 1}, {OptimiserStatus::stopped, 3}}));
  EXPECT_LT(halved.evaluations, 0.6 * static_cast<double>(all.evaluations));
  EXPECT_EQ(halved.loss, all.losses[halved.instance]);
}

TEST(Planner, StopsWhenThePlanIsStable) {
  Bench setup;
  Positions goal = *setup.request.goal;
  goal.col(2).array() += 0.05;  // out of reach: a loss is left, and a plan that cannot be improved
  setup.request.goal = std::make_shared<const Positions>(goal);
  setup.params.iterations = 2000;
  setup.optimiser = std::make_shared<rprop::Rprop>(rprop::Params{.step_tolerance = 0.0, .relative_tolerance = 0.0});
  const Plan whole = setup.plan();
  setup.optimiser = std::make_shared<rprop::Rprop>(rprop::Params{.relative_tolerance = 1e-3, .patience = 10});
  const Plan stable = setup.plan();
  EXPECT_LT(stable.iterations, 400);
  EXPECT_LT(stable.iterations, whole.iterations);
  EXPECT_LT(stable.loss, 1.05 * whole.loss);
}

TEST(Planner, SameSeedSameBitsAndAnotherSeedAnotherSearch) {
  Bench setup;
  setup.params.iterations = 5;
  const Plan a = setup.plan(), b = setup.plan();
  EXPECT_EQ(a.controls, b.controls);
  EXPECT_EQ(a.losses, b.losses);
  setup.request.seed = 4;
  EXPECT_NE(a.losses, setup.plan().losses);
}

// The predictor stalls for longer than the budget, some iterations in.
TEST(Planner, ReplayedIterationsRepeatARunThatWasLimitedByTime) {
  Bench setup;
  setup.params.time_budget_s = 1.0;
  setup.predictor->stalls_at = 8;
  setup.predictor->stall_s = 1.1;
  const Plan limited = setup.plan();
  EXPECT_GT(limited.iterations, 0);
  EXPECT_LT(limited.iterations, 8);
  setup.params.time_budget_s = 0;
  setup.predictor->stalls_at = 0;
  setup.params.replay_iterations = {static_cast<double>(limited.iterations)};
  const Plan replayed = setup.plan();
  EXPECT_EQ(replayed.controls, limited.controls);
  EXPECT_EQ(replayed.losses, limited.losses);
  EXPECT_EQ(replayed.curves, limited.curves);
  setup.params.replay_iterations = {static_cast<double>(limited.iterations + 1)};
  EXPECT_NE(setup.plan().losses, limited.losses);
}

TEST(Planner, RefusesAnOptimiserThatNeedsGradientsThatAreNotThere) {
  Bench setup;
  setup.predictor->has_gradients = false;
  EXPECT_THROW(setup.plan(), Unsupported);
}

TEST(ActivityLoss, IsZeroForASteadyTrajectoryAndPositiveForAJerkyOrSlowOne) {
  Bench setup;
  const Controls steady = setup.task.trajectory->default_controls(10);
  EXPECT_EQ(activity_loss(setup.task, setup.request.state, steady, 8, 10.0, nullptr), 0.0);
  Controls jerky = steady;
  jerky(3, 2) += 0.5;
  EXPECT_GT(activity_loss(setup.task, setup.request.state, jerky, 8, 10.0, nullptr), 0.0);
  Controls slow = steady;
  slow.col(0).setConstant(1.0);  // 12 deg a segment: 180 deg would need 15 of the 10 segments
  EXPECT_GT(activity_loss(setup.task, setup.request.state, slow, 10, 10.0, nullptr), 0.0);
}

TEST(ActivityLoss, GradientEqualsCentralDifferences) {
  Bench setup;
  Controls controls = setup.task.trajectory->default_controls(9);
  RandomStream random(5);
  const auto variables = setup.task.trajectory->controls();
  for (Index j = 0; j < controls.rows(); ++j) {
    for (Index c = 0; c < controls.cols(); ++c) {
      controls(j, c) += 0.5 * variables[c].scale * random.normal();
    }
  }
  controls(2, 0) = 0.7;  // slow on purpose
  Controls gradient;
  activity_loss(setup.task, setup.request.state, controls, 7, 10.0, &gradient);
  for (Index j = 0; j < controls.rows(); ++j) {
    for (Index c = 0; c < controls.cols(); ++c) {
      const double scale = variables[c].scale, h = 1e-5 * scale;
      Controls up = controls, down = controls;
      up(j, c) += h;
      down(j, c) -= h;
      const double expected = (activity_loss(setup.task, setup.request.state, up, 7, 10.0, nullptr) -
                               activity_loss(setup.task, setup.request.state, down, 7, 10.0, nullptr)) /
                              (2 * h);
      EXPECT_NEAR(gradient(j, c) * scale, expected * scale, 1e-5) << j << ", " << c;
    }
  }
}

/// An optimiser that hands the objective to a test.
class Probe final : public Optimiser {
 public:
  using Body = std::function<void(Objective&, ConstMatrix)>;
  explicit Probe(Body body) : body_(std::move(body)) {}
  OptimiserCapabilities capabilities() const override { return {.needs_residuals = true}; }
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box&, ConstVec,
                                        const OptimiserOptions& options, const OptimiserObserver&) const override {
    seen = options;
    body_(objective, starts);
    OptimiserResult result;
    result.x = starts.col(0);
    result.cost = 1.0;
    return {result};
  }
  mutable OptimiserOptions seen;

 private:
  Body body_;
};

TEST(PlanningObjective, HalfTheSquaredResidualsAreTheCostAndTheirJacobianGivesItsGradient) {
  for (const std::string loss : {"mean", "expected"}) {
    Bench setup;
    setup.params.loss = loss;
    setup.params.vertex_weights = {3.0, 1.0};
    setup.predictor->sigma_slope = 0.1;
    setup.params.activity_weight = 3.0;
    setup.params.noise = 2.0;  // slow segments among them
    setup.params.difference_step = 1e-3;
    setup.optimiser = std::make_shared<Probe>([&](Objective& f, ConstMatrix starts) {
      const Index r = f.capabilities().residuals;
      EXPECT_EQ(r, (loss == "mean" ? 6 : 12) + 24 * 5 + 25);
      std::vector<Index> instances(starts.cols());
      std::iota(instances.begin(), instances.end(), 0);
      const Evaluation plain = f.evaluate(starts, instances, {.gradients = true});
      const Evaluation e = f.evaluate(starts, instances, {.residuals = true, .jacobians = true});
      const Evaluation no_jacobian = f.evaluate(starts, instances, {.residuals = true});
      ASSERT_EQ(e.residuals.rows(), r);
      ASSERT_EQ(static_cast<Index>(e.jacobians.size()), starts.cols());
      EXPECT_TRUE(no_jacobian.jacobians.empty());
      EXPECT_EQ(no_jacobian.residuals, e.residuals);
      EXPECT_EQ(e.costs, plain.costs);
      for (Index i = 0; i < starts.cols(); ++i) {
        EXPECT_NEAR(0.5 * e.residuals.col(i).squaredNorm(), e.costs(i), 1e-9 * e.costs(i));
        const Vector gradient = e.jacobians[i].transpose() * e.residuals.col(i);
        EXPECT_LT((gradient - plain.gradients.col(i)).norm(), 1e-4 * plain.gradients.col(i).norm()) << i;
      }
    });
    setup.plan();
  }
}

TEST(PlanningObjective, ResidualsOfASurfaceGiveItsCostAndGradientToo) {
  Bench setup;
  Garment garment;
  garment.positions.resize(3, 3);
  garment.positions << 0, 0.2, 0.002, 0, -0.2, 0.002, 0.1, 0, 0.002;
  garment.faces.resize(1, 3);
  garment.faces << 0, 1, 2;
  setup.task.garment = std::make_shared<const Garment>(garment);
  setup.predictor->bind(setup.task);
  setup.request.shape = std::make_shared<const Positions>(garment.positions);
  Positions goal = garment.positions;
  goal.col(0).array() += 0.5;
  setup.request.goal = nullptr;
  setup.request.surface = std::make_shared<const GoalSurface>(GoalKind::surface, goal, garment.faces, garment);
  setup.params.difference_step = 1e-3;
  setup.optimiser = std::make_shared<Probe>([&](Objective& f, ConstMatrix starts) {
    std::vector<Index> instances(starts.cols());
    std::iota(instances.begin(), instances.end(), 0);
    const Evaluation plain = f.evaluate(starts, instances, {.gradients = true});
    const Evaluation e = f.evaluate(starts, instances, {.residuals = true, .jacobians = true});
    EXPECT_EQ(e.costs, plain.costs);
    for (Index i = 0; i < starts.cols(); ++i) {
      EXPECT_NEAR(0.5 * e.residuals.col(i).squaredNorm(), e.costs(i), 1e-9 * e.costs(i));
      const Vector gradient = e.jacobians[i].transpose() * e.residuals.col(i);
      EXPECT_GT(plain.gradients.col(i).norm(), 0.0);
      EXPECT_LT((gradient - plain.gradients.col(i)).norm(), 1e-4 * plain.gradients.col(i).norm()) << i;
    }
  });
  setup.plan();
}

TEST(PlanningObjective, AFixedReleaseIsKeptByAPenalty) {
  Bench setup;
  setup.params.activity_weight = 3.0;
  const Controls steady = setup.task.trajectory->default_controls(25);
  const Index u = setup.task.trajectory->release_segment(setup.task.manipulation, setup.request.state, steady);
  for (const Index release : {u - 2, u - 1, u, u + 1, Index{25}, Index{1}}) {
    setup.request.release = release;
    const Vector weights = Vector::Ones(2);
    PlanningObjective f(setup.task, *setup.predictor, setup.params, weights, setup.request, 25);
    const Vector x = setup.task.trajectory->encode(steady, setup.request.state);
    EXPECT_EQ(f.make_case(x).segments, std::vector<Index>{release});
    const Evaluation e = f.evaluate(x, {0}, {.gradients = true, .residuals = true, .jacobians = true});
    EXPECT_NEAR(0.5 * e.residuals.squaredNorm(), e.costs(0), 1e-9 * e.costs(0));
    EXPECT_LT((e.jacobians[0].transpose() * e.residuals - e.gradients).norm(), 1e-4 * e.gradients.norm()) << release;
    const double penalty = 0.5 * e.residuals.bottomRows(2).squaredNorm();
    EXPECT_EQ(penalty > 0.0, release != u) << release;
    const double shape_alone =
        f.loss_of(setup.predictor->predict({f.make_case(x)}, {})->shapes().front().front().mean, x, release);
    EXPECT_NEAR(e.costs(0), shape_alone + penalty, 1e-9 * e.costs(0));
    for (Index k = 0; k < x.size(); k += 7) {
      const double step = 1e-6 * setup.task.trajectory->decision_scale(25)(k);
      Vector up = x, down = x;
      up(k) += step;
      down(k) -= step;
      const double expected = (f.evaluate(up, {0}, {}).costs(0) - f.evaluate(down, {0}, {}).costs(0)) / (2.0 * step);
      EXPECT_NEAR(e.gradients(k, 0), expected, 1e-4 * e.gradients.norm()) << release << ", " << k;
    }
  }
  setup.request.release = 26;
  const Vector weights = Vector::Ones(2);
  EXPECT_THROW(PlanningObjective(setup.task, *setup.predictor, setup.params, weights, setup.request, 25), ShapeError);
}

TEST(PlanningObjective, LimitsOfTheHandsArePartOfCostResidualsAndDerivatives) {
  Bench setup;
  const Vector weights = Vector::Ones(2);
  setup.params.difference_step = 1e-3;
  const auto evaluated = [&](double speed) {
    setup.task.hands.speed = speed;
    PlanningObjective f(setup.task, *setup.predictor, setup.params, weights, setup.request, 25);
    const Vector x = setup.task.trajectory->encode(setup.task.trajectory->default_controls(25), setup.request.state);
    const Evaluation e = f.evaluate(x, {0}, {.gradients = true, .residuals = true, .jacobians = true});
    EXPECT_NEAR(0.5 * e.residuals.squaredNorm(), e.costs(0), 1e-9 * e.costs(0)) << speed;
    EXPECT_LT((e.jacobians[0].transpose() * e.residuals - e.gradients).norm(), 1e-4 * e.gradients.norm()) << speed;
    // What a simulated plan costs is what the search takes for its cost, where the simulation ends as predicted.
    const PredictionCase one = f.make_case(x);
    const Positions shape = setup.predictor->predict({one}, {})->shapes().front().front().mean;
    EXPECT_NEAR(f.loss_of(shape, x, one.segments.front()), e.costs(0), 1e-9 * e.costs(0)) << speed;
    return e;
  };
  const Evaluation any = evaluated(HandLimits::kNone), slow = evaluated(0.3);
  EXPECT_EQ(slow.residuals.rows(), any.residuals.rows() + 4 * 25);
  EXPECT_GT(slow.residuals.bottomRows(4 * 25).norm(), 0.0) << "the limit is so wide that the test shows little";
}

TEST(Planner, KeepsTheBestPlanOfEveryReleaseSegment) {
  Bench setup;
  setup.params.instances = 12;
  setup.params.noise = 3.0;
  setup.params.iterations = 3;
  const Plan plan = setup.plan();
  ASSERT_GE(plan.points.size(), 2u);
  EXPECT_EQ(plan.points.front().loss, plan.loss);
  EXPECT_EQ(plan.points.front().release, plan.controls.rows());
  for (std::size_t i = 1; i < plan.points.size(); ++i) {
    EXPECT_GE(plan.points[i].loss, plan.points[i - 1].loss);
    for (std::size_t j = 0; j < i; ++j) EXPECT_NE(plan.points[i].release, plan.points[j].release);
  }
}

TEST(Planner, SearchesNearAPlanWithAShiftedPredictor) {
  Bench setup;
  const Planner planner(setup.task, setup.predictor, setup.optimiser, setup.params, setup.host);
  const Plan plan = planner.plan(setup.request);
  const PlanPoint& anchor = plan.points.front();
  EXPECT_EQ(planner.controls_of(setup.request, anchor), plan.controls);
  // The real cloth ends 10 mm beside what is predicted. A goal that is shifted too is reached without a step.
  LocalSearch search{.anchor = anchor, .offset = Positions::Constant(2, 3, 0.0)};
  search.offset.col(0).setConstant(0.01);
  const double before = planner.loss_of(setup.request, anchor, plan.shapes.back().mean + search.offset);
  double last = before;
  for (const double radius : {0.05, 0.3, 1.0}) {
    search.radius = radius;
    const PlanPoint found = planner.search_near(setup.request, search);
    EXPECT_EQ(found.release, anchor.release);
    EXPECT_LT(found.loss, last) << radius;
    EXPECT_LE(planner.distance(found, anchor), 2.0 * radius * (1.0 + 1e-9));
    EXPECT_EQ(planner.controls_of(setup.request, found).rows(), anchor.release);
    last = found.loss;
  }
  EXPECT_LT(last, 0.5 * before);
  // A plan that was cut after its release is found again as a point.
  const PlanPoint again = planner.point_of(setup.request, plan.controls);
  EXPECT_EQ(again.release, plan.controls.rows());
  EXPECT_LT((planner.controls_of(setup.request, again) - plan.controls).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(PlanningObjective, ExpectedLossAddsTheVarianceOfWhatCounts) {
  Bench setup;
  setup.params.activity_weight = 0.0;
  setup.params.instances = 1;
  const auto cost = [&] {
    double value = 0.0;
    setup.optimiser = std::make_shared<Probe>(
        [&](Objective& f, ConstMatrix starts) { value = f.evaluate(starts, {0}, {}).costs(0); });
    setup.plan();
    return value;
  };
  const double mean = cost();
  setup.params.loss = "expected";
  EXPECT_NEAR(cost() - mean, 200.0 * 200.0, 1e-6);  // sigma is 200 mm everywhere
  setup.params.loss = "mean";
  setup.params.vertices = {0};
  const double first = cost();
  setup.params.vertices = {1};
  EXPECT_NEAR(0.5 * (first + cost()), mean, 1e-9 * mean);
  EXPECT_GT(std::abs(first - mean), 1e-3 * mean);
}

TEST(Planner, RefusesVerticesAndWeightsThatMakeNoSense) {
  const auto refuse = [](std::vector<double> vertices, std::vector<double> weights) {
    Bench setup;
    setup.params.vertices = std::move(vertices);
    setup.params.vertex_weights = std::move(weights);
    EXPECT_THROW(setup.plan(), ConfigError);
  };
  PlannerParams params;
  params.vertices = {1, 2};
  const auto origin = ConfigNode::parse("a: 1\nplanning: {vertices: [1, 2]}", "task.yaml");
  EXPECT_THAT([&] { vertex_weights(params, 2, origin); },
              testing::ThrowsMessage<ConfigError>(
                  testing::StrEq("task.yaml:2: planning.vertices.1 = 2, must be a vertex in [0, 1]")));
  refuse({2}, {});
  refuse({0.5}, {});
  refuse({1, 1}, {});
  refuse({0, 1}, {1});
  refuse({}, {1, 1, 1});
  refuse({}, {0, 0});
}

TEST(Planner, PlansStayInsideTheControlsThatThePredictorKnows) {
  Bench setup;
  const Plan free = setup.plan();
  ASSERT_GT(free.controls.col(2).maxCoeff(), 0.1);  // the goal wants 0.15
  Box range{Vector::Constant(5, -10.0), Vector::Constant(5, 10.0)};
  range.upper(2) = 0.1;
  range.lower(0) = 1.9;
  setup.predictor->range = range;
  const Plan plan = setup.plan();
  EXPECT_LE(plan.controls.col(2).maxCoeff(), 0.1);
  EXPECT_GE(plan.controls.col(0).minCoeff(), 1.9);
  EXPECT_GT(plan.controls.col(2).maxCoeff(), 0.08);  // and it still goes as far as it may
}

TEST(PlanningObjective, OffersResidualsWithoutGradients) {
  Bench setup;
  setup.predictor->has_gradients = false;
  setup.optimiser = std::make_shared<Probe>([&](Objective& f, ConstMatrix starts) {
    EXPECT_FALSE(f.capabilities().gradients);
    EXPECT_TRUE(f.evaluate(starts.leftCols(1), {0}, {.residuals = true, .jacobians = true}).jacobians[0].allFinite());
    EXPECT_THROW(f.evaluate(starts.leftCols(1), {0}, {.gradients = true}), Unsupported);
  });
  setup.plan();
}

TEST(PlanningObjective, CountsThePredictionsOfFiniteDifferences) {
  Bench setup;
  setup.params.instances = 1;
  setup.optimiser = std::make_shared<Probe>(
      [&](Objective& f, ConstMatrix starts) { f.evaluate(starts, {0}, {.residuals = true, .jacobians = true}); });
  // 8 segments of 5 controls up to the release, both sides; the point itself; the winner's sequence.
  EXPECT_EQ(setup.plan().evaluations, 1 + 2 * 8 * 5 + 1);
}

TEST(PlanningObjective, TakesSeveralPointsOfAnInstance) {
  Bench setup;
  setup.optimiser = std::make_shared<Probe>([&](Objective& f, ConstMatrix starts) {
    Matrix x(starts.rows(), 3);
    x << starts.col(0), starts.col(1), starts.col(0);
    const Evaluation e = f.evaluate(x, {0, 0, 2}, {});
    EXPECT_EQ(e.costs(0), e.costs(2));
    EXPECT_NE(e.costs(0), e.costs(1));
  });
  setup.plan();
}

TEST(Planner, EvaluationBudgetReachesTheOptimiser) {
  Bench setup;
  const auto probe = std::make_shared<Probe>([](Objective&, ConstMatrix) {});
  setup.optimiser = probe;
  setup.plan();
  EXPECT_EQ(probe->seen.max_evaluations, std::numeric_limits<Index>::max());
  setup.params.max_evaluations = 12;
  setup.plan();
  EXPECT_EQ(probe->seen.max_evaluations, 12);
}

TEST(ActivityLoss, ResidualsAreItsRoots) {
  Bench setup;
  Controls controls = setup.task.trajectory->default_controls(9);
  RandomStream random(5);
  const auto variables = setup.task.trajectory->controls();
  for (Index j = 0; j < controls.rows(); ++j)
    for (Index c = 0; c < controls.cols(); ++c) controls(j, c) += 0.5 * variables[c].scale * random.normal();
  controls(2, 0) = 0.7;  // slow on purpose
  Matrix jacobian;
  Controls gradient;
  const Vector r = activity_residuals(setup.task, setup.request.state, controls, 7, 10.0, &jacobian);
  EXPECT_EQ(r.size(), 8 * 5 + 9);
  EXPECT_NEAR(r.squaredNorm(), activity_loss(setup.task, setup.request.state, controls, 7, 10.0, &gradient), 1e-12);
  const Vector from_residuals = 2.0 * jacobian.transpose() * r;
  const Vector wanted = Eigen::Map<const Vector>(gradient.data(), gradient.size());
  EXPECT_LT((from_residuals - wanted).norm(), 1e-9 * wanted.norm());
}

}  // namespace
}  // namespace weft
