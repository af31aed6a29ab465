#include <algorithm>
#include <cmath>

#include "toy.hpp"
#include "weft/optimiser.hpp"
#include "weft/plugin.hpp"
#include "weft/random.hpp"

namespace weft::toy {

/// With gradients: sign steps that grow by 1.2 and halve. Without (declare: false): a random walk around the best point
/// whose length follows its success, 20 draws per iteration (a (1+1) evolution strategy).
class ToyOptimiser final : public Optimiser {
 public:
  explicit ToyOptimiser(const Params& params) : p_(params) {}

  OptimiserCapabilities capabilities() const override {
    OptimiserCapabilities c;
    c.needs_gradients = p_.declare && !is("asks_only_for_what_it_needs");
    return c;
  }

  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override {
    std::vector<OptimiserResult> results(static_cast<std::size_t>(starts.cols()));
    for (std::size_t i = 0; i < results.size(); ++i) results[i].x = starts.col(static_cast<Index>(i));
    const Index dim = objective.dim();
    if (is("refuses_bad_shapes") && scale.size() != dim) return results;
    require_shape("toy: starts", starts.rows(), dim);
    require_shape("toy: lower bounds", bounds.lower.size(), dim);
    require_shape("toy: upper bounds", bounds.upper.size(), dim);
    require_shape("toy: scale", scale.size(), dim);
    if (!starts.allFinite() || !bounds.lower.allFinite() || !bounds.upper.allFinite() || !scale.allFinite() ||
        (bounds.lower.array() > bounds.upper.array()).any() || (scale.array() <= 0.0).any()) {
      if (is("refuses_nan")) return results;
      throw Error("toy: starts, bounds and scale must be finite and make sense");
    }
    const bool gradients = p_.declare;
    if (gradients && !objective.capabilities().gradients && !is("refuses_objectives_that_lack_what_it_needs"))
      throw Unsupported("toy: gradients are needed");
    misbehave(p_);
    try {
      search(objective, starts, bounds, scale, options, observer, results);
    } catch (...) {
      if (!is("errors_of_the_objective_pass_through")) throw;
    }
    for (auto& r : results) {
      r.x = spoilt(p_, "x", r.x);
      r.cost = spoilt(p_, "cost", r.cost);
    }
    if (spoils(p_, "empty", "results")) results.clear();
    if (spoils(p_, "long", "results")) results.push_back({.x = starts.rowwise().mean()});
    if (p_.fault == "x_out_of_bounds") results.front().x = bounds.upper + scale;
    return results;
  }

 private:
  struct Instance {
    Vector x, step, gradient, before;
    double length = 1.0;
    bool running = true;
  };
  bool is(const char* mutation) const { return p_.mutation == mutation; }

  void search(Objective& objective, ConstMatrix starts, const Box& given, ConstVec scale,
              const OptimiserOptions& options, const OptimiserObserver& observer,
              std::vector<OptimiserResult>& results) const {
    const Index dim = objective.dim(), count = starts.cols();
    Box bounds = given;
    if (is("finds_a_minimum_on_the_boundary") && dim == 4) bounds = {0.5 * given.lower, 0.5 * given.upper};
    std::vector<Instance> all(static_cast<std::size_t>(count));
    Index budget = options.max_evaluations + (is("budget_is_respected") ? 1 : 0);
    Index iterations = options.max_iterations;
    if (is("solves_an_ill_conditioned_quadratic") && dim == 6) iterations = 3;
    if (is("solves_rosenbrock") && dim == 2) iterations = std::min<Index>(iterations, 2);
    for (Index i = 0; i < count; ++i) {
      auto& it = all[static_cast<std::size_t>(i)];
      it.x = is("never_leaves_the_box") ? Vector(starts.col(i)) : bounds.clamp(starts.col(i));
      it.step = scale * (is("instances_do_not_affect_one_another") ? 0.1 + 0.01 * static_cast<double>(count) : 0.1);
      if (is("same_bits_on_two_threads")) it.step *= 1.0 + 1e-3 * thread_ordinal();
      if (is("same_seed_same_bits")) it.step *= 1.0 + 1e-3 * object_ordinal();
      it.before = Vector::Zero(dim);
      results[static_cast<std::size_t>(i)].x = it.x;
    }
    Vector best = Vector::Constant(count, std::numeric_limits<double>::infinity());
    const auto each = [&](const std::function<Vector(Index, Instance&)>& propose) {
      std::vector<Index> active;
      for (Index i = 0; i < count; ++i) {
        auto& it = all[static_cast<std::size_t>(i)];
        auto& r = results[static_cast<std::size_t>(i)];
        if (it.running && r.evaluations >= budget) {
          it.running = false;
          r.status = std::isfinite(r.cost) ? OptimiserStatus::budget_spent : OptimiserStatus::diverged;
        }
        if (it.running) active.push_back(i);
      }
      if (active.empty()) return false;
      if (is("batches_are_well_formed")) std::reverse(active.begin(), active.end());
      Matrix x(dim, static_cast<Index>(active.size()));
      for (std::size_t j = 0; j < active.size(); ++j)
        x.col(static_cast<Index>(j)) = propose(active[j], all[static_cast<std::size_t>(active[j])]);
      EvaluationRequest request;
      request.gradients = p_.declare;
      const Evaluation e = objective.evaluate(spoilt(p_, "point", x), active, request);
      for (std::size_t j = 0; j < active.size(); ++j) {
        const Index i = active[j];
        auto& it = all[static_cast<std::size_t>(i)];
        auto& r = results[static_cast<std::size_t>(i)];
        const double cost = e.costs[static_cast<Index>(j)];
        ++r.evaluations;
        it.length *= cost < r.cost ? 1.5 : 0.92;
        if (p_.declare) it.gradient = e.gradients.col(static_cast<Index>(j));
        const bool finite = std::isfinite(cost) && (!p_.declare || it.gradient.allFinite());
        const bool better = is("survives_holes") ? !(cost >= r.cost) : finite && cost < r.cost;
        if (better || is("the_best_point_is_returned")) {
          r.cost = cost;
          r.x = x.col(static_cast<Index>(j));
        }
        if (!finite && is("a_failed_instance_costs_only_itself"))
          for (auto& other : all) other.running = false;
        if (!finite) {
          // Back to the best point with a shorter step; without one there is nothing to do.
          it.gradient = Vector::Zero(dim);
          it.x = r.x;
          it.step *= 0.5;
          if (!std::isfinite(r.cost) && p_.declare) it.running = false;
        }
        best[i] = std::min(best[i], r.cost);
      }
      return true;
    };

    for (Index iteration = 0; iteration <= iterations; ++iteration) {
      bool any = false;
      if (p_.declare) {
        any = each([&](Index, Instance& it) { return it.x; });
        for (Index i = 0; i < count; ++i) {
          auto& it = all[static_cast<std::size_t>(i)];
          if (!it.running || it.gradient.size() == 0 || iteration == iterations) continue;
          for (Index k = 0; k < dim; ++k) {
            const double turn = it.gradient[k] * it.before[k];
            it.step[k] = std::clamp(it.step[k] * (turn > 0   ? 1.2
                                                  : turn < 0 ? 0.5
                                                             : 1.0),
                                    1e-7 * scale[k], 2.0 * scale[k]);
            it.x[k] -= it.gradient[k] > 0 ? it.step[k] : it.gradient[k] < 0 ? -it.step[k] : 0.0;
          }
          // In a hole the gradient is 0: half a step back towards the best point's side happens by the shorter steps
          // above.
          if (it.gradient.isZero(0.0) && it.before.size() == dim)
            for (Index k = 0; k < dim; ++k)
              it.x[k] -= it.before[k] > 0 ? it.step[k] : it.before[k] < 0 ? -it.step[k] : 0.0;
          else
            it.before = it.gradient;
          it.x = bounds.clamp(it.x);
          ++results[static_cast<std::size_t>(i)].iterations;
        }
      } else {
        const int draws = iteration == 0 ? 1 : 20;
        for (int draw = 0; draw < draws; ++draw) {
          any |= each([&](Index i, Instance& it) -> Vector {
            if (iteration == 0) return it.x;
            RandomStream random(options.seed, static_cast<std::uint64_t>(i),
                                static_cast<std::uint64_t>(iteration * 20 + draw));
            Vector x = results[static_cast<std::size_t>(i)].x;
            for (Index k = 0; k < dim; ++k) x[k] += it.length * scale[k] * random.normal();
            return bounds.clamp(x);
          });
        }
        if (iteration < iterations)
          for (auto& r : results) ++r.iterations;
      }
      if (!any) break;
      if (observer && !observer(iteration, best) && !is("observer_stops_the_search")) {
        for (std::size_t i = 0; i < all.size(); ++i) {
          all[i].running = false;
          results[i].status = OptimiserStatus::stopped;
        }
        break;
      }
      for (std::size_t i = 0; i < all.size(); ++i) {
        if (!options.wanted || !all[i].running || options.wanted(i)) continue;
        all[i].running = false;
        results[i].status = OptimiserStatus::stopped;
        if (is("an_unwanted_instance_ends_alone")) all[0].running = false;
      }
    }
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (all[i].running) results[i].status = OptimiserStatus::budget_spent;
      if (!std::isfinite(results[i].cost)) results[i].status = OptimiserStatus::diverged;
      results[i].iterations = std::min(results[i].iterations, options.max_iterations);
    }
  }

  Params p_;
};

}  // namespace weft::toy

WEFT_PLUGIN(weft::Optimiser, weft::toy::ToyOptimiser, weft::toy::Params, "toy_optimiser", "1.0.0")
