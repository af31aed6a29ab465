#include "session/shape_filter.hpp"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>
#include <utility>

namespace weft {
namespace {

constexpr double kRange = 4.0;         // edges
constexpr double kLeastSigma = 2e-6;   // m: what a simulator's own digits scatter
constexpr double kLeastSpread = 2e-5;  // m: least tau; below, the difference is noise alone

}  // namespace

ShapeFilter::ShapeFilter(const Garment& garment) {
  const Index n = garment.vertex_count();
  std::set<std::pair<Index, Index>> edges;
  for (Index f = 0; f < garment.face_count(); ++f) {
    for (Index k = 0; k < 3; ++k) {
      const Index a = garment.faces(f, k), b = garment.faces(f, (k + 1) % 3);
      edges.emplace(std::min(a, b), std::max(a, b));
    }
  }
  std::vector<Eigen::Triplet<double>> entries;
  for (const auto& [a, b] : edges) {
    const double weight = kRange * kRange;
    entries.emplace_back(a, b, -weight);
    entries.emplace_back(b, a, -weight);
    entries.emplace_back(a, a, weight);
    entries.emplace_back(b, b, weight);
  }
  for (Index v = 0; v < n; ++v) entries.emplace_back(v, v, 1.0);
  Eigen::SparseMatrix<double> smooth(n, n);
  smooth.setFromTriplets(entries.begin(), entries.end());
  prior_ = Eigen::SparseMatrix<double>(smooth.transpose()) * smooth / (4.0 * std::numbers::pi * kRange * kRange);
}

Positions ShapeFilter::pulled(const Positions& simulated, const Observation& seen,
                              const std::vector<Index>& held) const {
  const Index n = simulated.rows();
  require_shape("shape filter: observed vertices", seen.positions.rows(), n);
  const double sigma = std::max(seen.sigma, kLeastSigma);
  Positions difference = Positions::Zero(n, 3);
  Vector weight = Vector::Zero(n);
  double square = 0.0;
  Index count = 0;
  for (Index v = 0; v < n; ++v) {
    if (!seen.sees(v)) continue;
    difference.row(v) = seen.positions.row(v) - simulated.row(v);
    weight(v) = 1.0 / (sigma * sigma);
    square += difference.row(v).squaredNorm();
    ++count;
  }
  if (count == 0) return simulated;
  const double excess = square / static_cast<double>(3 * count) - seen.sigma * seen.sigma;
  const double spread = std::sqrt(std::max(excess, kLeastSpread * kLeastSpread));
  for (const Index v : held) {
    difference.row(v).setZero();
    weight(v) = 1.0 / (kLeastSigma * kLeastSigma);
  }
  Eigen::SparseMatrix<double> system = prior_ / (spread * spread);
  for (Index v = 0; v < n; ++v) system.coeffRef(v, v) += weight(v);
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(system);
  if (solver.info() != Eigen::Success) return simulated;
  return simulated + Positions(solver.solve(weight.asDiagonal() * difference));
}

}  // namespace weft
