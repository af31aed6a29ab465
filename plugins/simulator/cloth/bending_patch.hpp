#pragma once
#include <array>

namespace weft::cloth {

/// Plate moduli, N m: energy per rest area 1/2 (d11 |x_uu|^2 + d22 |x_vv|^2 + 2 d12 x_uu.x_vv + d33 |x_uv|^2).
struct BendingModuli {
  double d11 = 0.0, d22 = 0.0, d12 = 0.0, d33 = 0.0;
};
/// The six-node bending patch of a triangle (see Elements): its corners, then the vertex across from each. Where an edge is
/// free there is no such vertex, and a ghost stands in its place. Positions are rest positions, m.
using PatchPoints = std::array<std::array<double, 2>, 6>;
/// One row each for uu, vv and uv, a column for each point.
using PatchRows = std::array<std::array<double, 6>, 3>;

/// Second derivatives, 1/m^2, of the quadratic through the six points. @param area rest area of the triangle, m^2.
PatchRows second_derivatives(const PatchPoints& points, double area);

/// Rows of sqrt(area eigenvalue) times second derivative, sqrt(N m) / m: the bending energy of the patch is
/// 1/2 sum_r |sum_k row_r[k] x_k|^2. Ghosts are condensed, so their columns are zero.
/// @param second from second_derivatives(). @param ghost of the points 3, 4, 5.
PatchRows bending_factors(const PatchPoints& points, double area, const PatchRows& second,
                          const std::array<bool, 3>& ghost, const BendingModuli& moduli);

}  // namespace weft::cloth
