#pragma once
#include <algorithm>

namespace weft {

/// The rule of a trust region: shrink where the model promised far more than came, grow where it kept its word at the edge
/// [Conn, Gould & Toint 2000, "Trust-region methods", sec. 6.1].
struct TrustRegion {
  double shrink = 0.4;  ///< factor on the shorter of step and radius
  double edge = 0.9;    ///< share of the radius from which on a step counts as one to the edge
  static constexpr double kPoorGain = 0.25, kGoodGain = 0.6, kGrow = 2.0;

  static bool is_poor(double gain) { return gain < kPoorGain; }
  /// @param gain what came, as a share of what was promised.
  double next(double radius, double step, double gain) const {
    if (is_poor(gain)) return shrink * std::min(radius, step);
    return gain > kGoodGain && step > edge * radius ? kGrow * radius : radius;
  }
};

}  // namespace weft
