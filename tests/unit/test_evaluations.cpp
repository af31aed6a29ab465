#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "experiments/estimation_evaluation.hpp"
#include "experiments/physics/textiles.hpp"
#include "experiments/planning_evaluation.hpp"
#include "report/times.hpp"
#include "test_support.hpp"

namespace weft {
namespace {

using nlohmann::json;

MaterialKnowledge interval(double centre, double width) {
  return {PropertyVector::Constant(centre), PropertyVector::Constant(width)};
}
MaterialProperties all(double q) { return PropertyVector::Constant(q); }

TEST(IntervalFigures, CountWhatEachPartOfTheIntervalHolds) {
  // Offsets of 0.1, 0.3 and 0.6 half-widths of 0.2 and one outside.
  const std::vector<MaterialKnowledge> k(4, interval(0.5, 0.4));
  const IntervalFigures f = interval_figures(k, {all(0.52), all(0.44), all(0.62), all(0.75)}, 2);
  EXPECT_DOUBLE_EQ(f.coverage50, 0.5);
  EXPECT_DOUBLE_EQ(f.coverage80, 0.75);
  EXPECT_DOUBLE_EQ(f.coverage100, 0.75);
}

TEST(IntervalFigures, ScoreIsTheWidthPlusWhatLiesOutside) {
  EXPECT_DOUBLE_EQ(interval_figures({interval(0.5, 0.4)}, {all(0.5)}, 0).score, 0.5 * (0.2 + 0.32));
  // 0.8 lies 0.2 outside of [0.4, 0.6] and 0.14 outside of [0.34, 0.66].
  EXPECT_NEAR(interval_figures({interval(0.5, 0.4)}, {all(0.8)}, 0).score,
              0.5 * (0.2 + 2.0 / 0.5 * 0.2 + 0.32 + 2.0 / 0.2 * 0.14), 1e-12);
}

TEST(IntervalFigures, ScoreIsBestForTheWidthOfTheTruth) {
  std::vector<MaterialProperties> truth;
  for (int i = 0; i < 200; ++i) truth.push_back(all(0.3 + 0.4 * (i + 0.5) / 200));
  const auto score = [&](double width) {
    return interval_figures(std::vector<MaterialKnowledge>(200, interval(0.5, width)), truth, 0).score;
  };
  EXPECT_LT(score(0.4), score(0.2));
  EXPECT_LT(score(0.4), score(0.8));
}

TEST(CalibrateDeviations, FindsByWhatFactorsPosteriorsAreOverconfident) {
  PropertyVector factor;
  factor << 3.0, 1.0, 0.5, 1.0;
  std::vector<MaterialPosterior> posteriors;
  std::vector<MaterialProperties> truth;
  RandomStream random(4);
  for (int i = 0; i < 60; ++i) {
    MaterialPosterior posterior;
    MaterialProperties q;
    for (Index p = 0; p < 4; ++p) {
      const double sd = 0.02;
      posterior.mode(p) = random.uniform(0.3, 0.7);
      posterior.precision(p, p) = 1 / (sd * sd);
      q(p) = posterior.mode(p) + factor(p) * sd * random.normal();
    }
    posteriors.push_back(posterior);
    truth.push_back(q);
  }
  const PropertyVector found = calibrate_deviations(posteriors, truth);
  for (Index p = 0; p < 4; ++p) EXPECT_NEAR(found(p) / factor(p), 1.0, 0.4) << p;
}

std::shared_ptr<const Dataset> dataset(int count) {
  auto data = std::make_shared<Dataset>();
  data->header.identity = "abc";
  data->header.test_fraction = 0.5;
  for (int i = 0; i < count; ++i) {
    Example example;
    example.index = i;
    example.released = i % 3 != 0;
    example.controls = Controls::Zero(2, 5);
    data->examples.push_back(example);
  }
  return data;
}

TEST(ChooseCases, FreshOnesAreAFunctionOfTheSeed) {
  const auto a = choose_cases("fresh", 20, 7, nullptr), b = choose_cases("fresh", 30, 7, nullptr);
  EXPECT_EQ(std::set<std::uint64_t>(a.seeds.begin(), a.seeds.end()).size(), 20u);
  EXPECT_TRUE(std::equal(a.seeds.begin(), a.seeds.end(), b.seeds.begin()));
  EXPECT_NE(a.seeds, choose_cases("fresh", 20, 8, nullptr).seeds);
  EXPECT_EQ(a.example(a.seeds[0]), nullptr);
  for (const auto seed : b.seeds) EXPECT_LE(seed, 9000000000000000000ull);
}

TEST(ChooseCases, ExamplesAreReleasedAndOfTheirSplitAndEachTakenOnce) {
  const auto data = dataset(90);
  const auto cases = choose_cases("test", 12, 7, data);
  std::set<std::int64_t> indices;
  for (const auto seed : cases.seeds) {
    const Example& example = *cases.example(seed);
    EXPECT_TRUE(example.released);
    EXPECT_EQ(data->header.split(example.index), Split::test);
    indices.insert(example.index);
  }
  EXPECT_EQ(indices.size(), 12u);
  EXPECT_THROW(choose_cases("test", 60, 7, data), ConfigError);
  EXPECT_THROW(choose_cases("test", 1, 7, nullptr), ConfigError);
  EXPECT_THROW(choose_cases("tests", 1, 7, data), ConfigError);
}

TEST(PlanningEvaluation, FiguresPerWidthAndFailedCases) {
  EvaluationColumn column;
  column.cases = choose_cases("fresh", 5, 1, nullptr);
  column.plan = planning_evaluation(ConfigNode::parse("{seed: 1}", "test"), {0.1, 1.0}, column.cases);
  ASSERT_EQ(column.plan.arms.size(), 2u);
  EXPECT_EQ(column.plan.arms[1].config.at("drawn_width").as_double(), 1.0);
  EXPECT_EQ(column.plan.arms[1].config.at("knowledge").as_string(), "drawn");
  const double errors[5] = {5, 6, 7, 8, 50};
  for (std::size_t a = 0; a < 2; ++a) {
    for (std::size_t i = 0; i < 5; ++i) {
      SweepRow row{a, column.plan.seeds[i], "", {}};
      row.outcome.metrics = {{"error_mm", errors[i]}};
      if (a == 1) {  // the rows of the first arm are of an earlier version
        row.outcome.metrics.emplace_back("max_error_mm", 3.0 * errors[i]);
        row.outcome.metrics.emplace_back("named_error_mm", i == 0 ? std::nan("") : 4.0);
        row.outcome.metrics.emplace_back("silhouette_iou", 0.9 + 0.01 * static_cast<double>(i));
      }
      row.outcome.times = {{"first_plan_seconds", 0.5}, {"plan_seconds", 2.0}};
      if (a == 1 && i == 4) row.failure = "diverged";
      column.rows.push_back(row);
    }
  }
  const json result = json::parse(planning_evaluation_json({column}));
  EXPECT_EQ(result["cases"].size(), 10u);
  EXPECT_EQ(result["complete"], true);
  const json& narrow = result["by_width"][0];
  EXPECT_EQ(narrow["n"], 5);
  EXPECT_EQ(narrow["median_mm"], 7.0);
  EXPECT_DOUBLE_EQ(narrow["mean_mm"], 15.2);
  EXPECT_EQ(narrow["q1_mm"], 6.0);
  EXPECT_EQ(narrow["q3_mm"], 8.0);
  EXPECT_EQ(narrow["outliers"], 1);
  EXPECT_EQ(result["by_width"][1]["n"], 4);
  EXPECT_EQ(result["by_width"][1]["median_mm"], 6.5);
  EXPECT_EQ(narrow["success_10mm"], 0.8);
  EXPECT_EQ(narrow["success_30mm"], 0.8);
  EXPECT_TRUE(narrow["silhouette_iou"].is_null());
  EXPECT_TRUE(result["cases"][0]["silhouette_iou"].is_null());
  const json& wide = result["by_width"][1];
  EXPECT_EQ(wide["success_10mm"], 1.0);
  EXPECT_DOUBLE_EQ(wide["silhouette_iou"], 0.915);
  EXPECT_DOUBLE_EQ(wide["max_error_mm"], 3.0 * 6.5);
  EXPECT_DOUBLE_EQ(wide["named_error_mm"], 4.0) << "the mean leaves out cases that saw none of them";
  EXPECT_EQ(result["cases"][6]["silhouette_iou"], 0.91);
  EXPECT_TRUE(result["cases"][5]["named_error_mm"].is_null());
  EXPECT_TRUE(result["cases"][9]["error_mm"].is_null());
  EXPECT_EQ(result["cases"][9]["failed"], "diverged");
  EXPECT_EQ(result["cases"][7]["goal"], 2);
  EXPECT_THAT(planning_evaluation_csv({column}), testing::HasSubstr("fresh,0.1,0,"));
  EXPECT_FALSE(result["cases"][0].contains("plan_seconds"));
  const json whole = json::parse(with_times(result.dump(), planning_times_json({column})));
  EXPECT_EQ(whole["cases"][7]["plan_seconds"], 2.0);
  EXPECT_EQ(whole["cases"][7]["goal"], 2);
  EXPECT_FALSE(whole["cases"][9].contains("plan_seconds"));
  EXPECT_THAT(planning_times_csv({column}),
              testing::AllOf(testing::StartsWith("goals,width,goal,seed,first_plan_seconds"),
                             testing::HasSubstr(",0.5,2.0\n")));
  EXPECT_THAT(planning_evaluation_csv({column}), testing::HasSubstr("fresh,1.0,1,"));
  EXPECT_THAT(planning_evaluation_table(column), testing::HasSubstr("0.10    5      7.00     15.20"));
  EXPECT_THAT(planning_evaluation_table(column), testing::HasSubstr("0.915      100 % 100 % 100 %"));
}

/// A row as the runner leaves it: two segments, all properties alike.
SweepRow row_of(std::size_t arm, std::uint64_t seed, double q, double c, double w) {
  SweepRow row{arm, seed, "", {}};
  row.outcome.payload = to_payload({all(q), {interval(0.5, 0.9), interval(c, w)}, std::nullopt});
  row.outcome.metrics = {{"segments", 2.0}};
  row.outcome.times = {{"slowest_estimate_seconds", 0.25}};
  return row;
}
/// The same as rows were before they had payloads.
SweepRow row_of_metrics(std::size_t arm, std::uint64_t seed, double q, double c, double w) {
  SweepRow row{arm, seed, "", {}};
  auto& m = row.outcome.metrics;
  for (const char* p : kPropertyNames) m.emplace_back(std::string("q_") + p, q);
  m.emplace_back("segments", 2.0);
  for (const char* step : {"01", "02"}) {
    for (const char* p : kPropertyNames) {
      m.emplace_back(std::string("c_") + p + "_" + step, step[1] == '2' ? c : 0.5);
      m.emplace_back(std::string("w_") + p + "_" + step, step[1] == '2' ? w : 0.9);
    }
  }
  m.emplace_back("slowest_estimate_seconds", 0.25);
  return row;
}
EvaluationColumn two_methods(SweepRow (*make)(std::size_t, std::uint64_t, double, double, double)) {
  EvaluationColumn column;
  column.cases = choose_cases("fresh", 2, 1, nullptr);
  column.plan = estimation_evaluation(ConfigNode::parse("{seed: 1}", "test"), {"plain", "prior"}, {}, column.cases);
  const auto& seeds = column.plan.seeds;
  column.rows = {make(0, seeds[0], 0.30, 0.32, 0.01),  // too narrow, but near: no failure
                 make(0, seeds[1], 0.30, 0.45, 0.10),  // a failure
                 make(1, seeds[0], 0.30, 0.32, 0.20),
                 make(1, seeds[1], 0.30, 0.45, 0.40)};  // far, and its interval holds the truth: no failure
  return column;
}

TEST(EstimationEvaluation, TableOneAndTheSequences) {
  const EvaluationColumn column = two_methods(row_of);
  const json result = json::parse(estimation_evaluation_json({column}));
  const json& plain = result["properties"]["bend"];
  EXPECT_NEAR(plain["abs_error"]["mean"].get<double>(), 0.085, 1e-12);
  EXPECT_NEAR(plain["width"]["median"].get<double>(), 0.055, 1e-12);
  EXPECT_EQ(plain["failure_rate"], 0.5);
  EXPECT_EQ(plain["coverage"]["1"], 0.0);
  EXPECT_EQ(result["narrow_share"], 0.5);
  EXPECT_EQ(result["columns"]["fresh"]["prior"]["properties"]["bend"]["failure_rate"], 0.0);
  EXPECT_EQ(result["columns"]["fresh"]["prior"]["properties"]["bend"]["coverage"]["1"], 1.0);
  ASSERT_EQ(result["cases"].size(), 2u);
  const json& sequence = result["cases"][1]["knowledge"];
  ASSERT_EQ(sequence.size(), 3u);
  EXPECT_EQ(sequence[0]["width"][2], 1.0);
  EXPECT_EQ(sequence[1]["width"][2], 0.9);
  EXPECT_EQ(sequence[2]["centre"][2], 0.45);
  EXPECT_FALSE(result.contains("calibration"));
  const std::string whole = with_times(result.dump(), estimation_times_json({column}));
  EXPECT_EQ(json::parse(whole)["cases"][1]["slowest_estimate_seconds"], 0.25);
  EXPECT_THAT(estimation_evaluation_table(whole), testing::HasSubstr("plain      bend          2         0.085"));
  EXPECT_THROW(estimation_evaluation(ConfigNode::parse("{seed: 1}", "test"), {"best"}, {}, column.cases), ConfigError);
}

TEST(EstimationEvaluation, RowsOfBeforePayloadsGiveTheSameResults) {
  const EvaluationColumn now = two_methods(row_of), before = two_methods(row_of_metrics);
  EXPECT_EQ(estimation_evaluation_json({before}), estimation_evaluation_json({now}));
  EXPECT_EQ(estimation_evaluation_csv({before}), estimation_evaluation_csv({now}));
  // With a posterior: mode, gradient, and precision by columns.
  SweepRow row = row_of_metrics(0, 1, 0.3, 0.4, 0.5);
  EXPECT_FALSE(estimation_case(row).posterior);
  for (int i = 0; i < 24; ++i) row.outcome.metrics.emplace_back("posterior_" + std::to_string(i), 0.5 + i);
  const MaterialPosterior posterior = estimation_case(row).posterior.value();
  EXPECT_EQ(posterior.mode(3), 3.5);
  EXPECT_EQ(posterior.gradient(0), 4.5);
  EXPECT_EQ(posterior.precision(1, 0), 9.5);
  EXPECT_EQ(posterior.precision(3, 3), 23.5);
}

TEST(EstimationEvaluation, CasesReadBackToTheSameBits) {
  EstimationCase one{all(1.0 / 3.0), {interval(0.1 + 0.2, 0.7), interval(1e-17, std::nan(""))}, MaterialPosterior()};
  RandomStream random(3);
  for (Index i = 0; i < 16; ++i) one.posterior->precision.data()[i] = random.normal();
  for (Index p = 0; p < 4; ++p) one.posterior->gradient(p) = random.normal();
  SweepRow row;
  row.outcome.payload = to_payload(one);
  const EstimationCase read = estimation_case(row);
  EXPECT_EQ(read.truth, one.truth);
  ASSERT_EQ(read.knowledge.size(), 2u);
  EXPECT_EQ(read.knowledge[0].centre, one.knowledge[0].centre);
  EXPECT_EQ(read.knowledge[1].centre, one.knowledge[1].centre);
  EXPECT_TRUE(std::isnan(read.knowledge[1].width(2)));
  EXPECT_EQ(read.posterior.value().mode, one.posterior->mode);
  EXPECT_EQ(read.posterior->gradient, one.posterior->gradient);
  EXPECT_EQ(read.posterior->precision, one.posterior->precision);
}

TEST(EstimationEvaluation, RefusesWhatIsNoCase) {
  using testing::HasSubstr;
  const auto refusal = [](const SweepPayload& payload) {
    SweepRow row;
    row.file = "cells/seed1.json";
    row.outcome.payload = payload;
    return test::message_of<ConfigError>([&] { estimation_case(row); });
  };
  SweepPayload payload = to_payload({all(0.3), {interval(0.5, 0.9)}, std::nullopt});
  EXPECT_THAT(refusal({payload.schema, R"({"true_material": [0.1, 0.2], "knowledge": []})"}),
              testing::AllOf(HasSubstr("cells/seed1.json"), HasSubstr("damaged")));
  EXPECT_THAT(refusal({payload.schema, R"({"knowledge": []})"}), HasSubstr("true_material"));
  EXPECT_THAT(refusal({"weft planning case 1", payload.json}), HasSubstr("weft planning case 1"));
  EXPECT_THAT(refusal({}), HasSubstr("no estimate"));
}

TEST(DrapeBand, IsReadFromTheFabricsFileOrTheMappingThatNamesIt) {
  const std::filesystem::path fabrics = WEFT_SOURCE_DIR "/configs/fabrics";
  const auto of = [&](const std::string& text) {
    return physics::read_drape_band(ConfigNode::parse(text, "t", fabrics));
  };
  const auto denim = of("{file: denim.yaml, bend_multiplier: 2}");
  ASSERT_TRUE(denim);
  EXPECT_EQ(denim->low, 70.0);
  EXPECT_EQ(denim->high, 90.0);
  EXPECT_FALSE(of("{file: light.yaml}"));
  EXPECT_EQ(of("{file: denim.yaml, drape: {percent: [1, 2], source: own}}")->high, 2.0);
  const auto refusal = [&](const std::string& drape) {
    return test::message_of<ConfigError>([&] { of("{drape: " + drape + "}"); });
  };
  EXPECT_THAT(refusal("{percent: [60, 40], source: x}"), testing::HasSubstr("must be rising, in [0, 100]"));
  EXPECT_THAT(refusal("{percent: [60, 400], source: x}"), testing::HasSubstr("must be rising, in [0, 100]"));
  EXPECT_THAT(refusal("{percent: 60, source: x}"), testing::HasSubstr("must be [LOW, HIGH]"));
  EXPECT_THAT(refusal("{percent: [60, 70]}"), testing::HasSubstr("source is missing"));
}

}  // namespace
}  // namespace weft
