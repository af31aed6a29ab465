#pragma once
#include <string>
#include <vector>

#include "weft/optimiser.hpp"
#include "weft/params.hpp"

namespace weft::ceres_solver {

/// Names and defaults are those of Ceres; README.md gives the reason for each exception.
struct Params {
  std::string method = "lbfgs";
  double function_tolerance = 1e-6;
  double gradient_tolerance = 1e-8;
  double parameter_tolerance = 1e-8;

  struct LineSearch {
    std::string type = "wolfe";
    std::string interpolation = "cubic";
    std::string nonlinear_cg = "fletcher_reeves";
    std::int64_t lbfgs_rank = 20;
    bool approximate_eigenvalue_scaling = false;
    double initial_step = 0.5;
    double start_margin = 0.01;
    double sufficient_decrease = 1e-4;
    double sufficient_curvature_decrease = 0.9;
    double max_contraction = 1e-3;
    double min_contraction = 0.6;
    double max_expansion = 10.0;
    double min_step_size = 1e-9;
    std::int64_t max_step_size_iterations = 20;
    std::int64_t max_direction_restarts = 5;
    template <class Visitor>
    void visit(Visitor& v) {
      v("type", type, choice({"wolfe", "armijo"}), "Condition on a step; bfgs and lbfgs need wolfe.");
      v("interpolation", interpolation, choice({"cubic", "quadratic", "bisection"}),
        "Interpolation that guesses the next step.");
      v("nonlinear_cg", nonlinear_cg, choice({"fletcher_reeves", "polak_ribiere", "hestenes_stiefel"}),
        "Direction update of nonlinear_conjugate_gradient.");
      v("lbfgs_rank", lbfgs_rank, range(1, 1000), "Steps that lbfgs remembers.");
      v("approximate_eigenvalue_scaling", approximate_eigenvalue_scaling,
        "Scale the first inverse Hessian of (l)bfgs by its approximate largest eigenvalue.");
      v("initial_step", initial_step, range(1e-6, 1e6),
        "Largest change of a variable in the first trial step, in units of its scale.");
      v("start_margin", start_margin, range(1e-9, 0.5),
        "A start closer to a bound than this part of half the box is moved to that distance.");
      v("sufficient_decrease", sufficient_decrease, range(1e-12, 0.5), "Armijo's constant.");
      v("sufficient_curvature_decrease", sufficient_curvature_decrease, range(1e-6, 0.999999), "Wolfe's constant.");
      v("max_contraction", max_contraction, range(1e-9, 0.999), "Smallest factor from one trial step to the next.");
      v("min_contraction", min_contraction, range(1e-9, 0.999),
        "Largest factor from one trial step to the next, when steps get shorter.");
      v("max_expansion", max_expansion, range(1.001, 1e6),
        "Largest factor from one trial step to the next while a Wolfe bracket is searched for.");
      v("min_step_size", min_step_size, range(0, 1), "Shorter steps end the search.");
      v("max_step_size_iterations", max_step_size_iterations, range(1, 1000), "Trials of one line search.");
      v("max_direction_restarts", max_direction_restarts, range(0, 1000), "Restarts along the gradient.");
    }
  } line_search;

  struct TrustRegion {
    std::string dogleg = "traditional";
    std::string linear_solver = "dense_qr";
    double initial_radius = 1e4;
    double max_radius = 1e16;
    double min_radius = 1e-32;
    double min_relative_decrease = 1e-3;
    double min_lm_diagonal = 1e-6;
    double max_lm_diagonal = 1e32;
    bool jacobi_scaling = true;
    bool nonmonotonic_steps = false;
    std::int64_t max_invalid_steps = 10;
    template <class Visitor>
    void visit(Visitor& v) {
      v("dogleg", dogleg, choice({"traditional", "subspace"}), "Kind of dogleg.");
      v("linear_solver", linear_solver, choice({"dense_qr", "dense_normal_cholesky"}),
        "For the normal equations; cholesky is faster, qr more exact.");
      v("initial_radius", initial_radius, range(1e-12, 1e16), "First radius of the trust region.");
      v("max_radius", max_radius, range(1e-12, 1e32), "Largest radius of the trust region.");
      v("min_radius", min_radius, range(0, 1e16), "Converged when the radius is smaller.");
      v("min_relative_decrease", min_relative_decrease, range(0, 1),
        "Least part of the predicted decrease that a step must achieve.");
      v("min_lm_diagonal", min_lm_diagonal, range(0, 1e32), "Least damping of a variable.");
      v("max_lm_diagonal", max_lm_diagonal, range(0, 1e32), "Most damping of a variable.");
      v("jacobi_scaling", jacobi_scaling, "Scale the columns of the Jacobian to length 1.");
      v("nonmonotonic_steps", nonmonotonic_steps, "Allow steps that raise the cost for a while.");
      v("max_invalid_steps", max_invalid_steps, range(0, 1000),
        "Steps in a row to points without a finite value before giving up.");
    }
  } trust_region;

  template <class Visitor>
  void visit(Visitor& v) {
    v("method", method,
      choice({"lbfgs", "bfgs", "nonlinear_conjugate_gradient", "steepest_descent", "levenberg_marquardt", "dogleg"}),
      "The first four are line searches on the cost, the last two least squares on its residuals.");
    v("function_tolerance", function_tolerance, range(0, 1),
      "Converged when an iteration changes the cost by a smaller part of it.");
    v("gradient_tolerance", gradient_tolerance, range(0, 1e6),
      "Converged when no gradient entry is larger. Line search: relative to the first gradient's largest.");
    v("parameter_tolerance", parameter_tolerance, range(0, 1),
      "Converged when a step is a smaller part of the variables.");
    v.group("line_search", line_search, "lbfgs, bfgs, nonlinear_conjugate_gradient, steepest_descent.");
    v.group("trust_region", trust_region, "levenberg_marquardt, dogleg.");
  }
};

/// Ceres Solver [Agarwal, Mierle and others, ceres-solver.org; version 2.1] on every instance at once, through the
/// framework's batching evaluator.
///
/// Line searches know no bounds, so they search over z with
///     x_i = mid_i + half_i sin(z_i scale_i / half_i),    dx_i/dz_i = scale_i cos(z_i scale_i / half_i),
/// mid and half the middle and half the width of the box: every z lies in the box, its faces can be reached, and in the
/// middle of the box z_i is x_i in units of its scale. On a face dx/dz = 0, so a start there is moved inwards
/// (start_margin; the start itself is evaluated, too). The cost is divided by the largest entry of the first gradient
/// over z, so that Ceres' first trial step moves no variable by more than initial_step scales.
///
/// Least squares searches over x_i / scale_i within Ceres' own bounds.
class Ceres final : public Optimiser {
 public:
  /// @throws ConfigError for options that Ceres refuses.
  explicit Ceres(const Params& params);
  OptimiserCapabilities capabilities() const override;
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override;

 private:
  Params p_;
  bool least_squares_;
};

}  // namespace weft::ceres_solver
