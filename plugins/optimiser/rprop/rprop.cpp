#include "rprop.hpp"

#include <algorithm>
#include <cmath>
#include <deque>

namespace weft::rprop {
namespace {

/// One search. Its numbers depend on its own start and evaluations only.
struct Instance {
  Vector x, step, gradient, previous_gradient;
  Vector best_gradient;
  std::deque<double> best_costs;  // after the last patience + 1 evaluations
  Index retries = 0;
  bool running = true;
  OptimiserResult result;

  void stop(OptimiserStatus status, std::string message) {
    running = false;
    result.status = status;
    result.message = std::move(message);
  }
};

double sign(double v) { return v > 0.0 ? 1.0 : v < 0.0 ? -1.0 : 0.0; }

}  // namespace

OptimiserCapabilities Rprop::capabilities() const { return {.needs_gradients = true}; }

std::vector<OptimiserResult> Rprop::minimise(Objective& objective, ConstMatrix starts, const Box& bounds,
                                             ConstVec scale, const OptimiserOptions& options,
                                             const OptimiserObserver& observer) const {
  if (!objective.capabilities().gradients)
    throw Unsupported("rprop: the objective offers no gradients; rprop needs them");
  check_search("rprop", objective, starts, bounds, scale);
  const Index dim = objective.dim();
  const auto count = static_cast<std::size_t>(starts.cols());
  const Vector max_step = p_.max_step * (bounds.upper - bounds.lower);
  const Vector min_step = (p_.min_step * scale).cwiseMin(max_step);

  std::vector<Instance> all(count);
  for (std::size_t i = 0; i < count; ++i) {
    all[i].x = bounds.clamp(starts.col(static_cast<Index>(i)));
    all[i].step = (p_.initial_step * scale).cwiseMax(min_step).cwiseMin(max_step);
    all[i].previous_gradient = Vector::Zero(dim);
    all[i].result.x = all[i].x;
  }

  // The next point of an instance, or its end.
  const auto move = [&](Instance& it, const Vector& gradient, const Vector& from) {
    Vector next = from;
    Index moving = 0;      // variables that the box and the gradient let move
    double largest = 0.0;  // their largest step, in scales
    for (Index i = 0; i < dim; ++i) {
      const double turn = gradient[i] * it.previous_gradient[i];
      if (turn < 0.0) it.step[i] = std::max(p_.decrease * it.step[i], min_step[i]);
      const double wanted = turn > 0.0 ? std::min(p_.increase * it.step[i], max_step[i]) : it.step[i];
      const double free = from[i] - sign(gradient[i]) * wanted;
      next[i] = std::clamp(free, bounds.lower[i], bounds.upper[i]);
      if (next[i] == free) it.step[i] = wanted;
      if (next[i] == from[i]) continue;
      ++moving;
      largest = std::max(largest, it.step[i] / scale[i]);
    }
    it.previous_gradient = gradient;
    if (moving == 0) return it.stop(OptimiserStatus::converged, "no variable can move against its gradient");
    if (largest <= p_.step_tolerance) return it.stop(OptimiserStatus::converged, "every step is below step_tolerance");
    it.x = next;
    ++it.result.iterations;
  };

  const auto take = [&](Instance& it, double cost, const Vector& gradient) {
    ++it.result.evaluations;
    const bool finite = std::isfinite(cost) && gradient.allFinite();
    if (finite && cost < it.result.cost) {
      it.result.cost = cost;
      it.result.x = it.x;
      it.best_gradient = gradient;
    }
    it.best_costs.push_back(it.result.cost);
    if (it.best_costs.size() > static_cast<std::size_t>(p_.patience) + 1) it.best_costs.pop_front();

    if (!finite) {
      if (it.best_gradient.size() == 0)
        return it.stop(OptimiserStatus::diverged, "cost or gradient is not finite at the start");
      if (++it.retries > p_.max_retries)
        return it.stop(OptimiserStatus::diverged, "cost or gradient stays non-finite around the best point");
    } else {
      it.retries = 0;
      const double before = it.best_costs.front(), now = it.result.cost;
      if (it.best_costs.size() == static_cast<std::size_t>(p_.patience) + 1 &&
          before - now <= p_.relative_tolerance * std::abs(now))
        return it.stop(OptimiserStatus::converged, "no improvement within `patience` iterations");
    }
    if (it.result.iterations >= options.max_iterations || it.result.evaluations >= options.max_evaluations)
      return it.stop(OptimiserStatus::budget_spent, "");
    if (finite) return move(it, gradient, it.x);
    // Back to the best point, with halved steps along its gradient.
    it.step = (0.5 * it.step).cwiseMax(min_step);
    it.previous_gradient.setZero();
    move(it, it.best_gradient, it.result.x);
  };

  if (options.max_evaluations <= 0)
    for (auto& it : all) it.stop(OptimiserStatus::budget_spent, "max_evaluations allows no evaluation");

  Vector best_costs = Vector::Constant(starts.cols(), std::numeric_limits<double>::infinity());
  for (Index iteration = 0;; ++iteration) {
    std::vector<Index> active;
    for (std::size_t i = 0; i < count; ++i)
      if (all[i].running) active.push_back(static_cast<Index>(i));
    if (active.empty()) break;

    const auto n = static_cast<Index>(active.size());
    Matrix x(dim, n);
    for (Index j = 0; j < n; ++j) x.col(j) = all[static_cast<std::size_t>(active[static_cast<std::size_t>(j)])].x;
    EvaluationRequest request;
    request.gradients = true;
    const Evaluation e = objective.evaluate(x, active, request);
    require_shape("rprop: costs of the objective", e.costs.size(), n);
    require_shape("rprop: rows of the objective's gradients", e.gradients.rows(), dim);
    require_shape("rprop: columns of the objective's gradients", e.gradients.cols(), n);

    for (Index j = 0; j < n; ++j) {
      Instance& it = all[static_cast<std::size_t>(active[static_cast<std::size_t>(j)])];
      take(it, e.costs[j], e.gradients.col(j));
      best_costs[active[static_cast<std::size_t>(j)]] = it.result.cost;
    }
    if (observer && !observer(iteration, best_costs)) {
      for (auto& it : all)
        if (it.running) it.stop(OptimiserStatus::stopped, "stopped by the observer");
    }
  }

  std::vector<OptimiserResult> results;
  for (auto& it : all) results.push_back(std::move(it.result));
  return results;
}

}  // namespace weft::rprop
