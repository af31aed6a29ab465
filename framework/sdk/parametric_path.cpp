#include "weft/parametric_path.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>

namespace weft {
namespace {

// Weight in encode() of a segment that starts after release, when the cloth lies already.
constexpr double kReleasedWeight = 1e-3;
// Up to this progress the hands are at the grasp points: for a state within its bounds they have moved by less than the
// rounding of a metre, and the state divided by s stays finite.
constexpr double kPathStart = 1e-9;

/// Progress per frame at a duration. Rounding must not cost another segment, so it is larger by a billionth.
double pace_of(double duration_s) { return (1.0 + 1e-9) * kFrameSeconds / duration_s; }

Vec2 turned_by(double angle, const Vec2& v) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * v.x() - s * v.y(), s * v.x() + c * v.y()};
}
Vec2 quarter_turn(const Vec2& v) { return {-v.y(), v.x()}; }  // z x v

/// The hands in XY at a point of the path.
struct PlacedHands {
  PlacedHands(const Manipulation& m, const PathPoint& q)
      : direction(m.displacement.normalized()),
        centre(m.grasp_points.leftCols<2>().colwise().mean().transpose()),
        moved(turned_by(q.heading.at.value,
                        q.along.at.value * direction + q.across.at.value * quarter_turn(direction))) {}
  /// Offset of a grasp point from the midpoint, turned, not spread.
  Vec2 arm(const Manipulation& m, const PathPoint& q, Index i) const {
    return turned_by(q.turn.at.value, m.grasp_points.row(i).head<2>().transpose() - centre);
  }
  Vec2 direction, centre;  // d/|d|, c_0
  Vec2 moved;              // of the midpoint from c_0
};

}  // namespace

Profile minimum_jerk(double s, double from, double to) {
  if (s <= from) return {};
  const double u = std::min(1.0, (s - from) / (to - from)), rest = 1.0 - u;
  return {u * u * u * (10.0 + u * (6.0 * u - 15.0)), 30.0 * u * u * rest * rest / (to - from)};
}

PathPoint::PathPoint(Index shape_parameters) {
  for (PathCoordinate* coordinate : {&along, &across, &up, &heading, &turn, &spread})
    coordinate->by_shape = Vector::Zero(shape_parameters);
}

ParametricPath::ParametricPath(std::string name, const PathParams& params, std::vector<ShapeParameter> shape)
    : name_(std::move(name)), params_(params), shape_(std::move(shape)) {
  if (params.duration_min_s <= params.duration_s && params.duration_s <= params.duration_max_s) return;
  std::ostringstream text;
  text << name_ << ": duration_s = " << params.duration_s << " s, must be in [duration_min_s, duration_max_s] = ["
       << params.duration_min_s << ", " << params.duration_max_s << "]";
  throw ConfigError(text.str());
}

std::vector<Variable> ParametricPath::controls() const {
  const double usual = pace_of(params_.duration_s), fastest = pace_of(params_.duration_min_s);
  std::vector<Variable> all = {
      {"ds", "1/frame", pace_of(params_.duration_max_s), fastest, usual, usual * params_.pace_scale}};
  for (const auto& [name, unit, change] : shape_) {
    const double scale = usual * params_.shape_scale * std::max(change, 1e-6);
    all.push_back({"d" + name, unit + "/frame", -fastest * change, fastest * change, 0.0, scale});
  }
  return all;
}

std::vector<Variable> ParametricPath::state() const {
  // These bounds cover a workspace of 10 m, ten turns and a hundred paths.
  std::vector<Variable> all = {{"s", "1", 0.0, 100.0, 0.0, 0.1}};
  for (const auto& [name, unit, change] : shape_) {
    const bool is_angle = unit == "deg";
    const double bound = is_angle ? 3600.0 : 10.0;
    all.push_back({name, unit, -bound, bound, 0.0, is_angle ? 10.0 : 0.1});
  }
  return all;
}

void ParametricPath::require_state(ConstVec state) const { require_shape(name_ + ": state", state.size(), size()); }

void ParametricPath::check(const Manipulation& manipulation) const {
  check_manipulation(name_, *this, manipulation);
  if (!(manipulation.displacement.norm() > 0.0))
    throw ConfigError(name_ + ": |d| = 0 (displacement of the grasp points), must be above 0: d is the direction");
}

Vector ParametricPath::initial_state(const Manipulation& manipulation) const {
  check(manipulation);
  return Vector::Zero(size());
}

double ParametricPath::progress(ConstVec state) const {
  require_state(state);
  return state[0];
}

PathPoint ParametricPath::point_at(const Manipulation& manipulation, ConstVec state) const {
  PathPoint point(size() - 1);
  path(manipulation, std::min(state[0], 1.0), state.tail(size() - 1) / state[0], point);
  return point;
}

Positions ParametricPath::targets(const Manipulation& manipulation, ConstVec state) const {
  require_state(state);
  check(manipulation);
  Positions g = manipulation.grasp_points;
  if (!(state[0] <= kPathStart)) {  // so that numbers that are not finite stay visible
    const PathPoint q = point_at(manipulation, state);
    const PlacedHands placed(manipulation, q);
    for (Index i = 0; i < g.rows(); ++i) {
      const Vec2 arm = (1.0 + q.spread.at.value) * placed.arm(manipulation, q, i);
      g.row(i).head<2>() = (placed.centre + (placed.moved + arm)).transpose();
    }
    g.col(2).array() += q.up.at.value;
  }
  g.col(2) = g.col(2).cwiseMax(manipulation.contact_height);
  return g;
}

Vector ParametricPath::targets_pullback(const Manipulation& manipulation, ConstVec state,
                                        const Positions& d_targets) const {
  require_state(state);
  require_shape(name_ + ": d_targets rows", d_targets.rows(), hands());
  check(manipulation);
  Vector gradient = Vector::Zero(size());
  const double s = state[0];
  if (s <= kPathStart) return gradient;
  const PathPoint q = point_at(manipulation, state);
  const PlacedHands placed(manipulation, q);

  // With x = p / s: dL/ds at constant p, and dL/dp. Beyond the end only x depends on s.
  const auto add = [&](const PathCoordinate& coordinate, double weight) {
    if (coordinate.by_shape.size() != size() - 1)
      require_shape(name_ + ": by_shape of the path", coordinate.by_shape.size(), size() - 1);
    if (s <= 1.0) gradient[0] += weight * coordinate.at.slope;
    gradient[0] -= weight / (s * s) * coordinate.by_shape.dot(state.tail(size() - 1));
    gradient.tail(size() - 1) += weight / s * coordinate.by_shape;
  };
  const Vec2 sum = d_targets.leftCols<2>().colwise().sum().transpose();
  const Vec2 sum_before_heading = turned_by(-q.heading.at.value, sum);
  add(q.along, placed.direction.dot(sum_before_heading));
  add(q.across, quarter_turn(placed.direction).dot(sum_before_heading));
  add(q.heading, quarter_turn(placed.moved).dot(sum));
  for (Index i = 0; i < d_targets.rows(); ++i) {
    const Vec2 arm = placed.arm(manipulation, q, i), xy = d_targets.row(i).head<2>().transpose();
    add(q.turn, (1.0 + q.spread.at.value) * quarter_turn(arm).dot(xy));
    add(q.spread, arm.dot(xy));
    if (manipulation.grasp_points(i, 2) + q.up.at.value >= manipulation.contact_height) add(q.up, d_targets(i, 2));
  }
  return gradient;
}

Index ParametricPath::decision_size(Index horizon) const {
  if (horizon < 0) throw ShapeError(name_ + ": horizon = " + std::to_string(horizon) + ", must be >= 0");
  return size();
}

Controls ParametricPath::decode(ConstVec x, Index horizon, ConstVec state) const {
  require_shape(name_ + ": x", x.size(), decision_size(horizon));
  require_state(state);
  Vector row = x[0] * x;
  row[0] = x[0];
  return row.transpose().replicate(horizon, 1);
}

Vector ParametricPath::decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const {
  require_shape(name_ + ": x", x.size(), decision_size(horizon));
  require_state(state);
  require_shape(name_ + ": d_controls rows", d_controls.rows(), horizon);
  require_shape(name_ + ": d_controls columns", d_controls.cols(), size());
  const Vector sums = d_controls.colwise().sum().transpose();
  Vector gradient = x[0] * sums;
  gradient[0] = sums[0] + x.tail(size() - 1).dot(sums.tail(size() - 1));
  return gradient;
}

Vector ParametricPath::encode(const Controls& controls, ConstVec state) const {
  require_shape(name_ + ": controls columns", controls.cols(), size());
  require_state(state);
  Vector sum = Vector::Zero(size());
  double weights = 0.0, s = state[0];
  for (Index j = 0; j < controls.rows(); ++j) {
    const double weight = j > 0 && s >= 1.0 ? kReleasedWeight : 1.0;
    sum += weight * controls.row(j).transpose();
    weights += weight;
    s += static_cast<double>(kFramesPerSegment) * controls(j, 0);
  }
  Vector x = Vector::Zero(size());
  if (sum[0] > 0.0) x = sum / sum[0];
  x[0] = weights > 0.0 ? sum[0] / weights : pace_of(params_.duration_s);
  return x;
}

Box ParametricPath::decision_bounds(Index horizon) const {
  Box box = Trajectory::decision_bounds(horizon);
  box.lower.tail(size() - 1) /= box.upper[0];
  box.upper.tail(size() - 1) /= box.upper[0];
  return box;
}

Vector ParametricPath::decision_scale(Index horizon) const {
  Vector scale = Trajectory::decision_scale(horizon);
  scale.tail(size() - 1) /= pace_of(params_.duration_s);
  return scale;
}

}  // namespace weft
