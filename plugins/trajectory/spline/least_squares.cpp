#include "least_squares.hpp"

#include <Eigen/QR>

namespace weft::spline {

Controls fit_control_points(const Matrix& basis, const Vector& weights, const Controls& controls) {
  // The weights of a segment sum to 1, so a constant is fitted exactly: fit what differs from the (weighted) mean.
  const Eigen::RowVectorXd mean = weights.transpose() * controls / weights.sum();
  const Matrix rest = weights.asDiagonal() * (controls.rowwise() - mean);
  Controls points = (weights.asDiagonal() * basis).completeOrthogonalDecomposition().solve(rest);
  points.rowwise() += mean;
  return points;
}

}  // namespace weft::spline
