#pragma once
#include <cstddef>
#include <utility>
#include <vector>

#include "weft/predictor.hpp"

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

/// Collects the cases of one row of figures.
class PredictionTally {
 public:
  /// @param example the case comes from. @param ahead segments predicted.
  void add(std::size_t example, const ShapeDistribution& predicted, const Positions& truth, Index ahead);
  /// The same of a prediction without sigma.
  void add(std::size_t example, const Positions& predicted, const Positions& truth, Index ahead);
  PredictionFigures figures() const;

 private:
  /// Mean and its standard error, when the cases of an example are one observation; NaN of one.
  std::pair<double, double> mean(const std::vector<double>& values) const;

  std::vector<double> errors_, inside_, square_;  // per case; the last two are means over its coordinates
  std::vector<std::size_t> examples_;             // per case
  double steps_ = 0.0, nll_ = 0.0, sigma_ = 0.0;
};

}  // namespace weft
