#include "experiments/shortfalls.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "sdk/formatted.hpp"
#include "sdk/json_text.hpp"

namespace weft {
namespace {

constexpr double kTargetMedianMm = 5.0;
constexpr double kLeastCoverage = 0.62, kMostCoverage = 0.74, kLeastNse = 0.8, kMostNse = 1.25;
constexpr Index kFewestJudged = 50;
constexpr double kStillFalls = 0.02;  // of the loss per coordinate, in the last fifth of the fit
constexpr double kOverfit = 0.3;      // validation loss above the training loss
constexpr double kClose = 0.1;        // nearer, iterations are what is missing (docs/measurements/network.md)

void judge_fit(const std::vector<FitCurvePoint>& curve, std::vector<Shortfall>& found) {
  if (curve.size() < 4) {
    found.push_back({"whether the loss still falls cannot be said: the fit had " + std::to_string(curve.size()) +
                         " evaluations, and 4 are needed",
                     "more iterations, or a lower evaluate_every"});
    return;
  }
  const auto best = std::min_element(curve.begin(), curve.end(), [](const FitCurvePoint& a, const FitCurvePoint& b) {
    return a.validation_loss < b.validation_loss;
  });
  const FitCurvePoint& last = curve.back();
  const auto before = static_cast<double>(last.iteration) * 0.8;
  const auto fifth = std::find_if(curve.begin(), curve.end(),
                                  [&](const FitCurvePoint& p) { return static_cast<double>(p.iteration) >= before; });
  if (static_cast<double>(best->iteration) < before) {
    found.push_back(
        {formatted("the validation loss was lowest after %lld of %lld iterations and rose again: too few examples",
                   static_cast<long long>(best->iteration), static_cast<long long>(last.iteration)),
         "more examples for the fit"});
  } else if (const double gap = last.validation_loss - last.training_loss; gap > kOverfit) {
    found.push_back({formatted("the validation loss ended %.2f above the training loss: too few examples", gap),
                     "more examples for the fit"});
  } else if (const double fall = fifth->validation_loss - last.validation_loss; fall > kStillFalls) {
    found.push_back(
        {formatted("the validation loss still fell, by %.2f in the last fifth of the fit", fall), "more iterations"});
  }
}

bool is_close(const std::vector<FitCurvePoint>& curve) {
  return !curve.empty() && curve.back().validation_loss - curve.back().training_loss < kClose;
}

/// Counts the numbers that can be judged, and those of them that are outside their bounds.
void judge_rows(const std::vector<PredictionFigures>& rows, int& judged, int& narrow, int& wide) {
  for (const PredictionFigures& row : rows) {
    if (row.examples < kFewestJudged) continue;
    judged += 2;
    const double c = 2.0 * row.coverage_1sigma_se, n = 2.0 * row.nse_se;
    narrow += (row.coverage_1sigma + c < kLeastCoverage) + (row.nse - n > kMostNse);
    wide += (row.coverage_1sigma - c > kMostCoverage) + (row.nse + n < kLeastNse);
  }
}

void judge_sigma(const PredictionEvaluation& held_out, std::vector<Shortfall>& found) {
  int judged = 0, narrow = 0, wide = 0;
  for (const auto* rows : {&held_out.by_step, &held_out.by_step_from_random, &held_out.by_step_no_knowledge})
    judge_rows(*rows, judged, narrow, wide);
  if (judged == 0) {
    found.push_back({formatted("sigma cannot be judged: %td held-out examples, and 50 are needed",
                               held_out.by_step.empty() ? Index{0} : held_out.by_step.front().examples),
                     "more held-out examples"});
    return;
  }
  for (const auto& [count, how] : {std::pair{narrow, "small"}, std::pair{wide, "large"}}) {
    if (count == 0) continue;
    found.push_back(
        {formatted("sigma is too %s in %d of %d numbers (coverage outside 0.62 to 0.74, nse outside 0.8 to 1.25)", how,
                   count, judged),
         "more examples for the calibration"});
  }
}

}  // namespace

std::vector<FitCurvePoint> curve_of(const std::string& training_json) {
  const auto json = parse_json_if_valid(training_json);
  std::vector<FitCurvePoint> curve;
  if (!json.is_object() || !json.contains("curve") || !json["curve"].is_array()) return curve;
  for (const auto& one : json["curve"]) {
    if (!one.is_object() || !one.contains("iteration") || !one.contains("training_loss") ||
        !one.contains("validation_loss") || !one["iteration"].is_number() || !one["validation_loss"].is_number() ||
        !one["training_loss"].is_number())
      return {};
    curve.push_back({one["iteration"].get<std::int64_t>(), one["training_loss"].get<double>(),
                     one["validation_loss"].get<double>()});
  }
  return curve;
}

std::vector<Shortfall> find_shortfalls(const LearnedModel& model) {
  std::vector<Shortfall> found;
  if (model.failed > 0 && 100 * model.failed > model.examples) {
    found.push_back({formatted("%lld of %lld examples failed", static_cast<long long>(model.failed),
                               static_cast<long long>(model.examples)),
                     "`weft dataset info` of the folders in examples/ lists why"});
  }
  judge_fit(model.curve, found);
  const PredictionFigures& settled = model.held_out.from_start;
  if (settled.n == 0) {
    found.push_back({"no held-out example was released, so settled shapes are not measured", "more held-out examples"});
  } else if (settled.median_mm > kTargetMedianMm) {
    found.push_back({formatted("settled shapes are off by %.1f mm in the median; the target is %.0f", settled.median_mm,
                               kTargetMedianMm),
                     is_close(model.curve) ? "more iterations: the losses of training and validation are close"
                                           : "more examples and iterations"});
  }
  judge_sigma(model.held_out, found);
  return found;
}

}  // namespace weft
