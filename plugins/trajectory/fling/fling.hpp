#pragma once
#include <vector>

#include "weft/params.hpp"
#include "weft/trajectory.hpp"

namespace weft::fling {

/// The default fling, its phases and how far a plan may leave it. The reasons for the defaults stand in README.md.
struct Params {
  std::int64_t hands = 2;
  double height_m = 0.4;
  double reach_m = 0.3;
  double pull_m = 0.05;
  double stretch = 0.0;
  double lift_end = 0.4;
  double swing_end = 0.65;
  double lay_end = 0.9;
  double duration_s = 2.0;
  double duration_min_s = 0.6;
  double duration_max_s = 5.0;
  double height_change_m = 0.3;
  double reach_change_m = 0.3;
  double pull_change_m = 0.15;
  double length_change_m = 0.2;
  double heading_change_deg = 45.0;
  double pace_scale = 0.2;
  double shape_scale = 0.15;

  template <class Visitor>
  void visit(Visitor& v) {
    v("hands", hands, range(1, 2), "Hands, each with a grasp point.");
    v("height_m", height_m, range(0.02, 2.0, "m"), "Height of the swing above the grasp points.");
    v("reach_m", reach_m, range(0.0, 1.0, "m"), "How far the hands swing out beyond the place of release.");
    v("pull_m", pull_m, range(0.0, 0.5, "m"), "Last part of the way back, with the hands down at the drop height.");
    v("stretch", stretch, range(-0.5, 0.1), "Share by which the hands move apart during the lift.");
    v("lift_end", lift_end, range(0.2, 0.5), "Progress at which the hands are up.");
    v("swing_end", swing_end, range(0.55, 0.75), "Progress at which they are out.");
    v("lay_end", lay_end, range(0.8, 0.95), "Progress at which they are down.");
    v("duration_s", duration_s, range(0.2, 60.0, "s"), "Duration of the default fling.");
    v("duration_min_s", duration_min_s, range(0.2, 60.0, "s"), "Duration at the fastest pace.");
    v("duration_max_s", duration_max_s, range(0.2, 60.0, "s"), "Duration at the slowest pace.");
    v("height_change_m", height_change_m, range(0.0, 2.0, "m"), "Largest change of the height, either way.");
    v("reach_change_m", reach_change_m, range(0.0, 2.0, "m"), "Largest change of the reach, either way.");
    v("pull_change_m", pull_change_m, range(0.0, 2.0, "m"), "Largest change of the pull, either way.");
    v("length_change_m", length_change_m, range(0.0, 2.0, "m"),
      "Largest change of the move from grasp to release, either way.");
    v("heading_change_deg", heading_change_deg, range(0.0, 180.0, "deg"), "Largest change of the heading, either way.");
    v("pace_scale", pace_scale, range(1e-3, 1.0), "Typical change of the pace, as a share of the default pace.");
    v("shape_scale", shape_scale, range(1e-3, 1.0), "Typical change of a shape parameter, as a share of its largest.");
  }
};

/// The dynamic fling of the literature [Ha & Song 2021]: lift, swing out beyond the place of release, pull back while
/// laying down, pull on over the table.
///
/// State: progress s, then per shape parameter (height m, reach m, pull m, length m, heading deg) the sum p_k of its
/// control. Control: their deltas per frame. In force is the mean p_k / s, so a plan with constant controls has one
/// shape from beginning to end, at any pace, and a later plan changes the shape without a jump of the hands.
///     S_w(s): minimum jerk step over window w = lift, swing, lay, pull [Flash & Hogan 1985]
///     H = height + p_1/s   R = reach + p_2/s   B = pull + p_3/s   l = |d| + p_4/s   phi = p_5/s S_swing
///     along = (l + R) S_swing - (R - B) S_lay - B S_pull    rise = H (S_lift - S_lay) + h S_lay
///     g_i = (c_0, g0_iz) + along d' + (1 + stretch S_lift) o_i' + rise z,   z >= contact height
/// c_0, o_i: midpoint of the grasp points and their offsets from it in XY; d', o_i': d/|d| and o_i turned by phi about z.
/// Decision vector: ds and the changes x_k of the shape parameters; every row is (ds, ds x_1, ..., ds x_5).
/// Derivatives are exact. Beyond a clamp they are 0; on it they are those of the inside.
class Fling final : public Trajectory {
 public:
  /// @throws ConfigError unless duration_min_s <= duration_s <= duration_max_s.
  explicit Fling(const Params& params);

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

}  // namespace weft::fling
