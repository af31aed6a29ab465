// A plan as it runs with Ceres or NLopt: a solver's thread per instance, and a predictor that spreads each batch over
// the host's threads. No plugin and no tensor library, so that it runs under the thread sanitizer.
#include <gmock/gmock.h>

#include <atomic>
#include <thread>

#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "session/planner.hpp"
#include "unit/descent.hpp"
#include "unit/test_support.hpp"
#include "unit/toy_trajectory.hpp"

namespace weft {
namespace {

/// Two vertices that follow the hands up by the sine of the sum of the controls.
class LiftPrediction final : public Prediction {
 public:
  LiftPrediction(Host& host, const std::vector<PredictionCase>& cases, double broken_above, bool rows_matter)
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
        if (rows_matter)
          mean.col(2).array() += 1e-6 * static_cast<double>(at) + 1e-5 * static_cast<double>(cases.size());
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
  bool rows_matter = false;
  int throws_at = -1;
  mutable std::atomic<int> batches{0};
  mutable std::atomic<std::size_t> largest{0}, smallest{99};
  PredictorCapabilities capabilities() const override { return {.gradients = true, .deterministic = !rows_matter}; }
  void bind(const Task&) override {}
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest&) const override {
    if (batches++ == throws_at) throw Diverged("lift: frame 3");
    largest = std::max<std::size_t>(largest, cases.size());
    if (cases.size() > 1) smallest = std::min<std::size_t>(smallest, cases.size());  // 1: of the plan that was chosen
    return std::make_unique<LiftPrediction>(host_, cases, broken_above, rows_matter);
  }

 private:
  Host& host_;
};

struct Lift : testing::Test {
  test::Folder folder;
  std::unique_ptr<Host> host =
      make_host(std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{folder.path()}), {.threads = 3});
  std::shared_ptr<LiftPredictor> predictor = std::make_shared<LiftPredictor>(*host);
  std::shared_ptr<test::Descent> optimiser = std::make_shared<test::Descent>();
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
    params.halvings = 0;  // alone there is no worse half
    Positions goal = garment.positions;
    goal.col(2).setConstant(0.25);
    request.shape = std::make_shared<const Positions>(garment.positions);
    request.goal = std::make_shared<const Positions>(goal);
    request.state = Vector::Zero(1);
    request.seed = 5;
  }
  Plan plan() { return plan(optimiser); }
  Plan plan(std::shared_ptr<const Optimiser> by) {
    return Planner(task, predictor, std::move(by), params, *host).plan(request);
  }
  Plan plan_one_by_one(bool numbered = true) { return plan(std::make_shared<test::OneByOne>(optimiser, numbered)); }
};

TEST_F(Lift, AllInstancesMeetInOneBatchAndEndAsEachAlone) {
  const Plan together = plan();
  EXPECT_EQ(predictor->largest, 7u);
  const int batches = predictor->batches;
  predictor->batches = 0;
  const Plan alone = plan_one_by_one();
  EXPECT_EQ(together.losses, alone.losses);
  EXPECT_EQ(together.controls, alone.controls);
  EXPECT_EQ(together.evaluations, alone.evaluations);
  EXPECT_GT(predictor->batches, 3 * batches);
}

TEST_F(Lift, WhereBitsDependOnTheRowInstancesKeepTheirs) {
  const Plan sound = plan();
  EXPECT_LT(predictor->smallest, 7u);  // those that have ended are left out
  predictor->smallest = 99;
  predictor->rows_matter = true;
  const Plan together = plan();
  EXPECT_EQ(predictor->smallest, 7u);
  EXPECT_EQ(predictor->largest, 7u);
  const Plan alone = plan_one_by_one();
  EXPECT_EQ(together.losses, alone.losses);
  EXPECT_EQ(together.controls, alone.controls);
  EXPECT_EQ(together.evaluations, alone.evaluations);  // padding does not count as an evaluation
  // The test means something: other rows give other bits.
  EXPECT_NE(together.losses, sound.losses);
  EXPECT_NE(together.losses, plan_one_by_one(false).losses);
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
