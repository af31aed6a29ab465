#pragma once
#include <array>
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// Delaunay triangulation of the convex hull, as the dual of Boost.Polygon's Voronoi diagram on a 2^30 integer grid.
/// Counter-clockwise triangles; cocircular points give a fan. Points that coincide on the grid get no triangle.
std::vector<std::array<int, 3>> delaunay(const std::vector<Vec2>& points);

}  // namespace weft
