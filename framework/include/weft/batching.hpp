#pragma once
#include <functional>
#include <string>
#include <vector>

#include "weft/optimiser.hpp"

namespace weft {

/// The objective at one point. What was not asked for is empty.
struct PointValue {
  double cost = 0.0;
  Vector gradient;      ///< [dim]
  Vector residuals;     ///< [r]
  Matrix jacobian;      ///< [r, dim]
  bool finite = false;  ///< cost and everything that was asked for
};

/// One instance of a search, as the solver that runs it sees it.
class PointwiseSearch {
 public:
  virtual ~PointwiseSearch() = default;
  virtual Index instance() const = 0;
  /// The objective at x, which is clamped into the box first. Blocks until every other running instance has asked for a
  /// point too, or has ended; then all of them are evaluated in one batch.
  /// @param x [dim]; a point that is not finite is not evaluated and comes back with cost +infinity.
  /// @return valid until the next call; null when the search is over for this instance: its budget is spent, the
  /// observer said so, or an exception is on its way. Every later call returns null as well: let the solver end by its
  /// own means.
  virtual const PointValue* evaluate(ConstVec x, const EvaluationRequest& request) = 0;
  virtual bool over() const = 0;          ///< evaluate() would return null
  virtual void count_iteration() = 0;     ///< OptimiserResult::iterations
  virtual Index evaluations() const = 0;  ///< so far
  /// The best finite point so far, and its cost; the start and +infinity before there is one.
  virtual const Vector& best_x() const = 0;
  virtual double best_cost() const = 0;
  virtual bool last_was_finite() const = 0;  ///< the last evaluated point; false before the first
};

/// What a solver says when it ends by itself.
struct SolverOutcome {
  OptimiserStatus status = OptimiserStatus::converged;
  std::string message;
};
/// Minimises one instance from `start` ([dim], inside the box). Runs on a thread of its own.
using PointwiseSolver = std::function<SolverOutcome(PointwiseSearch& search, const Vector& start)>;

/// The batching evaluator: runs a solver that evaluates one point at a time on every instance at once, so that it pays
/// what a batched solver pays per evaluation. One plain thread per instance; they wait for each other at every
/// evaluation, and when all that still run have asked, this thread evaluates the batch (one call of Objective::evaluate
/// per kind of request in it: costs only, gradients, ...) and wakes them. Objective and observer are called on the
/// calling thread only.
///
/// Which points share a batch depends on the solvers' decisions and never on timing: the columns ascend by instance,
/// and an instance that has ended is left out. So results are equal bit for bit from run to run, and equal to those of
/// every instance alone, as the objectives of planning and estimation keep the columns independent: where a predictor's
/// bits depend on the row, they pad (predict_in_rows).
///
/// Does for the solver: bounds (points are clamped), max_evaluations, the best point, the observer (after every batch),
/// and exceptions: what the objective, the observer or a solver throws ends all instances and is rethrown here (of
/// several solvers that of the lowest instance). max_iterations is the solver's own business.
///
/// Cost: a thread per instance (some 20 us to start, 8 MB of address space) and a wake-up per instance and batch (some
/// 5 to 10 us on one core; tests/bench/bench_batching.cpp), to be set against tens of milliseconds for a batch of
/// predictions.
/// @throws as Optimiser::minimise; Error when the threads cannot be started.
WEFT_API std::vector<OptimiserResult> minimise_pointwise(const std::string& who, Objective& objective,
                                                         ConstMatrix starts, const Box& bounds, ConstVec scale,
                                                         const OptimiserOptions& options,
                                                         const OptimiserObserver& observer,
                                                         const PointwiseSolver& solver);

}  // namespace weft
