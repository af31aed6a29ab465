#pragma once
#include "weft/params.hpp"
#include "weft/random.hpp"
#include "weft/trajectory.hpp"

namespace weft {

/// Random controls that cover the requests of a planner (section 3). Each control is a smooth random walk around a
/// random multiple of the default trajectory. So slow and fast, bent and shifted arcs all occur.
struct RandomControlsParams {
  double pace_low = 0.6;
  double pace_high = 1.6;
  double drift = 0.7;
  double walk = 0.5;
  double smoothness = 0.8;

  template <class Visitor>
  void visit(Visitor& v) {
    v("pace_low", pace_low, range(0.05, 10), "Slowest mean pace, as a multiple of the default controls.");
    v("pace_high", pace_high, range(0.05, 10), "Fastest mean pace, as a multiple of the default controls.");
    v("drift", drift, range(0, 10), "Standard deviation of the constant part, in units of the control's scale.");
    v("walk", walk, range(0, 10),
      "Standard deviation of the part that varies over segments, in units of the control's scale.");
    v("smoothness", smoothness, range(0, 0.999), "Correlation of the varying part from one segment to the next.");
  }
};

/// @return [horizon, C], inside the controls' bounds.
Controls random_controls(const Trajectory& trajectory, Index horizon, const RandomControlsParams& params,
                         RandomStream& random);

}  // namespace weft
