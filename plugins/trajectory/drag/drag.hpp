#pragma once
#include <vector>

#include "weft/params.hpp"
#include "weft/trajectory.hpp"

namespace weft::drag {

/// The default drag, its phases and how far a plan may leave it. The reasons for the defaults stand in README.md.
struct Params {
  std::int64_t hands = 2;
  double height_m = 0.1;
  double arrival_height_m = 0.05;
  double overshoot_m = 0.02;
  double lift_end = 0.25;
  double move_end = 0.75;
  double duration_s = 2.0;
  double duration_min_s = 0.6;
  double duration_max_s = 10.0;
  double height_change_m = 0.2;
  double arrival_height_change_m = 0.2;
  double overshoot_change_m = 0.1;
  double length_change_m = 0.2;
  double heading_change_deg = 45.0;
  double pace_scale = 0.2;
  double shape_scale = 0.15;

  template <class Visitor>
  void visit(Visitor& v) {
    v("hands", hands, range(1, 2), "Hands, each with a grasp point.");
    v("height_m", height_m, range(0.0, 2.0, "m"), "Height above the grasp points after the lift.");
    v("arrival_height_m", arrival_height_m, range(0.0, 2.0, "m"), "Height at the end of the move over the table.");
    v("overshoot_m", overshoot_m, range(0.0, 0.5, "m"), "How far the move goes beyond the place of release.");
    v("lift_end", lift_end, range(0.1, 0.4), "Progress at which the hands are up.");
    v("move_end", move_end, range(0.6, 0.85),
      "Progress at which the move over the table ends and the way back begins.");
    v("duration_s", duration_s, range(0.2, 60.0, "s"), "Duration of the default drag.");
    v("duration_min_s", duration_min_s, range(0.2, 60.0, "s"), "Duration at the fastest pace.");
    v("duration_max_s", duration_max_s, range(0.2, 60.0, "s"), "Duration at the slowest pace.");
    v("height_change_m", height_change_m, range(0.0, 2.0, "m"), "Largest change of the height, either way.");
    v("arrival_height_change_m", arrival_height_change_m, range(0.0, 2.0, "m"),
      "Largest change of the arrival height, either way.");
    v("overshoot_change_m", overshoot_change_m, range(0.0, 2.0, "m"), "Largest change of the overshoot, either way.");
    v("length_change_m", length_change_m, range(0.0, 2.0, "m"),
      "Largest change of the move from grasp to release, either way.");
    v("heading_change_deg", heading_change_deg, range(0.0, 180.0, "deg"), "Largest change of the heading, either way.");
    v("pace_scale", pace_scale, range(1e-3, 1.0), "Typical change of the pace, as a share of the default pace.");
    v("shape_scale", shape_scale, range(1e-3, 1.0), "Typical change of a shape parameter, as a share of its largest.");
  }
};

/// Lays an edge down while it moves over the table: a low lift, a long move along d whose height falls from one value
/// to another, a little too far, down, and back. Where the cloth trails behind the hands, friction pulls it straight.
///
/// State: progress s, then per shape parameter (height m, arrival height m, overshoot m, length m, heading deg) the sum
/// p_k of its control. Control: their deltas per frame. In force is the mean p_k / s, so a plan with constant controls
/// has one shape from beginning to end, at any pace, and a later plan changes the shape without a jump of the hands.
///     S_w(s): minimum jerk step over window w = lift, move, lower, back [Flash & Hogan 1985]
///     H = height + p_1/s   A = arrival + p_2/s   o = overshoot + p_3/s   l = |d| + p_4/s   phi = p_5/s S_move
///     along = (l + o) S_move - o S_back    rise = H S_lift + (A - H) S_move + (h - A) S_lower
///     g_i = (c_0, g0_iz) + along d' + o_i' + rise z,   z >= contact height
/// c_0, o_i: midpoint of the grasp points and their offsets from it in XY; d', o_i': d/|d| and o_i turned by phi about z.
/// Decision vector: ds and the changes x_k of the shape parameters; every row is (ds, ds x_1, ..., ds x_5).
/// Derivatives are exact. Beyond a clamp they are 0; on it they are those of the inside.
class Drag final : public Trajectory {
 public:
  /// @throws ConfigError unless duration_min_s <= duration_s <= duration_max_s.
  explicit Drag(const Params& params);

  std::vector<Variable> controls() const override;
  std::vector<Variable> state() const override;
  Index hands() const override { return p_.hands; }
  Vector initial_state(const Manipulation& manipulation) const override;
  Positions targets(const Manipulation& manipulation, ConstVec state) const override;
  Vector targets_pullback(const Manipulation& manipulation, ConstVec state, const Positions& d_targets) const override;
  double progress(ConstVec state) const override;

  Index decision_size(Index horizon) const override;
  Controls decode(ConstVec x, Index horizon, ConstVec state) const override;
  Vector decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const override;
  Vector encode(const Controls& controls, ConstVec state) const override;
  Box decision_bounds(Index horizon) const override;
  Vector decision_scale(Index horizon) const override;

 private:
  struct Pose;
  Pose pose(const Manipulation& manipulation, ConstVec state) const;

  Params p_;
};

}  // namespace weft::drag
