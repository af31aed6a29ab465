// A plan as it runs with Ceres or NLopt: a solver's thread per instance, and a predictor that spreads each batch over
// the host's threads. No plugin and no tensor library, so that it runs under the thread sanitizer.
#include <gmock/gmock.h>

#include <atomic>
#include <thread>

#include "unit/test_support.hpp"
#include "unit/toy_trajectory.hpp"
#include "weft/batching.hpp"
#include "weft/planner.hpp"
#include "weft/registry.hpp"

namespace weft {
namespace {

/// Two vertices that follow the hands up by the sine of what the controls add up to.
class LiftPrediction final : public Prediction {
 public:
  LiftPrediction(Host& host, const std::vector<PredictionCase>& cases, double broken_above)
      : host_(host), cases_(cases), shapes_(cases.size()), failures_(cases.size()) {
    host.parallel_for(static_cast<std::int64_t>(cases.size()), [&](std::int64_t i) {
      const auto at = static_cast<std::size_t>(i);
      if (cases[at].controls(0, 0) > broken_above) {
        failures_[at] = "broken";
        return;
      }
      for (const Index j : cases[at].segments) {
        Positions mean = *cases[at].shape;
        for (Index k = 0; k < j; ++k) mean.col(2).array() += height(cases[at].controls(k, 0), k);
        shapes_[at].push_back({mean, Positions::Constant(2, 3, 1e-3)});
      }
    });
  }
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return shapes_; }
  const std::string& failure(std::size_t i) const override { return failures_.at(i); }
  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    std::vector<CaseGradient> gradients(cases_.size());
    host_.parallel_for(static_cast<std::int64_t>(cases_.size()), [&](std::int64_t i) {
      const auto at = static_cast<std::size_t>(i);
      const auto& one = cases_[at];
      gradients[at].controls = Controls::Zero(one.controls.rows(), 1);
      for (std::size_t s = 0; s < shapes_[at].size(); ++s)
        for (Index k = 0; k < one.segments[s]; ++k)
          gradients[at].controls(k, 0) += cotangents[at][s].mean.col(2).sum() * slope(one.controls(k, 0), k);
    });
    return gradients;
  }

 private:
  static double height(double control, Index k) {
    return 0.1 * std::sin(20.0 * control + 0.3 * static_cast<double>(k));
  }
  static double slope(double control, Index k) { return 2.0 * std::cos(20.0 * control + 0.3 * static_cast<double>(k)); }
  Host& host_;
  std::vector<PredictionCase> cases_;
  std::vector<std::vector<ShapeDistribution>> shapes_;
  std::vector<std::string> failures_;
};

class LiftPredictor final : public Predictor {
 public:
  explicit LiftPredictor(Host& host) : host_(host) {}
  double broken_above = 1e9;
  int throws_at = -1;
  mutable std::atomic<int> batches{0};
  mutable std::atomic<std::size_t> largest{0};
  PredictorCapabilities capabilities() const override { return {.gradients = true}; }
  void bind(const Task&) override {}
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest&) const override {
    if (batches++ == throws_at) throw Diverged("lift: frame 3");
    largest = std::max<std::size_t>(largest, cases.size());
    return std::make_unique<LiftPrediction>(host_, cases, broken_above);
  }

 private:
  Host& host_;
};

/// Gradient descent by trial and error, whose instances take different numbers of evaluations; together or one by one.
class Descent final : public Optimiser {
 public:
  bool together = true;
  Index throwing_instance = -1;
  OptimiserCapabilities capabilities() const override { return {.needs_gradients = true}; }
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override {
    const PointwiseSolver solver = [&](PointwiseSearch& search, const Vector& start) -> SolverOutcome {
      Vector x = start;
      double step = 1e-6;
      const PointValue* value = search.evaluate(x, {.gradients = true});
      for (Index k = 0; value && k < options.max_iterations; ++k) {
        if (k == 2 && search.instance() == throwing_instance) throw Unsupported("descent: instance gives up");
        const double cost = value->cost;
        const Vector gradient = value->gradient;
        for (;;) {
          const PointValue* there = search.evaluate(x - step * gradient, {});
          if (!there) return {};
          if (there->cost < cost) break;
          step *= 0.5;
          if (step < 1e-14) return {OptimiserStatus::converged, "no step is short enough"};
        }
        x = search.best_x();
        step *= 1.5;
        search.count_iteration();
        value = search.evaluate(x, {.gradients = true});
      }
      return {OptimiserStatus::budget_spent, ""};
    };
    if (together) return minimise_pointwise("descent", objective, starts, bounds, scale, options, observer, solver);
    std::vector<OptimiserResult> results;
    for (Index i = 0; i < starts.cols(); ++i)
      results.push_back(
          minimise_pointwise("descent", objective, starts.col(i), bounds, scale, options, nullptr, solver)[0]);
    return results;
  }
};

struct Lift : testing::Test {
  test::Folder folder;
  std::unique_ptr<Host> host =
      make_host(std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{folder.path()}), {.threads = 3});
  std::shared_ptr<LiftPredictor> predictor = std::make_shared<LiftPredictor>(*host);
  std::shared_ptr<Descent> optimiser = std::make_shared<Descent>();
  PlannerParams params;
  Task task;
  PlanRequest request;

  Lift() {
    Garment garment;
    garment.positions = Positions::Zero(2, 3);
    task.garment = std::make_shared<const Garment>(garment);
    task.manipulation.grasp_vertices = {0, 1};
    task.manipulation.grasp_points = garment.positions;
    task.trajectory = std::make_shared<test::ToyTrajectory>();
    params.instances = 7;
    params.horizon = 6;
    params.iterations = 12;
    Positions goal = garment.positions;
    goal.col(2).setConstant(0.25);
    request.shape = std::make_shared<const Positions>(garment.positions);
    request.goal = std::make_shared<const Positions>(goal);
    request.state = Vector::Zero(1);
    request.seed = 5;
  }
  Plan plan() { return Planner(task, predictor, optimiser, params, *host).plan(request); }
};

TEST_F(Lift, AllInstancesMeetInOneBatchAndEndAsEachAlone) {
  const Plan together = plan();
  EXPECT_EQ(predictor->largest, 7u);
  const int batches = predictor->batches;
  optimiser->together = false;
  predictor->batches = 0;
  const Plan alone = plan();
  EXPECT_EQ(together.losses, alone.losses);
  EXPECT_EQ(together.controls, alone.controls);
  EXPECT_EQ(together.evaluations, alone.evaluations);
  EXPECT_GT(predictor->batches, 3 * batches);
}

TEST_F(Lift, SameBitsFromRunToRun) {
  const Plan first = plan();
  for (int repeat = 0; repeat < 5; ++repeat) {
    const Plan again = plan();
    EXPECT_EQ(again.losses, first.losses);
    EXPECT_EQ(again.curves, first.curves);
  }
}

TEST_F(Lift, APredictionThatFailsCostsItsInstanceOnly) {
  const Plan sound = plan();
  predictor->broken_above = 0.015;  // some of the starts
  const Plan holed = plan();
  int failed = 0;
  for (std::size_t i = 0; i < 7; ++i) failed += std::isinf(holed.losses[i]);
  EXPECT_GT(failed, 0);
  EXPECT_LT(failed, 7);
  EXPECT_EQ(sound.losses.size(), holed.losses.size());
}

TEST_F(Lift, WhatThrowsEndsThePlan) {
  for (const int batch : {0, 1, 9}) {
    predictor->batches = 0;
    predictor->throws_at = batch;
    EXPECT_THROW(plan(), Diverged) << batch;
  }
  predictor->throws_at = -1;
  optimiser->throwing_instance = 4;
  EXPECT_THROW(plan(), Unsupported);
}

TEST_F(Lift, TheBudgetEndsEveryInstance) {
  params.max_evaluations = 9;
  EXPECT_LE(plan().evaluations, 7 * 9 + 1);
}

TEST_F(Lift, PlansSideBySideDoNotDisturbOneAnother) {
  const Plan alone = plan();
  std::vector<Plan> plans(3);
  std::vector<std::thread> threads;
  for (auto& one : plans) threads.emplace_back([&] { one = plan(); });
  for (auto& thread : threads) thread.join();
  for (const auto& one : plans) EXPECT_EQ(one.losses, alone.losses);
}

}  // namespace
}  // namespace weft
