#pragma once
#include <map>
#include <string>
#include <vector>

#include "experiments/experiment_config.hpp"

namespace weft {

/// Errors and calibration of predictions over some cases.
struct PredictionFigures {
  double steps = 0.0;                     ///< segments predicted ahead; their mean where cases differ
  Index n = 0;                            ///< cases
  Index examples = 0;                     ///< that they come from
  double mean_mm = 0.0, median_mm = 0.0;  ///< over cases, of the mean vertex distance
  double nll = 0.0;                       ///< mean over coordinates of -log density, lengths in mm
  double coverage_1sigma = 0.0;           ///< share of the coordinates within one sigma (normal: 0.683)
  double nse = 0.0;                       ///< mean of (error / sigma)^2 (calibrated: 1)
  double sigma_mm = 0.0;                  ///< mean sigma
  /// Standard errors of the means above, for which the cases of one example count as one observation; NaN where there
  /// is but one.
  double mean_mm_se = 0.0, coverage_1sigma_se = 0.0, nse_se = 0.0;
};

/// A released example, predicted from its start with its material known.
struct PredictedExample {
  std::int64_t index = 0;  ///< in the dataset
  Index segments = 0;      ///< predicted ahead
  double error_mm = 0.0;   ///< mean vertex distance of the settled shape
  double sigma_mm =
      0.0;  ///< root of a vertex's three variances, its mean over the vertices: what error_mm should be like
};

struct PredictionEvaluation {
  PredictionFigures from_start, from_random, no_knowledge;  ///< the settled shape
  std::vector<PredictionFigures> by_step, by_step_from_random, by_step_no_knowledge;
  std::map<std::string, PredictionFigures> baselines;  ///< settled shape; only n, mean_mm and median_mm
  Index failed = 0;                                    ///< cases that the predictor could not predict
  Index shortened = 0;   ///< cases that go on beyond the predictor's max_segments(): not predicted to their end
  double seconds = 0.0;  ///< inside predict()
  std::vector<PredictedExample> examples;     ///< those that from_start counts
  std::vector<Positions> settled, predicted;  ///< of the first examples, for the page
};

/// Measures a bound predictor on a split of a dataset: the paper's accuracy claims for its network, and more.
/// @throws ConfigError when the split is empty.
PredictionEvaluation evaluate_prediction(const Predictor& predictor, const Task& task, const Dataset& dataset,
                                         const PredictionEvaluationParams& params, std::uint64_t seed, Host& host);
/// prediction.json (design section 5; docs/file-formats.md).
std::string prediction_evaluation_json(const PredictionEvaluation& result);
/// cases.h5 of the page: settled and predicted shapes of the first of prediction.json's `cases`.
void write_prediction_shapes(const PredictionEvaluation& result, const Garment& garment,
                             const std::filesystem::path& file);
std::string prediction_evaluation_csv(const PredictionEvaluation& result);

}  // namespace weft
