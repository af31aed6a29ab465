#pragma once
#include <Eigen/SparseCore>
#include <vector>

#include "session/observation.hpp"
#include "weft/garment.hpp"

namespace weft {

/// Pulls a simulated shape to what was observed. The difference d between the real cloth and the simulated one is a
/// smooth field on the mesh; the measurement's noise is not. So d is the most probable field, given the seen vertices,
/// under a Gaussian Markov random field with the Matern covariance [Lindgren, Rue & Lindstroem 2011, "An explicit link
/// between Gaussian fields and Gaussian Markov random fields", sec. 2]:
///     minimise  sum_seen |d_v - (seen_v - simulated_v)|^2 / sigma^2  +  |(I + r^2 L) d|^2 / (4 pi r^2 tau^2),
/// with the graph Laplacian L, the range r in edges, and tau^2, the variance of d, from the differences themselves:
/// their mean square less sigma^2. Without noise every seen vertex is met, and the unseen ones follow.
class ShapeFilter {
 public:
  explicit ShapeFilter(const Garment& garment);
  /// @param simulated [V, 3] m. @param held vertices whose simulated positions are right: the hands hold them.
  /// @return [V, 3] m.
  Positions pulled(const Positions& simulated, const Observation& seen, const std::vector<Index>& held) const;

 private:
  Eigen::SparseMatrix<double> prior_;  // [V, V]: (I + r^2 L)' (I + r^2 L) / (4 pi r^2)
};

}  // namespace weft
