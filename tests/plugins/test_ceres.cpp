#include "test_objectives.hpp"

namespace weft::test {
namespace {

std::vector<OptimiserResult> run(const std::string& params, LeastSquares& f, ConstMatrix starts, const Box& box,
                                 const Vector& scale, const OptimiserOptions& options = {},
                                 const OptimiserObserver& observer = nullptr) {
  PluginBench bench;
  return bench.optimiser("{plugin: ceres, params: {" + params + "}}")
      ->minimise(f, starts, box, scale, options, observer);
}
std::vector<OptimiserResult> run(const std::string& params, LeastSquares& f, ConstMatrix starts, const Box& box) {
  return run(params, f, starts, box, Vector::Ones(f.dim()));
}

class CeresMethod : public testing::TestWithParam<const char*> {
 protected:
  std::string params() const { return std::string("method: ") + GetParam(); }
  bool least_squares() const {
    return params().find("levenberg") != std::string::npos || params().find("dogleg") != std::string::npos;
  }
};
INSTANTIATE_TEST_SUITE_P(All, CeresMethod,
                         testing::Values("lbfgs", "bfgs", "nonlinear_conjugate_gradient", "steepest_descent",
                                         "levenberg_marquardt", "dogleg"));

TEST_P(CeresMethod, DeclaresWhatItAsksFor) {
  PluginBench bench;
  const auto c = bench.optimiser("{plugin: ceres, params: {" + params() + "}}")->capabilities();
  EXPECT_EQ(c.needs_gradients, !least_squares());
  EXPECT_EQ(c.needs_residuals, least_squares());
}

TEST_P(CeresMethod, SolvesABowlInsideTheBox) {
  LeastSquares f = bowl(vec({0.5, -1.0, 0.2}), vec({1, 4, 9}));
  const auto r = run(params(), f, Matrix::Zero(3, 2), cube(3, 3));
  for (const auto& one : r) {
    EXPECT_LT(one.cost, 1e-4) << one.message;
    // Without curvature the budget ends first.
    const bool is_slow = params().find("steepest") != std::string::npos;
    EXPECT_EQ(one.status, is_slow ? OptimiserStatus::budget_spent : OptimiserStatus::converged) << one.message;
  }
}

TEST_P(CeresMethod, StopsOnTheFaceOfTheBoxAndNeverLeavesIt) {
  LeastSquares f = bowl(vec({5, 0.25}), vec({1, 1}));
  const auto r = run(params(), f, vec({-9, -9}), cube(2, 1));
  EXPECT_NEAR(r[0].x[0], 1.0, 1e-3) << r[0].message;
  EXPECT_NEAR(r[0].x[1], 0.25, 1e-2);
  for (const auto& x : f.points) EXPECT_LE(x.cwiseAbs().maxCoeff(), 1.0);
}

TEST_P(CeresMethod, LeavesAFaceThatItStartsOn) {
  LeastSquares f = bowl(vec({0.2, 0.1}), vec({1, 1}));
  const auto r = run(params(), f, vec({-1, 1}), cube(2, 1));
  EXPECT_EQ(f.points[0], vec({-1, 1}));  // the start itself is evaluated, too
  EXPECT_LT(r[0].cost, 1e-3) << r[0].message;
}

TEST_P(CeresMethod, FixedVariablesStayFixed) {
  LeastSquares f = bowl(vec({5, 0.5, -3}), vec({1, 1, 1}));
  const Box box{vec({0.3, -1, 0.1}), vec({0.3, 1, 0.1})};
  const auto r = run(params(), f, vec({0.3, 0.0, 0.1}), box);
  EXPECT_EQ(r[0].x[0], 0.3);
  EXPECT_EQ(r[0].x[2], 0.1);
  EXPECT_NEAR(r[0].x[1], 0.5, 1e-2);
  LeastSquares g = bowl(vec({5}), vec({1}));
  const auto fixed = run(params(), g, vec({0.3}), {vec({0.3}), vec({0.3})});
  EXPECT_EQ(fixed[0].status, OptimiserStatus::converged);
  EXPECT_EQ(fixed[0].evaluations, 1);
}

TEST_P(CeresMethod, UnitsOfTheVariablesDoNotMatter) {
  // The same bowl in metres and millimetres, scales likewise: the same iterations up to rounding.
  LeastSquares f = bowl(vec({0.5, -0.4}), vec({1, 4}));
  LeastSquares g = bowl(vec({500, -400}), vec({1e-6, 4e-6}));
  const auto a = run(params(), f, Matrix::Zero(2, 1), cube(2, 2), Vector::Ones(2));
  const auto b = run(params(), g, Matrix::Zero(2, 1), cube(2, 2000), Vector::Constant(2, 1000));
  EXPECT_EQ(a[0].iterations, b[0].iterations);
  EXPECT_TRUE((1000.0 * a[0].x).isApprox(b[0].x, 1e-6));
}

TEST_P(CeresMethod, SurvivesAWallOfNaN) {
  LeastSquares f(1, 1, [](const Vector& x, Index) {
    return Residuals{Vector::Constant(1, x[0] > 0.9 ? kNaN : x[0] - 1.0), Matrix::Ones(1, 1)};
  });
  const auto r = run(params(), f, Matrix::Constant(1, 1, -1.0), cube(1, 3));
  EXPECT_LT(r[0].cost, 0.5 * 0.5 * 0.5) << r[0].message;
  EXPECT_LE(r[0].x[0], 0.9);
}

TEST_P(CeresMethod, ErrorsOfTheObjectivePassThrough) {
  for (const Index call : {1, 2, 4}) {
    LeastSquares f = rosenbrock();
    f.throw_at_call = call;
    EXPECT_THROW(run(params(), f, spread(), cube(2, 2)), Diverged) << call;
  }
}

TEST_P(CeresMethod, ObeysTheLaws) {
  PluginBench bench;
  // Methods without curvature need more than the kit's budget for narrow valleys.
  const std::string slow = "{bound: 0.2, reason: no curvature}";
  const bool is_slow =
      params().find("steepest") != std::string::npos || params().find("conjugate") != std::string::npos;
  EXPECT_EQ(failed_laws(bench.host(), "{plugin: ceres, params: {" + params() + "}}",
                        is_slow ? "{solves_rosenbrock: " + slow + ", solves_an_ill_conditioned_quadratic: " + slow + "}"
                                : "{}"),
            "");
}

TEST(Ceres, LevenbergMarquardtTakesFewEvaluationsAndSparesJacobians) {
  LeastSquares f = rosenbrock();
  const auto r = run("method: levenberg_marquardt", f, vec({-1.2, 1.0}), cube(2, 2));
  EXPECT_LT(r[0].cost, 1e-9);
  EXPECT_LT(r[0].evaluations, 100);  // an accepted step counts twice: its residuals, then its Jacobian
  Index jacobians = 0, trials = 0;
  for (const auto& request : f.requests) {
    EXPECT_FALSE(request.gradients);
    EXPECT_TRUE(request.residuals);
    ++(request.jacobians ? jacobians : trials);
  }
  EXPECT_GT(trials, 0);  // trial steps ask for residuals alone
  EXPECT_GT(jacobians, 0);
}

TEST(Ceres, AJacobianThatNoIterationWouldUseIsNotAskedFor) {
  for (const char* method : {"levenberg_marquardt", "dogleg"})
    for (const Index iterations : {0, 1, 3}) {
      LeastSquares f = rosenbrock();
      OptimiserOptions options;
      options.max_iterations = iterations;
      const auto r = run(std::string("method: ") + method, f, vec({-1.2, 1.0}), cube(2, 2), Vector::Ones(2), options);
      const auto jacobians =
          std::count_if(f.requests.begin(), f.requests.end(), [](const auto& q) { return q.jacobians; });
      EXPECT_LE(jacobians, iterations) << method;
      EXPECT_EQ(jacobians == 0, iterations == 0) << method;
      EXPECT_EQ(r[0].iterations, iterations) << method;
      EXPECT_EQ(r[0].status, OptimiserStatus::budget_spent) << method;
    }
}

TEST(Ceres, LbfgsBeatsSteepestDescentInAValley) {
  LeastSquares f = rosenbrock(), g = rosenbrock();
  OptimiserOptions options;
  options.max_evaluations = 60;
  const auto fast = run("method: lbfgs", f, vec({-1.2, 1.0}), cube(2, 2), Vector::Ones(2), options);
  const auto slow = run("method: steepest_descent", g, vec({-1.2, 1.0}), cube(2, 2), Vector::Ones(2), options);
  EXPECT_LT(fast[0].cost, 1e-3);
  EXPECT_LT(fast[0].cost, slow[0].cost);
}

TEST(Ceres, FirstTrialStepIsInitialStepScales) {
  LeastSquares f = bowl(vec({50, 0}), vec({1e-3, 1e-3}));
  OptimiserOptions options;
  options.max_evaluations = 2;
  run("line_search: {initial_step: 0.25}", f, Matrix::Zero(2, 1), cube(2, 1e4), vec({2, 1}), options);
  ASSERT_EQ(f.points.size(), 2u);
  EXPECT_NEAR(f.points[1][0], 0.5, 1e-6);  // a quarter of a scale of 2
}

TEST(Ceres, IterationsAreCeresOwn) {
  LeastSquares f = rosenbrock();
  OptimiserOptions options;
  options.max_iterations = 4;
  const auto r = run("method: lbfgs", f, vec({-1.2, 1.0}), cube(2, 2), Vector::Ones(2), options);
  EXPECT_EQ(r[0].iterations, 4);
  EXPECT_EQ(r[0].status, OptimiserStatus::budget_spent);
  EXPECT_GE(r[0].evaluations, 5);
}

TEST(Ceres, RefusesWhatTheObjectiveDoesNotOffer) {
  LeastSquares f = rosenbrock();
  f.offers_residuals = false;
  EXPECT_THROW(run("method: levenberg_marquardt", f, spread(), cube(2, 2)), Unsupported);
  f.offers_residuals = true;
  f.gradients = false;
  EXPECT_THROW(run("method: lbfgs", f, spread(), cube(2, 2)), Unsupported);
  EXPECT_TRUE(f.requests.empty());
}

TEST(Ceres, RefusesOptionsThatCeresRefuses) {
  PluginBench bench;
  EXPECT_THROW(bench.optimiser("{plugin: ceres, params: {method: bfgs, line_search: {type: armijo}}}"), ConfigError);
  EXPECT_THROW(bench.optimiser("{plugin: ceres, params: {line_search: {max_contraction: 0.9, min_contraction: 0.5}}}"),
               ConfigError);
  EXPECT_THROW(bench.optimiser("{plugin: ceres, params: {method: newton}}"), ConfigError);
}

TEST(Ceres, PrintsNothing) {
  testing::internal::CaptureStderr();
  testing::internal::CaptureStdout();
  LeastSquares f(1, 1, [](const Vector& x, Index) {
    return Residuals{Vector::Constant(1, x[0] != 0.5 ? kNaN : 1.0), Matrix::Ones(1, 1)};
  });
  for (const char* method : {"lbfgs", "steepest_descent", "levenberg_marquardt", "dogleg"})
    run(std::string("method: ") + method, f, Matrix::Constant(1, 1, 0.5), cube(1, 3));
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

}  // namespace
}  // namespace weft::test
