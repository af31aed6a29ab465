#include <cmath>

#include "loader/checked.hpp"
#include "loader/guard.hpp"
#include "weft/optimiser.hpp"

namespace weft {
namespace {

/// The objective as a solver sees it. It checks what the solver asks for.
class CheckedObjective final : public Objective {
 public:
  /// @param instances of the search; @param bounds of x.
  CheckedObjective(Objective& objective, const Guard& guard, Index instances, const Box& bounds)
      : objective_(objective),
        guard_(guard),
        instances_(instances),
        bounds_(bounds),
        dim_(objective.dim()),
        capabilities_(objective.capabilities()),
        caller_(Where::here()) {}

  Index dim() const override { return dim_; }
  ObjectiveCapabilities capabilities() const override { return capabilities_; }

  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) override {
    const OnBehalfOf caller(caller_);  // the solver may call from a thread of its own
    check(x, instances, request);
    return call_back([&] { return objective_.evaluate(x, instances, request); });
  }

 private:
  /// A law has an objective of its own that looks at what it is asked for.
  void check(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) const {
    if (!guard_.callers_too()) return;
    guard_.want_size("a point x that it evaluates", x.rows(), dim_);
    guard_.want_size("the list of instances of the points that it evaluates", std::ssize(instances), x.cols());
    if ((request.gradients && !capabilities_.gradients) ||
        ((request.residuals || request.jacobians) && capabilities_.residuals == 0))
      guard_.fail("it asked the objective for gradients or residuals that the objective does not offer");
    for (Index i = 0; i < x.cols(); ++i) {
      const Index instance = instances[static_cast<std::size_t>(i)];
      if (instance < 0 || instance >= instances_ || (i > 0 && instance < instances[static_cast<std::size_t>(i - 1)])) {
        guard_.fail("it evaluates instance " + std::to_string(instance) + ", must ascend in [0, " +
                    std::to_string(instances_ - 1) + "]");
      }
      if (!all_finite(x.col(i))) guard_.fail_not_finite("a point x that it evaluates");
      if ((x.col(i).array() < bounds_.lower.array()).any() || (x.col(i).array() > bounds_.upper.array()).any())
        guard_.fail("a point x that it evaluates is out of bounds");
    }
  }

  Objective& objective_;
  const Guard& guard_;
  Index instances_;
  const Box& bounds_;
  Index dim_;
  ObjectiveCapabilities capabilities_;
  const Where* caller_;
};

class CheckedOptimiser final : public Optimiser {
 public:
  CheckedOptimiser(const std::string& name, std::shared_ptr<Optimiser> plugin, PluginChecks checks)
      : guard_(kKind, name, checks == PluginChecks::all), plugin_(std::move(plugin)) {}

  OptimiserCapabilities capabilities() const override {
    return guard_.call("capabilities()", [&] { return plugin_->capabilities(); });
  }

  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override {
    return guard_.call("minimise()", [&] {
      CheckedObjective watched(objective, guard_, starts.cols(), bounds);
      const OptimiserObserver watching = [&](Index iteration, const Vector& best_costs) {
        guard_.want_size("the best costs that it reports", best_costs.size(), starts.cols());
        if (best_costs.hasNaN()) guard_.fail("a best cost that it reports is NaN");
        return call_back([&] { return observer(iteration, best_costs); });
      };
      OptimiserOptions asked = options;
      if (options.wanted) {
        asked.wanted = [&](Index instance) {
          if (instance < 0 || instance >= starts.cols())
            guard_.fail("it asks whether instance " + std::to_string(instance) + " is wanted, must be in [0, " +
                        std::to_string(starts.cols() - 1) + "]");
          return call_back([&] { return options.wanted(instance); });
        };
      }
      auto results = plugin_->minimise(watched, starts, bounds, scale, asked, observer ? watching : nullptr);
      guard_.want_size("the list of results from minimise()", std::ssize(results), starts.cols());
      for (const auto& result : results) check(result, watched.dim(), bounds);
      return results;
    });
  }

 private:
  void check(const OptimiserResult& result, Index dim, const Box& bounds) const {
    guard_.want_size("x of a result from minimise()", result.x.size(), dim);
    guard_.want_finite("x of a result from minimise()", result.x);
    if (std::isnan(result.cost)) guard_.fail("the cost of a result from minimise() is NaN");
    if (result.status < OptimiserStatus::converged || result.status > OptimiserStatus::infeasible)
      guard_.fail("the status of a result from minimise() is none of OptimiserStatus");
    if (!guard_.callers_too()) return;
    if ((result.x.array() < bounds.lower.array()).any() || (result.x.array() > bounds.upper.array()).any())
      guard_.fail("x of a result from minimise() is out of bounds");
  }

  Guard guard_;
  std::shared_ptr<Optimiser> plugin_;
};

}  // namespace

std::shared_ptr<Optimiser> checked(const std::string& name, std::shared_ptr<Optimiser> plugin, PluginChecks checks) {
  return std::make_shared<CheckedOptimiser>(name, std::move(plugin), checks);
}

}  // namespace weft
