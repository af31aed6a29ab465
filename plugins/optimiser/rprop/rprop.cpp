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

/// One call of minimise(): what does not change over its iterations, and what an iteration does with an instance.
class Search {
 public:
  Search(const Params& params, const Box& bounds, ConstVec scale, const OptimiserOptions& options)
      : p_(params),
        bounds_(bounds),
        scale_(scale),
        options_(options),
        max_step_(p_.max_step * (bounds.upper - bounds.lower)),
        min_step_((p_.min_step * scale).cwiseMin(max_step_)) {}

  Instance begin(ConstVec start) const {
    Instance it;
    it.x = bounds_.clamp(start);
    it.step = (p_.initial_step * scale_).cwiseMax(min_step_).cwiseMin(max_step_);
    it.previous_gradient = Vector::Zero(it.x.size());
    it.result.x = it.x;
    return it;
  }

  /// What an instance makes of the cost and gradient at its point.
  void take(Instance& it, double cost, const Vector& gradient) const {
    ++it.result.evaluations;
    const bool finite = std::isfinite(cost) && gradient.allFinite();
    if (finite && cost < it.result.cost) {
      it.result.cost = cost;
      it.result.x = it.x;
      it.best_gradient = gradient;
    }
    it.best_costs.push_back(it.result.cost);
    if (std::ssize(it.best_costs) > p_.patience + 1) it.best_costs.pop_front();

    if (!finite) {
      if (it.best_gradient.size() == 0)
        return it.stop(OptimiserStatus::diverged, "cost or gradient is not finite at the start");
      if (++it.retries > p_.max_retries)
        return it.stop(OptimiserStatus::diverged, "cost or gradient stays non-finite around the best point");
    } else {
      it.retries = 0;
      const double before = it.best_costs.front(), now = it.result.cost;
      if (std::ssize(it.best_costs) == p_.patience + 1 && before - now <= p_.relative_tolerance * std::abs(now))
        return it.stop(OptimiserStatus::converged, "no improvement within `patience` iterations");
    }
    if (it.result.iterations >= options_.max_iterations || it.result.evaluations >= options_.max_evaluations)
      return it.stop(OptimiserStatus::budget_spent, "");
    if (finite) return move(it, gradient, it.x);
    // Back to the best point, with halved steps along its gradient.
    it.step = (0.5 * it.step).cwiseMax(min_step_);
    it.previous_gradient.setZero();
    move(it, it.best_gradient, it.result.x);
  }

 private:
  /// The next point of an instance, or its end.
  void move(Instance& it, const Vector& gradient, const Vector& from) const {
    Vector next = from;
    Index moving = 0;      // variables that the box and the gradient let move
    double largest = 0.0;  // their largest step, in scales
    for (Index i = 0; i < from.size(); ++i) {
      const double turn = gradient[i] * it.previous_gradient[i];
      if (turn < 0.0) it.step[i] = std::max(p_.decrease * it.step[i], min_step_[i]);
      const double wanted = turn > 0.0 ? std::min(p_.increase * it.step[i], max_step_[i]) : it.step[i];
      const double free = from[i] - sign(gradient[i]) * wanted;
      next[i] = std::clamp(free, bounds_.lower[i], bounds_.upper[i]);
      if (next[i] == free) it.step[i] = wanted;
      if (next[i] == from[i]) continue;
      ++moving;
      largest = std::max(largest, it.step[i] / scale_[i]);
    }
    it.previous_gradient = gradient;
    if (moving == 0) return it.stop(OptimiserStatus::converged, "no variable can move against its gradient");
    if (largest <= p_.step_tolerance) return it.stop(OptimiserStatus::converged, "every step is below step_tolerance");
    it.x = next;
    ++it.result.iterations;
  }

  const Params& p_;
  const Box& bounds_;
  ConstVec scale_;
  const OptimiserOptions& options_;
  Vector max_step_, min_step_;
};

}  // namespace

OptimiserCapabilities Rprop::capabilities() const { return {.needs_gradients = true}; }

std::vector<OptimiserResult> Rprop::minimise(Objective& objective, ConstMatrix starts, const Box& bounds,
                                             ConstVec scale, const OptimiserOptions& options,
                                             const OptimiserObserver& observer) const {
  if (!objective.capabilities().gradients)
    throw Unsupported("rprop: the objective offers no gradients; rprop needs them");
  check_search("rprop", objective, starts, bounds, scale);
  const Search search(p_, bounds, scale, options);
  std::vector<Instance> all;
  for (Index i = 0; i < starts.cols(); ++i) all.push_back(search.begin(starts.col(i)));

  if (options.max_evaluations <= 0)
    for (auto& it : all) it.stop(OptimiserStatus::budget_spent, "max_evaluations allows no evaluation");

  Vector best_costs = Vector::Constant(starts.cols(), std::numeric_limits<double>::infinity());
  for (Index iteration = 0;; ++iteration) {
    std::vector<Index> active;
    for (Index i = 0; i < starts.cols(); ++i)
      if (all[i].running) active.push_back(i);
    if (active.empty()) break;

    const Index n = active.size();
    Matrix x(objective.dim(), n);
    for (Index j = 0; j < n; ++j) x.col(j) = all[active[j]].x;
    EvaluationRequest request;
    request.gradients = true;
    const Evaluation e = objective.evaluate(x, active, request);
    require_shape("rprop: costs of the objective", e.costs.size(), n);
    require_shape("rprop: rows of the objective's gradients", e.gradients.rows(), x.rows());
    require_shape("rprop: columns of the objective's gradients", e.gradients.cols(), n);

    for (Index j = 0; j < n; ++j) {
      Instance& it = all[active[j]];
      search.take(it, e.costs[j], e.gradients.col(j));
      best_costs[active[j]] = it.result.cost;
    }
    if (observer && !observer(iteration, best_costs)) {
      for (auto& it : all)
        if (it.running) it.stop(OptimiserStatus::stopped, "stopped by the observer");
    }
    for (Index i : active)
      if (options.wanted && all[i].running && !options.wanted(i))
        all[i].stop(OptimiserStatus::stopped, "not wanted any more");
  }

  std::vector<OptimiserResult> results;
  for (auto& it : all) results.push_back(std::move(it.result));
  return results;
}

}  // namespace weft::rprop
