#pragma once
#include <functional>
#include <string>
#include <vector>

#include "weft/optimiser.hpp"

namespace weft {

/// The objective at one point. Entries that the request did not ask for are empty.
struct PointValue {
  double cost = 0.0;
  Vector gradient;      ///< [dim]
  Vector residuals;     ///< [r]
  Matrix jacobian;      ///< [r, dim]
  bool finite = false;  ///< cost and every requested entry are finite
};

/// One instance of a search, as the solver that runs it sees it.
class PointwiseSearch {
 public:
  virtual ~PointwiseSearch() = default;
  virtual Index instance() const = 0;
  /// Evaluates the objective at x, clamped into the box. Blocks until every other running instance has asked for a
  /// point or has ended. Then all points are evaluated in one batch.
  /// @param x [dim]. A non-finite point is not evaluated; its cost is +infinity.
  /// @return valid until the next call. Null when the search is over for this instance: its budget is spent, the
  /// observer stopped the search, it is not wanted any more, or an exception was thrown. Every later call also returns null; the solver should
  /// then return.
  virtual const PointValue* evaluate(ConstVec x, const EvaluationRequest& request) = 0;
  virtual bool over() const = 0;          ///< evaluate() would return null
  virtual void count_iteration() = 0;     ///< OptimiserResult::iterations
  virtual Index evaluations() const = 0;  ///< so far
  /// The best finite point so far, and its cost; the start and +infinity before there is one.
  virtual const Vector& best_x() const = 0;
  virtual double best_cost() const = 0;
  virtual bool last_was_finite() const = 0;  ///< the last evaluated point; false before the first
};

/// Why a solver ended by itself.
struct SolverOutcome {
  OptimiserStatus status = OptimiserStatus::converged;
  std::string message;
};
/// Minimises one instance from `start` ([dim], inside the box). Each instance runs on its own thread.
using PointwiseSolver = std::function<SolverOutcome(PointwiseSearch& search, const Vector& start)>;

/// Runs a solver that evaluates one point at a time on all instances, and evaluates their points in batches. The solver
/// then costs as little per evaluation as a batched one. Every instance has a thread, which waits at each evaluation.
/// When all running instances wait, the calling thread evaluates the batch and wakes them. It calls
/// Objective::evaluate once per kind of request in the batch (costs only, gradients, ...). Objective and observer are
/// called on the calling thread only.
///
/// The solvers' decisions alone fix which points share a batch; timing does not. Columns ascend by instance, and ended
/// instances are left out. So runs are equal bit for bit. Each instance also gets the bits of a run alone, because the
/// objectives of planning and estimation keep the columns independent. Where a predictor's bits depend on the row, they
/// pad the batch (predict_in_rows).
///
/// Handled here: bounds (points are clamped), max_evaluations, the best point, the observer (after every batch), OptimiserOptions::wanted and
/// exceptions. An exception of the objective, the observer or a solver ends all instances and is rethrown here; if
/// several solvers throw, that of the lowest instance. The solver handles max_iterations.
///
/// Cost: a thread per instance (about 20 us to start, 8 MB of address space) and a wake-up per instance and batch
/// (5 to 10 us on one core; tests/bench/bench_batching.cpp). A batch of predictions takes tens of milliseconds.
/// @throws as Optimiser::minimise; Error when the threads cannot be started.
WEFT_API std::vector<OptimiserResult> minimise_pointwise(const std::string& who, Objective& objective,
                                                         ConstMatrix starts, const Box& bounds, ConstVec scale,
                                                         const OptimiserOptions& options,
                                                         const OptimiserObserver& observer,
                                                         const PointwiseSolver& solver);

}  // namespace weft
