#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "optimiser/rprop/rprop.cpp"  // the class is compiled in: what is tested here does not need the loader
#include "weft/random.hpp"

namespace weft::rprop {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// cost(x, gradient) per point. Keeps every batch of points.
class Function final : public Objective {
 public:
  using Call = std::function<double(const Vector& x, Vector& gradient, Index instance)>;
  Function(Index dim, Call call) : dim_(dim), call_(std::move(call)) {}
  Index dim() const override { return dim_; }
  ObjectiveCapabilities capabilities() const override { return {gradients, 0}; }
  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) override {
    EXPECT_TRUE(request.gradients);
    EXPECT_FALSE(request.residuals);
    batches.push_back(instances);
    Evaluation e;
    e.costs.resize(x.cols());
    e.gradients.resize(dim_, x.cols());
    for (Index j = 0; j < x.cols(); ++j) {
      Vector g = Vector::Zero(dim_);
      e.costs[j] = call_(x.col(j), g, instances[j]);
      e.gradients.col(j) = g;
      points.push_back(x.col(j));
    }
    return e;
  }
  bool gradients = true;
  std::vector<std::vector<Index>> batches;
  std::vector<Vector> points;

 private:
  Index dim_;
  Call call_;
};

Function bowl(const Vector& centre, const Vector& curvature) {
  return {centre.size(), [=](const Vector& x, Vector& g, Index) {
            g = curvature.cwiseProduct(x - centre);
            return 0.5 * (x - centre).dot(g);
          }};
}

Vector vec(std::initializer_list<double> values) {
  Vector v(static_cast<Index>(values.size()));
  std::copy(values.begin(), values.end(), v.data());
  return v;
}
Box cube(Index dim, double half) { return {Vector::Constant(dim, -half), Vector::Constant(dim, half)}; }

TEST(Rprop, FollowsTheRuleByHand) {
  // f = |x|, one variable, scale 1, start 1: steps 0.1, 0.12, 0.144 (grown by 1.2 while the sign holds).
  Function f(1, [](const Vector& x, Vector& g, Index) {
    g[0] = x[0] > 0 ? 1.0 : -1.0;
    return std::abs(x[0]);
  });
  OptimiserOptions options;
  options.max_iterations = 8;
  Rprop(Params{}).minimise(f, Matrix::Constant(1, 1, 0.3), cube(1, 100), Vector::Ones(1), options, nullptr);
  const double wanted[] = {0.3, 0.2, 0.2 - 0.12, 0.08 - 0.144, -0.064 + 0.072, 0.008 - 0.036};
  for (std::size_t i = 0; i < std::size(wanted); ++i) EXPECT_NEAR(f.points[i][0], wanted[i], 1e-15) << i;
}

TEST(Rprop, FirstStepIsAMultipleOfEachScale) {
  Function f = bowl(vec({10, -10}), vec({1, 1e-6}));
  OptimiserOptions options;
  options.max_iterations = 1;
  const auto r = Rprop(Params{}).minimise(f, Matrix::Zero(2, 1), cube(2, 100), vec({2.0, 0.01}), options, nullptr);
  ASSERT_EQ(f.points.size(), 2u);
  EXPECT_TRUE(f.points[1].isApprox(vec({0.2, -0.001}), 1e-15));
  EXPECT_EQ(r[0].status, OptimiserStatus::budget_spent);
  EXPECT_EQ(r[0].iterations, 1);
  EXPECT_EQ(r[0].evaluations, 2);
}

TEST(Rprop, StepsAreBoundedByTheBox) {
  Function f = bowl(vec({1e6}), vec({1}));
  OptimiserOptions options;
  options.max_iterations = 12;
  Params p;
  p.initial_step = 1.0;
  p.max_step = 0.1;
  Rprop(p).minimise(f, Matrix::Zero(1, 1), {vec({0}), vec({20})}, vec({1}), options, nullptr);
  double largest = 0;
  for (std::size_t i = 1; i < f.points.size(); ++i) largest = std::max(largest, f.points[i][0] - f.points[i - 1][0]);
  EXPECT_NEAR(largest, 2.0, 1e-12);
}

TEST(Rprop, SolvesAnIllConditionedBowl) {
  Function f = bowl(vec({1, -2, 3}), vec({1, 100, 1e4}));
  OptimiserOptions options;
  options.max_iterations = 400;
  const auto r = Rprop(Params{}).minimise(f, Matrix::Zero(3, 1), cube(3, 5), Vector::Ones(3), options, nullptr);
  EXPECT_LT(r[0].cost, 1e-6);
  EXPECT_EQ(r[0].status, OptimiserStatus::converged) << r[0].message;
  EXPECT_LT(r[0].iterations, 400);
}

TEST(Rprop, MakesProgressInNoise) {
  Function f(3, [random = RandomStream(5)](const Vector& x, Vector& g, Index) mutable {
    for (Index i = 0; i < 3; ++i) g[i] = x[i] + 0.2 * random.normal();
    return 0.5 * x.squaredNorm() + 0.05 * random.normal();
  });
  const Vector start = vec({1.2, -1.5, 0.9});
  const auto r = Rprop(Params{}).minimise(f, start, cube(3, 2), Vector::Constant(3, 0.25), {}, nullptr);
  EXPECT_LT(r[0].x.squaredNorm(), 0.1 * start.squaredNorm());
}

TEST(Rprop, StopsOnTheBoundaryAndNeverLeavesTheBox) {
  Function f = bowl(vec({5, 0.25}), vec({1, 1}));
  OptimiserOptions options;
  options.max_iterations = 300;
  const auto r = Rprop(Params{}).minimise(f, vec({-9, -9}), cube(2, 1), Vector::Ones(2), options, nullptr);
  EXPECT_EQ(r[0].x[0], 1.0);
  EXPECT_NEAR(r[0].x[1], 0.25, 1e-4);
  EXPECT_EQ(r[0].status, OptimiserStatus::converged);
  for (const auto& x : f.points) EXPECT_LE(x.cwiseAbs().maxCoeff(), 1.0);
}

TEST(Rprop, FixedVariableStaysFixed) {
  Function f = bowl(vec({5, 0.5}), vec({1, 1}));
  OptimiserOptions options;
  options.max_iterations = 200;
  const auto r =
      Rprop(Params{}).minimise(f, vec({0.3, 0.0}), {vec({0.3, -1}), vec({0.3, 1})}, Vector::Ones(2), options, nullptr);
  EXPECT_EQ(r[0].x[0], 0.3);
  EXPECT_NEAR(r[0].x[1], 0.5, 1e-4);
}

TEST(Rprop, AllInstancesShareABatchAndTheConvergedLeaveIt) {
  Function f = bowl(vec({0.5}), vec({1}));
  Matrix starts(1, 3);
  starts << 0.9, 0.5, -0.9;  // the middle one starts at the minimum
  OptimiserOptions options;
  options.max_iterations = 100;
  const auto r = Rprop(Params{}).minimise(f, starts, cube(1, 1), Vector::Ones(1), options, nullptr);
  ASSERT_GE(f.batches.size(), 2u);
  EXPECT_EQ(f.batches[0], (std::vector<Index>{0, 1, 2}));
  EXPECT_EQ(f.batches[1], (std::vector<Index>{0, 2}));
  EXPECT_EQ(r[1].status, OptimiserStatus::converged);
  EXPECT_EQ(r[1].evaluations, 1);
  for (const auto& one : r) EXPECT_NEAR(one.x[0], 0.5, 1e-4);
}

TEST(Rprop, AnInstanceAloneGivesTheSameBits) {
  const auto rosenbrock = [](const Vector& x, Vector& g, Index) {
    const double a = 1 - x[0], b = x[1] - x[0] * x[0];
    g << -2 * a - 400 * x[0] * b, 200 * b;
    return a * a + 100 * b * b;
  };
  Matrix starts(2, 3);
  starts << -1.2, 0.3, 1.7, 1.0, -0.5, 1.9;
  OptimiserOptions options;
  options.max_iterations = 400;
  Function together(2, rosenbrock);
  const auto r = Rprop(Params{}).minimise(together, starts, cube(2, 2), Vector::Ones(2), options, nullptr);
  for (Index i = 0; i < 3; ++i) {
    Function alone(2, rosenbrock);
    const auto one = Rprop(Params{}).minimise(alone, starts.col(i), cube(2, 2), Vector::Ones(2), options, nullptr);
    EXPECT_EQ(one[0].x, r[i].x);
    EXPECT_EQ(one[0].cost, r[i].cost);
    EXPECT_EQ(one[0].evaluations, r[i].evaluations);
    EXPECT_LT(one[0].cost, 0.5);
  }
}

TEST(Rprop, ResultIsTheBestPointEvaluated) {
  Function f = bowl(vec({0.55}), vec({1}));
  OptimiserOptions options;
  options.max_iterations = 7;
  Params p;
  p.initial_step = 0.5;
  const auto r = Rprop(p).minimise(f, Matrix::Zero(1, 1), cube(1, 5), Vector::Ones(1), options, nullptr);
  double best = kInfinity;
  for (const auto& x : f.points) best = std::min(best, 0.5 * std::pow(x[0] - 0.55, 2));
  EXPECT_EQ(r[0].cost, best);
  EXPECT_NEAR(0.5 * std::pow(r[0].x[0] - 0.55, 2), best, 1e-18);
}

TEST(Rprop, StepsBackFromNonFiniteCosts) {
  // Minimum at 1, a wall of NaN from 1.02 on; the first steps jump over it.
  Function f(1, [](const Vector& x, Vector& g, Index) {
    g[0] = x[0] - 1;
    return x[0] > 1.02 ? kNaN : 0.5 * (x[0] - 1) * (x[0] - 1);
  });
  OptimiserOptions options;
  options.max_iterations = 200;
  Params p;
  p.initial_step = 0.7;
  const auto r = Rprop(p).minimise(f, Matrix::Zero(1, 1), cube(1, 5), Vector::Ones(1), options, nullptr);
  EXPECT_NEAR(r[0].x[0], 1.0, 1e-3);
  EXPECT_EQ(r[0].status, OptimiserStatus::converged) << r[0].message;
}

TEST(Rprop, GivesUpWhenEveryStepIsNonFinite) {
  Function f(1, [](const Vector& x, Vector& g, Index) {
    g[0] = 1;
    return x[0] == 0.5 ? 3.0 : kInfinity;
  });
  OptimiserOptions options;
  const auto r =
      Rprop(Params{}).minimise(f, Matrix::Constant(1, 1, 0.5), cube(1, 5), Vector::Ones(1), options, nullptr);
  EXPECT_EQ(r[0].status, OptimiserStatus::diverged);
  EXPECT_EQ(r[0].cost, 3.0);
  EXPECT_EQ(r[0].x[0], 0.5);
  EXPECT_EQ(r[0].evaluations, 2 + Params{}.max_retries);
}

TEST(Rprop, NonFiniteStartCostsThatInstanceOnly) {
  for (const bool gradient : {false, true}) {
    const auto call = [=](const Vector& x, Vector& g, Index instance) {
      g = x;
      if (instance == 1 && gradient) g[0] = kNaN;
      return instance == 1 && !gradient ? -kInfinity : 0.5 * x.squaredNorm();
    };
    Function f(2, call), alone(2, call);
    Matrix starts(2, 2);
    starts << 1, 2, 3, 4;
    OptimiserOptions options;
    const auto r = Rprop(Params{}).minimise(f, starts, cube(2, 5), Vector::Ones(2), options, nullptr);
    const auto one = Rprop(Params{}).minimise(alone, starts.col(0), cube(2, 5), Vector::Ones(2), options, nullptr);
    EXPECT_EQ(r[1].status, OptimiserStatus::diverged);
    EXPECT_EQ(r[1].cost, kInfinity);
    EXPECT_EQ(r[0].x, one[0].x);
  }
}

TEST(Rprop, RespectsTheEvaluationBudget) {
  Function f = bowl(vec({4}), vec({1}));
  OptimiserOptions options;
  options.max_evaluations = 5;
  const auto r = Rprop(Params{}).minimise(f, Matrix::Zero(1, 2), cube(1, 5), Vector::Ones(1), options, nullptr);
  EXPECT_EQ(f.points.size(), 10u);
  EXPECT_EQ(r[0].evaluations, 5);
  EXPECT_EQ(r[0].status, OptimiserStatus::budget_spent);
  options.max_evaluations = 0;
  EXPECT_EQ(Rprop(Params{}).minimise(f, Matrix::Zero(1, 1), cube(1, 5), Vector::Ones(1), options, nullptr)[0].status,
            OptimiserStatus::budget_spent);
  EXPECT_EQ(f.points.size(), 10u);
}

TEST(Rprop, ObserverSeesTheBestCostsAndStops) {
  Function f = bowl(vec({4}), vec({1}));
  std::vector<double> seen;
  const auto r = Rprop(Params{}).minimise(f, Matrix::Zero(1, 1), cube(1, 5), Vector::Ones(1), {},
                                          [&](Index iteration, const Vector& best) {
                                            EXPECT_EQ(iteration, static_cast<Index>(seen.size()));
                                            seen.push_back(best[0]);
                                            return seen.size() < 4;
                                          });
  EXPECT_EQ(r[0].status, OptimiserStatus::stopped);
  EXPECT_EQ(f.batches.size(), 4u);
  EXPECT_TRUE(std::is_sorted(seen.rbegin(), seen.rend()));
  EXPECT_EQ(seen.front(), 8.0);
}

TEST(Rprop, StopsWhenTheBestCostNoLongerImproves) {
  Function f(1, [](const Vector& x, Vector& g, Index) {
    g[0] = 1.0;
    return 7.0 + 0.0 * x[0];
  });
  OptimiserOptions options;
  options.max_iterations = 1000;
  const auto r = Rprop(Params{}).minimise(f, Matrix::Zero(1, 1), cube(1, 1e9), Vector::Ones(1), options, nullptr);
  EXPECT_EQ(r[0].status, OptimiserStatus::converged);
  EXPECT_EQ(r[0].evaluations, Params{}.patience + 1);
}

TEST(Rprop, RefusesBadInput) {
  Function f = bowl(vec({1, 2}), vec({1, 1}));
  const Rprop rprop{Params{}};
  const Box box = cube(2, 1);
  const Vector scale = Vector::Ones(2);
  EXPECT_THROW(rprop.minimise(f, Matrix::Zero(3, 1), box, scale, {}, nullptr), ShapeError);
  EXPECT_THROW(rprop.minimise(f, Matrix::Zero(2, 1), cube(3, 1), scale, {}, nullptr), ShapeError);
  EXPECT_THROW(rprop.minimise(f, Matrix::Zero(2, 1), box, Vector::Ones(1), {}, nullptr), ShapeError);
  EXPECT_THROW(rprop.minimise(f, Matrix::Zero(2, 1), box, Vector::Zero(2), {}, nullptr), Error);
  EXPECT_THROW(rprop.minimise(f, Matrix::Constant(2, 1, kNaN), box, scale, {}, nullptr), Error);
  EXPECT_THROW(rprop.minimise(f, Matrix::Zero(2, 1), {vec({1, 0}), vec({0, 1})}, scale, {}, nullptr), Error);
  EXPECT_THROW(rprop.minimise(f, Matrix::Zero(2, 1), {vec({-kInfinity, 0}), vec({0, 1})}, scale, {}, nullptr), Error);
  f.gradients = false;
  EXPECT_THROW(rprop.minimise(f, Matrix::Zero(2, 1), box, scale, {}, nullptr), Unsupported);
  EXPECT_TRUE(f.points.empty());
  f.gradients = true;
  EXPECT_TRUE(rprop.minimise(f, Matrix(2, 0), box, scale, {}, nullptr).empty());
}

TEST(Rprop, ErrorsOfTheObjectivePassThrough) {
  Function f(1, [](const Vector&, Vector&, Index) -> double { throw Diverged("frame 3"); });
  EXPECT_THROW(Rprop(Params{}).minimise(f, Matrix::Zero(1, 1), cube(1, 1), Vector::Ones(1), {}, nullptr), Diverged);
}

}  // namespace
}  // namespace weft::rprop
