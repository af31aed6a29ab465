#include "nlopt.hpp"

#include <nlopt.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <memory>

#include "weft/batching.hpp"
#include "weft/config.hpp"
#include "weft/random.hpp"

namespace weft::nlopt_solver {
namespace {

struct Algorithm {
  const char* name;
  nlopt_algorithm code;
  bool gradients;
};
constexpr Algorithm kAlgorithms[] = {
    {"LBFGS", NLOPT_LD_LBFGS, true},
    {"MMA", NLOPT_LD_MMA, true},
    {"CCSAQ", NLOPT_LD_CCSAQ, true},
    {"SLSQP", NLOPT_LD_SLSQP, true},
    {"TNEWTON", NLOPT_LD_TNEWTON, true},
    {"TNEWTON_RESTART", NLOPT_LD_TNEWTON_RESTART, true},
    {"TNEWTON_PRECOND", NLOPT_LD_TNEWTON_PRECOND, true},
    {"TNEWTON_PRECOND_RESTART", NLOPT_LD_TNEWTON_PRECOND_RESTART, true},
    {"VAR1", NLOPT_LD_VAR1, true},
    {"VAR2", NLOPT_LD_VAR2, true},
    {"COBYLA", NLOPT_LN_COBYLA, false},
    {"BOBYQA", NLOPT_LN_BOBYQA, false},
    {"NELDERMEAD", NLOPT_LN_NELDERMEAD, false},
    {"SBPLX", NLOPT_LN_SBPLX, false},
    {"CRS2_LM", NLOPT_GN_CRS2_LM, false},
    {"ISRES", NLOPT_GN_ISRES, false},
    {"ESCH", NLOPT_GN_ESCH, false},
    {"DIRECT", NLOPT_GN_DIRECT, false},
    {"DIRECT_L", NLOPT_GN_DIRECT_L, false},
};

const Algorithm& find(const std::string& name) {
  for (const auto& one : kAlgorithms)
    if (name == one.name) return one;
  throw ConfigError("nlopt: no algorithm is called '" + name + "'" + nearest_hint(name, Params::algorithms()));
}

// Cost of a point without a finite value, as long as no point has a finite one (algorithms without gradients).
constexpr double kNothingFinite = 1e10;

using Handle = std::unique_ptr<nlopt_opt_s, decltype(&nlopt_destroy)>;

/// One instance as NLopt sees it: free variables only, in units of their scales.
struct Problem {
  PointwiseSearch& search;
  const Vector& scale;
  std::vector<Index> variables;
  Index most_evaluations = 0;
  bool gradients = false;
  nlopt_opt handle = nullptr;

  Vector x;             // all variables
  double factor = 1.0;  // on the cost
  bool spent = false;
  std::exception_ptr error;
  // The start, which is evaluated before NLopt runs. Most algorithms evaluate it again.
  Vector start;
  PointValue start_value;
  double worst = 0.0;  // finite cost seen

  double value(const double* y, double* gradient) {
    for (std::size_t k = 0; k < variables.size(); ++k) x[variables[k]] = y[k] * scale[variables[k]];
    const PointValue* v = x == start ? &start_value : evaluate();
    if (v == nullptr) {
      nlopt_force_stop(handle);
      if (gradient != nullptr) std::fill(gradient, gradient + variables.size(), 0.0);
      return HUGE_VAL;
    }
    if (v->finite) {
      worst = std::max(worst, v->cost);
      if (gradient != nullptr)
        for (std::size_t k = 0; k < variables.size(); ++k)
          gradient[k] = factor * v->gradient[variables[k]] * scale[variables[k]];
      return factor * v->cost;
    }
    // A bowl around the best point, through a cost here that is worse than any seen.
    const double best = search.best_cost();
    if (!std::isfinite(best)) return kNothingFinite;
    const double high = worst + 10.0 * (worst - best) + std::abs(worst) + 1e-3 / factor;
    if (gradient != nullptr) {
      double square = 0.0;
      for (std::size_t k = 0; k < variables.size(); ++k) {
        gradient[k] = y[k] - search.best_x()[variables[k]] / scale[variables[k]];
        square += gradient[k] * gradient[k];
      }
      for (std::size_t k = 0; k < variables.size(); ++k)
        gradient[k] *= square > 0.0 ? 2.0 * factor * (high - best) / square : 0.0;
    }
    return factor * high;
  }

  const PointValue* evaluate() {
    if (spent || search.evaluations() >= most_evaluations) {
      spent = true;
      return nullptr;
    }
    const PointValue* v = search.evaluate(x, {.gradients = gradients});
    if (v != nullptr && search.evaluations() > 1) search.count_iteration();
    return v;
  }

  static double call(unsigned, const double* y, double* gradient, void* data) {
    auto& self = *static_cast<Problem*>(data);
    try {
      return self.value(y, gradient);
    } catch (...) {  // no exception crosses NLopt's C frames
      if (!self.error) self.error = std::current_exception();
      self.spent = true;
      nlopt_force_stop(self.handle);
      return HUGE_VAL;
    }
  }
};

SolverOutcome outcome(nlopt_result code, const Problem& problem) {
  const char* said = nlopt_get_errmsg(problem.handle);
  const std::string text = nlopt_result_to_string(code) + (said != nullptr ? std::string(": ") + said : "");
  if (problem.spent) return {OptimiserStatus::budget_spent, text};
  switch (code) {
    case NLOPT_SUCCESS:
    case NLOPT_STOPVAL_REACHED:
    case NLOPT_FTOL_REACHED:
    case NLOPT_XTOL_REACHED:
    case NLOPT_ROUNDOFF_LIMITED:
      return {OptimiserStatus::converged, text};
    case NLOPT_MAXEVAL_REACHED:
    case NLOPT_MAXTIME_REACHED:
      return {OptimiserStatus::budget_spent, text};
    case NLOPT_FORCED_STOP:
      return {OptimiserStatus::stopped, text};
    case NLOPT_INVALID_ARGS:
      return {OptimiserStatus::infeasible, text};
    case NLOPT_OUT_OF_MEMORY:
      throw Error("nlopt: " + text);
    default:
      break;
  }
  // NLOPT_FAILURE: no step improves the cost, as at a minimum for which the tolerances are too fine, or there are no
  // more finite values.
  return {problem.search.last_was_finite() ? OptimiserStatus::converged : OptimiserStatus::diverged, text};
}

}  // namespace

std::vector<std::string> Params::algorithms() {
  std::vector<std::string> names;
  for (const auto& one : kAlgorithms) names.emplace_back(one.name);
  return names;
}

Nlopt::Nlopt(const Params& params) : p_(params) { find(p_.algorithm); }

OptimiserCapabilities Nlopt::capabilities() const {
  OptimiserCapabilities c;
  c.needs_gradients = find(p_.algorithm).gradients;
  return c;
}

std::vector<OptimiserResult> Nlopt::minimise(Objective& objective, ConstMatrix starts, const Box& bounds,
                                             ConstVec scale_in, const OptimiserOptions& options,
                                             const OptimiserObserver& observer) const {
  const Algorithm& algorithm = find(p_.algorithm);
  if (algorithm.gradients && !objective.capabilities().gradients)
    throw Unsupported("nlopt: the objective offers no gradients; algorithm " + p_.algorithm + " needs them");
  const Vector scale = scale_in;

  const auto solve = [&](PointwiseSearch& search, const Vector& start) -> SolverOutcome {
    Problem problem{search, scale};
    for (Index i = 0; i < bounds.dim(); ++i)
      if (bounds.lower[i] < bounds.upper[i]) problem.variables.push_back(i);
    problem.gradients = algorithm.gradients;
    // NLopt does not report its iterations, so every evaluation after the first counts as one.
    const Index iterations = std::max<Index>(0, options.max_iterations);
    problem.most_evaluations = std::min(options.max_evaluations, std::max(iterations, iterations + 1));
    problem.x = start;
    const PointValue* first = problem.evaluate();
    if (first == nullptr) return {OptimiserStatus::budget_spent, ""};
    if (!first->finite && algorithm.gradients) return {OptimiserStatus::diverged, "no finite value at the start"};
    problem.start_value = *first;
    if (problem.variables.empty()) return {OptimiserStatus::converged, "the box fixes every variable"};

    const auto n = problem.variables.size();
    std::vector<double> y(n), lower(n), upper(n), step(n);
    double largest = 0.0;
    problem.start = start;
    for (std::size_t k = 0; k < n; ++k) {
      const Index i = problem.variables[k];
      lower[k] = bounds.lower[i] / scale[i];
      upper[k] = bounds.upper[i] / scale[i];
      y[k] = std::clamp(start[i] / scale[i], lower[k], upper[k]);
      step[k] = std::min(p_.initial_step, 0.25 * (upper[k] - lower[k]));
      problem.start[i] = y[k] * scale[i];  // what value() makes of y
      if (algorithm.gradients) largest = std::max(largest, std::abs(first->gradient[i] * scale[i]));
    }
    if (algorithm.gradients) {
      if (largest == 0.0) return {OptimiserStatus::converged, "the gradient at the start is zero"};
      problem.factor = 1.0 / largest;
    }
    if (first->finite) problem.worst = first->cost;

    const Handle handle(nlopt_create(algorithm.code, static_cast<unsigned>(n)), &nlopt_destroy);
    if (!handle) throw Error("nlopt: cannot create " + p_.algorithm);
    problem.handle = handle.get();
    nlopt_set_min_objective(problem.handle, &Problem::call, &problem);
    nlopt_set_lower_bounds(problem.handle, lower.data());
    nlopt_set_upper_bounds(problem.handle, upper.data());
    nlopt_set_ftol_rel(problem.handle, p_.relative_tolerance);
    nlopt_set_xtol_abs1(problem.handle, p_.step_tolerance);
    if (!algorithm.gradients) nlopt_set_initial_step(problem.handle, step.data());
    if (p_.vector_storage > 0) nlopt_set_vector_storage(problem.handle, static_cast<unsigned>(p_.vector_storage));
    if (p_.population > 0) nlopt_set_population(problem.handle, static_cast<unsigned>(p_.population));
    // NLopt's generator belongs to the thread, and every instance has a thread of its own.
    RandomStream random(options.seed, static_cast<std::uint64_t>(search.instance()));
    nlopt_srand(random.bits());

    double cost = 0.0;
    const nlopt_result code = nlopt_optimize(problem.handle, y.data(), &cost);
    if (problem.error) std::rethrow_exception(problem.error);
    return outcome(code, problem);
  };
  return minimise_pointwise("nlopt", objective, starts, bounds, scale, options, observer, solve);
}

}  // namespace weft::nlopt_solver
