#include "session/planner.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "loader/where.hpp"
#include "session/instance_rows.hpp"
#include "session/jvp.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

constexpr double kSquareMm = 1e6;  // m^2 to mm^2, so that losses are between 1 and 1e4

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

/// Eq. 4 on a batch of decision vectors.
class PlanningObjective final : public Objective {
 public:
  PlanningObjective(const Task& task, const Predictor& predictor, const PlannerParams& params, const Vector& weights,
                    const PlanRequest& request, Index horizon)
      : task_(task),
        predictor_(predictor),
        params_(params),
        weights_(weights),
        request_(request),
        horizon_(horizon),
        moments_(params.loss == "expected" ? Moments::mean_and_sigma : Moments::mean),
        range_(predictor.control_range()) {}

  Index dim() const override { return task_.trajectory->decision_size(horizon_); }
  /// Residuals: 3 V of the shape, with `loss: expected` also 3 V of sigma, then those of the activity loss.
  /// Cost = 1/2 |r|^2 up to rounding.
  ObjectiveCapabilities capabilities() const override {
    const Index controls = task_.trajectory->controls().size();
    return {.gradients = predictor_.capabilities().gradients,
            .residuals = shape_rows() + (horizon_ - 1) * controls + horizon_};
  }

  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& wanted) override {
    require_shape("planning objective: x rows", x.rows(), dim());
    require_shape("planning objective: instances", instances.size(), x.cols());
    if (wanted.gradients && !capabilities().gradients)
      throw Unsupported("planning objective: the predictor has no gradients");
    const Index n = x.cols();
    std::vector<PredictionCase> cases;
    for (Index i = 0; i < n; ++i) cases.push_back(make_case(x.col(i)));
    const auto prediction = predict_in_rows(predictor_, cases, instances, params_.instances,
                                            {.moments = moments_,
                                             .gradients = wanted.gradients || uses_jvp(wanted),
                                             .control_gradients = true,
                                             .knowledge_gradients = false});
    evaluations_ += n;

    Evaluation result;
    result.costs.resize(n);
    std::vector<std::vector<ShapeCotangent>> cotangents(n);
    std::vector<Controls> d_activity(n);
    for (Index i = 0; i < n; ++i) {
      cotangents[i].resize(1);
      if (!prediction->failure(i).empty()) {
        result.costs(i) = std::numeric_limits<double>::infinity();
        continue;
      }
      // Row v is weighted by the vertex's weight, both in the loss and in its gradient.
      const auto& shape = prediction->shapes()[i].front();
      const Positions difference = shape.mean - *request_.goal;
      const Positions weighted = weights_.asDiagonal() * difference;
      const double weight = kSquareMm / static_cast<double>(difference.size());
      const Index u = cases[i].segments.front();
      const double activity = activity_loss(task_, request_.state, cases[i].controls, u, params_.slowness_weight,
                                            wanted.gradients ? &d_activity[i] : nullptr);
      result.costs(i) = weight * weighted.cwiseProduct(difference).sum() + params_.activity_weight * activity;
      if (wanted.gradients) cotangents[i].front().mean = 2.0 * weight * weighted;
      if (moments_ == Moments::mean) continue;
      // E |x - s*|^2 = |mu - s*|^2 + sigma^2
      const Positions weighted_sigma = weights_.asDiagonal() * shape.sigma;
      result.costs(i) += weight * weighted_sigma.cwiseProduct(shape.sigma).sum();
      if (wanted.gradients) cotangents[i].front().sigma = 2.0 * weight * weighted_sigma;
    }
    if (wanted.gradients) {
      const auto gradients = prediction->pullback(cotangents);
      result.gradients = Matrix::Zero(dim(), n);
      for (Index i = 0; i < n; ++i) {
        if (!std::isfinite(result.costs(i))) continue;
        Controls total = gradients[i].controls + params_.activity_weight * d_activity[i];
        limit_gradient(x.col(i), total);
        result.gradients.col(i) = task_.trajectory->decode_pullback(x.col(i), horizon_, request_.state, total);
      }
    }
    if (wanted.residuals || wanted.jacobians) add_residuals(x, cases, *prediction, wanted.jacobians, result);
    return result;
  }

  /// The case of one decision vector. It requests only the shape after the release segment u (eq. 5).
  PredictionCase make_case(ConstVec x) const {
    PredictionCase one{.shape = request_.shape, .previous = request_.previous, .state = request_.state};
    one.controls = decode(x);
    one.knowledge = request_.knowledge;
    one.segments = {task_.trajectory->release_segment(task_.manipulation, request_.state, one.controls)};
    return one;
  }
  /// Controls of a decision vector, clamped to the predictor's control range.
  Controls decode(ConstVec x) const {
    Controls controls = task_.trajectory->decode(x, horizon_, request_.state);
    if (range_) {
      for (Index j = 0; j < controls.rows(); ++j)
        controls.row(j) = range_->clamp(controls.row(j).transpose()).transpose();
    }
    return controls;
  }
  Index evaluations() const { return evaluations_; }

 private:
  /// A clamped control gets no gradient outwards, but keeps one inwards.
  void limit_gradient(ConstVec x, Controls& gradient) const {
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
  Index shape_rows() const { return (moments_ == Moments::mean ? 1 : 2) * request_.goal->size(); }
  bool uses_jvp(const EvaluationRequest& wanted) const { return wanted.jacobians && predictor_.capabilities().jvp; }

  /// Eq. 4 as 1/2 |r|^2. Jacobian and gradient hold the release segment u fixed.
  void add_residuals(ConstMatrix x, const std::vector<PredictionCase>& cases, const Prediction& prediction,
                     bool with_jacobians, Evaluation& result) {
    const Index rows = capabilities().residuals, columns = dim(), n = x.cols();
    const Index coordinates = request_.goal->size();
    Vector shape_weight(coordinates);
    for (Index k = 0; k < coordinates; ++k)
      shape_weight(k) = std::sqrt(2.0 * kSquareMm * weights_(k / 3) / static_cast<double>(coordinates));
    const auto flat = [](const Positions& p) { return Eigen::Map<const Vector>(p.data(), p.size()); };
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
      const Positions difference = shape.mean - *request_.goal;
      result.residuals.col(i).head(coordinates) = shape_weight.cwiseProduct(flat(difference));
      if (moments_ != Moments::mean)
        result.residuals.col(i).segment(coordinates, coordinates) = shape_weight.cwiseProduct(flat(shape.sigma));
      Matrix d_activity;
      const Vector activity = activity_residuals(task_, request_.state, one.controls, u, params_.slowness_weight,
                                                 with_jacobians ? &d_activity : nullptr);
      result.residuals.col(i).tail(activity.size()) = activity_weight * activity;
      if (!with_jacobians) continue;
      // d controls / dx up to u, row by row. Later controls have no effect.
      const Index controls = one.controls.cols();
      Matrix decode(u * controls, columns);
      Controls unit = Controls::Zero(one.controls.rows(), controls);
      const Controls uncut = task_.trajectory->decode(x.col(i), horizon_, request_.state);
      for (Index k = 0; k < decode.rows(); ++k) {
        if (uncut.data()[k] != one.controls.data()[k]) {  // clamped: no effect
          decode.row(k).setZero();
          continue;
        }
        unit.data()[k] = 1.0;
        decode.row(k) = task_.trajectory->decode_pullback(x.col(i), horizon_, request_.state, unit).transpose();
        unit.data()[k] = 0.0;
      }
      result.jacobians[i].bottomRows(activity.size()) = activity_weight * d_activity.leftCols(decode.rows()) * decode;
      for (Index k = 0; k < columns; ++k) {
        if (decode.col(k).isZero(0.0)) continue;
        CaseDirection direction;
        direction.controls = Controls::Zero(one.controls.rows(), controls);
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
        auto column = result.jacobians[i].col(variables[i][k]);
        column.head(coordinates) = shape_weight.cwiseProduct(flat(change.mean));
        if (moments_ != Moments::mean)
          column.segment(coordinates, coordinates) = shape_weight.cwiseProduct(flat(change.sigma));
      }
    }
  }

  const Task& task_;
  const Predictor& predictor_;
  const PlannerParams& params_;
  const Vector& weights_;
  const PlanRequest& request_;
  Index horizon_;
  Moments moments_;
  std::optional<Box> range_;  // [C]
  Index evaluations_ = 0;
};

}  // namespace

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

Vector vertex_weights(const PlannerParams& params, Index vertices, const ConfigNode& origin) {
  if (params.vertices.empty() && params.vertex_weights.empty()) return Vector::Ones(vertices);
  std::vector<double> counted = params.vertices;
  if (counted.empty()) {
    for (Index v = 0; v < vertices; ++v) counted.push_back(static_cast<double>(v));
  }
  if (!params.vertex_weights.empty() && params.vertex_weights.size() != counted.size()) {
    place(origin, "planning.vertex_weights")
        .fail("has " + std::to_string(params.vertex_weights.size()) + " numbers, must have " +
              std::to_string(counted.size()) + ": one per vertex in planning.vertices");
  }
  Vector weights = Vector::Constant(vertices, -1.0);
  for (std::size_t i = 0; i < counted.size(); ++i) {
    const auto refuse = [&](const std::string& problem) {
      place(origin, "planning.vertices." + std::to_string(i))
          .fail("= " + ConfigNode::number(counted[i]).as_string() + problem);
    };
    const Index v = counted[i];
    if (static_cast<double>(v) != counted[i] || v >= vertices)
      refuse(", must be a vertex in [0, " + std::to_string(vertices - 1) + "]");
    if (weights(v) >= 0.0) refuse(" is listed twice");
    weights(v) = params.vertex_weights.empty() ? 1.0 : params.vertex_weights[i];
  }
  weights = weights.cwiseMax(0.0);
  if (weights.sum() <= 0.0) place(origin, "planning.vertex_weights").fail("are all 0, at least one must be above");
  return weights * (static_cast<double>(vertices) / weights.sum());
}

Planner::Planner(const Task& task, std::shared_ptr<const Predictor> predictor,
                 std::shared_ptr<const Optimiser> optimiser, const PlannerParams& params, Host& host)
    : task_(task), predictor_(std::move(predictor)), optimiser_(std::move(optimiser)), params_(params), host_(host) {
  if (optimiser_->capabilities().needs_gradients && !predictor_->capabilities().gradients) {
    throw Unsupported("the optimiser needs gradients, but the predictor has none; choose a gradient-free optimiser");
  }
  weights_ = vertex_weights(params_, task_.garment->vertex_count());
}

Plan Planner::plan(const PlanRequest& request) const {
  const Step segment("segment", request.round + 1);
  const Step planning("planning");
  const auto started = std::chrono::steady_clock::now();
  const auto elapsed = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  };
  const auto& trajectory = *task_.trajectory;
  const bool first = request.warm_start.rows() == 0;

  Plan plan;
  plan.horizon = first ? params_.horizon : request.warm_start.rows() + params_.leeway;
  if (const auto most = predictor_->max_segments()) plan.horizon = std::min(plan.horizon, *most);
  Controls start = trajectory.default_controls(plan.horizon);
  const Index kept = std::min(request.warm_start.rows(), plan.horizon);
  if (!first) start.topRows(kept) = request.warm_start.topRows(kept);

  // Instance 0 starts from the plan itself, the others from the plan plus noise.
  const Box bounds = trajectory.decision_bounds(plan.horizon);
  const Vector scale = trajectory.decision_scale(plan.horizon);
  const Vector centre = trajectory.encode(start, request.state);
  const double noise = first ? params_.noise : params_.replan_noise;
  Matrix starts(centre.size(), params_.instances);
  for (Index i = 0; i < starts.cols(); ++i) {
    RandomStream random = RandomStream(request.seed, stream_key("plan"), static_cast<std::uint64_t>(request.round))
                              .child(static_cast<std::uint64_t>(i));
    for (Index k = 0; k < starts.rows(); ++k)
      starts(k, i) = centre(k) + (i == 0 ? 0.0 : noise * scale(k) * random.normal());
    starts.col(i) = bounds.clamp(starts.col(i));
  }

  PlanningObjective objective(task_, *predictor_, params_, weights_, request, plan.horizon);
  OptimiserOptions options;
  options.max_iterations = first ? params_.iterations : params_.replan_iterations;
  options.seed = RandomStream(request.seed, stream_key("opti"), static_cast<std::uint64_t>(request.round)).bits64();
  const bool is_replay = static_cast<std::size_t>(request.round) < params_.replay_iterations.size();
  if (params_.max_evaluations > 0) options.max_evaluations = params_.max_evaluations;
  const Index replayed = is_replay ? static_cast<Index>(params_.replay_iterations[request.round]) : 0;
  const auto observer = [&](Index iteration, const Vector& best) {
    plan.iterations = iteration;
    plan.curves.emplace_back(best.data(), best.data() + best.size());
    const bool in_time =
        is_replay ? iteration < replayed : params_.time_budget_s <= 0.0 || elapsed() < params_.time_budget_s;
    return in_time && !host_.cancelled();
  };
  const auto results = optimiser_->minimise(objective, starts, bounds,
                                            first ? scale : Vector(params_.replan_scale * scale), options, observer);

  plan.loss = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < results.size(); ++i) {
    plan.losses.push_back(results[i].cost);
    if (results[i].cost < plan.loss) {
      plan.loss = results[i].cost;
      plan.instance = i;
    }
  }
  if (!std::isfinite(plan.loss))
    throw Diverged("planning: no instance reached a finite loss: " + results.front().message);

  plan.ended = search_end(results, plan.instance);

  // Truncate the winner after its release segment and predict its whole sequence.
  PredictionCase winner = objective.make_case(results[plan.instance].x);
  const Index u = winner.segments.front();
  winner.controls.conservativeResize(u, Eigen::NoChange);
  winner.segments.clear();
  for (Index j = 1; j <= u; ++j) winner.segments.push_back(j);
  const auto prediction = predictor_->predict({winner}, {.moments = Moments::mean_and_sigma});
  if (!prediction->failure(0).empty())
    throw Error("planning: the chosen plan cannot be predicted: " + prediction->failure(0));
  plan.shapes = prediction->shapes().front();
  plan.controls = winner.controls;
  const Controls states = trajectory.segment_states(task_.manipulation, request.state, plan.controls);
  plan.releases = trajectory.released(states.row(u - 1).transpose());
  plan.predicted_error_mm = mean_distance_mm(plan.shapes.back().mean, *request.goal);
  plan.evaluations = objective.evaluations() + 1;
  plan.seconds = elapsed();
  return plan;
}

}  // namespace weft
