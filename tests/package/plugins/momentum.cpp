#include <algorithm>
#include <cmath>

#include "weft/optimiser.hpp"
#include "weft/plugin.hpp"

namespace momentum {

struct Params {
  double first_step = 0.1;
  double momentum = 0.9;
  double tolerance = 1e-9;
  template <class Visitor>
  void visit(Visitor& v) {
    v("first_step", first_step, weft::range(1e-6, 10.0), "Length of the first step, in scales.");
    v("momentum", momentum, weft::range(0.0, 0.999), "Part of a step that is repeated in the next one.");
    v("tolerance", tolerance, weft::range(0.0, 1.0), "Converged when a step is shorter than this, in scales.");
  }
};

using namespace weft;

/// Gradient descent with momentum [Polyak 1964] in units of the scales, whose rate adapts: 5 % more after a step that
/// went down; after one that did not, back, with half the rate and without momentum. Costs therefore only fall, which
/// makes it no solver for noisy ones.
class Momentum final : public Optimiser {
 public:
  explicit Momentum(const Params& params) : p_(params) {}

  OptimiserCapabilities capabilities() const override {
    return {.needs_gradients = true, .honours_bounds = true, .handles_noise = false};
  }

  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override {
    check_search("momentum", objective, starts, bounds, scale);
    if (!objective.capabilities().gradients) throw Unsupported("momentum: the objective offers no gradients");

    std::vector<Search> searches;
    for (Index i = 0; i < starts.cols(); ++i) searches.push_back({.x = bounds.clamp(starts.col(i))});
    for (auto& s : searches) {
      s.result.x = s.x;
      if (options.max_evaluations <= 0) s.stop(OptimiserStatus::budget_spent);
    }
    for (Index iteration = 0;; ++iteration) {
      // All instances that still run are evaluated in one batch.
      std::vector<Index> running;
      for (std::size_t i = 0; i < searches.size(); ++i) {
        if (searches[i].running) running.push_back(static_cast<Index>(i));
      }
      if (running.empty()) break;
      Matrix x(starts.rows(), static_cast<Index>(running.size()));
      for (Index k = 0; k < x.cols(); ++k)
        x.col(k) = searches[static_cast<std::size_t>(running[static_cast<std::size_t>(k)])].x;
      const Evaluation e = objective.evaluate(x, running, {.gradients = true});
      Vector best(starts.cols());
      for (Index k = 0; k < x.cols(); ++k) {
        advance(searches[static_cast<std::size_t>(running[static_cast<std::size_t>(k)])], e.costs[k],
                e.gradients.col(k), bounds, scale, options);
      }
      for (Index i = 0; i < best.size(); ++i) best[i] = searches[static_cast<std::size_t>(i)].result.cost;
      if (observer && !observer(iteration, best)) {
        for (auto& s : searches) {
          if (s.running) s.stop(OptimiserStatus::stopped);
        }
      }
    }
    std::vector<OptimiserResult> results;
    for (auto& s : searches) results.push_back(std::move(s.result));
    return results;
  }

 private:
  /// One instance. It never looks at another one.
  struct Search {
    Vector x;         // evaluated next
    Vector gradient;  // at result.x, in 1 / scales; empty until there is a finite cost
    Vector step;      // last one that went down, in scales
    double rate = 0.0;
    bool running = true;
    OptimiserResult result{};
    void stop(OptimiserStatus status, const char* message = "") {
      running = false;
      result.status = status;
      result.message = message;
    }
  };

  void advance(Search& s, double cost, ConstVec gradient, const Box& bounds, ConstVec scale,
               const OptimiserOptions& options) const {
    ++s.result.evaluations;
    if (std::isfinite(cost) && gradient.allFinite() && cost < s.result.cost) {
      const Vector moved = (s.x - s.result.x).cwiseQuotient(scale);
      s.step = s.gradient.size() == 0 ? Vector::Zero(scale.size()) : moved;
      s.result.cost = cost;
      s.result.x = s.x;
      s.gradient = gradient.cwiseProduct(scale);
      s.rate = s.rate == 0.0 ? p_.first_step / std::max(s.gradient.norm(), 1e-300) : 1.05 * s.rate;
    } else if (s.gradient.size() == 0) {
      return s.stop(OptimiserStatus::diverged, "cost or gradient is not finite at the start");
    } else {
      s.rate *= 0.5;
      s.step.setZero();
    }
    if (s.result.iterations >= options.max_iterations || s.result.evaluations >= options.max_evaluations) {
      return s.stop(OptimiserStatus::budget_spent);
    }
    const Vector step = p_.momentum * s.step - s.rate * s.gradient;
    s.x = bounds.clamp(s.result.x + step.cwiseProduct(scale));
    const double length = (s.x - s.result.x).cwiseQuotient(scale).norm();
    if (length <= p_.tolerance) return s.stop(OptimiserStatus::converged, "the next step is shorter than tolerance");
    ++s.result.iterations;
  }

  Params p_;
};

}  // namespace momentum

WEFT_PLUGIN(weft::Optimiser, momentum::Momentum, momentum::Params, "momentum", "1.0.0")
