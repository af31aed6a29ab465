#include <gtest/gtest.h>

#include <cmath>

#include "session/jvp.hpp"
#include "toy_trajectory.hpp"

namespace weft {
namespace {

/// One vertex; after segment j: x = sum of the controls up to j squared, y = centre_0 + width_1^2, z = 3. sigma =
/// width_2 + 1.
struct Formula final : Prediction {
  explicit Formula(const std::vector<PredictionCase>& cases, double broken_above) {
    for (const auto& one : cases) {
      failures.emplace_back(one.controls(0, 0) > broken_above ? "broken" : "");
      std::vector<ShapeDistribution> of;
      for (const Index j : one.segments) {
        const double s = one.controls.topRows(j).sum();
        Positions mean(1, 3), sigma = Positions::Constant(1, 3, one.knowledge.width(2) + 1.0);
        mean << s * s, one.knowledge.centre(0) + std::pow(one.knowledge.width(1), 2), 3.0;
        if (failures.back().empty()) of.push_back({mean, sigma});
      }
      all.push_back(of);
    }
  }
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return all; }
  const std::string& failure(std::size_t i) const override { return failures.at(i); }
  /// Of each case, the number of its shapes that count. The derivative of case `without_derivative` diverges.
  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    std::vector<CaseGradient> gradients(cotangents.size());
    for (std::size_t i = 0; i < cotangents.size(); ++i) {
      double count = 0.0;
      for (const auto& one : cotangents[i]) count += one.mean.rows() > 0 ? 1.0 : 0.0;
      if (i == without_derivative && count > 0.0) throw Diverged("formula");
      gradients[i].controls = Controls::Constant(3, 1, count);
    }
    return gradients;
  }
  std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const override {
    std::vector<std::vector<std::vector<ShapeCotangent>>> result(directions.size());
    for (std::size_t i = 0; i < directions.size(); ++i) {
      if (i == without_derivative && !directions[i].empty()) throw Diverged("formula");
      for (const auto& direction : directions[i])
        result[i].push_back({{Positions::Constant(1, 3, direction.controls(0, 0)), Positions::Zero(1, 3)}});
    }
    return result;
  }
  static constexpr std::size_t none = 99;
  std::size_t without_derivative = none;
  std::vector<std::vector<ShapeDistribution>> all;
  std::vector<std::string> failures;
};

struct FormulaPredictor final : Predictor {
  bool has_jvp = false, deterministic = true;
  double broken_above = 1e9;
  mutable std::vector<std::vector<PredictionCase>> batches;
  PredictorCapabilities capabilities() const override { return {.jvp = has_jvp, .deterministic = deterministic}; }
  void bind(const Task&) override {}
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest&) const override {
    batches.push_back(cases);
    return std::make_unique<Formula>(cases, broken_above);
  }
};

PredictionCase start() {
  PredictionCase one;
  one.controls = Controls::Constant(3, 1, 0.02);
  one.segments = {1, 3};
  one.knowledge.centre << 0.5, 0.5, 0.5, 0.5;
  one.knowledge.width << 0.4, 0.4, 0.4, 0.4;
  return one;
}
CaseDirection along(double a, double b, double c) {
  CaseDirection d;
  d.controls.resize(3, 1);
  d.controls << a, b, c;
  return d;
}

struct Jvp : testing::Test {
  FormulaPredictor predictor;
  test::ToyTrajectory trajectory;  // scale 0.01
  std::vector<std::vector<std::vector<ShapeCotangent>>> derive(
      const std::vector<PredictionCase>& cases, const std::vector<std::vector<CaseDirection>>& directions,
      const JvpOptions& options = {}, Index* predicted = nullptr) {
    const auto base = predictor.predict(cases, {});
    predictor.batches.clear();
    return jvp(predictor, *base, cases, directions, trajectory, Moments::mean_and_sigma, options, predicted);
  }
};

TEST_F(Jvp, DifferencesOfAQuadraticAreExact) {
  Index predicted = 0;
  const auto d = derive({start(), start()}, {{along(1, 0, 0), along(0, 2, 1)}, {along(0, 0, 1)}}, {}, &predicted);
  ASSERT_EQ(d.size(), 2u);
  ASSERT_EQ(d[0].size(), 2u);
  ASSERT_EQ(d[0][0].size(), 2u);
  EXPECT_NEAR(d[0][0][0].mean(0, 0), 2 * 0.02, 1e-12);  // segment 1: d (m1^2)
  EXPECT_NEAR(d[0][0][1].mean(0, 0), 2 * 0.06, 1e-12);  // segment 3
  EXPECT_NEAR(d[0][1][0].mean(0, 0), 0.0, 1e-12);
  EXPECT_NEAR(d[0][1][1].mean(0, 0), 2 * 0.06 * 3.0, 1e-12);
  EXPECT_NEAR(d[1][0][1].mean(0, 0), 2 * 0.06, 1e-12);
  EXPECT_EQ(d[0][0][0].sigma.cwiseAbs().maxCoeff(), 0.0);
  EXPECT_EQ(predicted, 6);
}

TEST_F(Jvp, StepIsInUnitsOfTheScale) {
  JvpOptions options;
  options.step = 0.5;
  derive({start()}, {{along(0, 4, 1)}}, options);
  ASSERT_EQ(predictor.batches.size(), 1u);
  EXPECT_NEAR(predictor.batches[0][0].controls(1, 0), 0.02 + 0.5 * 0.01, 1e-15);
  EXPECT_NEAR(predictor.batches[0][1].controls(1, 0), 0.02 - 0.5 * 0.01, 1e-15);
  EXPECT_NEAR(predictor.batches[0][0].controls(2, 0), 0.02 + 0.125 * 0.01, 1e-15);
}

TEST_F(Jvp, KnowledgeStaysWithinItsInterval) {
  PredictionCase one = start();
  one.knowledge.centre(0) = 1.0;
  one.knowledge.width(1) = 0.03;
  CaseDirection centre = along(0, 0, 0), width = along(0, 0, 0), sigma = along(0, 0, 0);
  centre.centre(0) = 1.0;
  width.width(1) = 1.0;
  sigma.width(2) = 1.0;
  const auto d = derive({one}, {{centre, width, sigma}});
  EXPECT_NEAR(d[0][0][0].mean(0, 1), 1.0, 1e-12);                   // one side only
  EXPECT_NEAR(d[0][1][0].mean(0, 1), (0.13 * 0.13) / 0.13, 1e-12);  // between 0 and 0.13, slope at the middle
  EXPECT_NEAR(d[0][2][1].sigma(0, 2), 1.0, 1e-12);
  for (const auto& perturbed : predictor.batches[0]) {
    EXPECT_GE(perturbed.knowledge.width.minCoeff(), 0.0);
    EXPECT_LE(perturbed.knowledge.centre.maxCoeff(), 1.0);
  }
}

TEST_F(Jvp, BatchesAreLimited) {
  JvpOptions options;
  options.batch = 4;
  const auto d =
      derive({start()}, {{along(1, 0, 0), along(0, 1, 0), along(0, 0, 1), along(1, 1, 1), along(1, 0, 1)}}, options);
  ASSERT_EQ(predictor.batches.size(), 3u);
  EXPECT_EQ(predictor.batches[2].size(), 2u);
  EXPECT_NEAR(d[0][3][1].mean(0, 0), 2 * 0.06 * 3.0, 1e-12);
}

TEST_F(Jvp, WhereBitsDependOnTheBatchEveryCaseHasItsOwn) {
  const std::vector<PredictionCase> cases(3, start());
  const std::vector<std::vector<CaseDirection>> directions = {{along(1, 0, 0)}, {}, {along(0, 1, 0), along(0, 0, 1)}};
  const auto together = derive(cases, directions);
  EXPECT_EQ(predictor.batches.size(), 1u);
  predictor.batches.clear();
  predictor.deterministic = false;
  const auto apart = derive(cases, directions);
  ASSERT_EQ(predictor.batches.size(), 2u);
  EXPECT_EQ(predictor.batches[0].size(), 2u);
  EXPECT_EQ(predictor.batches[1].size(), 4u);
  EXPECT_EQ(apart[2][1][1].mean, together[2][1][1].mean);
}

TEST_F(Jvp, ASideThatFailsIsReplacedByTheCaseItself) {
  predictor.broken_above = 0.0205;
  const auto d = derive({start()}, {{along(1, 0, 0)}});
  EXPECT_NEAR(d[0][0][0].mean(0, 0), (0.02 * 0.02 - 0.019 * 0.019) / 0.001, 1e-12);
}

TEST_F(Jvp, CasesWithoutResultAndDirectionsOfZeros) {
  predictor.broken_above = 0.5;
  PredictionCase broken = start();
  broken.controls(0, 0) = 0.7;
  const auto d = derive({broken, start()}, {{along(1, 0, 0)}, {along(0, 0, 0)}});
  ASSERT_EQ(d[0][0].size(), 2u);
  EXPECT_EQ(d[0][0][0].mean.rows(), 0);
  EXPECT_EQ(d[1][0][1].mean, Positions::Zero(1, 3));
  EXPECT_TRUE(predictor.batches.empty());
}

TEST_F(Jvp, ThePredictorsOwnComesFirst) {
  predictor.has_jvp = true;
  EXPECT_EQ(derive({start()}, {{along(1, 0, 0)}}).size(), 1u);
  EXPECT_TRUE(predictor.batches.empty());
}

TEST_F(Jvp, ADerivativeThatDivergesCostsItsCaseOnly) {
  predictor.has_jvp = true;
  const std::vector<PredictionCase> cases(3, start());
  Formula prediction(cases, 1e9);
  prediction.without_derivative = 1;
  const std::vector<CaseDirection> both{along(1, 0, 0), along(2, 0, 0)};
  const auto slopes = jvp(predictor, prediction, cases, {both, both, both}, trajectory, Moments::mean_and_sigma);
  for (const std::size_t i : {0u, 2u}) {
    EXPECT_EQ(slopes[i][0][0].mean, Positions::Constant(1, 3, 1.0));
    EXPECT_EQ(slopes[i][1][0].mean, Positions::Constant(1, 3, 2.0));
  }
  ASSERT_EQ(slopes[1].size(), 2u);
  ASSERT_EQ(slopes[1][1].size(), 2u);
  for (const auto& slope : slopes[1][1]) {
    EXPECT_TRUE(slope.mean.array().isNaN().all());
    EXPECT_TRUE(slope.sigma.array().isNaN().all());
  }
  const std::vector<ShapeCotangent> ones(2, {Positions::Ones(1, 3), Positions()});
  const auto gradients = pullback(prediction, cases, {ones, ones, ones});
  EXPECT_EQ(gradients[0].controls, Controls::Constant(3, 1, 2.0));
  EXPECT_EQ(gradients[2].controls, Controls::Constant(3, 1, 2.0));
  EXPECT_TRUE(gradients[1].controls.array().isNaN().all());
  EXPECT_TRUE(gradients[1].centre.array().isNaN().all());
  prediction.without_derivative = Formula::none;
  EXPECT_EQ(pullback(prediction, cases, {ones, ones, ones})[1].controls, Controls::Constant(3, 1, 2.0));
}

TEST_F(Jvp, RefusesWrongSizes) {
  CaseDirection small;
  small.controls = Controls::Zero(2, 1);
  EXPECT_THROW(derive({start()}, {{small}}), ShapeError);
  EXPECT_THROW(derive({start()}, {}), ShapeError);
}

}  // namespace
}  // namespace weft
