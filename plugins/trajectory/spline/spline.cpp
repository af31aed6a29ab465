#include "spline.hpp"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

namespace weft::spline {
namespace {

// Weight in encode() of a segment that starts after release, where the cloth lies already: enough to settle what
// nothing else does.
constexpr double kReleasedWeight = 1e-3;

// Fewer than this of progress left: the whole plan sits at the spline's start.
constexpr double kLeastProgressLeft = 1e-9;

/// d progress / d state by central differences with a step as large as the state's scale: exact where progress is
/// linear.
Vector progress_gradient(const Trajectory& trajectory, const Vector& state) {
  const auto variables = trajectory.state();
  Vector gradient(state.size());
  for (Index s = 0; s < state.size(); ++s) {
    const double step = 1e-4 * variables[static_cast<std::size_t>(s)].scale;
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
      columns_(static_cast<Index>(geometry_->controls().size())),
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
    const double t =
        by_progress_ ? parameter_of_progress(geometry_->progress(current), first)
                     : static_cast<double>((points_ - 3) * j) / static_cast<double>(std::max<Index>(1, horizon - 1));
    const Place p = place(t);
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
  const double first = geometry_->progress(state), left = 1.0 - first;

  // States before every frame.
  std::vector<Vector> states;
  if (by_progress_) {
    states.push_back(state);
    for (Index j = 0; j + 1 < horizon; ++j)
      for (Index frame = 0; frame < kFramesPerSegment; ++frame)
        states.push_back(geometry_->advance(none, states.back(), controls.row(j).transpose()));
  }
  Controls gradient = Controls::Zero(points_, columns_);
  Vector d_next = Vector::Zero(state.size());  // dL/d state after segment j
  Vector d_state, d_control;
  for (Index j = horizon - 1; j >= 0; --j) {
    Vector d_row = d_controls.row(j).transpose();
    if (by_progress_ && j + 1 < horizon) {
      for (Index frame = kFramesPerSegment - 1; frame >= 0; --frame) {
        const Vector& before = states[static_cast<std::size_t>(j * kFramesPerSegment + frame)];
        geometry_->advance_pullback(none, before, controls.row(j).transpose(), d_next, d_state, d_control);
        d_row += d_control;
        d_next = d_state;
      }
    }
    double t = static_cast<double>((points_ - 3) * j) / static_cast<double>(std::max<Index>(1, horizon - 1));
    double progress = first;
    if (by_progress_) {
      progress = geometry_->progress(states[static_cast<std::size_t>(j * kFramesPerSegment)]);
      t = parameter_of_progress(progress, first);
    }
    const Place p = place(t);
    for (Index i = 0; i < 4; ++i) gradient.row(p.first + i) += p.weight[i] * d_row.transpose();
    // The start of the first segment does not depend on x; beyond release nothing depends on the progress.
    if (by_progress_ && j > 0 && left >= kLeastProgressLeft && progress > first && progress < 1.0) {
      double d_t = 0.0;
      for (Index i = 0; i < 4; ++i) d_t += p.slope[i] * points.row(p.first + i).dot(d_row.transpose());
      const Vector& start = states[static_cast<std::size_t>(j * kFramesPerSegment)];
      d_next += d_t * static_cast<double>(points_ - 3) / left * progress_gradient(*geometry_, start);
    }
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
    const double t =
        by_progress_ ? parameter_of_progress(progress, first)
                     : static_cast<double>((points_ - 3) * j) / static_cast<double>(std::max<Index>(1, horizon - 1));
    if (j > 0 && progress >= 1.0) weights[j] = kReleasedWeight;
    const Place p = place(t);
    for (Index i = 0; i < 4; ++i) basis(j, p.first + i) = p.weight[i];
    current = after(current, controls.row(j).transpose());
  }
  Controls points = Controls::Zero(points_, columns_);
  if (horizon > 0) {
    // The weights of a segment sum to 1, so a constant is fitted exactly: fit what differs from the (weighted) mean.
    const Eigen::RowVectorXd mean = weights.transpose() * controls / weights.sum();
    const Matrix rest = weights.asDiagonal() * (controls.rowwise() - mean);
    points = (weights.asDiagonal() * basis).completeOrthogonalDecomposition().solve(rest);
    points.rowwise() += mean;
  }
  return Eigen::Map<const Vector>(points.data(), points.size());
}

Box Spline::decision_bounds(Index horizon) const {
  Box box{Vector(decision_size(horizon)), Vector(decision_size(horizon))};
  const auto variables = controls();
  for (Index i = 0; i < box.lower.size(); ++i) {
    box.lower[i] = variables[static_cast<std::size_t>(i % columns_)].lower;
    box.upper[i] = variables[static_cast<std::size_t>(i % columns_)].upper;
  }
  return box;
}

Vector Spline::decision_scale(Index horizon) const {
  Vector scale(decision_size(horizon));
  const auto variables = controls();
  for (Index i = 0; i < scale.size(); ++i) scale[i] = variables[static_cast<std::size_t>(i % columns_)].scale;
  return scale;
}

}  // namespace weft::spline
