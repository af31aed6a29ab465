#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "experiments/prediction_evaluation.hpp"

namespace weft {

/// One validation of a fit.
struct FitCurvePoint {
  std::int64_t iteration = 0;
  double training_loss = 0.0, validation_loss = 0.0;
};
/// The curve in a training.json; empty for a predictor that writes none.
std::vector<FitCurvePoint> curve_of(const std::string& training_json);

/// What `weft learn` made, to be judged.
struct LearnedModel {
  std::int64_t examples = 0, failed = 0;  ///< of all examples, and those of them that failed
  std::vector<FitCurvePoint> curve;
  const PredictionEvaluation& held_out;
};

/// Where a model falls short of what docs/model.md asks for, or could not be judged.
struct Shortfall {
  std::string what;    ///< with the numbers
  std::string remedy;  ///< what to change
};
/// In this order: failed examples, examples and iterations of the fit, the error of settled shapes (target: a median of
/// 5 mm), and calibration: coverage in [0.62, 0.74] and nse in [0.8, 1.25] for every number of segments with at least 50
/// examples. A number is outside when it is so by more than two standard errors.
std::vector<Shortfall> find_shortfalls(const LearnedModel& model);

}  // namespace weft
