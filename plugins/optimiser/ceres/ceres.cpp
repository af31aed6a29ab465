#include "ceres.hpp"

#include <ceres/ceres.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>

#include "weft/batching.hpp"

namespace weft::ceres_solver {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

int to_int(Index n) { return static_cast<int>(std::min<Index>(n, std::numeric_limits<int>::max())); }

::ceres::GradientProblemSolver::Options line_search_options(const Params& p) {
  const auto& l = p.line_search;
  ::ceres::GradientProblemSolver::Options o;
  o.line_search_direction_type = p.method == "steepest_descent"               ? ::ceres::STEEPEST_DESCENT
                                 : p.method == "nonlinear_conjugate_gradient" ? ::ceres::NONLINEAR_CONJUGATE_GRADIENT
                                 : p.method == "bfgs"                         ? ::ceres::BFGS
                                                                              : ::ceres::LBFGS;
  o.line_search_type = l.type == "armijo" ? ::ceres::ARMIJO : ::ceres::WOLFE;
  o.line_search_interpolation_type = l.interpolation == "bisection"   ? ::ceres::BISECTION
                                     : l.interpolation == "quadratic" ? ::ceres::QUADRATIC
                                                                      : ::ceres::CUBIC;
  o.nonlinear_conjugate_gradient_type = l.nonlinear_cg == "polak_ribiere"      ? ::ceres::POLAK_RIBIERE
                                        : l.nonlinear_cg == "hestenes_stiefel" ? ::ceres::HESTENES_STIEFEL
                                                                               : ::ceres::FLETCHER_REEVES;
  o.max_lbfgs_rank = static_cast<int>(l.lbfgs_rank);
  o.use_approximate_eigenvalue_bfgs_scaling = l.approximate_eigenvalue_scaling;
  o.min_line_search_step_size = l.min_step_size;
  o.line_search_sufficient_function_decrease = l.sufficient_decrease;
  o.line_search_sufficient_curvature_decrease = l.sufficient_curvature_decrease;
  o.max_line_search_step_contraction = l.max_contraction;
  o.min_line_search_step_contraction = l.min_contraction;
  o.max_line_search_step_expansion = l.max_expansion;
  o.max_num_line_search_step_size_iterations = static_cast<int>(l.max_step_size_iterations);
  o.max_num_line_search_direction_restarts = static_cast<int>(l.max_direction_restarts);
  o.function_tolerance = p.function_tolerance;
  o.gradient_tolerance = p.gradient_tolerance;
  o.parameter_tolerance = p.parameter_tolerance;
  o.logging_type = ::ceres::SILENT;
  o.minimizer_progress_to_stdout = false;
  return o;
}

::ceres::Solver::Options least_squares_options(const Params& p) {
  const auto& t = p.trust_region;
  ::ceres::Solver::Options o;
  o.minimizer_type = ::ceres::TRUST_REGION;
  o.trust_region_strategy_type = p.method == "dogleg" ? ::ceres::DOGLEG : ::ceres::LEVENBERG_MARQUARDT;
  o.dogleg_type = t.dogleg == "subspace" ? ::ceres::SUBSPACE_DOGLEG : ::ceres::TRADITIONAL_DOGLEG;
  o.linear_solver_type = t.linear_solver == "dense_qr" ? ::ceres::DENSE_QR : ::ceres::DENSE_NORMAL_CHOLESKY;
  o.dense_linear_algebra_library_type = ::ceres::EIGEN;  // the same bits whichever LAPACK the system has
  o.initial_trust_region_radius = t.initial_radius;
  o.max_trust_region_radius = t.max_radius;
  o.min_trust_region_radius = t.min_radius;
  o.min_relative_decrease = t.min_relative_decrease;
  o.min_lm_diagonal = t.min_lm_diagonal;
  o.max_lm_diagonal = t.max_lm_diagonal;
  o.jacobi_scaling = t.jacobi_scaling;
  o.use_nonmonotonic_steps = t.nonmonotonic_steps;
  o.max_num_consecutive_invalid_steps = static_cast<int>(t.max_invalid_steps);
  o.function_tolerance = p.function_tolerance;
  o.gradient_tolerance = p.gradient_tolerance;
  o.parameter_tolerance = p.parameter_tolerance;
  // Steps are projected into the box. With bounds Ceres would also search along each step, and that search would ask
  // for a Jacobian at every trial.
  o.max_num_line_search_step_size_iterations = 0;
  o.num_threads = 1;  // evaluations stay on the instance's own thread
  o.logging_type = ::ceres::SILENT;
  o.minimizer_progress_to_stdout = false;
  return o;
}

/// The variables that the box leaves free; Ceres knows no others.
struct FreeVariables {
  explicit FreeVariables(const Box& box) {
    for (Index i = 0; i < box.dim(); ++i)
      if (box.lower[i] < box.upper[i]) index.push_back(i);
  }
  Index size() const { return index.size(); }
  Index operator[](Index k) const { return index[k]; }
  std::vector<Index> index;
};

class LineSearchFunction final : public ::ceres::FirstOrderFunction {
 public:
  LineSearchFunction(PointwiseSearch& search, const Vector& start, const Box& box, const Vector& scale,
                     const FreeVariables& variables, double margin)
      : search_(search), variables_(variables), x_(start), z_(variables.size()) {
    const Index n = variables.size();
    mid_.resize(n), half_.resize(n), scale_.resize(n);
    for (Index k = 0; k < n; ++k) {
      const Index i = variables[k];
      mid_[k] = 0.5 * (box.lower[i] + box.upper[i]);
      half_[k] = 0.5 * (box.upper[i] - box.lower[i]);
      scale_[k] = scale[i];
      const double s = (start[i] - mid_[k]) / half_[k];
      const double inside = std::clamp(s, margin - 1.0, 1.0 - margin);
      moved_ = moved_ || inside != s;
      z_[k] = std::asin(inside) * half_[k] / scale_[k];
    }
  }
  const Vector& start() const { return z_; }
  bool start_was_moved() const { return moved_; }

  /// Divides the cost so that the largest gradient entry at the start becomes initial_step. @return false without a
  /// value.
  bool normalise(double initial_step) {
    Vector gradient(z_.size());
    double cost = 0.0;
    const Vector z = z_;
    if (!Evaluate(z.data(), &cost, gradient.data())) return false;
    const double largest = gradient.cwiseAbs().maxCoeff();
    if (largest > 0.0) factor_ = initial_step / largest;
    return std::isfinite(factor_);
  }

  int NumParameters() const override { return static_cast<int>(z_.size()); }
  bool Evaluate(const double* z, double* cost, double* gradient) const override {
    const Eigen::Map<const Vector> at(z, z_.size());
    if (!has_value_ || at != z_ || (gradient != nullptr && !has_gradient_)) {
      if (!at.allFinite()) return false;
      z_ = at;
      for (Index k = 0; k < z_.size(); ++k)
        x_[variables_[k]] = mid_[k] + half_[k] * std::sin(z_[k] * scale_[k] / half_[k]);
      value_ = search_.evaluate(x_, {.gradients = gradient != nullptr});
      has_value_ = value_ != nullptr && value_->finite;
      has_gradient_ = has_value_ && gradient != nullptr;
    }
    if (!has_value_) return false;
    *cost = factor_ * value_->cost;
    if (gradient != nullptr)
      for (Index k = 0; k < z_.size(); ++k)
        gradient[k] = factor_ * value_->gradient[variables_[k]] * scale_[k] * std::cos(z_[k] * scale_[k] / half_[k]);
    return true;
  }

 private:
  PointwiseSearch& search_;
  const FreeVariables& variables_;
  Vector mid_, half_, scale_;
  bool moved_ = false;
  double factor_ = 1.0;
  // The last point and its value: Ceres asks for some points twice.
  mutable Vector x_, z_;
  mutable const PointValue* value_ = nullptr;
  mutable bool has_value_ = false, has_gradient_ = false;
};

class Residuals final : public ::ceres::CostFunction {
 public:
  Residuals(PointwiseSearch& search, const Vector& start, const Vector& scale, const FreeVariables& variables,
            Index residuals, Index max_iterations)
      : search_(search), scale_(scale), variables_(variables), iterations_left_(max_iterations), x_(start) {
    set_num_residuals(static_cast<int>(residuals));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(variables.size()));
  }
  /// An iteration of the search has ended.
  void count_iteration() { --iterations_left_; }
  /// A Jacobian was left out because no iteration was left to use it.
  bool out_of_iterations() const { return out_of_iterations_; }

  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    const double* y = parameters[0];
    for (Index k = 0; k < variables_.size(); ++k) x_[variables_[k]] = y[k] * scale_[variables_[k]];
    const bool asks_jacobian = jacobians != nullptr && jacobians[0] != nullptr;
    // Ceres asks for the Jacobian at the start and within every iteration that goes downhill, before it counts that
    // iteration. Nothing uses the last one, and with the simulator as predictor it costs as much as a whole search.
    const bool is_last = asks_jacobian && iterations_left_ <= (has_started_ ? 1 : 0);
    const bool wants_jacobian = asks_jacobian && !is_last;
    has_started_ = has_started_ || asks_jacobian;
    const PointValue* value = search_.evaluate(x_, {.residuals = true, .jacobians = wants_jacobian});
    if (value == nullptr || !value->finite) return false;
    Eigen::Map<Vector>(residuals, num_residuals()) = value->residuals;
    if (wants_jacobian) {
      Eigen::Map<RowMajor> jacobian(jacobians[0], num_residuals(), variables_.size());
      for (Index k = 0; k < variables_.size(); ++k)
        jacobian.col(k) = value->jacobian.col(variables_[k]) * scale_[variables_[k]];
    } else if (is_last) {
      std::fill_n(jacobians[0], num_residuals() * variables_.size(), 0.0);  // a gradient of 0 ends Ceres
      out_of_iterations_ = true;
    }
    return true;
  }

 private:
  PointwiseSearch& search_;
  const Vector& scale_;
  const FreeVariables& variables_;
  Index iterations_left_;
  mutable bool has_started_ = false, out_of_iterations_ = false;
  mutable Vector x_;
};

/// Counts iterations, and ends Ceres once the search is over.
class Progress final : public ::ceres::IterationCallback {
 public:
  /// @param residuals those of a least squares search, or null.
  explicit Progress(PointwiseSearch& search, Residuals* residuals = nullptr) : search_(search), residuals_(residuals) {}
  ::ceres::CallbackReturnType operator()(const ::ceres::IterationSummary& summary) override {
    if (summary.iteration > 0) {
      search_.count_iteration();
      if (residuals_ != nullptr) residuals_->count_iteration();
    }
    return search_.over() ? ::ceres::SOLVER_ABORT : ::ceres::SOLVER_CONTINUE;
  }

 private:
  PointwiseSearch& search_;
  Residuals* residuals_;
};

SolverOutcome outcome(const PointwiseSearch& search, ::ceres::TerminationType type, const std::string& message) {
  switch (type) {
    case ::ceres::CONVERGENCE:
    case ::ceres::USER_SUCCESS:
      return {OptimiserStatus::converged, message};
    case ::ceres::NO_CONVERGENCE:
      return {OptimiserStatus::budget_spent, message};
    default:
      break;
  }
  // Ceres fails when no step improves the cost, which is how a search ends at a minimum if its tolerances are too fine.
  // It also fails when it finds no more finite values.
  return {search.last_was_finite() ? OptimiserStatus::converged : OptimiserStatus::diverged, message};
}

}  // namespace

Ceres::Ceres(const Params& params)
    : p_(params), least_squares_(params.method == "levenberg_marquardt" || params.method == "dogleg") {
  // Ceres logs some problems even with its logging off. OptimiserResult::message reports them.
  static std::once_flag once;
  std::call_once(once, [] { FLAGS_minloglevel = google::GLOG_FATAL; });
  std::string error;
  const bool valid =
      least_squares_ ? least_squares_options(p_).IsValid(&error) : line_search_options(p_).IsValid(&error);
  if (!valid) throw ConfigError("ceres: " + error);
}

OptimiserCapabilities Ceres::capabilities() const {
  OptimiserCapabilities c;
  c.needs_gradients = !least_squares_;
  c.needs_residuals = least_squares_;
  return c;
}

std::vector<OptimiserResult> Ceres::minimise(Objective& objective, ConstMatrix starts, const Box& bounds,
                                             ConstVec scale_in, const OptimiserOptions& options,
                                             const OptimiserObserver& observer) const {
  const Index residuals = objective.capabilities().residuals;
  if (least_squares_ && residuals == 0)
    throw Unsupported("ceres: the objective offers no residuals; method " + p_.method + " needs them");
  if (!least_squares_ && !objective.capabilities().gradients)
    throw Unsupported("ceres: the objective offers no gradients; method " + p_.method + " needs them");
  const Vector scale = scale_in;
  const FreeVariables variables(bounds);

  const auto line_search = [&](PointwiseSearch& search, const Vector& start) -> SolverOutcome {
    auto* function = new LineSearchFunction(search, start, bounds, scale, variables, p_.line_search.start_margin);
    const ::ceres::GradientProblem problem(function);  // owns it
    if (function->start_was_moved()) search.evaluate(start, {.gradients = true});
    Vector z = function->start();
    if (!function->normalise(p_.line_search.initial_step))
      return {OptimiserStatus::diverged, "no finite value at the start"};
    auto o = line_search_options(p_);
    o.max_num_iterations = to_int(options.max_iterations);
    o.gradient_tolerance *= p_.line_search.initial_step;  // the first gradient's largest entry is initial_step
    Progress progress(search);
    o.callbacks.push_back(&progress);
    ::ceres::GradientProblemSolver::Summary summary;
    ::ceres::Solve(o, problem, z.data(), &summary);
    return outcome(search, summary.termination_type, summary.message);
  };

  const auto least_squares = [&](PointwiseSearch& search, const Vector& start) -> SolverOutcome {
    Vector y(variables.size());
    for (Index k = 0; k < y.size(); ++k) y[k] = start[variables[k]] / scale[variables[k]];
    ::ceres::Problem problem;
    auto* function = new Residuals(search, start, scale, variables, residuals, options.max_iterations);
    problem.AddResidualBlock(function, nullptr, y.data());  // owns it
    for (Index k = 0; k < y.size(); ++k) {
      const Index i = variables[k];
      problem.SetParameterLowerBound(y.data(), static_cast<int>(k), bounds.lower[i] / scale[i]);
      problem.SetParameterUpperBound(y.data(), static_cast<int>(k), bounds.upper[i] / scale[i]);
    }
    auto o = least_squares_options(p_);
    o.max_num_iterations = to_int(options.max_iterations);
    Progress progress(search, function);
    o.callbacks.push_back(&progress);
    ::ceres::Solver::Summary summary;
    ::ceres::Solve(o, &problem, &summary);
    if (function->out_of_iterations()) return {OptimiserStatus::budget_spent, "maximum number of iterations reached"};
    return outcome(search, summary.termination_type, summary.message);
  };

  const auto solve = [&](PointwiseSearch& search, const Vector& start) -> SolverOutcome {
    if (variables.size() == 0) {
      search.evaluate(start, {.gradients = !least_squares_, .residuals = least_squares_});
      return {OptimiserStatus::converged, "the box fixes every variable"};
    }
    return least_squares_ ? least_squares(search, start) : line_search(search, start);
  };
  return minimise_pointwise("ceres", objective, starts, bounds, scale, options, observer, solve);
}

}  // namespace weft::ceres_solver
