#pragma once
#include <vector>

#include "weft/predictor.hpp"

namespace weft {

struct JvpOptions {
  /// Step of the central differences: the largest change of a control in units of its scale, of centre and width in
  /// units of 1.
  double step = 0.1;
  Index batch = 256;  ///< most cases in one predict()
};

/// Directional derivatives of a batch of predictions: the predictor's own jvp by capability, central differences
/// otherwise. The differences evaluate every direction on both sides, in batches. Centre and width stay within [0, 1]:
/// where a side would leave it, the difference is taken between what is left. A perturbed case that has no result is
/// replaced by the unperturbed one; with neither side the derivative is NaN.
///
/// Differences do not know that a loss holds the release segment fixed (eq. 5): a predictor that finds the release in
/// the controls it is given may release a perturbed case one segment earlier or later.
/// @param prediction of `cases`; made with `gradients` where the predictor has jvp of its own.
/// @param directions [cases], any number each.
/// @param trajectory gives the controls' scales.
/// @param predicted if not null: the number of cases predicted here is added to it.
/// @return [cases][directions of that case][case.segments]; of a case without result: no rows.
std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(const Predictor& predictor, const Prediction& prediction,
                                                          const std::vector<PredictionCase>& cases,
                                                          const std::vector<std::vector<CaseDirection>>& directions,
                                                          const Trajectory& trajectory, Moments moments,
                                                          const JvpOptions& options = {}, Index* predicted = nullptr);

}  // namespace weft
