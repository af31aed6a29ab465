#pragma once
#include <string>
#include <vector>

#include "weft/params.hpp"
#include "weft/trajectory.hpp"

namespace weft {

/// A function of the progress s: its value and its derivative with respect to s.
struct Profile {
  double value = 0.0;
  double slope = 0.0;
};
inline Profile operator+(const Profile& a, const Profile& b) { return {a.value + b.value, a.slope + b.slope}; }
inline Profile operator-(const Profile& a, const Profile& b) { return {a.value - b.value, a.slope - b.slope}; }
inline Profile operator*(double factor, const Profile& a) { return {factor * a.value, factor * a.slope}; }

/// A step from 0 to 1 over a window of s: u^3 (10 - 15 u + 6 u^2), u = (s - from) / (to - from) in [0, 1]. It is the
/// move of the least squared jerk [Flash & Hogan 1985]: velocity and acceleration vanish at both ends.
/// @param from, to 0 <= from < to.
WEFT_API Profile minimum_jerk(double s, double from, double to);

/// One coordinate of the hands.
struct PathCoordinate {
  Profile at;       ///< its value, and the derivative with respect to s for a constant shape
  Vector by_shape;  ///< [P]: its derivatives with respect to the shape parameters
};

/// Where the hands are, in the frame of the displacement d. As constructed: at the grasp points, for every shape.
struct PathPoint {
  explicit PathPoint(Index shape_parameters);

  PathCoordinate along, across;  ///< m: offset of the hands' midpoint from its start along d and to the left of it
  PathCoordinate up;             ///< m: height above the grasp points
  PathCoordinate heading;        ///< rad: turns the offset (along, across) about the start of the midpoint
  PathCoordinate turn;           ///< rad: turns the hands about their midpoint
  PathCoordinate spread;         ///< share by which the hands move apart
};

/// A number that changes the shape of a path.
struct ShapeParameter {
  std::string name;     ///< "height"
  std::string unit;     ///< "m"; "deg" for angles
  double change = 0.0;  ///< largest change that a plan may make, either way, in `unit`; finite, >= 0
};

/// The parameters that all parametric paths have; a plugin puts them beside its own with v.part(path).
struct PathParams {
  std::int64_t hands = 2;
  double duration_s = 2.0;
  double duration_min_s = 0.6;
  double duration_max_s = 5.0;
  double pace_scale = 0.2;
  double shape_scale = 0.15;

  template <class Visitor>
  void visit(Visitor& v) {
    v("hands", hands, range(1, 2), "Hands, each with a grasp point.");
    v("duration_s", duration_s, range(0.2, 60.0, "s"), "Duration of the default path.");
    v("duration_min_s", duration_min_s, range(0.2, 60.0, "s"), "Duration at the fastest pace.");
    v("duration_max_s", duration_max_s, range(0.2, 60.0, "s"), "Duration at the slowest pace.");
    v("pace_scale", pace_scale, range(1e-3, 1.0), "Typical change of the pace, as a share of the default pace.");
    v("shape_scale", shape_scale, range(1e-3, 1.0), "Typical change of a shape parameter, as a share of its largest.");
  }
};

/// A trajectory whose path is a formula with a few shape parameters, such as heights and lengths. A plugin derives from
/// it and writes path(); pace, decision variables and the geometry of the hands are here.
///
/// State [1 + P]: progress s, then per shape parameter the sum p_k of its control. Control: their deltas per frame. In
/// force is the mean x_k = p_k / s, so a plan with constant controls has one shape from beginning to end, at any pace,
/// and a later plan changes the shape without a jump of the hands. s has no clamp; progress() = s.
///     g_i = (c_0, g0_iz) + R(heading) (along d/|d| + across z x d/|d|) + (1 + spread) R(turn) o_i + up z
///     z >= contact height
/// c_0, o_i: midpoint of the grasp points and their offsets from it in XY; R(a) turns by a about z.
/// The six coordinates are those of path() at min(s, 1) and x. At s <= 0 the hands are at the grasp points.
///
/// Decision vector [1 + P] for any horizon: the pace ds and the changes x; every row of the controls is (ds, ds x).
/// encode() is the least squares fit; segments that start after the release count by 1e-3.
/// Derivatives are exact. Beyond a clamp they are 0; on it they are those of the inside.
/// Plugins contain this class, so a change to it bumps Trajectory::kVersion, too.
class WEFT_API ParametricPath : public Trajectory {
 public:
  std::vector<Variable> controls() const override;
  std::vector<Variable> state() const override;
  Index hands() const override { return params_.hands; }
  /// @throws ConfigError for |d| = 0, because d is the direction.
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

 protected:
  /// @param name the plugin's name; messages start with it.
  /// @param shape P entries; the state has their names, the controls these with a "d" before them.
  /// @throws ConfigError unless duration_min_s <= duration_s <= duration_max_s.
  ParametricPath(std::string name, const PathParams& params, std::vector<ShapeParameter> shape);

  /// Where the hands are at a progress. Called from many threads.
  /// @param manipulation has hands() grasp points and |d| > 0.
  /// @param s in (0, 1]. Towards 0 every coordinate must vanish as s^3, as minimum_jerk() does: shape can be as large
  ///   as the state divided by s. At 1 every slope must be 0.
  /// @param shape [P]: the changes x of the shape parameters, in their units; 0 for the default path.
  /// @param point as constructed; set those coordinates and derivatives that are not 0.
  virtual void path(const Manipulation& manipulation, double s, ConstVec shape, PathPoint& point) const = 0;

 private:
  Index size() const { return 1 + std::ssize(shape_); }
  void require_state(ConstVec state) const;
  void check(const Manipulation& manipulation) const;
  PathPoint point_at(const Manipulation& manipulation, ConstVec state) const;

  std::string name_;
  PathParams params_;
  std::vector<ShapeParameter> shape_;
};

}  // namespace weft
