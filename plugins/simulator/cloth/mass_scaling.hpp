#pragma once
#include <Eigen/SparseCore>
#include <functional>
#include <vector>

#include "elements.hpp"

namespace weft::cloth {

/// Selective mass scaling: waves shorter than some length get more inertia, so that no substep need resolve them.
///     a = p(W L) W f,   W = 1/m where a component may move, else 0
/// L is the scalar stiffness, the same for x, y and z, of a membrane that is nowhere softer than the cloth's. L of a
/// constant is 0 and p(0) = 1: free fall and momentum stay exact. p > 0, so equilibrium (f = 0) does not change. The
/// mass matrix of this scheme is constant and the same for x, y and z. So an angular momentum is conserved, that of
/// M + O(l^2).
/// [Selective mass scaling: Olovsson, Simonsson and Unosson 2005, who have (M + s K)^-1 in place of p(W L) W.]
///
/// p comes from one damped Runge-Kutta-Chebyshev step of length tau and s stages for dy/dt = a - W L y, y = 0 at its
/// start: it ends at y = tau p(W L) a, after s - 1 products with L [Verwer, Hundsdorfer and Sommeijer 1990]:
///     p(lambda) = (1 - T_s(w0 - w1 lambda) / T_s(w0)) / (tau lambda),   largest lambda p(lambda) ~ 1 / s^2
/// Since K <= L, this bounds the eigenvalues of p(W L) W K, too, whichever vertices are held. For K <= r L the bound is
/// r times that.
class MassScaling {
 public:
  /// @param length m: eigenvalues are at most (c / length)^2, c the larger wave speed of L, m/s; 0: no scaling.
  MassScaling(const Topology& topology, const MembraneModuli& moduli, double density, const std::vector<double>& masses,
              double length);
  /// 1: nothing is scaled.
  int stages() const { return stages_; }
  /// Bound of the eigenvalues of p(W L) W K, K the membrane's stiffness, 1/s^2. Only where stages() > 1.
  double largest() const { return largest_; }
  /// The same for another K, such as bending's: r times that, r by power iteration of L^-1 K. K of a constant is 0.
  /// @param stiffness writes K x to its second argument.
  double largest(const std::function<void(const std::vector<double>&, std::vector<double>&)>& stiffness) const;
  /// @param a [V] W f. @param w [V] W, per component. @return [V] p(W L) a, valid until the next call.
  const Float4* apply(const Float4* a, const Float4* w) const;

 private:
  int stages_ = 1;
  double largest_ = 0.0;
  /// y_{j+1} = now y_j + last y_{j-1} + gain a - slope W L y_j; y_0 = 0.
  struct Stage {
    float now, last, gain, slope;
  };
  std::vector<Stage> stage_;
  Eigen::SparseMatrix<double> laplacian_;  ///< L, N/m
  /// Eight rows of L, lane by lane: sum over diagonals of value times the eight records from `at` on.
  struct alignas(32) Diagonal {
    float value[8];  ///< N/m
  };
  /// x, y, z of the rows' vertices, each with room for a diagonal that begins before the first or ends after the last.
  struct Planes {
    std::vector<float> of[3];
    void resize(std::size_t rows);
  };
  /// Puts the vertices in strips and the entries of L, by rows of vertices, on diagonals.
  void arrange(const Topology& topology, const std::vector<std::int32_t>& start,
               const std::vector<std::int32_t>& column, const std::vector<double>& value);

  std::vector<std::int32_t> vertex_;  ///< of a row; the last is repeated up to a multiple of eight
  std::vector<std::int32_t> start_;   ///< [groups + 1] into diagonal_
  std::vector<std::int32_t> at_;      ///< [diagonals] into Planes
  std::vector<Diagonal> diagonal_;
  mutable Planes a_, w_, now_, last_;
  mutable std::vector<Float4> out_;  ///< [V]
};

}  // namespace weft::cloth
