#pragma once
#include <string>
#include <vector>

#include "weft/optimiser.hpp"
#include "weft/params.hpp"

namespace weft::nlopt_solver {

struct Params {
  std::string algorithm = "LBFGS";
  double relative_tolerance = 1e-7;
  double step_tolerance = 1e-5;
  double initial_step = 1.0;
  std::int64_t vector_storage = 0;
  std::int64_t population = 0;

  /// NLopt's names without their prefixes GN_, LN_ and LD_. README.md lists those that are left out.
  static std::vector<std::string> algorithms();

  template <class Visitor>
  void visit(Visitor& v) {
    v("algorithm", algorithm, choice(algorithms()), "NLopt's algorithm, without its GN_, LN_ or LD_.");
    v("relative_tolerance", relative_tolerance, range(0, 1),
      "NLopt's ftol_rel: converged when a step changes the cost by a smaller part.");
    v("step_tolerance", step_tolerance, range(0, 1e6),
      "NLopt's xtol_abs: converged when a step changes every variable by less, in units of its scale.");
    v("initial_step", initial_step, range(1e-9, 1e6),
      "First step of the algorithms without gradients, in units of each variable's scale; "
      "at most a quarter of the box.");
    v("vector_storage", vector_storage, range(0, 10000),
      "Steps that LBFGS, VAR* and TNEWTON* remember; 0: NLopt's choice.");
    v("population", population, range(0, 1000000), "Points of CRS2_LM and ISRES; 0: NLopt's choice.");
  }
};

/// NLopt [Johnson, nlopt.readthedocs.io; version 2.7.1] on every instance at once, through the framework's batching
/// evaluator. It searches over x_i / scale_i inside NLopt's own bounds. For the algorithms with gradients the cost is
/// divided by the largest entry of the first gradient, because MMA, CCSAQ and LBFGS take their first step from it. A
/// point without a finite value gets a cost above all earlier ones, with a gradient that leads back to the best point.
/// The models of several algorithms would not survive an infinite cost.
class Nlopt final : public Optimiser {
 public:
  explicit Nlopt(const Params& params);
  OptimiserCapabilities capabilities() const override;
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override;

 private:
  Params p_;
};

}  // namespace weft::nlopt_solver
