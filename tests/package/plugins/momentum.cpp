#include "weft/batching.hpp"
#include "weft/plugin.hpp"
using namespace weft;

struct Params {
  double repeat = 0.9;
  void visit(auto& v) { v("repeat", repeat, range(0.0, 0.999), "Part of a step that the next one repeats."); }
};

/// Gradient descent that repeats a part of the last step [Polyak 1964]. The rate grows by 5 % after a step that went
/// down; another step is taken back, and the next one has half the rate and repeats nothing. In units of the scales.
struct Momentum final : Optimiser {
  explicit Momentum(const Params& params) : p(params) {}
  OptimiserCapabilities capabilities() const override { return {.needs_gradients = true}; }
  std::vector<OptimiserResult> minimise(Objective& f, ConstMatrix starts, const Box& box, ConstVec scale,
                                        const OptimiserOptions& options, const OptimiserObserver& see) const override {
    if (!f.capabilities().gradients) throw Unsupported("momentum: the objective offers no gradients");
    const auto solve = [&](PointwiseSearch& search, const Vector& start) -> SolverOutcome {
      Vector x = start, best = start, gradient;
      double rate = 0.0;
      for (Index k = 0; const PointValue* here = search.evaluate(x, {.gradients = true}); ++k) {
        const bool down = here->finite && search.best_x() == x;
        if (k == 0 && !down) return {OptimiserStatus::diverged, "no finite value at the start"};
        if (down) gradient = here->gradient.cwiseProduct(scale);
        rate = k == 0 ? 0.1 / (gradient.norm() + 1e-300) : (down ? 1.05 : 0.5) * rate;
        const Vector step = (down ? p.repeat : 0.0) * (x - best).cwiseQuotient(scale) - rate * gradient;
        if (k >= options.max_iterations) return {OptimiserStatus::budget_spent, "max_iterations"};
        best = search.best_x();
        x = box.clamp(best + step.cwiseProduct(scale));
        if ((x - best).norm() <= 1e-9 * scale.norm()) return {OptimiserStatus::converged, "the step is too short"};
        search.count_iteration();
      }
      return {};  // the budget or the observer has ended the search, and the reason is known
    };
    return minimise_pointwise("momentum", f, starts, box, scale, options, see, solve);
  }
  Params p;
};

WEFT_PLUGIN(weft::Optimiser, Momentum, Params, "momentum", "1.0.0")
