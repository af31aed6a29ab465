#pragma once
#include <vector>

#include "weft/predictor.hpp"

namespace weft {

struct JvpOptions {
  /// Step of the central differences: the largest change of a control in units of its scale, of centre and width in
  /// units of 1.
  double step = 0.1;
  Index batch = 256;  ///< largest number of cases in one predict()
};

/// Directional derivatives of a batch of predictions: the predictor's jvp if it declares one, else central differences.
/// The differences evaluate both sides of every direction, in batches. Centre and width stay within [0, 1]: a side that
/// would leave it is shortened. A perturbed case without a result is replaced by the unperturbed one. If both sides
/// have no result, the derivative is NaN; so it is where the predictor's jvp diverges.
///
/// A loss holds the release segment fixed (eq. 5), but the differences do not. A predictor that computes the release
/// from the controls may release a perturbed case one segment earlier or later.
/// @param prediction of `cases`; made with `gradients` if the predictor declares jvp.
/// @param directions [cases], any number each.
/// @param trajectory gives the controls' scales.
/// @param predicted if not null: the number of cases predicted here is added to it.
/// @return [cases][directions of that case][case.segments]; no rows for a case without a result.
std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(const Predictor& predictor, const Prediction& prediction,
                                                          const std::vector<PredictionCase>& cases,
                                                          const std::vector<std::vector<CaseDirection>>& directions,
                                                          const Trajectory& trajectory, Moments moments,
                                                          const JvpOptions& options = {}, Index* predicted = nullptr);

/// Prediction::pullback() of a batch. Where a case's derivative diverges it is NaN, so that only its own search has a failed
/// evaluation.
/// @param prediction of `cases`, made with `gradients`.
std::vector<CaseGradient> pullback(const Prediction& prediction, const std::vector<PredictionCase>& cases,
                                   const std::vector<std::vector<ShapeCotangent>>& cotangents);

}  // namespace weft
