#include "session/planning_objective.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "session/instance_rows.hpp"
#include "session/jvp.hpp"
#include "session/shape_errors.hpp"

namespace weft {
namespace {

constexpr double kSquareMm = 1e6;  // m^2 to mm^2, so that losses are between 1 and 1e4
/// A fixed release: progress passes 1 by this much in segment u, and stays as far below it before. 0.05 deg of 180.
constexpr double kReleaseMargin = 0.05 / 180.0;
constexpr double kReleaseWeight = 1e7;  // mm^2 per progress^2: 1 deg too far counts as 17 mm

/// The penalty of hands that exceed their limits, mm^2 per squared residual: a speed 10 % too high in one whole segment
/// counts as 3 mm.
constexpr double kLimitWeight = 1e3;

constexpr double kCoverageWeight = 1e4;  // mm^2: one percent counts as 1 mm

/// d progress / d state by central differences. Progress is a smooth function of a handful of state variables, so
/// trajectory plugins need not write its gradient.
Vector progress_gradient(const Trajectory& trajectory, const Vector& state) {
  const auto variables = trajectory.state();
  Vector gradient(state.size());
  for (Index s = 0; s < state.size(); ++s) {
    const double step = 1e-4 * variables[s].scale;
    Vector up = state, down = state;
    up(s) += step;
    down(s) -= step;
    gradient(s) = (trajectory.progress(up) - trajectory.progress(down)) / (2.0 * step);
  }
  return gradient;
}

/// dL/d controls from dL/d state after every segment [k, S].
Controls states_pullback(const Task& task, ConstVec start, const Controls& controls, const Controls& d_states) {
  Controls gradient = Controls::Zero(controls.rows(), controls.cols());
  const auto add = [&](Index j, Vector& d_state) { d_state += d_states.row(j).transpose(); };
  task.trajectory->pullback_states(task.manipulation, start, controls, add, gradient);
  return gradient;
}

}  // namespace

PlanningObjective::PlanningObjective(const Task& task, const Predictor& predictor, const PlannerParams& params,
                                     const Vector& weights, const PlanRequest& request, Index horizon, Host* host)
    : task_(task),
      predictor_(predictor),
      params_(params),
      weights_(weights),
      request_(request),
      horizon_(horizon),
      moments_(params.loss == "expected" ? Moments::mean_and_sigma : Moments::mean),
      range_(predictor.control_range()),
      host_(host) {
  if (request.release < 0 || request.release > horizon)
    throw ShapeError("planning objective: release = " + std::to_string(request.release) + ", must be in [0, " +
                     std::to_string(horizon) + "]");
}

ObjectiveCapabilities PlanningObjective::capabilities() const {
  const Index controls = task_.trajectory->controls().size();
  if (params_.loss == "coverage") return {.gradients = false, .residuals = 0};
  const bool has_residuals = !request_.surface || request_.surface->kind() != GoalKind::silhouette;
  if (!has_residuals) return {.gradients = predictor_.capabilities().gradients, .residuals = 0};
  return {.gradients = predictor_.capabilities().gradients,
          .residuals = shape_rows() + (horizon_ - 1) * controls + horizon_ + (request_.release > 0 ? 2 : 0) +
                       (has_limits() ? 4 * horizon_ : 0)};
}

PlanningObjective::ShapeTerm PlanningObjective::shape_term(const Positions& mean, const Positions* sigma,
                                                           bool with_gradient) const {
  ShapeTerm term;
  if (params_.loss == "coverage") {
    const double missing = 1.0 - coverage(request_.offset ? Positions(mean + *request_.offset) : mean, *task_.garment);
    term.loss = kCoverageWeight * missing * missing;
    return term;
  }
  if (const auto& surface = request_.surface) {
    const Positions shape = request_.offset ? Positions(mean + *request_.offset) : mean;
    term.pairs = surface->pairs(shape);
    term.residuals = surface->residuals(term.pairs, shape);
    term.loss = 0.5 * term.residuals.squaredNorm();
    if (with_gradient) term.d_mean = surface->pullback(term.pairs, term.residuals);
    return term;
  }
  // Row v is weighted by the vertex's weight, both in the loss and in its gradient.
  const Positions difference = mean - *request_.goal;
  const Positions weighted = weights_.asDiagonal() * difference;
  const double weight = kSquareMm / static_cast<double>(difference.size());
  term.loss = weight * weighted.cwiseProduct(difference).sum();
  if (with_gradient) term.d_mean = 2.0 * weight * weighted;
  if (sigma == nullptr) return term;
  // E |x - s*|^2 = |mu - s*|^2 + sigma^2
  const Positions weighted_sigma = weights_.asDiagonal() * *sigma;
  term.sigma_loss = weight * weighted_sigma.cwiseProduct(*sigma).sum();
  if (with_gradient) term.d_sigma = 2.0 * weight * weighted_sigma;
  return term;
}

double PlanningObjective::loss_of(const Positions& shape, ConstVec x, Index u) const {
  const Decoded point = decoded(x);
  const double activity =
      activity_loss(task_, request_.state, point.limited.controls, u, params_.slowness_weight, nullptr);
  return shape_term(shape, nullptr, false).loss + params_.activity_weight * activity +
         0.5 * hand_residuals(point, nullptr).squaredNorm();
}

Evaluation PlanningObjective::evaluate(ConstMatrix x, const std::vector<Index>& instances,
                                       const EvaluationRequest& wanted) {
  require_shape("planning objective: x rows", x.rows(), dim());
  require_shape("planning objective: instances", instances.size(), x.cols());
  if (wanted.gradients && !capabilities().gradients)
    throw Unsupported("planning objective: the predictor has no gradients");
  const Index n = x.cols();
  std::vector<Decoded> points;
  std::vector<PredictionCase> cases;
  for (Index i = 0; i < n; ++i) {
    points.push_back(decoded(x.col(i)));
    cases.push_back(case_of(points.back().limited.controls));
  }
  const auto prediction = predict_in_rows(predictor_, cases, instances, params_.instances,
                                          {.moments = moments_,
                                           .gradients = wanted.gradients || uses_jvp(wanted),
                                           .control_gradients = true,
                                           .knowledge_gradients = false});
  evaluations_ += n;

  Evaluation result;
  result.costs.resize(n);
  std::vector<std::vector<ShapeCotangent>> cotangents(n);
  std::vector<Controls> d_controls(n);  // of all but the shape and the hands' limits
  std::vector<Controls> d_wanted(n);    // of the hands' limits; empty: 0
  std::vector<ShapeTerm> terms(n);
  const auto find_term = [&](Index i) {
    if (!prediction->failure(i).empty()) return;
    const auto& shape = prediction->shapes()[i].front();
    terms[i] = shape_term(shape.mean, moments_ == Moments::mean ? nullptr : &shape.sigma, wanted.gradients);
  };
  if (host_ && (request_.surface || params_.loss == "coverage")) {
    host_->parallel_for(n, find_term);
  } else {
    for (Index i = 0; i < n; ++i) find_term(i);
  }
  for (Index i = 0; i < n; ++i) {
    cotangents[i].resize(1);
    if (!prediction->failure(i).empty()) {
      result.costs(i) = std::numeric_limits<double>::infinity();
      continue;
    }
    const Index u = cases[i].segments.front();
    const double activity = activity_loss(task_, request_.state, cases[i].controls, u, params_.slowness_weight,
                                          wanted.gradients ? &d_controls[i] : nullptr);
    std::vector<Controls> d_release;
    const Vector release = release_residuals(cases[i].controls, wanted.gradients ? &d_release : nullptr);
    std::vector<Controls> d_hands;
    const Vector hands = hand_residuals(points[i], wanted.gradients ? &d_hands : nullptr);
    result.costs(i) = terms[i].loss + params_.activity_weight * activity + 0.5 * release.squaredNorm() +
                      terms[i].sigma_loss + 0.5 * hands.squaredNorm();
    if (!wanted.gradients) continue;
    d_controls[i] *= params_.activity_weight;
    for (Index k = 0; k < release.size(); ++k) d_controls[i] += release(k) * d_release[k];
    if (hands.size() > 0) d_wanted[i] = Controls::Zero(horizon_, d_controls[i].cols());
    for (Index k = 0; k < hands.size(); ++k)
      if (hands(k) > 0.0) d_wanted[i] += hands(k) * d_hands[k];
    cotangents[i].front().mean = std::move(terms[i].d_mean);
    if (moments_ != Moments::mean) cotangents[i].front().sigma = std::move(terms[i].d_sigma);
  }
  if (wanted.gradients) {
    const auto gradients = pullback(*prediction, cases, cotangents);
    result.gradients = Matrix::Zero(dim(), n);
    for (Index i = 0; i < n; ++i) {
      if (!std::isfinite(result.costs(i))) continue;
      Controls total = unlimited_gradient(points[i], gradients[i].controls + d_controls[i]);
      if (d_wanted[i].size() > 0) total += d_wanted[i];
      limit_gradient(x.col(i), total);
      result.gradients.col(i) = task_.trajectory->decode_pullback(x.col(i), horizon_, request_.state, total);
    }
  }
  if (wanted.residuals || wanted.jacobians)
    add_residuals(x, points, cases, *prediction, terms, wanted.jacobians, result);
  return result;
}

PredictionCase PlanningObjective::make_case(ConstVec x) const { return case_of(decode(x)); }

PredictionCase PlanningObjective::case_of(const Controls& controls) const {
  PredictionCase one{.shape = request_.shape, .previous = request_.previous, .state = request_.state};
  one.controls = controls;
  one.knowledge = request_.knowledge;
  one.segments = {request_.release > 0
                      ? request_.release
                      : task_.trajectory->release_segment(task_.manipulation, request_.state, one.controls)};
  return one;
}

Controls PlanningObjective::decode(ConstVec x) const { return decoded(x).limited.controls; }

bool PlanningObjective::keeps_limits(ConstVec x) const { return !has_limits() || decoded(x).limited.kept; }

PlanningObjective::Decoded PlanningObjective::decoded(ConstVec x) const {
  Decoded point;
  point.wanted = task_.trajectory->decode(x, horizon_, request_.state);
  if (range_) {
    for (Index j = 0; j < point.wanted.rows(); ++j)
      point.wanted.row(j) = range_->clamp(point.wanted.row(j).transpose()).transpose();
  }
  if (has_limits())
    point.limited = within_limits(task_, request_.state, request_.hand_step, point.wanted);
  else
    point.limited.controls = point.wanted;
  return point;
}

Controls PlanningObjective::unlimited_gradient(const Decoded& point, const Controls& gradient) const {
  if (!has_limits()) return gradient;
  Controls result = Controls::Zero(gradient.rows(), gradient.cols());
  for (Index j = 0; j < gradient.rows(); ++j)
    result.row(point.limited.rows[j]) += gradient.row(j) / static_cast<double>(point.limited.parts[j]);
  return result;
}

Vector PlanningObjective::hand_residuals(const Decoded& point, std::vector<Controls>* gradients) const {
  if (!has_limits()) return {};
  const Index u = task_.trajectory->release_segment(task_.manipulation, request_.state, point.wanted);
  const double root = std::sqrt(2.0 * kLimitWeight);
  Vector residuals = root * limit_residuals(task_, request_.state, request_.hand_step, point.wanted, u, gradients);
  if (gradients)
    for (auto& gradient : *gradients) gradient *= root;
  return residuals;
}

/// A clamped control gets no gradient outwards, but keeps one inwards.
void PlanningObjective::limit_gradient(ConstVec x, Controls& gradient) const {
  if (!range_) return;
  const Controls wanted = task_.trajectory->decode(x, horizon_, request_.state);
  for (Index j = 0; j < wanted.rows(); ++j) {
    for (Index c = 0; c < wanted.cols(); ++c) {
      const bool outwards = (wanted(j, c) < range_->lower(c) && gradient(j, c) > 0.0) ||
                            (wanted(j, c) > range_->upper(c) && gradient(j, c) < 0.0);
      if (outwards) gradient(j, c) = 0.0;
    }
  }
}

Vector PlanningObjective::release_residuals(const Controls& controls, std::vector<Controls>* gradients) const {
  const Index u = request_.release;
  if (u == 0) return {};
  const auto& trajectory = *task_.trajectory;
  const Controls states = trajectory.segment_states(task_.manipulation, request_.state, controls);
  const double root = std::sqrt(2.0 * kReleaseWeight);
  Vector residuals = Vector::Zero(2);
  if (gradients) gradients->assign(2, Controls::Zero(controls.rows(), controls.cols()));
  // Entry 0: not released after segment u - 1. Entry 1: released after segment u.
  for (Index k = u == 1 ? 1 : 0; k < 2; ++k) {
    const Index j = u - 2 + k;
    const Vector state = states.row(j).transpose();
    const double side = k == 0 ? 1.0 : -1.0;
    const double excess = side * (trajectory.progress(state) - 1.0) + kReleaseMargin;
    if (excess <= 0.0) continue;
    residuals(k) = root * excess;
    if (!gradients) continue;
    Controls d_states = Controls::Zero(controls.rows(), states.cols());
    d_states.row(j) = root * side * progress_gradient(trajectory, state).transpose();
    (*gradients)[k] = states_pullback(task_, request_.state, controls, d_states);
  }
  return residuals;
}

Vector PlanningObjective::shape_residuals(const Positions& mean, const Positions* sigma, const ShapeTerm& term,
                                          bool is_change) const {
  if (const auto& surface = request_.surface)
    return is_change ? surface->residual_change(term.pairs, mean) : term.residuals;
  const Index coordinates = mean.size();
  Vector weight(coordinates);
  for (Index k = 0; k < coordinates; ++k)
    weight(k) = std::sqrt(2.0 * kSquareMm * weights_(k / 3) / static_cast<double>(coordinates));
  const auto flat = [](const Positions& p) { return Eigen::Map<const Vector>(p.data(), p.size()); };
  Vector residuals(shape_rows());
  residuals.head(coordinates) = weight.cwiseProduct(flat(is_change ? mean : Positions(mean - *request_.goal)));
  if (moments_ != Moments::mean) residuals.tail(coordinates) = weight.cwiseProduct(flat(*sigma));
  return residuals;
}

/// d controls / dx up to the release segment u, row by row: [u C, D]. Later controls have no effect.
Matrix PlanningObjective::decoding(ConstVec x, const Decoded& point, Index u) const {
  const Index controls = point.wanted.cols();
  Matrix decode(u * controls, dim());
  Controls unit = Controls::Zero(horizon_, controls);
  const Controls uncut = task_.trajectory->decode(x, horizon_, request_.state);
  for (Index k = 0; k < decode.rows(); ++k) {
    const Index row = k / controls, column = k % controls;
    const Index of = has_limits() ? point.limited.rows[row] : row;
    if (uncut(of, column) != point.wanted(of, column)) {  // clamped: no effect
      decode.row(k).setZero();
      continue;
    }
    unit(of, column) = has_limits() ? 1.0 / static_cast<double>(point.limited.parts[row]) : 1.0;
    decode.row(k) = task_.trajectory->decode_pullback(x, horizon_, request_.state, unit).transpose();
    unit(of, column) = 0.0;
  }
  return decode;
}

/// Eq. 4 as 1/2 |r|^2. Jacobian and gradient hold the release segment u fixed.
void PlanningObjective::add_residuals(ConstMatrix x, const std::vector<Decoded>& points,
                                      const std::vector<PredictionCase>& cases, const Prediction& prediction,
                                      const std::vector<ShapeTerm>& terms, bool with_jacobians, Evaluation& result) {
  const Index rows = capabilities().residuals, columns = dim(), n = x.cols();
  const double activity_weight = std::sqrt(2.0 * params_.activity_weight);
  result.residuals = Matrix::Zero(rows, n);
  if (with_jacobians) result.jacobians.assign(n, Matrix::Zero(rows, columns));
  std::vector<std::vector<CaseDirection>> directions(n);
  std::vector<std::vector<Index>> variables(directions.size());  // of x, one per direction
  for (Index i = 0; i < n; ++i) {
    if (!std::isfinite(result.costs(i))) continue;
    const auto& one = cases[i];
    const Index u = one.segments.front();
    const auto& shape = prediction.shapes()[i].front();
    result.residuals.col(i).head(shape_rows()) = shape_residuals(shape.mean, &shape.sigma, terms[i], false);
    Matrix d_activity;
    const Vector activity = activity_residuals(task_, request_.state, one.controls, u, params_.slowness_weight,
                                               with_jacobians ? &d_activity : nullptr);
    std::vector<Controls> d_release;
    const Vector release = release_residuals(one.controls, with_jacobians ? &d_release : nullptr);
    result.residuals.col(i).segment(shape_rows(), activity.size()) = activity_weight * activity;
    const Index after_activity = shape_rows() + activity.size(), after_release = after_activity + release.size();
    result.residuals.col(i).segment(after_activity, release.size()) = release;
    std::vector<Controls> d_hands;
    const Vector hands = hand_residuals(points[i], with_jacobians ? &d_hands : nullptr);
    result.residuals.col(i).tail(hands.size()) = hands;
    if (!with_jacobians) continue;
    const Matrix decode = decoding(x.col(i), points[i], u);
    for (Index k = 0; k < hands.size(); ++k) {
      if (hands(k) > 0.0)
        result.jacobians[i].row(after_release + k) =
            task_.trajectory->decode_pullback(x.col(i), horizon_, request_.state, d_hands[k]).transpose();
    }
    result.jacobians[i].middleRows(shape_rows(), activity.size()) =
        activity_weight * d_activity.leftCols(decode.rows()) * decode;
    for (Index k = 0; k < release.size(); ++k) {
      const auto row = Eigen::Map<const Eigen::RowVectorXd>(d_release[k].data(), decode.rows());
      result.jacobians[i].row(after_activity + k) = row * decode;
    }
    for (Index k = 0; k < columns; ++k) {
      if (decode.col(k).isZero(0.0)) continue;
      CaseDirection direction;
      direction.controls = Controls::Zero(one.controls.rows(), one.controls.cols());
      Eigen::Map<Vector>(direction.controls.data(), decode.rows()) = decode.col(k);
      directions[i].push_back(std::move(direction));
      variables[i].push_back(k);
    }
  }
  if (!with_jacobians) return;
  const auto derivatives = jvp(predictor_, prediction, cases, directions, *task_.trajectory, moments_,
                               {.step = params_.difference_step}, &evaluations_);
  for (std::size_t i = 0; i < variables.size(); ++i) {
    for (std::size_t k = 0; k < variables[i].size(); ++k) {
      const auto& change = derivatives[i][k].front();
      result.jacobians[i].col(variables[i][k]).head(shape_rows()) =
          shape_residuals(change.mean, &change.sigma, terms[i], true);
    }
  }
}

Vector activity_residuals(const Task& task, ConstVec state, const Controls& controls, Index u, double slowness_weight,
                          Matrix* jacobian) {
  const auto& trajectory = *task.trajectory;
  const auto variables = trajectory.controls();
  const Index horizon = controls.rows(), columns = controls.cols();
  const Controls states = trajectory.segment_states(task.manipulation, state, controls);
  Vector residuals = Vector::Zero((horizon - 1) * columns + horizon);
  if (jacobian) *jacobian = Matrix::Zero(residuals.size(), controls.size());
  const double root = std::sqrt(1.0 / static_cast<double>(u));
  for (Index j = 0; j + 1 < u; ++j) {
    for (Index c = 0; c < columns; ++c) {
      const double factor = root / variables[c].scale;
      const Index row = j * columns + c;
      residuals(row) = factor * (controls(j + 1, c) - controls(j, c));
      if (jacobian) {
        (*jacobian)(row, row + columns) = factor;
        (*jacobian)(row, row) = -factor;
      }
    }
  }
  const double pace = std::max(1e-9, 1.0 - trajectory.progress(state)) / static_cast<double>(horizon);
  const double slow_root = root * std::sqrt(slowness_weight);
  for (Index j = 0; j < u; ++j) {
    const Vector after = states.row(j).transpose();
    const Vector before = j == 0 ? Vector(state) : Vector(states.row(j - 1).transpose());
    const double slowness = 1.0 - (trajectory.progress(after) - trajectory.progress(before)) / pace;
    if (slowness <= 0.0) continue;
    const Index row = (horizon - 1) * columns + j;
    residuals(row) = slow_root * slowness;
    if (jacobian) {
      Controls d_states = Controls::Zero(horizon, states.cols());
      d_states.row(j) = -slow_root / pace * progress_gradient(trajectory, after).transpose();
      if (j > 0) d_states.row(j - 1) = slow_root / pace * progress_gradient(trajectory, before).transpose();
      const Controls gradient = states_pullback(task, state, controls, d_states);
      jacobian->row(row) = Eigen::Map<const Eigen::RowVectorXd>(gradient.data(), gradient.size());
    }
  }
  return residuals;
}

double activity_loss(const Task& task, ConstVec state, const Controls& controls, Index u, double slowness_weight,
                     Controls* gradient) {
  const auto& trajectory = *task.trajectory;
  const auto variables = trajectory.controls();
  const Index horizon = controls.rows();
  const Controls states = trajectory.segment_states(task.manipulation, state, controls);
  Controls d_states = Controls::Zero(horizon, states.cols());
  if (gradient) *gradient = Controls::Zero(horizon, controls.cols());
  double loss = 0.0;
  const double per_segment = 1.0 / static_cast<double>(u);
  for (Index j = 0; j + 1 < u; ++j) {
    for (Index c = 0; c < controls.cols(); ++c) {
      const double scale = variables[c].scale;
      const double jump = (controls(j + 1, c) - controls(j, c)) / scale;
      loss += per_segment * jump * jump;
      if (gradient) {
        (*gradient)(j + 1, c) += 2.0 * per_segment * jump / scale;
        (*gradient)(j, c) -= 2.0 * per_segment * jump / scale;
      }
    }
  }
  // A segment is slow if its pace is below the remaining progress divided by b segments.
  const double remaining = std::max(1e-9, 1.0 - trajectory.progress(state));
  const double pace = remaining / static_cast<double>(horizon);
  for (Index j = 0; j < u; ++j) {
    const Vector after = states.row(j).transpose();
    const Vector before = j == 0 ? Vector(state) : Vector(states.row(j - 1).transpose());
    const double slowness = 1.0 - (trajectory.progress(after) - trajectory.progress(before)) / pace;
    if (slowness <= 0.0) continue;
    loss += per_segment * slowness_weight * slowness * slowness;
    if (gradient) {
      const double d_progress = -2.0 * per_segment * slowness_weight * slowness / pace;
      d_states.row(j) += d_progress * progress_gradient(trajectory, after).transpose();
      if (j > 0) d_states.row(j - 1) -= d_progress * progress_gradient(trajectory, before).transpose();
    }
  }
  if (gradient && !d_states.isZero(0.0)) *gradient += states_pullback(task, state, controls, d_states);
  return loss;
}

}  // namespace weft
