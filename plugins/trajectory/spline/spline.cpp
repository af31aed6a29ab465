#include "spline.hpp"

#include <algorithm>
#include <cmath>

#include "least_squares.hpp"

namespace weft::spline {
namespace {

// Weight in encode() of a segment that starts after release, when the cloth lies already. It only settles what no other
// segment settles.
constexpr double kReleasedWeight = 1e-3;

// With less progress left than this, the whole plan sits at the spline's start.
constexpr double kLeastProgressLeft = 1e-9;

/// d progress / d state by central differences with a step as large as the state's scale: exact where progress is
/// linear.
Vector progress_gradient(const Trajectory& trajectory, const Vector& state) {
  const auto variables = trajectory.state();
  Vector gradient(state.size());
  for (Index s = 0; s < state.size(); ++s) {
    const double step = 1e-4 * variables[s].scale;
    Vector up = state, down = state;
    up[s] += step;
    down[s] -= step;
    gradient[s] = (trajectory.progress(up) - trajectory.progress(down)) / (up[s] - down[s]);
  }
  return gradient;
}

}  // namespace

/// Where a parameter falls: the first of four control points, their weights and the weights' derivatives.
struct Spline::Place {
  Index first = 0;
  double weight[4], slope[4];
};

Spline::Spline(const Params& params, Host& host)
    : geometry_(host.create<Trajectory>(params.geometry)),
      points_(params.control_points),
      columns_(geometry_->controls().size()),
      by_progress_(params.over == "progress") {}

Spline::Place Spline::place(double t) const {
  const double spans = static_cast<double>(points_ - 3);
  const double inside = std::clamp(t, 0.0, spans);
  Place p;
  p.first = std::min(static_cast<Index>(inside), points_ - 4);
  const double s = inside - static_cast<double>(p.first), r = 1.0 - s;
  p.weight[0] = r * r * r / 6.0;
  p.weight[1] = (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0;
  p.weight[2] = (-3.0 * s * s * s + 3.0 * s * s + 3.0 * s + 1.0) / 6.0;
  p.weight[3] = s * s * s / 6.0;
  p.slope[0] = -0.5 * r * r;
  p.slope[1] = 1.5 * s * s - 2.0 * s;
  p.slope[2] = -1.5 * s * s + s + 0.5;
  p.slope[3] = 0.5 * s * s;
  return p;
}

Vector Spline::after(ConstVec state, ConstVec control) const {
  static const Manipulation none;
  Vector next = state;
  for (Index frame = 0; frame < kFramesPerSegment; ++frame) next = geometry_->advance(none, next, control);
  return next;
}

double Spline::parameter_of_progress(double progress, double first) const {
  const double left = 1.0 - first;
  if (left < kLeastProgressLeft) return 0.0;
  return static_cast<double>(points_ - 3) * std::clamp((progress - first) / left, 0.0, 1.0);
}

double Spline::parameter(Index j, Index horizon, double progress, double first) const {
  if (by_progress_) return parameter_of_progress(progress, first);
  return static_cast<double>((points_ - 3) * j) / static_cast<double>(std::max<Index>(1, horizon - 1));
}

Index Spline::decision_size(Index horizon) const {
  if (horizon < 0) throw ShapeError("spline: horizon = " + std::to_string(horizon) + ", must be >= 0");
  return points_ * columns_;
}

Controls Spline::decode(ConstVec x, Index horizon, ConstVec state) const {
  require_shape("spline: x", x.size(), decision_size(horizon));
  const Eigen::Map<const Controls> points(x.data(), points_, columns_);
  Controls result(horizon, columns_);
  const double first = geometry_->progress(state);
  Vector current = state;
  for (Index j = 0; j < horizon; ++j) {
    const Place p = place(parameter(j, horizon, geometry_->progress(current), first));
    result.row(j).setZero();
    for (Index i = 0; i < 4; ++i) result.row(j) += p.weight[i] * points.row(p.first + i);
    if (by_progress_ && j + 1 < horizon) current = after(current, result.row(j).transpose());
  }
  return result;
}

Vector Spline::decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const {
  require_shape("spline: x", x.size(), decision_size(horizon));
  require_shape("spline: d_controls rows", d_controls.rows(), horizon);
  require_shape("spline: d_controls columns", d_controls.cols(), columns_);
  const Eigen::Map<const Controls> points(x.data(), points_, columns_);
  static const Manipulation none;
  const Controls controls = decode(x, horizon, state);
  const Controls states = geometry_->segment_states(none, state, controls);
  const double first = geometry_->progress(state), left = 1.0 - first;
  const auto progress_before = [&](Index j) {
    return j == 0 ? first : geometry_->progress(states.row(j - 1).transpose());
  };

  // dL/d controls of a segment, directly and through the spline parameters of the later segments.
  Controls d_rows = d_controls;
  const auto add_place = [&](Index j, Vector& d_state) {
    const Index next = j + 1;
    if (next == horizon || left < kLeastProgressLeft) return;
    const double progress = progress_before(next);
    if (progress <= first || progress >= 1.0) return;  // beyond release nothing depends on the progress
    const Place p = place(parameter(next, horizon, progress, first));
    const Vector d_row = d_rows.row(next).transpose();
    double d_t = 0.0;
    for (Index i = 0; i < 4; ++i) d_t += p.slope[i] * points.row(p.first + i).dot(d_row.transpose());
    d_state += d_t * static_cast<double>(points_ - 3) / left * progress_gradient(*geometry_, states.row(j).transpose());
  };
  if (by_progress_) geometry_->pullback_states(none, state, controls, add_place, d_rows);

  Controls gradient = Controls::Zero(points_, columns_);
  for (Index j = horizon - 1; j >= 0; --j) {
    const Place p = place(parameter(j, horizon, progress_before(j), first));
    for (Index i = 0; i < 4; ++i) gradient.row(p.first + i) += p.weight[i] * d_rows.row(j);
  }
  return Eigen::Map<const Vector>(gradient.data(), gradient.size());
}

Vector Spline::encode(const Controls& controls, ConstVec state) const {
  require_shape("spline: controls columns", controls.cols(), columns_);
  const Index horizon = controls.rows();
  Matrix basis = Matrix::Zero(horizon, points_);
  Vector weights = Vector::Ones(horizon);
  const double first = geometry_->progress(state);
  Vector current = state;
  for (Index j = 0; j < horizon; ++j) {
    const double progress = geometry_->progress(current);
    if (j > 0 && progress >= 1.0) weights[j] = kReleasedWeight;
    const Place p = place(parameter(j, horizon, progress, first));
    for (Index i = 0; i < 4; ++i) basis(j, p.first + i) = p.weight[i];
    current = after(current, controls.row(j).transpose());
  }
  const Controls points =
      horizon > 0 ? fit_control_points(basis, weights, controls) : Controls(Controls::Zero(points_, columns_));
  return Eigen::Map<const Vector>(points.data(), points.size());
}

}  // namespace weft::spline
