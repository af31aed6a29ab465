#pragma once
#include "weft/parametric_path.hpp"

namespace weft::drag {

/// The default drag, its phases and how far a plan may leave it. The reasons for the defaults stand in README.md.
struct Params {
  PathParams path{.duration_max_s = 10.0};
  double height_m = 0.1;
  double arrival_height_m = 0.05;
  double overshoot_m = 0.02;
  double lift_end = 0.25;
  double move_end = 0.75;
  double height_change_m = 0.2;
  double arrival_height_change_m = 0.2;
  double overshoot_change_m = 0.1;
  double length_change_m = 0.2;
  double heading_change_deg = 45.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v.part(path);
    v("height_m", height_m, range(0.0, 2.0, "m"), "Height above the grasp points after the lift.");
    v("arrival_height_m", arrival_height_m, range(0.0, 2.0, "m"), "Height at the end of the move over the table.");
    v("overshoot_m", overshoot_m, range(0.0, 0.5, "m"), "How far the move goes beyond the place of release.");
    v("lift_end", lift_end, range(0.1, 0.4), "Progress at which the hands are up.");
    v("move_end", move_end, range(0.6, 0.85),
      "Progress at which the move over the table ends and the way back begins.");
    v("height_change_m", height_change_m, range(0.0, 2.0, "m"), "Largest change of the height, either way.");
    v("arrival_height_change_m", arrival_height_change_m, range(0.0, 2.0, "m"),
      "Largest change of the arrival height, either way.");
    v("overshoot_change_m", overshoot_change_m, range(0.0, 2.0, "m"), "Largest change of the overshoot, either way.");
    v("length_change_m", length_change_m, range(0.0, 2.0, "m"),
      "Largest change of the move from grasp to release, either way.");
    v("heading_change_deg", heading_change_deg, range(0.0, 180.0, "deg"), "Largest change of the heading, either way.");
  }
};

/// Lays an edge down while it moves over the table: a low lift, a long move along d whose height falls from one value
/// to another, a little too far, down, and back. Where the cloth trails behind the hands, friction pulls it straight.
/// State, decision vector and the geometry of the hands: weft/parametric_path.hpp.
///
/// Shape parameters: the changes x of height, arrival height, overshoot, length (m) and heading (deg).
///     S_w(s): minimum jerk step over window w = lift, move, lower, back [Flash & Hogan 1985]
///     H = height + x_1   A = arrival + x_2   o = overshoot + x_3   l = |d| + x_4   heading = turn = x_5 S_move
///     along = (l + o) S_move - o S_back    up = H S_lift + (A - H) S_move + (h - A) S_lower
class Drag final : public ParametricPath {
 public:
  /// @throws ConfigError unless duration_min_s <= duration_s <= duration_max_s.
  explicit Drag(const Params& params);

 private:
  void path(const Manipulation& manipulation, double s, ConstVec shape, PathPoint& point) const override;

  Params p_;
};

}  // namespace weft::drag
