#pragma once
#include "weft/parametric_path.hpp"

namespace weft::fling {

/// The default fling, its phases and how far a plan may leave it. The reasons for the defaults stand in README.md.
struct Params {
  PathParams path;
  double height_m = 0.4;
  double reach_m = 0.3;
  double pull_m = 0.05;
  double stretch = 0.0;
  double lift_end = 0.4;
  double swing_end = 0.65;
  double lay_end = 0.9;
  double height_change_m = 0.3;
  double reach_change_m = 0.3;
  double pull_change_m = 0.15;
  double length_change_m = 0.2;
  double heading_change_deg = 45.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v.part(path);
    v("height_m", height_m, range(0.02, 2.0, "m"), "Height of the swing above the grasp points.");
    v("reach_m", reach_m, range(0.0, 1.0, "m"), "How far the hands swing out beyond the place of release.");
    v("pull_m", pull_m, range(0.0, 0.5, "m"), "Last part of the way back, with the hands down at the drop height.");
    v("stretch", stretch, range(-0.5, 0.1), "Share by which the hands move apart during the lift.");
    v("lift_end", lift_end, range(0.2, 0.5), "Progress at which the hands are up.");
    v("swing_end", swing_end, range(0.55, 0.75), "Progress at which they are out.");
    v("lay_end", lay_end, range(0.8, 0.95), "Progress at which they are down.");
    v("height_change_m", height_change_m, range(0.0, 2.0, "m"), "Largest change of the height, either way.");
    v("reach_change_m", reach_change_m, range(0.0, 2.0, "m"), "Largest change of the reach, either way.");
    v("pull_change_m", pull_change_m, range(0.0, 2.0, "m"), "Largest change of the pull, either way.");
    v("length_change_m", length_change_m, range(0.0, 2.0, "m"),
      "Largest change of the move from grasp to release, either way.");
    v("heading_change_deg", heading_change_deg, range(0.0, 180.0, "deg"), "Largest change of the heading, either way.");
  }
};

/// The dynamic fling of the literature [Ha & Song 2021]: lift, swing out beyond the place of release, pull back while
/// laying down, pull on over the table. State, decision vector and the geometry of the hands: weft/parametric_path.hpp.
///
/// Shape parameters: the changes x of height, reach, pull, length (m) and heading (deg).
///     S_w(s): minimum jerk step over window w = lift, swing, lay, pull [Flash & Hogan 1985]
///     H = height + x_1   R = reach + x_2   B = pull + x_3   l = |d| + x_4   heading = turn = x_5 S_swing
///     along = (l + R) S_swing - (R - B) S_lay - B S_pull    up = H (S_lift - S_lay) + h S_lay
///     spread = stretch S_lift
class Fling final : public ParametricPath {
 public:
  /// @throws ConfigError unless duration_min_s <= duration_s <= duration_max_s.
  explicit Fling(const Params& params);

 private:
  void path(const Manipulation& manipulation, double s, ConstVec shape, PathPoint& point) const override;

  Params p_;
};

}  // namespace weft::fling
