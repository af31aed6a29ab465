#pragma once
#include <cstddef>
#include <utility>
#include <vector>

#include "weft/predictor.hpp"

namespace weft {

/// Errors and calibration of predictions over some cases.
struct PredictionFigures {
  double steps = 0.0;                     ///< segments predicted ahead, mean over the cases
  Index n = 0;                            ///< cases
  Index examples = 0;                     ///< number of examples that the cases come from
  double mean_mm = 0.0, median_mm = 0.0;  ///< over cases, of the mean vertex distance
  double nll = 0.0;                       ///< mean over coordinates of -log density, lengths in mm
  double coverage_1sigma = 0.0;           ///< share of the coordinates within one sigma (normal: 0.683)
  double nse = 0.0;                       ///< mean of (error / sigma)^2 (calibrated: 1)
  double sigma_mm = 0.0;                  ///< mean sigma
  /// Standard errors of the means above. The cases of one example count as one observation; NaN for a single one.
  double mean_mm_se = 0.0, coverage_1sigma_se = 0.0, nse_se = 0.0;
};

/// One predicted shape compared with the true one. Means are over its coordinates.
struct PredictionScore {
  double error_mm = 0.0;  ///< mean vertex distance
  double nll = 0.0;       ///< mean of -log density, lengths in mm
  double inside = 0.0;    ///< share within one sigma
  double square = 0.0;    ///< mean of (error / sigma)^2
  double sigma_mm = 0.0;  ///< mean sigma
};
PredictionScore score_of(const ShapeDistribution& predicted, const Positions& truth);

/// Collects the cases of one row of figures.
class PredictionTally {
 public:
  /// @param example of the case. @param ahead number of predicted segments.
  void add(std::size_t example, const PredictionScore& score, Index ahead);
  /// The same for a prediction without sigma.
  void add(std::size_t example, const Positions& predicted, const Positions& truth, Index ahead);
  PredictionFigures figures() const;

 private:
  /// Mean and its standard error. The cases of one example count as one observation; NaN for a single one.
  std::pair<double, double> mean(const std::vector<double>& values) const;

  std::vector<double> errors_, inside_, square_;  // per case; the last two are means over its coordinates
  std::vector<std::size_t> examples_;             // per case
  double steps_ = 0.0, nll_ = 0.0, sigma_ = 0.0;
};

}  // namespace weft
