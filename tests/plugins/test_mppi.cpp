#include "optimiser/mppi/mppi.cpp"  // the class is compiled in: what is tested here does not need the loader
#include "test_objectives.hpp"

namespace weft::mppi {
namespace {

using namespace weft::test;

Params cem() {
  Params p;
  p.method = "cem";
  return p;
}
std::vector<OptimiserResult> run(const Params& p, LeastSquares& f, ConstMatrix starts, const Box& box,
                                 const OptimiserOptions& options = {}, const OptimiserObserver& observer = nullptr) {
  return Mppi(p).minimise(f, starts, box, Vector::Constant(f.dim(), 0.5), options, observer);
}

TEST(Mppi, EveryInstanceHasItsPopulationInOneBatch) {
  LeastSquares f = rosenbrock();
  Params p;
  p.samples = 5;
  OptimiserOptions options;
  options.max_iterations = 1;
  run(p, f, spread(), cube(2, 2), options);
  ASSERT_EQ(f.owners.size(), 2u);
  EXPECT_EQ(f.owners[0], (std::vector<Index>{0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2}));
  for (Index i = 0; i < 3; ++i) EXPECT_EQ(f.points[5 * i], spread().col(i));  // the mean itself
  for (const auto& request : f.requests) EXPECT_EQ(request, EvaluationRequest());
}

TEST(Mppi, UpdateFollowsTheWeightsByHand) {
  LeastSquares f = bowl(vec({3.0}), vec({1.0}));
  Params p;
  p.samples = 6;
  p.mppi.temperature = 0.7;
  p.mppi.temperature_unit = "cost";
  OptimiserOptions options;
  options.max_iterations = 1;
  options.seed = 4;
  run(p, f, vec({0.5}), cube(1, 9), options);
  ASSERT_EQ(f.points.size(), 12u);
  double sum = 0.0, mean = 0.0;
  for (std::size_t k = 0; k < 6; ++k) {
    const double weight = std::exp(-0.5 * std::pow(f.points[k][0] - 3.0, 2) / 0.7);
    sum += weight;
    mean += weight * f.points[k][0];
  }
  EXPECT_NEAR(f.points[6][0], mean / sum, 1e-12);  // the second population's mean
}

TEST(Mppi, MakesProgressInNoise) {
  LeastSquares f(3, 3, [random = RandomStream(5)](const Vector& x, Index) mutable {
    Vector r = x;
    for (Index i = 0; i < 3; ++i) r[i] += 0.1 * random.normal();
    return Residuals{r, Matrix::Identity(3, 3)};
  });
  for (const Params& p : {Params(), cem()})
    EXPECT_LT(run(p, f, vec({1.2, -1.5, 0.9}), cube(3, 2))[0].x.squaredNorm(), 0.1 * 4.5) << p.method;
}

TEST(Mppi, SpreadTemperatureKnowsNoUnits) {
  LeastSquares f = bowl(vec({1.0, -1.0}), vec({1, 2})), g = bowl(vec({1.0, -1.0}), vec({1e6, 2e6}));
  run(Params(), f, Matrix::Zero(2, 1), cube(2, 4));
  run(Params(), g, Matrix::Zero(2, 1), cube(2, 4));
  for (std::size_t i = 0; i < 200; ++i) EXPECT_TRUE(f.points[i].isApprox(g.points[i], 1e-9)) << i;
}

TEST(Mppi, NoiseDecaysToItsFloor) {
  LeastSquares f = bowl(Vector::Zero(1), Vector::Zero(1));  // flat: the mean stays where it is
  Params p;
  p.samples = 400;
  p.mppi.noise_decay = 0.5;
  p.min_noise = 0.1;
  p.step_tolerance = 0.0;
  OptimiserOptions options;
  options.max_iterations = 6;
  run(p, f, Matrix::Zero(1, 1), cube(1, 100), options);
  const double wanted[] = {0.5, 0.25, 0.125, 0.0625, 0.05, 0.05, 0.05};  // scale 0.5
  for (std::size_t t = 0; t < 7; ++t) {
    double square = 0.0;
    for (std::size_t k = 1; k < 400; ++k) square += std::pow(f.points[400 * t + k][0], 2) / 399.0;
    EXPECT_NEAR(std::sqrt(square), wanted[t], 0.15 * wanted[t]) << t;
  }
}

TEST(Cem, FitsMeanAndDeviationOfTheElite) {
  LeastSquares f = bowl(vec({3.0}), vec({1.0}));
  Params p = cem();
  p.samples = 2000;
  p.cem.elite_fraction = 0.01;
  p.cem.smoothing = 0.6;
  p.cem.noise_smoothing = 0.8;
  OptimiserOptions options;
  options.max_iterations = 1;
  run(p, f, vec({0.5}), cube(1, 9), options);
  std::vector<double> x;
  for (std::size_t k = 0; k < 2000; ++k) x.push_back(f.points[k][0]);
  std::sort(x.begin(), x.end(), [](double a, double b) { return std::abs(a - 3.0) < std::abs(b - 3.0); });
  double mean = 0.0, square = 0.0, spread_then = 0.0;
  for (std::size_t k = 0; k < 20; ++k) mean += x[k] / 20;
  for (std::size_t k = 0; k < 20; ++k) square += std::pow(x[k] - mean, 2) / 20;
  const double wanted_mean = 0.6 * mean + 0.4 * 0.5;
  EXPECT_NEAR(f.points[2000][0], wanted_mean, 1e-12);
  for (std::size_t k = 1; k < 2000; ++k) spread_then += std::pow(f.points[2000 + k][0] - wanted_mean, 2) / 1999;
  const double wanted = 0.8 * std::sqrt(square) + 0.2 * 0.5;  // t = 1: beta_1 = beta
  EXPECT_NEAR(std::sqrt(spread_then), wanted, 0.1 * wanted);
}

class Methods : public testing::TestWithParam<const char*> {
 protected:
  Params params() const {
    Params p;
    p.method = GetParam();
    return p;
  }
};
INSTANTIATE_TEST_SUITE_P(All, Methods, testing::Values("mppi", "cem"));

TEST_P(Methods, ReducesABowlAndStaysInTheBox) {
  LeastSquares f = bowl(vec({0.5, -1.0, 7.0}), vec({1, 4, 9}));
  OptimiserOptions options;
  options.max_iterations = 150;
  const auto r = run(params(), f, vec({-1.5, 1.5, -1.0}), cube(3, 2), options);
  EXPECT_LT(r[0].cost - 0.5 * 9 * 25, 1e-2);
  for (const auto& x : f.points) EXPECT_LE(x.cwiseAbs().maxCoeff(), 2.0);
}

TEST_P(Methods, FindsTheDeeperBasin) {
  LeastSquares f = two_basins(2);
  Params p = params();
  p.noise = 3.0;
  OptimiserOptions options;
  options.max_iterations = 100;
  EXPECT_LT(run(p, f, vec({1.0, 1.0}), cube(2, 2), options)[0].cost, 0.1);
}

TEST_P(Methods, SeedAndInstanceDecideTheSamples) {
  LeastSquares f = rosenbrock(), g = rosenbrock(), h = rosenbrock();
  OptimiserOptions options;
  options.max_iterations = 5;
  options.seed = 7;
  const auto a = run(params(), f, spread(), cube(2, 2), options);
  const auto b = run(params(), g, spread().leftCols(2), cube(2, 2), options);
  EXPECT_EQ(a[0].x, b[0].x);
  EXPECT_EQ(a[1].x, b[1].x);
  options.seed = 8;
  EXPECT_NE(run(params(), h, spread(), cube(2, 2), options)[0].x, a[0].x);
}

TEST_P(Methods, LastPopulationFitsTheBudget) {
  LeastSquares f = rosenbrock();
  OptimiserOptions options;
  options.max_evaluations = 70;  // 32 + 32 + 6
  const auto r = run(params(), f, spread(), cube(2, 2), options);
  EXPECT_EQ(f.points.size(), 210u);
  for (const auto& one : r) {
    EXPECT_EQ(one.evaluations, 70);
    EXPECT_EQ(one.iterations, 2);
    EXPECT_EQ(one.status, OptimiserStatus::budget_spent);
  }
}

TEST_P(Methods, SamplesWithoutACostAreLeftOut) {
  LeastSquares f(1, 1, [](const Vector& x, Index) {
    return Residuals{Vector::Constant(1, x[0] > 0.5 ? kNaN : x[0] - 1.0), Matrix::Ones(1, 1)};
  });
  OptimiserOptions options;
  options.max_iterations = 60;
  const auto r = run(params(), f, vec({-1.0}), cube(1, 3), options);
  EXPECT_NEAR(r[0].x[0], 0.5, 0.05);
  LeastSquares none(1, 1, [](const Vector&, Index) {
    return Residuals{Vector::Constant(1, kNaN), Matrix::Ones(1, 1)};
  });
  EXPECT_EQ(run(params(), none, vec({-1.0}), cube(1, 3), options)[0].status, OptimiserStatus::diverged);
}

TEST_P(Methods, ConvergesWhenTheNoiseIsSmall) {
  LeastSquares f = bowl(vec({0.5}), vec({1}));
  Params p = params();
  p.step_tolerance = 0.05;
  OptimiserOptions options;
  options.max_iterations = 1000;
  const auto r = run(p, f, vec({-1.0}), cube(1, 3), options);
  EXPECT_EQ(r[0].status, OptimiserStatus::converged);
  EXPECT_LT(r[0].iterations, 200);
}

TEST(Mppi, RefusesAnEliteOfNobody) {
  Params p = cem();
  p.samples = 4;
  p.cem.elite_fraction = 0.1;
  EXPECT_THROW(Mppi{p}, ConfigError);
}

TEST_P(Methods, ObeysTheLaws) {
  PluginBench bench;
  EXPECT_EQ(failed_laws(bench.host(), std::string("{plugin: mppi, params: {method: ") + GetParam() + "}}"), "");
}

}  // namespace
}  // namespace weft::mppi
