#include <gtest/gtest.h>

#include "session/instance_rows.hpp"

namespace weft {
namespace {

using Batch = std::vector<PredictionCase>;

/// Everything tells the row it was in: shapes and derivatives; a control above 1 fails.
struct RowPrediction final : Prediction {
  explicit RowPrediction(const Batch& cases) : rows(cases.size()) {
    for (std::size_t row = 0; row < rows; ++row) {
      of.emplace_back(cases[row].segments.size(),
                      ShapeDistribution{Positions::Constant(1, 3, static_cast<double>(row)), Positions(0, 3)});
      failures.push_back(cases[row].controls(0, 0) > 1.0 ? "row " + std::to_string(row) : "");
    }
  }
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return of; }
  const std::string& failure(std::size_t i) const override { return failures.at(i); }
  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    EXPECT_EQ(cotangents.size(), rows);
    std::vector<CaseGradient> gradients(rows);
    for (std::size_t row = 0; row < rows; ++row) {
      EXPECT_EQ(cotangents[row].size(), of[row].size());
      if (!cotangents[row].empty())
        gradients[row].controls = Controls::Constant(1, 1, static_cast<double>(row) + cotangents[row][0].mean(0, 0));
    }
    return gradients;
  }
  std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const override {
    EXPECT_EQ(directions.size(), rows);
    std::vector<std::vector<std::vector<ShapeCotangent>>> all(rows);
    for (std::size_t row = 0; row < rows; ++row)
      for (const auto& d : directions[row])
        all[row].push_back({{Positions::Constant(1, 3, static_cast<double>(row) + d.controls(0, 0)), Positions(0, 3)}});
    return all;
  }
  std::size_t rows;
  std::vector<std::vector<ShapeDistribution>> of;
  std::vector<std::string> failures;
};

struct RowPredictor final : Predictor {
  bool deterministic = false;
  mutable std::vector<Batch> batches;
  PredictorCapabilities capabilities() const override { return {.jvp = true, .deterministic = deterministic}; }
  void bind(const Task&) override {}
  std::unique_ptr<Prediction> predict(const Batch& cases, const PredictionRequest&) const override {
    batches.push_back(cases);
    return std::make_unique<RowPrediction>(cases);
  }
};

Batch some(std::size_t count) {
  Batch cases(count);
  for (std::size_t i = 0; i < count; ++i) {
    cases[i].controls = Controls::Constant(1, 1, 0.1 * static_cast<double>(i));
    cases[i].segments = {1};
  }
  return cases;
}
double row_of(const Prediction& prediction, std::size_t i) { return prediction.shapes().at(i).at(0).mean(0, 0); }

TEST(InstanceRows, EveryInstanceKeepsItsRowOfTheWholeBatch) {
  const RowPredictor predictor;
  const auto prediction = predict_in_rows(predictor, some(2), {1, 4}, 6, {});
  ASSERT_EQ(predictor.batches.at(0).size(), 6u);
  ASSERT_EQ(prediction->shapes().size(), 2u);
  EXPECT_EQ(row_of(*prediction, 0), 1.0);
  EXPECT_EQ(row_of(*prediction, 1), 4.0);
  for (const std::size_t row : {0, 2, 3, 5}) EXPECT_TRUE(predictor.batches[0][row].segments.empty());
  EXPECT_EQ(predictor.batches[0][4].controls(0, 0), 0.1);
}

TEST(InstanceRows, SamplesOfAPopulationHaveRowsSideBySide) {
  const RowPredictor predictor;
  const auto prediction = predict_in_rows(predictor, some(5), {0, 0, 0, 2, 2}, 3, {});
  ASSERT_EQ(predictor.batches.at(0).size(), 9u);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(row_of(*prediction, i), static_cast<double>(i));
  EXPECT_EQ(row_of(*prediction, 3), 6.0);
  EXPECT_EQ(row_of(*prediction, 4), 7.0);
}

TEST(InstanceRows, FailuresAndDerivativesAreThoseOfTheRow) {
  const RowPredictor predictor;
  Batch cases = some(2);
  cases[1].controls(0, 0) = 2.0;
  const auto prediction = predict_in_rows(predictor, cases, {2, 3}, 4, {});
  EXPECT_EQ(prediction->failure(0), "");
  EXPECT_EQ(prediction->failure(1), "row 3");
  const auto cotangent = [](double c) { return ShapeCotangent{Positions::Constant(1, 3, c), Positions(0, 3)}; };
  const auto gradients = prediction->pullback({{cotangent(0.25)}, {cotangent(0.5)}});
  ASSERT_EQ(gradients.size(), 2u);
  EXPECT_EQ(gradients[0].controls(0, 0), 2.25);
  EXPECT_EQ(gradients[1].controls(0, 0), 3.5);
  CaseDirection direction;
  direction.controls = Controls::Constant(1, 1, 0.125);
  const auto slopes = prediction->jvp({{}, {direction, direction}});
  EXPECT_TRUE(slopes.at(0).empty());
  EXPECT_EQ(slopes.at(1).at(1).at(0).mean(0, 0), 3.125);
  EXPECT_THROW(prediction->pullback({{cotangent(1.0)}}), ShapeError);
}

TEST(InstanceRows, ADeterministicPredictorIsNotPadded) {
  RowPredictor predictor;
  predictor.deterministic = true;
  EXPECT_EQ(row_of(*predict_in_rows(predictor, some(2), {1, 4}, 6, {}), 1), 1.0);
  EXPECT_EQ(predictor.batches.at(0).size(), 2u);
}

TEST(InstanceRows, RefusesInstancesThatAreNone) {
  const RowPredictor predictor;
  EXPECT_THROW(predict_in_rows(predictor, some(2), {0}, 2, {}), ShapeError);
  EXPECT_THROW(predict_in_rows(predictor, some(2), {1, 0}, 2, {}), Error);
  EXPECT_THROW(predict_in_rows(predictor, some(2), {0, 2}, 2, {}), Error);
  EXPECT_THROW(predict_in_rows(predictor, some(1), {-1}, 2, {}), Error);
  EXPECT_TRUE(predict_in_rows(predictor, {}, {}, 2, {})->shapes().empty());
}

}  // namespace
}  // namespace weft
