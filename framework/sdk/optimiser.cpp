#include "weft/optimiser.hpp"

#include <cmath>

namespace weft {

const char* to_string(OptimiserStatus status) {
  switch (status) {
    case OptimiserStatus::converged:
      return "converged";
    case OptimiserStatus::budget_spent:
      return "budget_spent";
    case OptimiserStatus::stopped:
      return "stopped";
    case OptimiserStatus::diverged:
      return "diverged";
    case OptimiserStatus::infeasible:
      return "infeasible";
  }
  return "";
}

void check_search(const std::string& who, const Objective& objective, ConstMatrix starts, const Box& bounds,
                  ConstVec scale) {
  const Index dim = objective.dim();
  require_shape(who + ": rows of starts", starts.rows(), dim);
  require_shape(who + ": bounds.lower", bounds.lower.size(), dim);
  require_shape(who + ": bounds.upper", bounds.upper.size(), dim);
  require_shape(who + ": scale", scale.size(), dim);
  if (!starts.allFinite()) throw Error(who + ": starts must be finite");
  for (Index i = 0; i < dim; ++i) {
    const std::string at = "[" + std::to_string(i) + "]";
    if (!std::isfinite(bounds.lower[i]) || !std::isfinite(bounds.upper[i]) || bounds.lower[i] > bounds.upper[i])
      throw Error(who + ": bounds" + at + " = [" + std::to_string(bounds.lower[i]) + ", " +
                  std::to_string(bounds.upper[i]) + "], must be finite with lower <= upper");
    if (!(scale[i] > 0.0) || !std::isfinite(scale[i]))
      throw Error(who + ": scale" + at + " = " + std::to_string(scale[i]) + ", must be finite and > 0");
  }
}

}  // namespace weft
