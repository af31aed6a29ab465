#include "bending_patch.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace weft::cloth {
namespace {

// At a free edge: least overlap of the ghost's curvature with that of the natural condition.
constexpr double kSeesNatural = 0.5;

}  // namespace

PatchRows second_derivatives(const PatchPoints& points, double area) {
  std::array<Eigen::Vector2d, 6> point;
  for (int k = 0; k < 6; ++k) point[k] = {points[k][0], points[k][1]};
  // Fit relative to the centroid in units of the triangle's size, which keeps the 6 x 6 system well scaled.
  const Eigen::Vector2d centre = (point[0] + point[1] + point[2]) / 3.0;
  const double size = std::sqrt(area);
  Eigen::Matrix<double, 6, 6> quadratic;
  for (int k = 0; k < 6; ++k) {
    const Eigen::Vector2d p = (point[k] - centre) / size;
    quadratic.row(k) << 1.0, p.x(), p.y(), 0.5 * p.x() * p.x(), 0.5 * p.y() * p.y(), p.x() * p.y();
  }
  const Eigen::Matrix<double, 6, 6> inverse = quadratic.fullPivLu().inverse();
  PatchRows second;
  for (int row = 0; row < 3; ++row)
    for (int k = 0; k < 6; ++k) second[row][k] = inverse(3 + row, k) / (size * size);
  return second;
}

PatchRows bending_factors(const PatchPoints& points, double area, const PatchRows& derivatives,
                          const std::array<bool, 3>& ghost, const BendingModuli& m) {
  Eigen::Matrix3d d;
  d << m.d11, m.d12, 0.0, m.d12, m.d22, 0.0, 0.0, 0.0, m.d33;
  Eigen::Matrix<double, 3, 6> second;
  for (int row = 0; row < 3; ++row)
    for (int k = 0; k < 6; ++k) second(row, k) = derivatives[row][k];
  // Free edges: the ghost's place follows from the natural condition, no moment across the edge:
  // m^T d kappa = 0 with m = (n_u^2, n_v^2, n_u n_v). kappa = P second x with P = 1 - G (M^T d G)^-1 M^T d, G the
  // ghosts' columns, M their m. Energy P^T d P. Where G hardly overlaps with M (bad corners) the ghost goes to the
  // place of least energy.
  Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 3> ghosts(3, 0), normals(3, 0);
  for (int k = 0; k < 3; ++k) {
    if (!ghost[k]) continue;
    const auto &p = points[(k + 1) % 3], &q = points[(k + 2) % 3];
    const double nu = q[1] - p[1], nv = p[0] - q[0], size2 = nu * nu + nv * nv;
    const Eigen::Vector3d across(nu * nu / size2, nv * nv / size2, nu * nv / size2);
    ghosts.conservativeResize(3, ghosts.cols() + 1);
    normals.conservativeResize(3, normals.cols() + 1);
    ghosts.col(ghosts.cols() - 1) = second.col(3 + k).normalized();
    normals.col(normals.cols() - 1) = across.normalized();
    second.col(3 + k).setZero();
  }
  if (ghosts.cols() == 3) {
    d.setZero();
  } else if (ghosts.cols() > 0) {
    const Eigen::MatrixXd mixed = normals.transpose() * d * ghosts, own = ghosts.transpose() * d * ghosts;
    const bool sees =
        std::abs(mixed.determinant()) > kSeesNatural * std::abs(own.determinant()) && own.determinant() > 0.0;
    if (sees) {
      const Eigen::Matrix3d project = Eigen::Matrix3d::Identity() - ghosts * mixed.inverse() * normals.transpose() * d;
      d = (project.transpose() * d * project).eval();
    } else if (own.determinant() > 1e-12 * std::pow(d.trace(), static_cast<double>(ghosts.cols()))) {
      d -= (d * ghosts * own.inverse() * ghosts.transpose() * d).eval();
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(d);
  PatchRows factors;
  for (int row = 0; row < 3; ++row) {
    const double weight = std::sqrt(std::max(0.0, eigen.eigenvalues()[row]) * area);
    const Eigen::Matrix<double, 1, 6> factor = weight * eigen.eigenvectors().col(row).transpose() * second;
    double sum = 0.0;
    for (int k = 1; k < 6; ++k) {
      factors[row][k] = factor[k];
      sum += factor[k];
    }
    factors[row][0] = -sum;  // up to ghosts: a constant has no second derivative
  }
  return factors;
}

}  // namespace weft::cloth
