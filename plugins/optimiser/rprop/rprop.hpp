#pragma once
#include <vector>

#include "weft/optimiser.hpp"
#include "weft/params.hpp"

namespace weft::rprop {

struct Params {
  double increase = 1.2;
  double decrease = 0.5;
  double initial_step = 0.1;
  double max_step = 0.25;
  double min_step = 1e-6;
  double step_tolerance = 1e-5;
  double relative_tolerance = 1e-6;
  std::int64_t patience = 30;
  std::int64_t max_retries = 8;

  template <class Visitor>
  void visit(Visitor& v) {
    v("increase", increase, range(1.0, 10.0), "Factor on a step whose gradient kept its sign.");
    v("decrease", decrease, range(0.01, 1.0), "Factor on a step whose gradient changed its sign.");
    v("initial_step", initial_step, range(1e-9, 1e6), "First step, as a multiple of the variable's scale.");
    v("max_step", max_step, range(1e-9, 1.0), "Largest step, as a fraction of the variable's box.");
    v("min_step", min_step, range(0.0, 1.0), "Smallest step, as a multiple of the variable's scale.");
    v("step_tolerance", step_tolerance, range(0.0, 1.0),
      "Converged when every step is at most this multiple of its scale.");
    v("relative_tolerance", relative_tolerance, range(0.0, 1.0),
      "Converged when `patience` iterations improve the best cost by no more than this part of it.");
    v("patience", patience, range(1.0, 1e9), "Iterations over which relative_tolerance is measured.");
    v("max_retries", max_retries, range(0.0, 100.0),
      "Steps back in a row from a non-finite cost or gradient before an instance counts as diverged.");
  }
};

/// Rprop-: resilient backpropagation without weight backtracking [Igel & Huesken 2003, "Empirical evaluation of the
/// improved Rprop learning algorithms", sec. 2.2]. For every variable i on its own, g the gradient, D the step:
///     D_i <- min(increase D_i, D_max) if g_i(t) g_i(t-1) > 0;  max(decrease D_i, D_min) if < 0;  else D_i
///     x_i <- x_i - sign(g_i(t)) D_i
/// Departures: steps are in units of the variable's scale and bounded by its box (their D_max = 50 means nothing for a
/// variable in [0, 1]). x is projected on the box, and a step that the box cuts off does not grow. The result is the
/// best point, not the last one.
class Rprop final : public Optimiser {
 public:
  explicit Rprop(const Params& params) : p_(params) {}
  OptimiserCapabilities capabilities() const override;
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override;

 private:
  Params p_;
};

}  // namespace weft::rprop
