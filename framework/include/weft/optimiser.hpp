#pragma once
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "weft/error.hpp"
#include "weft/types.hpp"

namespace weft {

struct ObjectiveCapabilities {
  bool gradients = false;
  Index residuals = 0;  ///< > 0: cost = 1/2 |residuals|^2, and residuals and Jacobians are offered
};

/// What an objective is asked for on a batch of n points.
struct EvaluationRequest {
  bool gradients = false;
  bool residuals = false;
  bool jacobians = false;  ///< of the residuals; only together with them
  bool operator==(const EvaluationRequest&) const = default;
};

/// Results for n points. A point that cannot be evaluated has cost = +infinity (and anything in its other entries).
struct Evaluation {
  Vector costs;                   ///< [n]
  Matrix gradients;               ///< [dim, n] when asked for
  Matrix residuals;               ///< [r, n] when asked for
  std::vector<Matrix> jacobians;  ///< [n] of [r, dim] when asked for
};

/// A batched function to be minimised: all instances of a search run through one predictor call.
class WEFT_API Objective {
 public:
  virtual ~Objective() = default;
  virtual Index dim() const = 0;
  virtual ObjectiveCapabilities capabilities() const = 0;
  /// @param x [dim, n]; @param instances [n]: which instance each column belongs to, ascending (noise is keyed on it).
  /// Solvers that sample a population give an instance several columns in one call; the others one.
  /// @throws Unsupported for what capabilities() does not offer.
  virtual Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) = 0;
};

struct OptimiserOptions {
  Index max_iterations = 80;
  Index max_evaluations =
      std::numeric_limits<Index>::max();  ///< per instance; points evaluated, with or without gradient
  std::uint64_t seed = 0;                 ///< for stochastic solvers
};

/// One meaning each: converged: the solver's own stopping rule was met; budget_spent: max_iterations or
/// max_evaluations; stopped: the observer said so; diverged: no finite cost was found; infeasible: the problem cannot
/// be solved by this solver.
enum class OptimiserStatus { converged, budget_spent, stopped, diverged, infeasible };
WEFT_API const char* to_string(OptimiserStatus status);

/// Outcome of one instance. x is the best point that was evaluated, and cost its cost.
struct OptimiserResult {
  OptimiserStatus status = OptimiserStatus::diverged;
  std::string message;
  Vector x;  ///< [dim]
  double cost = std::numeric_limits<double>::infinity();
  Index iterations = 0;
  Index evaluations = 0;
};

/// Called after every batch of evaluations (for most solvers that is an iteration) with the number of calls before this
/// one and the best cost so far of every instance [instances] (+infinity before the first finite one); returning false
/// stops the search there. Called on the thread that called minimise.
using OptimiserObserver = std::function<bool(Index iteration, const Vector& best_costs)>;

/// What a solver asks an objective for; it evaluates nothing else.
struct OptimiserCapabilities {
  bool needs_gradients = false;
  bool needs_residuals = false;  ///< with their Jacobians
};

/// Minimises several instances of one objective at the same time. Stateless: minimise() may run on many threads.
class WEFT_API Optimiser {
 public:
  static constexpr const char* kKind = "optimiser";
  static constexpr int kVersion = 2;  // bump on any change to this class or the types above
  virtual ~Optimiser() = default;

  virtual OptimiserCapabilities capabilities() const = 0;
  /// @param starts [dim, instances], clamped into bounds. @param bounds finite, units of x; no point outside is
  /// evaluated.
  /// @param scale [dim], > 0: a typical change of each variable; step sizes are multiples of it.
  /// @return [instances]. A non-finite cost or gradient costs that instance, never the others.
  /// @throws ShapeError; Unsupported if the objective lacks what capabilities() needs; what the objective throws.
  virtual std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds,
                                                ConstVec scale, const OptimiserOptions& options,
                                                const OptimiserObserver& observer) const = 0;
};

/// What every solver demands of its input, checked before the first evaluation; `who` starts the messages.
/// @throws ShapeError for sizes; Error for a start, bound or scale that is not finite, lower > upper, or scale <= 0.
WEFT_API void check_search(const std::string& who, const Objective& objective, ConstMatrix starts, const Box& bounds,
                           ConstVec scale);

}  // namespace weft
