#pragma once
#include <string>
#include <vector>

#include "weft/params.hpp"
#include "weft/trajectory.hpp"

namespace weft::keyframes {

/// The default poses, their times and how far a plan may leave them. The reasons for the defaults stand in README.md.
struct Params {
  std::int64_t hands = 2;
  std::int64_t poses = 3;
  std::vector<double> times;
  double height = 0.5;
  std::vector<double> along_m;
  std::vector<double> across_m;
  std::vector<double> up_m;
  bool turn = false;
  double duration_s = 1.6;
  double duration_min_s = 0.4;
  double duration_max_s = 5.0;
  double pose_change_m = 0.3;
  double end_change_m = 0.2;
  double heading_change_deg = 45.0;
  double pace_scale = 0.2;
  double shape_scale = 0.15;

  template <class Visitor>
  void visit(Visitor& v) {
    v("hands", hands, range(1, 2), "Hands, each with a grasp point.");
    v("poses", poses, range(1, 8), "Poses between the grasp and the release.");
    v("times", times, range(0.01, 0.99), "Time of each pose, as a share of the duration, ascending; empty: even.");
    v("height", height, range(0.0, 5.0),
      "Height of the default path, a half ellipse over the displacement, in lengths of the displacement.");
    v("along_m", along_m, range(-10.0, 10.0, "m"),
      "Default poses: offsets of the hands' midpoint from its start along the displacement; empty: on the half ellipse.");
    v("across_m", across_m, range(-10.0, 10.0, "m"), "Default poses: offsets across it, to the left; empty: 0.");
    v("up_m", up_m, range(-10.0, 10.0, "m"),
      "Default poses: heights above the grasp points; empty: on the half ellipse.");
    v("turn", turn, "Two hands: poses and end have headings too.");
    v("duration_s", duration_s, range(0.2, 60.0, "s"), "Duration of the default path.");
    v("duration_min_s", duration_min_s, range(0.2, 60.0, "s"), "Duration at the fastest pace.");
    v("duration_max_s", duration_max_s, range(0.2, 60.0, "s"), "Duration at the slowest pace.");
    v("pose_change_m", pose_change_m, range(0.0, 2.0, "m"), "Largest change of a pose, each direction, either way.");
    v("end_change_m", end_change_m, range(0.0, 2.0, "m"), "Largest change of the place of release, along and across.");
    v("heading_change_deg", heading_change_deg, range(0.0, 180.0, "deg"), "Largest change of a heading, either way.");
    v("pace_scale", pace_scale, range(1e-3, 1.0), "Typical change of the pace, as a share of the default pace.");
    v("shape_scale", shape_scale, range(1e-3, 1.0), "Typical change of a shape parameter, as a share of its largest.");
  }
};

/// The functions phi_1 ... phi_{K+1} of s with phi_j = 1 at time j, 0 at the other times and at 0: cubic splines, twice
/// continuously differentiable, with zero velocity and acceleration at 0 and 1. Two more knots, midway to the first and
/// from the last pose, make room for the latter conditions [Biagiotti & Melchiorri 2008, "Trajectory Planning for
/// Automatic Machines and Robots", chapter 4]. Before 0 and after 1 they are constant.
class Splines {
 public:
  /// @param times [K] of the poses: ascending, in (0, 1); time K + 1 is 1.
  explicit Splines(const std::vector<double>& times);
  /// [K + 1]: the functions at s and their derivatives.
  void evaluate(double s, Vector& value, Vector& slope) const;

 private:
  std::vector<double> knots_;  ///< n + 1
  Matrix heights_, bends_;     ///< [n + 1, K + 1]: values and second derivatives at the knots
};

/// Poses at given times as decision variables: the midpoint of the hands passes through K poses on a smooth curve from
/// the grasp to the place of release.
///
/// State: progress s, then the sums p of the controls of each shape parameter: along_k, across_k, up_k (m) of pose k,
/// along and across of the end, and with `turn` the headings of the poses and of the end (deg). Control: their deltas
/// per frame. In force is the mean p / s, so a plan with constant controls has one shape from beginning to end, at any
/// pace, and a later plan changes the shape without a jump of the hands.
///     P_k = default pose k + p_k / s   P_{K+1} = (|d|, 0, h) + p_{K+1} / s   phi_j: class Splines
///     (along, across, up) = sum_j phi_j(s) P_j    turn = sum_j phi_j(s) p_turn,j / s
///     g_i = (c_0, g0_iz) + along d/|d| + across z x d/|d| + o_i' + up z,   z >= contact height
/// c_0, o_i: midpoint of the grasp points and their offsets from it in XY; o_i': o_i turned by `turn` about z.
/// Decision vector: ds and the changes x of the shape parameters; every row is (ds, ds x).
/// Derivatives are exact. Beyond a clamp they are 0; on it they are those of the inside.
class Keyframes final : public Trajectory {
 public:
  /// @throws ConfigError for times that do not ascend, lists that have not one number per pose, `turn` with one hand,
  /// and unless duration_min_s <= duration_s <= duration_max_s.
  explicit Keyframes(const Params& params);

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
  struct Place;
  Place place(const Manipulation& manipulation, ConstVec state) const;
  std::vector<double> read_times() const;  ///< [K] times of the poses
  Index size() const { return 3 + 3 * p_.poses + (p_.turn ? p_.poses + 1 : 0); }

  Params p_;
  std::vector<double> times_;
  Splines splines_;
};

}  // namespace weft::keyframes
