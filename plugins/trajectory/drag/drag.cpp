#include "drag.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>

namespace weft::drag {
namespace {

constexpr Index kSize = 6;  // of state, control and decision vector
enum : Index { kProgress, kHeight, kArrival, kOvershoot, kLength, kHeading };
using Gradient = Eigen::Matrix<double, kSize, 1>;
constexpr double kRadians = std::numbers::pi / 180.0;

constexpr double kOverlap = 0.1;    // the move starts this much before the end of the lift
constexpr double kLowering = 0.15;  // the hands go down so much before and after the end of the move
// Weight in encode() of a segment that starts after release, when the cloth lies already.
constexpr double kReleasedWeight = 1e-3;

/// Progress per frame at a duration. Rounding must not cost another segment, so it is larger by a billionth.
double pace(double duration_s) { return (1.0 + 1e-9) * kFrameSeconds / duration_s; }

/// A step from 0 to 1 over a window of s, and the step over s, which is what a sum of controls is multiplied by.
struct Move {
  /// u^3 (10 - 15 u + 6 u^2), u = (s - from) / (to - from) in [0, 1]: the move of the least squared jerk
  /// [Flash & Hogan 1985]. Velocity and acceleration vanish at both ends. @param from >= 0.
  Move(double s, double from, double to) {
    if (s <= from) return;
    const double u = std::min(1.0, (s - from) / (to - from)), rest = 1.0 - u;
    step = u * u * u * (10.0 + u * (6.0 * u - 15.0));
    slope = 30.0 * u * u * rest * rest / (to - from);
    mean = step / s;
    mean_slope = (slope - mean) / s;
  }
  double step = 0.0, slope = 0.0;       // and its derivative
  double mean = 0.0, mean_slope = 0.0;  // step / s and its derivative
};

void check(const Trajectory& trajectory, const Manipulation& m) {
  check_manipulation("drag", trajectory, m);
  if (!(m.displacement.norm() > 0.0))
    throw ConfigError("drag: |d| = 0 (displacement of the grasp points), must be above 0: d is the direction");
}

Vec2 turned(const Vec2& v, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * v.x() - s * v.y(), s * v.x() + c * v.y()};
}
Vec2 quarter(const Vec2& v) { return {-v.y(), v.x()}; }  // z x v
Vec2 midpoint(const Manipulation& m) { return m.grasp_points.leftCols<2>().colwise().mean().transpose(); }

}  // namespace

/// Where the hands are, in the frame of d, and the gradients with respect to the state.
struct Drag::Pose {
  double along = 0.0, rise = 0.0, turn = 0.0;  // m, m, rad
  Gradient d_along = Gradient::Zero(), d_rise = Gradient::Zero(), d_turn = Gradient::Zero();
};

Drag::Drag(const Params& params) : p_(params) {
  if (p_.duration_min_s <= p_.duration_s && p_.duration_s <= p_.duration_max_s) return;
  std::ostringstream text;
  text << "drag: duration_s = " << p_.duration_s << " s, must be in [duration_min_s, duration_max_s] = ["
       << p_.duration_min_s << ", " << p_.duration_max_s << "]";
  throw ConfigError(text.str());
}

std::vector<Variable> Drag::controls() const {
  const double usual = pace(p_.duration_s), fastest = pace(p_.duration_min_s);
  const auto shape = [&](const char* name, const char* unit, double change) {
    return Variable{
        name, unit, -fastest * change, fastest * change, 0.0, usual * p_.shape_scale * std::max(change, 1e-6)};
  };
  return {{"ds", "1/frame", pace(p_.duration_max_s), fastest, usual, usual * p_.pace_scale},
          shape("dheight", "m/frame", p_.height_change_m),
          shape("darrival_height", "m/frame", p_.arrival_height_change_m),
          shape("dovershoot", "m/frame", p_.overshoot_change_m),
          shape("dlength", "m/frame", p_.length_change_m),
          shape("dheading", "deg/frame", p_.heading_change_deg)};
}

std::vector<Variable> Drag::state() const {
  // These bounds cover a workspace of 10 m, ten turns and a hundred paths.
  return {{"s", "1", 0.0, 100.0, 0.0, 0.1},
          {"height", "m", -10.0, 10.0, 0.0, 0.1},
          {"arrival_height", "m", -10.0, 10.0, 0.0, 0.1},
          {"overshoot", "m", -10.0, 10.0, 0.0, 0.1},
          {"length", "m", -10.0, 10.0, 0.0, 0.1},
          {"heading", "deg", -3600.0, 3600.0, 0.0, 10.0}};
}

Vector Drag::initial_state(const Manipulation& m) const {
  check(*this, m);
  return Vector::Zero(kSize);
}

double Drag::progress(ConstVec state) const {
  check_state("drag", *this, state);
  return state[kProgress];
}

Drag::Pose Drag::pose(const Manipulation& m, ConstVec state) const {
  const double s = state[kProgress];
  const Move lift(s, 0.0, p_.lift_end), move(s, p_.lift_end - kOverlap, p_.move_end);
  const Move lower(s, p_.move_end - kLowering, p_.move_end + kLowering), back(s, p_.move_end, 1.0);
  const double length = m.displacement.norm();
  const double height = state[kHeight], arrival = state[kArrival], overshoot = state[kOvershoot];

  Pose q;
  q.along = (length + p_.overshoot_m) * move.step - p_.overshoot_m * back.step +
            (state[kLength] + overshoot) * move.mean - overshoot * back.mean;
  q.d_along[kProgress] = (length + p_.overshoot_m) * move.slope - p_.overshoot_m * back.slope +
                         (state[kLength] + overshoot) * move.mean_slope - overshoot * back.mean_slope;
  q.d_along[kOvershoot] = move.mean - back.mean;
  q.d_along[kLength] = move.mean;

  const double fall = p_.arrival_height_m - p_.height_m, down = m.drop_height - p_.arrival_height_m;
  q.rise = p_.height_m * lift.step + fall * move.step + down * lower.step + height * (lift.mean - move.mean) +
           arrival * (move.mean - lower.mean);
  q.d_rise[kProgress] = p_.height_m * lift.slope + fall * move.slope + down * lower.slope +
                        height * (lift.mean_slope - move.mean_slope) + arrival * (move.mean_slope - lower.mean_slope);
  q.d_rise[kHeight] = lift.mean - move.mean;
  q.d_rise[kArrival] = move.mean - lower.mean;

  q.turn = kRadians * state[kHeading] * move.mean;
  q.d_turn[kProgress] = kRadians * state[kHeading] * move.mean_slope;
  q.d_turn[kHeading] = kRadians * move.mean;
  return q;
}

Positions Drag::targets(const Manipulation& m, ConstVec state) const {
  check_state("drag", *this, state);
  check(*this, m);
  const Pose q = pose(m, state);
  const Vec2 centre = midpoint(m), d = m.displacement.normalized();
  Positions g(hands(), 3);
  for (Index i = 0; i < g.rows(); ++i) {
    const Vec2 offset = m.grasp_points.row(i).head<2>().transpose() - centre;
    g.row(i).head<2>() = (centre + turned(q.along * d + offset, q.turn)).transpose();
    g(i, 2) = std::max(m.grasp_points(i, 2) + q.rise, m.contact_height);
  }
  return g;
}

Vector Drag::targets_pullback(const Manipulation& m, ConstVec state, const Positions& d_targets) const {
  check_state("drag", *this, state);
  require_shape("drag: d_targets rows", d_targets.rows(), hands());
  check(*this, m);
  const Pose q = pose(m, state);
  const Vec2 centre = midpoint(m), d = m.displacement.normalized();
  Gradient out = Gradient::Zero();
  for (Index i = 0; i < d_targets.rows(); ++i) {
    const Vec2 offset = m.grasp_points.row(i).head<2>().transpose() - centre;
    // In the frame that turns with the hands.
    const Vec2 w = turned(d_targets.row(i).head<2>().transpose(), -q.turn);
    const double wz = m.grasp_points(i, 2) + q.rise >= m.contact_height ? d_targets(i, 2) : 0.0;
    out += d.dot(w) * q.d_along + quarter(q.along * d + offset).dot(w) * q.d_turn + wz * q.d_rise;
  }
  return out;
}

Index Drag::decision_size(Index horizon) const {
  if (horizon < 0) throw ShapeError("drag: horizon = " + std::to_string(horizon) + ", must be >= 0");
  return kSize;
}

Controls Drag::decode(ConstVec x, Index horizon, ConstVec state) const {
  require_shape("drag: x", x.size(), decision_size(horizon));
  check_state("drag", *this, state);
  Vector row = x[0] * x;
  row[0] = x[0];
  return row.transpose().replicate(horizon, 1);
}

Vector Drag::decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const {
  require_shape("drag: x", x.size(), decision_size(horizon));
  check_state("drag", *this, state);
  require_shape("drag: d_controls rows", d_controls.rows(), horizon);
  require_shape("drag: d_controls columns", d_controls.cols(), kSize);
  const Vector sums = d_controls.colwise().sum().transpose();
  Vector gradient = x[0] * sums;
  gradient[0] = sums[0] + x.tail(kSize - 1).dot(sums.tail(kSize - 1));
  return gradient;
}

Vector Drag::encode(const Controls& controls, ConstVec state) const {
  require_shape("drag: controls columns", controls.cols(), kSize);
  check_state("drag", *this, state);
  Vector sum = Vector::Zero(kSize);
  double weights = 0.0, s = state[kProgress];
  for (Index j = 0; j < controls.rows(); ++j) {
    const double weight = j > 0 && s >= 1.0 ? kReleasedWeight : 1.0;
    sum += weight * controls.row(j).transpose();
    weights += weight;
    s += static_cast<double>(kFramesPerSegment) * controls(j, 0);
  }
  Vector x = Vector::Zero(kSize);
  if (sum[0] > 0.0) x = sum / sum[0];
  x[0] = weights > 0.0 ? sum[0] / weights : pace(p_.duration_s);
  return x;
}

Box Drag::decision_bounds(Index horizon) const {
  Box box = Trajectory::decision_bounds(horizon);
  box.lower.tail(kSize - 1) /= box.upper[0];
  box.upper.tail(kSize - 1) /= box.upper[0];
  return box;
}

Vector Drag::decision_scale(Index horizon) const {
  Vector scale = Trajectory::decision_scale(horizon);
  scale.tail(kSize - 1) /= pace(p_.duration_s);
  return scale;
}

}  // namespace weft::drag
