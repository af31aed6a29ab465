// What `weft learn` decides without a simulator: numbers from hours, and what a model is short of.
#include "experiments/shortfalls.hpp"
#include "learning/budget.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr LearnRates kShirt{3.75, 16.7};

TEST(LearnBudget, TheNumbersFillTheTime) {
  for (const double seconds : {1200.0, 3600.0, 7200.0, 200000.0}) {
    const LearnNumbers numbers = numbers_for(seconds, kShirt, 64);
    const double needed = seconds_of(numbers, kShirt);
    EXPECT_LE(needed, 1.0001 * seconds);
    EXPECT_GE(needed, 0.97 * seconds);
    // By hand: (fit + held out + 8/7 calibration) / rate of examples + iterations / rate of iterations.
    const LearnParams& n = numbers.examples;
    EXPECT_NEAR(needed,
                static_cast<double>(n.examples + n.held_out_examples) / 3.75 +
                    8.0 / 7.0 * static_cast<double>(n.calibration_examples) / 3.75 +
                    static_cast<double>(numbers.iterations) / 16.7,
                1e-6);
  }
}

TEST(LearnBudget, ThreeIterationsForEachExampleAndSharesForTheOthers) {
  const LearnNumbers numbers = numbers_for(3600.0, kShirt, 64);
  EXPECT_EQ(numbers.iterations, 3 * numbers.examples.examples);
  EXPECT_NEAR(numbers.examples.calibration_examples, numbers.examples.examples / 4.0, 1.0);
  EXPECT_NEAR(numbers.examples.held_out_examples, numbers.examples.examples / 8.0, 1.0);
  // Half the time is half of all.
  EXPECT_NEAR(numbers_for(1800.0, kShirt, 64).examples.examples, numbers.examples.examples / 2.0, 2.0);
}

TEST(LearnBudget, TooLittleTimeStillGivesTheLeast) {
  const LearnNumbers numbers = numbers_for(1.0, kShirt, 64);
  EXPECT_EQ(numbers.examples.examples, 64);
  EXPECT_EQ(numbers.examples.calibration_examples, 64);
  EXPECT_EQ(numbers.examples.held_out_examples, 64);
  EXPECT_EQ(numbers.iterations, 192);
}

TEST(LearnBudget, BeyondTenThousandExamplesTheTimeGoesToIterations) {
  const LearnNumbers day = numbers_for(86400.0, kShirt, 64), week = numbers_for(7 * 86400.0, kShirt, 64);
  EXPECT_EQ(day.examples.examples, 10000);
  EXPECT_EQ(week.examples.examples, 10000);
  EXPECT_NEAR(static_cast<double>(week.iterations - day.iterations), 6 * 86400.0 * 16.7, 2.0);
}

/// A model that is as it should be.
struct GoodModel {
  PredictionEvaluation held_out;
  std::vector<FitCurvePoint> curve;

  GoodModel() {
    PredictionFigures row;
    row.n = row.examples = 200;
    row.median_mm = 2.2;
    row.coverage_1sigma = 0.70;
    row.nse = 1.0;
    row.coverage_1sigma_se = 0.01;
    row.nse_se = 0.05;
    held_out.from_start = row;
    held_out.by_step = held_out.by_step_from_random = held_out.by_step_no_knowledge = {row, row};
    for (int k = 1; k <= 10; ++k) curve.push_back({1000 * k, -2.0 - 0.001 * k, -1.95 - 0.001 * k});
  }
  std::vector<std::string> shortfalls(std::int64_t failed = 0) const {
    std::vector<std::string> texts;
    for (const auto& one : find_shortfalls({1000, failed, curve, held_out})) {
      EXPECT_FALSE(one.remedy.empty());
      texts.push_back(one.what);
    }
    return texts;
  }
};

TEST(LearnShortfalls, AGoodModelHasNone) { EXPECT_THAT(GoodModel().shortfalls(10), IsEmpty()); }

TEST(LearnShortfalls, FailedExamplesAreCounted) {
  EXPECT_THAT(GoodModel().shortfalls(11), ElementsAre(HasSubstr("11 of 1000 examples failed")));
}

TEST(LearnShortfalls, TheCurveTellsWhatTheFitWasShortOf) {
  GoodModel falling;
  falling.curve[9].validation_loss = falling.curve[7].validation_loss - 0.05;
  falling.curve[9].training_loss = falling.curve[9].validation_loss - 0.1;
  EXPECT_THAT(falling.shortfalls(), ElementsAre(HasSubstr("still fell, by 0.05 in the last fifth")));
  GoodModel risen;
  risen.curve[4].validation_loss = -3.0;
  EXPECT_THAT(risen.shortfalls(), ElementsAre(HasSubstr("lowest after 5000 of 10000 iterations")));
  GoodModel apart;
  for (auto& point : apart.curve) point.training_loss -= 0.5;
  EXPECT_THAT(apart.shortfalls(), ElementsAre(HasSubstr("0.55 above the training loss")));
  GoodModel unknown;
  unknown.curve.resize(3);
  EXPECT_THAT(unknown.shortfalls(), ElementsAre(HasSubstr("the fit had 3 evaluations")));
}

TEST(LearnShortfalls, AnErrorAboveTheTargetIsSaid) {
  GoodModel model;
  model.held_out.from_start.median_mm = 5.1;
  EXPECT_THAT(model.shortfalls(), ElementsAre(HasSubstr("off by 5.1 mm in the median")));
  const auto remedy = [&] { return find_shortfalls({1000, 0, model.curve, model.held_out}).at(0).remedy; };
  EXPECT_THAT(remedy(), HasSubstr("more iterations: the losses of training and validation are close"));
  for (auto& point : model.curve) point.training_loss -= 0.2;
  EXPECT_EQ(remedy(), "more examples and iterations");
  model.held_out.from_start.n = 0;
  EXPECT_THAT(model.shortfalls(), ElementsAre(HasSubstr("no held-out example was released")));
}

TEST(LearnShortfalls, SigmaIsJudgedBeyondTwoStandardErrors) {
  GoodModel model;
  model.held_out.by_step[0].coverage_1sigma = 0.605;  // 0.015 too low, 1.5 standard errors
  EXPECT_THAT(model.shortfalls(), IsEmpty());
  model.held_out.by_step[0].coverage_1sigma = 0.59;
  model.held_out.by_step_no_knowledge[1].nse = 1.4;
  EXPECT_THAT(model.shortfalls(), ElementsAre(HasSubstr("sigma is too small in 2 of 12 numbers")));
  model.held_out.by_step_from_random[0].nse = 0.6;
  EXPECT_THAT(model.shortfalls(), ElementsAre(HasSubstr("too small in 2 of 12"), HasSubstr("too large in 1 of 12")));
  // Few examples are not judged.
  for (auto* rows :
       {&model.held_out.by_step, &model.held_out.by_step_from_random, &model.held_out.by_step_no_knowledge})
    for (auto& row : *rows) row.examples = 49;
  EXPECT_THAT(model.shortfalls(), ElementsAre(HasSubstr("sigma cannot be judged: 49 held-out examples")));
}

TEST(LearnShortfalls, TheCurveIsReadFromATrainingReport) {
  const auto curve = curve_of(R"({"curve": [{"iteration": 100, "training_loss": -1.5, "validation_loss": -1.25}]})");
  ASSERT_EQ(curve.size(), 1u);
  EXPECT_EQ(curve[0].iteration, 100);
  EXPECT_EQ(curve[0].training_loss, -1.5);
  EXPECT_EQ(curve[0].validation_loss, -1.25);
  // Another predictor may write something else.
  for (const char* text : {"{}", "[]", "", R"({"curve": 3})", R"({"curve": [{"iteration": 1}]})",
                           R"({"curve": [{"iteration": 1, "training_loss": null, "validation_loss": 2}]})"})
    EXPECT_THAT(curve_of(text), IsEmpty()) << text;
}

}  // namespace
}  // namespace weft
