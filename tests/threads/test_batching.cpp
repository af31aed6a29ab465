#include <gtest/gtest.h>

#include <cmath>
#include <mutex>
#include <thread>

#include "weft/batching.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

/// Rosenbrock per column, without the work of a predictor on a batch. Keeps the requested points.
class Valley final : public Objective {
 public:
  Index dim() const override { return 2; }
  ObjectiveCapabilities capabilities() const override { return {true, 2}; }
  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) override {
    EXPECT_EQ(std::this_thread::get_id(), caller);
    if (throw_at_batch >= 0 && static_cast<Index>(batches.size()) == throw_at_batch) throw Diverged("frame 7");
    batches.push_back(instances);
    requests.push_back(request);
    Evaluation e;
    e.costs.resize(x.cols());
    if (request.gradients) e.gradients.resize(2, x.cols());
    if (request.residuals) e.residuals.resize(2, x.cols());
    for (Index j = 0; j < x.cols(); ++j) {
      Vector r(2);
      Matrix jacobian(2, 2);
      r << 10.0 * (x(1, j) - x(0, j) * x(0, j)), 1.0 - x(0, j);
      jacobian << -20.0 * x(0, j), 10.0, -1.0, 0.0;
      const Index instance = instances[j];
      e.costs[j] = instance == broken ? std::numeric_limits<double>::quiet_NaN() : 0.5 * r.squaredNorm();
      if (request.gradients) e.gradients.col(j) = jacobian.transpose() * r;
      if (request.residuals) e.residuals.col(j) = r;
      if (request.jacobians) e.jacobians.push_back(jacobian);
    }
    return e;
  }
  std::thread::id caller = std::this_thread::get_id();
  Index throw_at_batch = -1;
  Index broken = -1;
  std::vector<std::vector<Index>> batches;
  std::vector<EvaluationRequest> requests;
};

Box square() { return {Vector::Constant(2, -2.0), Vector::Constant(2, 2.0)}; }

Matrix spread(Index instances) {
  RandomStream random(3);
  Matrix starts(2, instances);
  for (Index i = 0; i < starts.size(); ++i) starts.data()[i] = random.uniform(-1.5, 1.5);
  return starts;
}

/// Gradient descent with halving: a different number of evaluations for every start. Ends after `most` iterations.
SolverOutcome descend(PointwiseSearch& search, const Vector& start, Index most) {
  Vector x = start;
  double step = 1e-3;
  const PointValue* value = search.evaluate(x, {.gradients = true});
  for (Index k = 0; value && k < most; ++k) {
    const double cost = value->cost;
    const Vector gradient = value->gradient;
    for (;;) {
      const Vector trial = x - step * gradient;
      const PointValue* there = search.evaluate(trial, {});
      if (!there) return {};
      if (there->cost < cost) {
        x = search.best_x();  // the trial, clamped
        break;
      }
      step *= 0.5;
      if (step < 1e-12) return {OptimiserStatus::converged, "no step is short enough"};
    }
    step *= 1.5;
    search.count_iteration();
    value = search.evaluate(x, {.gradients = true});
  }
  return {OptimiserStatus::budget_spent, ""};
}
PointwiseSolver descent(Index most = 200) {
  return [most](PointwiseSearch& s, const Vector& start) { return descend(s, start, most); };
}

std::vector<OptimiserResult> run(Objective& f, ConstMatrix starts, const PointwiseSolver& solver,
                                 const OptimiserOptions& options = {}, const OptimiserObserver& observer = nullptr) {
  return minimise_pointwise("test", f, starts, square(), Vector::Ones(2), options, observer, solver);
}

TEST(Batching, EqualsTheInstancesOneByOneBitForBit) {
  const Matrix starts = spread(9);
  Valley together;
  const auto all = run(together, starts, descent());
  for (Index i = 0; i < starts.cols(); ++i) {
    Valley alone;
    const auto one = run(alone, starts.col(i), descent());
    const auto& same = all[i];
    EXPECT_EQ(one[0].x, same.x);
    EXPECT_EQ(one[0].cost, same.cost);
    EXPECT_EQ(one[0].evaluations, same.evaluations);
    EXPECT_EQ(one[0].iterations, same.iterations);
    EXPECT_LT(same.cost, 0.2 * std::max(1.0, 0.5 * std::pow(10.0 * (starts(1, i) - starts(0, i) * starts(0, i)), 2)));
  }
}

TEST(Batching, BatchesDependOnDecisionsAndNotOnTiming) {
  const Matrix starts = spread(6);
  Valley first;
  run(first, starts, descent(40));
  for (int repeat = 0; repeat < 5; ++repeat) {
    Valley again;
    run(again, starts, [&](PointwiseSearch& s, const Vector& start) {
      std::this_thread::sleep_for(std::chrono::microseconds(100 * ((s.instance() + repeat) % 6)));
      return descend(s, start, 40);
    });
    EXPECT_EQ(again.batches, first.batches);
  }
}

TEST(Batching, OneCallPerKindOfRequestAndAscendingColumns) {
  Valley f;
  run(f, spread(4), [](PointwiseSearch& s, const Vector& start) {
    const EvaluationRequest request = s.instance() % 2 == 0
                                          ? EvaluationRequest{.gradients = true}
                                          : EvaluationRequest{.residuals = true, .jacobians = s.instance() == 3};
    const PointValue* value = s.evaluate(start, request);
    EXPECT_EQ(value->gradient.size(), s.instance() % 2 == 0 ? 2 : 0);
    EXPECT_EQ(value->residuals.size(), s.instance() % 2 == 0 ? 0 : 2);
    EXPECT_EQ(value->jacobian.size(), s.instance() == 3 ? 4 : 0);
    EXPECT_TRUE(value->finite);
    return SolverOutcome{};
  });
  EXPECT_EQ(f.batches, (std::vector<std::vector<Index>>{{0, 2}, {1}, {3}}));
}

TEST(Batching, InstancesThatEndLeaveTheBatch) {
  Valley f;
  const auto results = run(f, spread(4), [](PointwiseSearch& s, const Vector& start) {
    for (Index k = 0; k <= s.instance(); ++k) s.evaluate(start, {});
    return SolverOutcome{OptimiserStatus::converged, "enough"};
  });
  EXPECT_EQ(f.batches, (std::vector<std::vector<Index>>{{0, 1, 2, 3}, {1, 2, 3}, {2, 3}, {3}}));
  for (Index i = 0; i < 4; ++i) {
    EXPECT_EQ(results[i].evaluations, i + 1);
    EXPECT_EQ(results[i].message, "enough");
  }
}

TEST(Batching, SolversThatAskForNothingEnd) {
  Valley f;
  const auto results = run(f, spread(3), [](PointwiseSearch&, const Vector&) {
    return SolverOutcome{OptimiserStatus::infeasible, "no"};
  });
  EXPECT_TRUE(f.batches.empty());
  EXPECT_EQ(results[2].status, OptimiserStatus::infeasible);
  EXPECT_EQ(results[2].x, spread(3).col(2));
  EXPECT_TRUE(run(f, Matrix(2, 0), descent()).empty());
}

TEST(Batching, BudgetEndsEachInstanceAndNoMore) {
  for (const Index budget : {0, 1, 7, 20}) {
    Valley f;
    OptimiserOptions options;
    options.max_evaluations = budget;
    const auto results = run(f, spread(5), descent(), options);
    Index points = 0;
    for (const auto& batch : f.batches) points += static_cast<Index>(batch.size());
    EXPECT_EQ(points, 5 * budget);
    for (const auto& r : results) {
      EXPECT_EQ(r.evaluations, budget);
      EXPECT_EQ(r.status, OptimiserStatus::budget_spent);
    }
  }
}

TEST(Batching, ASolverThatIgnoresTheEndGetsNothingMore) {
  Valley f;
  OptimiserOptions options;
  options.max_evaluations = 3;
  const auto results = run(
      f, spread(3),
      [](PointwiseSearch& s, const Vector& start) {
        for (int k = 0; k < 50; ++k) EXPECT_EQ(s.evaluate(start, {}) == nullptr, k >= 3);
        EXPECT_TRUE(s.over());
        return SolverOutcome{OptimiserStatus::converged, "the solver's own reason comes too late"};
      },
      options);
  EXPECT_EQ(f.batches.size(), 3u);
  EXPECT_EQ(results[0].status, OptimiserStatus::budget_spent);
}

TEST(Batching, ObserverStopsAllAtOnceAndRunsHere) {
  Valley f;
  Index seen = 0;
  Vector last;
  const auto results = run(f, spread(4), descent(), {}, [&](Index round, const Vector& best) {
    EXPECT_EQ(std::this_thread::get_id(), f.caller);
    EXPECT_EQ(round, seen);
    EXPECT_TRUE(seen == 0 || (best.array() <= last.array()).all());
    last = best;
    return ++seen < 5;
  });
  EXPECT_EQ(seen, 5);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(results[i].status, OptimiserStatus::stopped);
    EXPECT_EQ(results[i].cost, last[i]);
  }
}

TEST(Batching, ErrorsOfTheObjectivePassThroughFromAnyBatch) {
  for (const Index batch : {0, 1, 5}) {
    Valley f;
    f.throw_at_batch = batch;
    EXPECT_THROW(run(f, spread(6), descent()), Diverged) << batch;
    EXPECT_EQ(static_cast<Index>(f.batches.size()), batch);
  }
}

TEST(Batching, ErrorsOfTheObserverPassThrough) {
  Valley f;
  EXPECT_THROW(run(f, spread(6), descent(), {},
                   [](Index round, const Vector&) -> bool {
                     if (round == 2) throw ConfigError("observer");
                     return true;
                   }),
               ConfigError);
}

TEST(Batching, OfSolversThatThrowTheLowestInstanceIsHeard) {
  for (int repeat = 0; repeat < 10; ++repeat) {
    Valley f;
    try {
      run(f, spread(8), [](PointwiseSearch& s, const Vector& start) {
        s.evaluate(start, {});
        if (s.instance() % 2 == 1) throw Error("instance " + std::to_string(s.instance()));
        return descend(s, start, 50);
      });
      FAIL() << "nothing was thrown";
    } catch (const Error& error) {
      EXPECT_STREQ(error.what(), "instance 1");
    }
    EXPECT_EQ(f.batches.size(), 1u);
  }
}

TEST(Batching, ThrowingWhileOthersHaveEndedAndOthersWait) {
  Valley f;
  EXPECT_THROW(run(f, spread(9),
                   [](PointwiseSearch& s, const Vector& start) {
                     if (s.instance() % 3 == 0) return SolverOutcome{};
                     s.evaluate(start, {});
                     if (s.instance() == 4) throw Unsupported("four");
                     return descend(s, start, 30);
                   }),
               Unsupported);
}

TEST(Batching, NonFiniteCostsCostTheirInstanceOnly) {
  const Matrix starts = spread(3);
  Valley sound, broken;
  broken.broken = 1;
  const auto a = run(sound, starts, descent(30)), b = run(broken, starts, descent(30));
  EXPECT_EQ(b[1].status, OptimiserStatus::diverged);
  EXPECT_EQ(b[1].cost, std::numeric_limits<double>::infinity());
  EXPECT_EQ(a[0].x, b[0].x);
  EXPECT_EQ(a[2].x, b[2].x);
}

TEST(Batching, PointsAreClampedAndNaNIsNeverEvaluated) {
  Valley f;
  const auto results = run(f, spread(1), [](PointwiseSearch& s, const Vector&) {
    const PointValue* value = s.evaluate(Vector::Constant(2, std::nan("")), {.gradients = true});
    EXPECT_EQ(value->cost, std::numeric_limits<double>::infinity());
    EXPECT_EQ(value->gradient.size(), 2);
    EXPECT_FALSE(value->finite);
    Vector far(2);
    far << 9.0, 4.0;
    EXPECT_EQ(s.evaluate(far, {})->cost, 0.5 * (400.0 + 1.0));  // at (2, 2)
    return SolverOutcome{};
  });
  EXPECT_EQ(results[0].evaluations, 1);
  EXPECT_EQ(results[0].x, Vector::Constant(2, 2.0));
}

TEST(Batching, ManyInstancesMeet) {
  Valley f;
  const auto results = run(f, spread(64), descent(25));
  EXPECT_EQ(results.size(), 64u);
  EXPECT_EQ(f.batches.front().size(), 64u);
}

TEST(Batching, SearchesNestAndRunSideBySide) {
  // A solver whose every step is a search of its own, on two threads at once.
  const auto outer = [] {
    Valley f;
    return minimise_pointwise("outer", f, spread(3), square(), Vector::Ones(2), {}, nullptr,
                              [](PointwiseSearch& s, const Vector& start) {
                                Valley inner;
                                const auto results = run(inner, start, descent(20));
                                s.evaluate(results[0].x, {});
                                return SolverOutcome{};
                              });
  };
  std::vector<OptimiserResult> a, b;
  std::thread one([&] { a = outer(); }), two([&] { b = outer(); });
  one.join();
  two.join();
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(a[i].x, b[i].x);
}

TEST(Batching, RefusesBadInput) {
  Valley f;
  const auto with = [&](ConstMatrix starts, const Box& box, const Vector& scale) {
    minimise_pointwise("test", f, starts, box, scale, {}, nullptr, descent());
  };
  const Vector ones = Vector::Ones(2);
  EXPECT_THROW(with(Matrix::Zero(3, 1), square(), ones), ShapeError);
  EXPECT_THROW(with(Matrix::Zero(2, 1), square(), Vector::Ones(3)), ShapeError);
  EXPECT_THROW(with(Matrix::Zero(2, 1), {Vector::Ones(2), Vector::Zero(2)}, ones), Error);
  EXPECT_THROW(with(Matrix::Zero(2, 1), {Vector::Ones(1), Vector::Ones(2)}, ones), ShapeError);
  EXPECT_THROW(with(Matrix::Constant(2, 1, std::nan("")), square(), ones), Error);
  EXPECT_THROW(with(Matrix::Zero(2, 1), square(), Vector::Zero(2)), Error);
  EXPECT_TRUE(f.batches.empty());
}

}  // namespace
}  // namespace weft
