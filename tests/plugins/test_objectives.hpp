#pragma once
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "conformance/conformance.hpp"
#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "weft/optimiser.hpp"

/// Shared by the tests of the optimisers: objectives with known minima, and a host that loads the plugins.
namespace weft::test {

inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

inline Vector vec(std::initializer_list<double> values) {
  Vector v(static_cast<Index>(values.size()));
  std::copy(values.begin(), values.end(), v.data());
  return v;
}
inline Box cube(Index dim, double half) { return {Vector::Constant(dim, -half), Vector::Constant(dim, half)}; }

struct Residuals {
  Vector r;
  Matrix jacobian;
};

/// 1/2 |r(x)|^2 per column. Counts, and keeps every point.
class LeastSquares final : public Objective {
 public:
  using Call = std::function<Residuals(const Vector& x, Index instance)>;
  LeastSquares(Index dim, Index residuals, Call call) : dim_(dim), residuals_(residuals), call_(std::move(call)) {}
  Index dim() const override { return dim_; }
  ObjectiveCapabilities capabilities() const override { return {gradients, offers_residuals ? residuals_ : 0}; }
  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) override {
    if (throw_at_call > 0 && static_cast<Index>(requests.size()) + 1 == throw_at_call) throw Diverged("frame 3");
    requests.push_back(request);
    owners.push_back(instances);
    Evaluation e;
    e.costs.resize(x.cols());
    if (request.gradients) e.gradients.resize(dim_, x.cols());
    if (request.residuals) e.residuals.resize(residuals_, x.cols());
    for (Index j = 0; j < x.cols(); ++j) {
      points.push_back(x.col(j));
      const Residuals at = call_(x.col(j), instances[j]);
      e.costs[j] = 0.5 * at.r.squaredNorm();
      if (request.gradients) e.gradients.col(j) = at.jacobian.transpose() * at.r;
      if (request.residuals) e.residuals.col(j) = at.r;
      if (request.jacobians) e.jacobians.push_back(at.jacobian);
    }
    return e;
  }
  bool gradients = true, offers_residuals = true;
  Index throw_at_call = 0;
  std::vector<EvaluationRequest> requests;
  std::vector<std::vector<Index>> owners;
  std::vector<Vector> points;

 private:
  Index dim_, residuals_;
  Call call_;
};

/// sum of curvature_i (x_i - centre_i)^2 / 2
inline LeastSquares bowl(const Vector& centre, const Vector& curvature) {
  return {centre.size(), centre.size(), [=](const Vector& x, Index) {
            const Vector root = curvature.cwiseSqrt();
            return Residuals{root.cwiseProduct(x - centre), root.asDiagonal()};
          }};
}

/// 50 (y - x^2)^2 + (1 - x)^2 / 2
inline LeastSquares rosenbrock() {
  return {2, 2, [](const Vector& x, Index) {
            Residuals at{Vector(2), Matrix(2, 2)};
            at.r << 10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0];
            at.jacobian << -20.0 * x[0], 10.0, -1.0, 0.0;
            return at;
          }};
}

/// Two basins, at x = -1 and, half as deep, at x = 1, per variable: 1/2 (x^2 - 1)^2 + (x + 1)^2 / 8.
inline LeastSquares two_basins(Index dim) {
  return {dim, 2 * dim, [dim](const Vector& x, Index) {
            Residuals at{Vector(2 * dim), Matrix::Zero(2 * dim, dim)};
            for (Index i = 0; i < dim; ++i) {
              at.r[2 * i] = x[i] * x[i] - 1.0;
              at.r[2 * i + 1] = 0.5 * (x[i] + 1.0);
              at.jacobian(2 * i, i) = 2.0 * x[i];
              at.jacobian(2 * i + 1, i) = 0.5;
            }
            return at;
          }};
}

inline Matrix spread() {
  Matrix starts(2, 3);
  starts << -1.2, 0.5, 1.7, 1.0, -0.5, 1.9;
  return starts;
}

/// Loads plugins from the build folder.
class PluginBench {
 public:
  std::shared_ptr<Optimiser> optimiser(const std::string& slot) {
    return host_->create<Optimiser>(ConfigNode::parse(slot, "test"));
  }
  Host& host() { return *host_; }

 private:
  std::shared_ptr<PluginRegistry> registry_ =
      std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_PLUGIN_DIR});
  std::unique_ptr<Host> host_ = make_host(registry_, {});
};

/// The failed conformance laws of the optimisers, one line each.
inline std::string failed_laws(Host& host, const std::string& slot, const std::string& tolerances = "{}") {
  std::string failed;
  for (const auto& law : check_conformance(host, "optimiser", ConfigNode::parse(slot, "test"),
                                           ConfigNode::parse(tolerances, "tolerances")))
    if (!law.passed)
      failed += law.law + ": " + std::to_string(law.measured) + ", bound " + std::to_string(law.bound) + " " +
                law.detail + "\n";
  return failed;
}

}  // namespace weft::test
