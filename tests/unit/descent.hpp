#pragma once
#include <memory>

#include "weft/batching.hpp"

namespace weft::test {

/// Gradient descent by trial and error, a thread per instance; instances take different numbers of evaluations.
class Descent final : public Optimiser {
 public:
  Index throwing_instance = -1;
  OptimiserCapabilities capabilities() const override { return {.needs_gradients = true}; }
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override {
    const PointwiseSolver solver = [&](PointwiseSearch& search, const Vector& start) -> SolverOutcome {
      Vector x = start;
      double step = 1e-6;
      const PointValue* value = search.evaluate(x, {.gradients = true});
      for (Index k = 0; value && k < options.max_iterations; ++k) {
        if (k == 2 && search.instance() == throwing_instance) throw Unsupported("descent: instance gives up");
        const double cost = value->cost;
        const Vector gradient = value->gradient;
        for (;;) {
          const PointValue* there = search.evaluate(x - step * gradient, {});
          if (!there) return {};
          if (there->cost < cost) break;
          step *= 0.5;
          if (step < 1e-14) return {OptimiserStatus::converged, "no step is short enough"};
        }
        x = search.best_x();
        step *= 1.5;
        search.count_iteration();
        value = search.evaluate(x, {.gradients = true});
      }
      return {OptimiserStatus::budget_spent, ""};
    };
    return minimise_pointwise("descent", objective, starts, bounds, scale, options, observer, solver);
  }
};

/// Another optimiser, one instance after the other: the reference for all instances at once.
class OneByOne final : public Optimiser {
 public:
  /// @param numbered each instance asks under its own number; otherwise all ask as instance 0.
  OneByOne(std::shared_ptr<const Optimiser> inner, bool numbered) : inner_(std::move(inner)), numbered_(numbered) {}
  OptimiserCapabilities capabilities() const override { return inner_->capabilities(); }
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options, const OptimiserObserver&) const override {
    std::vector<OptimiserResult> results;
    for (Index i = 0; i < starts.cols(); ++i) {
      Numbered one(objective, numbered_ ? i : 0);
      results.push_back(inner_->minimise(one, starts.col(i), bounds, scale, options, nullptr)[0]);
    }
    return results;
  }

 private:
  class Numbered final : public Objective {
   public:
    Numbered(Objective& inner, Index number) : inner_(inner), number_(number) {}
    Index dim() const override { return inner_.dim(); }
    ObjectiveCapabilities capabilities() const override { return inner_.capabilities(); }
    Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) override {
      return inner_.evaluate(x, std::vector<Index>(instances.size(), number_), request);
    }

   private:
    Objective& inner_;
    Index number_;
  };
  std::shared_ptr<const Optimiser> inner_;
  bool numbered_;
};

}  // namespace weft::test
