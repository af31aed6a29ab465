#pragma once
#include <string>
#include <vector>

#include "weft/parametric_path.hpp"

namespace weft::keyframes {

/// The default poses, their times and how far a plan may leave them. The reasons for the defaults stand in README.md.
struct Params {
  PathParams path{.duration_s = 1.6, .duration_min_s = 0.4};
  std::int64_t poses = 3;
  std::vector<double> times;
  double height = 0.5;
  std::vector<double> along_m;
  std::vector<double> across_m;
  std::vector<double> up_m;
  bool turn = false;
  double pose_change_m = 0.3;
  double end_change_m = 0.2;
  double heading_change_deg = 45.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v.part(path);
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
    v("pose_change_m", pose_change_m, range(0.0, 2.0, "m"), "Largest change of a pose, each direction, either way.");
    v("end_change_m", end_change_m, range(0.0, 2.0, "m"), "Largest change of the place of release, along and across.");
    v("heading_change_deg", heading_change_deg, range(0.0, 180.0, "deg"), "Largest change of a heading, either way.");
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
/// the grasp to the place of release. State, decision vector and the geometry of the hands: weft/parametric_path.hpp.
///
/// Shape parameters: along_k, across_k, up_k (m) of pose k, along and across of the end, and with `turn` the headings of
/// the poses and of the end (deg).
///     P_k = default pose k + x_k   P_{K+1} = (|d|, 0, h) + x_{K+1}   phi_j: class Splines
///     (along, across, up) = sum_j phi_j(s) P_j    turn = sum_j phi_j(s) x_turn,j
class Keyframes final : public ParametricPath {
 public:
  /// @throws ConfigError for times that do not ascend, lists that have not one number per pose, `turn` with one hand,
  /// and unless duration_min_s <= duration_s <= duration_max_s.
  explicit Keyframes(const Params& params);

 private:
  void path(const Manipulation& manipulation, double s, ConstVec shape, PathPoint& point) const override;

  Params p_;
  std::vector<double> times_;
  Splines splines_;
};

}  // namespace weft::keyframes
