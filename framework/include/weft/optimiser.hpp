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
  Index residuals = 0;  ///< r > 0: cost = 1/2 |residuals|^2; evaluate() can return residuals [r] and their Jacobian
};

/// What Objective::evaluate() computes besides the costs.
struct EvaluationRequest {
  bool gradients = false;
  bool residuals = false;
  bool jacobians = false;  ///< of the residuals; needs `residuals` too
  bool operator==(const EvaluationRequest&) const = default;
};

/// Results for n points. A point that cannot be evaluated has cost = +infinity; its other entries are undefined.
struct Evaluation {
  Vector costs;                   ///< [n]
  Matrix gradients;               ///< [dim, n] if requested
  Matrix residuals;               ///< [r, n] if requested
  std::vector<Matrix> jacobians;  ///< [n] of [r, dim] if requested
};

/// The function to minimise, evaluated in batches: one predictor call serves all instances of a search.
class WEFT_API Objective {
 public:
  virtual ~Objective() = default;
  virtual Index dim() const = 0;
  virtual ObjectiveCapabilities capabilities() const = 0;
  /// @param x [dim, n]; @param instances [n]: the instance of each column, ascending (noise is keyed on it). Solvers
  /// that sample a population pass several columns per instance; the others pass one.
  /// @throws Unsupported for a request beyond capabilities().
  virtual Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) = 0;
};

struct OptimiserOptions {
  Index max_iterations = 80;
  /// Points evaluated per instance, with or without gradient.
  Index max_evaluations = std::numeric_limits<Index>::max();
  std::uint64_t seed = 0;  ///< for stochastic solvers
  /// Whether an instance shall go on; null: all shall. Asked after the observer, on the thread that called minimise(). An
  /// instance that shall not ends as `stopped` with its best point, and no other changes by that. A solver may ignore this:
  /// it then costs more, and its results are as good.
  std::function<bool(Index instance)> wanted;
};

/// Why a search ended.
enum class OptimiserStatus {
  converged,     ///< the solver's own stopping rule was met
  budget_spent,  ///< max_iterations or max_evaluations was reached
  stopped,       ///< the observer returned false
  diverged,      ///< no finite cost was found
  infeasible,    ///< this solver cannot solve the problem
};
WEFT_API const char* to_string(OptimiserStatus status);

/// Outcome of one instance. x is the best evaluated point, cost its cost.
struct OptimiserResult {
  OptimiserStatus status = OptimiserStatus::diverged;
  std::string message;
  Vector x;  ///< [dim]
  double cost = std::numeric_limits<double>::infinity();
  Index iterations = 0;
  Index evaluations = 0;
};

/// Called after every batch of evaluations (for most solvers, an iteration), on the thread that called minimise.
/// `iteration` counts the earlier calls. `best_costs` [instances] are the best costs so far; +infinity before the first
/// finite one. Returning false stops the search.
using OptimiserObserver = std::function<bool(Index iteration, const Vector& best_costs)>;

/// What a solver needs besides costs. It requests nothing else.
struct OptimiserCapabilities {
  bool needs_gradients = false;
  bool needs_residuals = false;  ///< with their Jacobians
};

/// Minimises several instances of one objective at the same time. Stateless: minimise() may run on many threads.
class WEFT_API Optimiser {
 public:
  static constexpr const char* kKind = "optimiser";
  static constexpr int kVersion = 3;  // bump on any change to this class or the types above
  static constexpr TypeSize kCrossing[] = {{"ObjectiveCapabilities", sizeof(ObjectiveCapabilities)},
                                           {"EvaluationRequest", sizeof(EvaluationRequest)},
                                           {"Evaluation", sizeof(Evaluation)},
                                           {"OptimiserOptions", sizeof(OptimiserOptions)},
                                           {"OptimiserResult", sizeof(OptimiserResult)},
                                           {"OptimiserObserver", sizeof(OptimiserObserver)},
                                           {"OptimiserCapabilities", sizeof(OptimiserCapabilities)},
                                           {"Box", sizeof(Box)},
                                           {"ConstMatrix", sizeof(ConstMatrix)}};
  virtual ~Optimiser() = default;

  virtual OptimiserCapabilities capabilities() const = 0;
  /// @param starts [dim, instances], clamped into bounds.
  /// @param bounds finite, units of x; no point outside is evaluated.
  /// @param scale [dim], > 0: a typical change of each variable; step sizes are multiples of it.
  /// @return [instances]. A non-finite cost or gradient affects its own instance only.
  /// @throws ShapeError; Unsupported if the objective lacks what capabilities() needs; any error of the objective.
  virtual std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds,
                                                ConstVec scale, const OptimiserOptions& options,
                                                const OptimiserObserver& observer) const = 0;
};

/// Checks that every solver makes before its first evaluation. Messages start with `who`.
/// @throws ShapeError for sizes; Error for a start, bound or scale that is not finite, lower > upper, or scale <= 0.
WEFT_API void check_search(const std::string& who, const Objective& objective, ConstMatrix starts, const Box& bounds,
                           ConstVec scale);

}  // namespace weft
