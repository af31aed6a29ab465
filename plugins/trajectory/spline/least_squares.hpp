#pragma once
#include "weft/types.hpp"

namespace weft::spline {

/// Control points [K, C] whose curve is nearest to the controls, by weighted linear least squares. Of equally good fits
/// it is the one nearest the weighted mean of the controls.
/// @param basis [b, K]: row j holds the weights of the control points in segment j; they sum to 1.
/// @param weights [b] of the segments, >= 0, not all zero. @param controls [b, C], b > 0.
Controls fit_control_points(const Matrix& basis, const Vector& weights, const Controls& controls);

}  // namespace weft::spline
