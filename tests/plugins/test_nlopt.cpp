#include "test_objectives.hpp"

namespace weft::test {
namespace {

std::vector<OptimiserResult> run(const std::string& params, LeastSquares& f, ConstMatrix starts, const Box& box,
                                 const OptimiserOptions& options = {}, const OptimiserObserver& observer = nullptr) {
  PluginBench bench;
  return bench.optimiser("{plugin: nlopt, params: {" + params + "}}")
      ->minimise(f, starts, box, Vector::Constant(f.dim(), 0.5), options, observer);
}

struct Algorithm {
  const char* name;
  bool gradients, stochastic, global;
  double reached;          ///< part of the start's cost above the minimum's that 400 evaluations of a bowl leave
  const char* tolerances;  ///< for the laws that it obeys with a lower standard only
};
void PrintTo(const Algorithm& algorithm, std::ostream* out) { *out << algorithm.name; }

// Populations spread over the box come to its faces slowly.
constexpr const char* kPopulation =
    "{finds_a_minimum_on_the_boundary: {bound: 0.4, reason: 400 evaluations of a population}, "
    "solves_an_ill_conditioned_quadratic: {bound: 0.1, reason: 400 evaluations of a population}}";
const Algorithm kAlgorithms[] = {
    {"LBFGS", true, false, false, 1e-4, "{}"},
    {"MMA", true, false, false, 1e-4, "{}"},
    {"CCSAQ", true, false, false, 1e-4, "{}"},
    {"SLSQP", true, false, false, 1e-4, "{}"},
    {"TNEWTON", true, false, false, 1e-4, "{}"},
    {"TNEWTON_RESTART", true, false, false, 1e-4, "{}"},
    {"TNEWTON_PRECOND", true, false, false, 1e-4, "{}"},
    {"TNEWTON_PRECOND_RESTART", true, false, false, 1e-4, "{}"},
    {"VAR1", true, false, false, 1e-4, "{}"},
    {"VAR2", true, false, false, 1e-4, "{}"},
    {"COBYLA", false, false, false, 1e-3, "{}"},
    {"BOBYQA", false, false, false, 1e-3, "{}"},
    {"NELDERMEAD", false, false, false, 1e-3, "{}"},
    {"SBPLX", false, false, false, 1e-3, "{}"},
    {"CRS2_LM", false, true, true, 0.3, "{}"},
    {"ISRES", false, true, true, 0.3, kPopulation},
    {"ESCH", false, true, true, 0.3, kPopulation},
    {"DIRECT", false, false, true, 0.3, "{}"},
    {"DIRECT_L", false, false, true, 0.3, "{}"},
};

class NloptAlgorithm : public testing::TestWithParam<Algorithm> {
 protected:
  std::string params() const { return std::string("algorithm: ") + GetParam().name; }
};
INSTANTIATE_TEST_SUITE_P(All, NloptAlgorithm, testing::ValuesIn(kAlgorithms),
                         [](const auto& one) { return std::string(one.param.name); });

TEST_P(NloptAlgorithm, TheSeedMattersWhereItDraws) {
  PluginBench bench;
  const auto solver = bench.optimiser("{plugin: nlopt, params: {" + params() + "}}");
  std::vector<Vector> ends;
  for (const std::uint64_t seed : {1, 2}) {
    LeastSquares f = rosenbrock();
    OptimiserOptions options;
    options.max_evaluations = 60;
    options.seed = seed;
    ends.push_back(solver->minimise(f, spread(), cube(2, 2), Vector::Constant(2, 0.25), options, nullptr)[0].x);
  }
  EXPECT_EQ(ends[0] != ends[1], GetParam().stochastic);
}

TEST_P(NloptAlgorithm, DeclaresWhatItAsksFor) {
  PluginBench bench;
  const auto c = bench.optimiser("{plugin: nlopt, params: {" + params() + "}}")->capabilities();
  EXPECT_EQ(c.needs_gradients, GetParam().gradients);
  EXPECT_FALSE(c.needs_residuals);
  LeastSquares f = rosenbrock();
  f.gradients = GetParam().gradients;
  OptimiserOptions options;
  options.max_evaluations = 30;
  run(params(), f, vec({-1.2, 1.0}), cube(2, 2), options);
  for (const auto& request : f.requests) EXPECT_EQ(request.gradients, GetParam().gradients);
}

TEST_P(NloptAlgorithm, ReducesABowl) {
  LeastSquares f = bowl(vec({0.5, -1.0, 0.2}), vec({1, 4, 9}));
  OptimiserOptions options;
  options.max_iterations = 400;
  const auto r = run(params(), f, vec({-1.5, 1.5, -1.0}), cube(3, 2), options);
  const double start = 0.5 * (4.0 + 4 * 6.25 + 9 * 1.44);
  EXPECT_LT(r[0].cost, GetParam().reached * start) << r[0].message;
}

TEST_P(NloptAlgorithm, FixedVariablesStayFixedAndTheBoxHolds) {
  LeastSquares f = bowl(vec({5, 0.5, -3, 4}), vec({1, 1, 1, 1}));
  const Box box{vec({0.3, -1, -1, -1}), vec({0.3, 1, 1, 1})};
  OptimiserOptions options;
  options.max_iterations = 150;
  run(params(), f, vec({0.3, 0.0, 0.1, -0.4}), box, options);
  for (const auto& x : f.points) {
    EXPECT_EQ(x[0], 0.3);
    EXPECT_LE(x.cwiseAbs().maxCoeff(), 1.0);
  }
}

TEST_P(NloptAlgorithm, NoExceptionCrossesItsFrames) {
  for (const Index call : {1, 2, 5}) {
    LeastSquares f = rosenbrock();
    f.throw_at_call = call;
    EXPECT_THROW(run(params(), f, vec({-1.2, 1.0}), cube(2, 2)), Diverged) << call;
  }
}

TEST_P(NloptAlgorithm, ObserverStopsIt) {
  LeastSquares f = rosenbrock();
  Index seen = 0;
  const auto r = run(params(), f, vec({-1.2, 1.0}), cube(2, 2), {}, [&](Index, const Vector&) { return ++seen < 4; });
  EXPECT_EQ(r[0].status, OptimiserStatus::stopped);
  EXPECT_EQ(f.requests.size(), 4u);
}

TEST_P(NloptAlgorithm, ObeysTheLaws) {
  PluginBench bench;
  EXPECT_EQ(failed_laws(bench.host(), "{plugin: nlopt, params: {" + params() + "}}", GetParam().tolerances), "");
}

TEST(Nlopt, GlobalAlgorithmsFindTheDeeperBasin) {
  for (const auto& algorithm : kAlgorithms) {
    if (!algorithm.global) continue;
    LeastSquares f = two_basins(2);
    OptimiserOptions options;
    options.max_iterations = 2000;
    const auto r = run(std::string("algorithm: ") + algorithm.name, f, vec({1.0, 1.0}), cube(2, 2), options);
    EXPECT_LT(r[0].cost, 0.1) << algorithm.name;  // 0.48 in the other basins
  }
}

TEST(Nlopt, AnEvaluationAfterTheFirstCountsAsAnIteration) {
  LeastSquares f = rosenbrock();
  OptimiserOptions options;
  options.max_iterations = 6;
  const auto r = run("algorithm: SBPLX", f, vec({-1.2, 1.0}), cube(2, 2), options);
  EXPECT_EQ(r[0].iterations, 6);
  EXPECT_EQ(r[0].evaluations, 7);
  EXPECT_EQ(r[0].status, OptimiserStatus::budget_spent);
}

TEST(Nlopt, StopReasonsAreTold) {
  LeastSquares f = bowl(vec({0.5, 0.1}), vec({1, 1}));
  const auto r = run("algorithm: LBFGS", f, vec({-1.2, 1.0}), cube(2, 2));
  EXPECT_EQ(r[0].status, OptimiserStatus::converged);
  EXPECT_NE(r[0].message, "");
}

TEST(Nlopt, RefusesUnknownAlgorithmsAndLackingGradients) {
  PluginBench bench;
  EXPECT_THROW(bench.optimiser("{plugin: nlopt, params: {algorithm: LBFG}}"), ConfigError);
  LeastSquares f = rosenbrock();
  f.gradients = false;
  EXPECT_THROW(run("algorithm: MMA", f, vec({0, 0}), cube(2, 2)), Unsupported);
  EXPECT_TRUE(f.requests.empty());
}

}  // namespace
}  // namespace weft::test
