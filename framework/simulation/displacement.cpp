#include "simulation/displacement.hpp"

#include <cmath>

namespace weft {

DisplacementResult tune_displacement(const Task& task, Simulator& simulator, const MaterialProperties& material,
                                     const Cancelled& cancelled, double tolerance_m) {
  const Eigen::Vector2d direction = Eigen::Vector2d(task.manipulation.displacement).normalized();
  if (task.start) throw ConfigError("displacement: takes a flat garment; leave start.session out");
  const auto& rest = task.garment->positions;
  const Vector along = rest.leftCols<2>() * direction;
  const double middle = 0.5 * (along.minCoeff() + along.maxCoeff());
  const double grasp = (task.manipulation.grasp_points.leftCols<2>() * direction).mean();
  const double geometric = 2.0 * (middle - grasp);
  if (geometric <= 0.0) {
    throw ConfigError("displacement: the grasp points lie beyond the middle of the garment along d; reverse d");
  }
  DisplacementResult result;
  const auto misfit = [&](double length) {
    Task candidate = task;
    candidate.manipulation.displacement = length * direction;
    const Controls controls = 0.5 * task.trajectory->default_controls(60);
    const auto fold = simulate_fold(simulator, candidate, material, controls, cancelled);
    ++result.evaluations;
    double sum = 0.0;
    Index count = 0;
    for (Index v = 0; v < rest.rows(); ++v) {
      if (along(v) >= middle) continue;
      const Eigen::Vector2d mirrored = rest.row(v).head<2>().transpose() + 2.0 * (middle - along(v)) * direction;
      sum += (fold.shapes.back().row(v).head<2>().transpose() - mirrored).norm();
      ++count;
    }
    return 1e3 * sum / static_cast<double>(count);
  };
  const double ratio = 0.5 * (std::sqrt(5.0) - 1.0);
  double low = 0.8 * geometric, high = 1.25 * geometric;
  double a = high - ratio * (high - low), b = low + ratio * (high - low);
  double at_a = misfit(a), at_b = misfit(b);
  while (high - low > tolerance_m) {
    if (at_a < at_b) {
      high = b;
      b = a;
      at_b = at_a;
      at_a = misfit(a = high - ratio * (high - low));
    } else {
      low = a;
      a = b;
      at_a = at_b;
      at_b = misfit(b = low + ratio * (high - low));
    }
  }
  result.displacement = (at_a < at_b ? a : b) * direction;
  result.misfit_mm = std::min(at_a, at_b);
  return result;
}

}  // namespace weft
