#include "session/planner.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "loader/where.hpp"
#include "session/halving.hpp"
#include "session/planning_objective.hpp"
#include "session/shape_errors.hpp"
#include "weft/config.hpp"

namespace weft {

namespace {

/// Variables of a point that move the hands before the release: those of its first segments, where x is the controls row by
/// row; else all.
Index moving_variables(const Trajectory& trajectory, const PlanPoint& point) {
  const Index controls = std::ssize(trajectory.controls());
  return point.x.size() == controls * point.horizon ? controls * point.release : point.x.size();
}

/// The best point of each release segment that keeps the limits of the hands, by loss.
std::vector<PlanPoint> best_points(const PlanningObjective& objective, const std::vector<OptimiserResult>& results,
                                   Index horizon) {
  std::vector<PlanPoint> points;
  for (const auto& result : results) {
    if (!std::isfinite(result.cost) || !objective.keeps_limits(result.x)) continue;
    PlanPoint point{result.x, horizon, objective.make_case(result.x).segments.front(), result.cost};
    const auto same = std::find_if(points.begin(), points.end(),
                                   [&](const PlanPoint& other) { return other.release == point.release; });
    if (same == points.end())
      points.push_back(std::move(point));
    else if (point.loss < same->loss)
      *same = std::move(point);
  }
  std::stable_sort(points.begin(), points.end(),
                   [](const PlanPoint& a, const PlanPoint& b) { return a.loss < b.loss; });
  return points;
}

}  // namespace

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

double goal_distance_mm(const PlanRequest& request, const Positions& shape) {
  return request.goal ? mean_distance_mm(shape, *request.goal, request.counts) : request.surface->chamfer_mm(shape);
}

Planner::Planner(const Task& task, std::shared_ptr<const Predictor> predictor,
                 std::shared_ptr<const Optimiser> optimiser, const PlannerParams& params, Host& host)
    : task_(task),
      predictor_(std::move(predictor)),
      optimiser_(std::move(optimiser)),
      params_(params),
      mean_params_(params),
      host_(host) {
  if (params_.loss != "coverage") mean_params_.loss = "mean";
  if (optimiser_->capabilities().needs_gradients && !predictor_->capabilities().gradients) {
    throw Unsupported("the optimiser needs gradients, but the predictor has none; choose a gradient-free optimiser");
  }
  if (optimiser_->capabilities().needs_residuals && params_.loss == "silhouette") {
    throw Unsupported(
        "the optimiser needs residuals, which planning.loss = silhouette does not have; choose another optimiser, or "
        "planning.loss = chamfer");
  }
  if (params_.loss == "coverage" &&
      (optimiser_->capabilities().needs_gradients || optimiser_->capabilities().needs_residuals)) {
    throw Unsupported(
        "planning.loss = coverage has no gradient, which the optimiser needs; choose mppi or a gradient-free algorithm "
        "of nlopt");
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
  plan.horizon = horizon_of(request.warm_start);
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

  PlanningObjective objective(task_, *predictor_, params_, weights_, request, plan.horizon, &host_);
  OptimiserOptions options;
  options.max_iterations = first ? params_.iterations : params_.replan_iterations;
  options.seed = RandomStream(request.seed, stream_key("opti"), static_cast<std::uint64_t>(request.round)).bits64();
  const bool is_replay = static_cast<std::size_t>(request.round) < params_.replay_iterations.size();
  if (params_.max_evaluations > 0) options.max_evaluations = params_.max_evaluations;
  const Index replayed = is_replay ? static_cast<Index>(params_.replay_iterations[request.round]) : 0;
  Halving halving(params_.instances, std::min(options.max_iterations, options.max_evaluations), params_.halvings);
  options.wanted = [&](Index instance) { return halving.wants(instance); };
  const auto observer = [&](Index iteration, const Vector& best) {
    plan.iterations = iteration;
    halving.look(iteration, best);
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

  plan.points = best_points(objective, results, plan.horizon);
  // What is left of the plan in force keeps the limits of the hands, which move already.
  Plan winner = plan.points.empty() ? plan_of_controls(request, start.topRows(first ? plan.horizon : kept))
                                    : plan_of(request, plan.points.front());
  plan.shapes = std::move(winner.shapes);
  plan.controls = std::move(winner.controls);
  plan.releases = winner.releases;
  plan.predicted_error_mm = winner.predicted_error_mm;
  plan.evaluations = objective.evaluations() + 1;
  plan.seconds = elapsed();
  return plan;
}

Index Planner::horizon_of(const Controls& warm_start) const {
  const Index horizon = warm_start.rows() == 0 ? params_.horizon : warm_start.rows() + params_.leeway;
  return std::min(horizon, predictor_->max_segments().value_or(horizon));
}

PlanPoint Planner::point_of(const PlanRequest& request, const Controls& controls) const {
  PlanPoint point;
  point.horizon = horizon_of(controls);
  const Index kept = std::min(controls.rows(), point.horizon);
  Controls start = task_.trajectory->default_controls(point.horizon);
  start.topRows(kept) = controls.topRows(kept);
  point.x = task_.trajectory->decision_bounds(point.horizon).clamp(task_.trajectory->encode(start, request.state));
  point.release = PlanningObjective(task_, *predictor_, mean_params_, weights_, request, point.horizon)
                      .make_case(point.x)
                      .segments.front();
  return point;
}

Controls Planner::controls_of(const PlanRequest& request, const PlanPoint& point) const {
  const PlanningObjective objective(task_, *predictor_, mean_params_, weights_, request, point.horizon);
  return objective.decode(point.x).topRows(point.release);
}

PlanPoint Planner::search_near(const PlanRequest& request, const LocalSearch& search) const {
  const auto& trajectory = *task_.trajectory;
  PlanRequest shifted = request;
  // |mean + offset - goal| = |mean - (goal - offset)|
  if (request.surface || params_.loss == "coverage")
    shifted.offset = std::make_shared<const Positions>(search.offset);
  else
    shifted.goal = std::make_shared<const Positions>(*request.goal - search.offset);
  shifted.release = search.anchor.release;
  const Index horizon = search.anchor.horizon;
  PlanningObjective objective(task_, *predictor_, mean_params_, weights_, shifted, horizon);
  const Vector scale = trajectory.decision_scale(horizon);
  const double moving = static_cast<double>(moving_variables(trajectory, search.anchor));
  const Vector half = 2.0 * search.radius / std::sqrt(moving) * scale;
  const Box all = trajectory.decision_bounds(horizon);
  const Box region{(search.anchor.x - half).cwiseMax(all.lower), (search.anchor.x + half).cwiseMin(all.upper)};
  OptimiserOptions options;
  options.max_iterations = search.iterations;
  options.seed = search.seed;
  const auto observer = [&](Index, const Vector&) { return !host_.cancelled(); };
  const auto results =
      optimiser_->minimise(objective, search.anchor.x, region, half.cwiseMin(scale), options, observer);
  PlanPoint best = search.anchor;
  best.x = results.front().x;
  best.loss = results.front().cost;
  return best;
}

double Planner::distance(const PlanPoint& a, const PlanPoint& b) const {
  const Vector scale = task_.trajectory->decision_scale(a.horizon);
  return (a.x - b.x).cwiseQuotient(scale).head(moving_variables(*task_.trajectory, a)).norm();
}

double Planner::loss_of(const PlanRequest& request, const PlanPoint& point, const Positions& shape) const {
  const PlanningObjective objective(task_, *predictor_, mean_params_, weights_, request, point.horizon);
  return objective.loss_of(shape, point.x, point.release);
}

bool Planner::keeps_limits(const PlanRequest& request, const PlanPoint& point) const {
  return PlanningObjective(task_, *predictor_, mean_params_, weights_, request, point.horizon).keeps_limits(point.x);
}

std::vector<ShapeDistribution> Planner::predict(const PlanRequest& request, const PlanPoint& point) const {
  return predict(request, controls_of(request, point));
}

std::vector<ShapeDistribution> Planner::predict(const PlanRequest& request, const Controls& controls) const {
  PredictionCase one{.shape = request.shape, .previous = request.previous, .state = request.state};
  one.controls = controls;
  one.knowledge = request.knowledge;
  for (Index j = 1; j <= controls.rows(); ++j) one.segments.push_back(j);
  const auto prediction = predictor_->predict({one}, {.moments = Moments::mean_and_sigma});
  if (!prediction->failure(0).empty())
    throw Error("planning: the chosen plan cannot be predicted: " + prediction->failure(0));
  return prediction->shapes().front();
}

Plan Planner::plan_of(const PlanRequest& request, const PlanPoint& point) const {
  Plan plan = plan_of_controls(request, controls_of(request, point));
  plan.horizon = point.horizon;
  plan.loss = point.loss;
  plan.points = {point};
  return plan;
}

Plan Planner::plan_of_controls(const PlanRequest& request, const Controls& controls) const {
  Plan plan;
  plan.horizon = controls.rows();
  plan.controls = controls.topRows(task_.trajectory->release_segment(task_.manipulation, request.state, controls));
  plan.shapes = predict(request, plan.controls);
  const Controls states = task_.trajectory->segment_states(task_.manipulation, request.state, plan.controls);
  plan.releases = task_.trajectory->released(states.row(states.rows() - 1).transpose());
  plan.predicted_error_mm = goal_distance_mm(request, plan.shapes.back().mean);
  return plan;
}

}  // namespace weft
