#pragma once
#include "weft/mesh.hpp"
#include "weft/obstacle.hpp"

namespace weft {

/// An obstacle as a closed mesh to draw, with its rounded edges and without rest positions. A half-space is a slab with
/// `extent` (m) as half of its width, its upper side around the point of its surface next to `focus`.
Mesh obstacle_mesh(const Obstacle& obstacle, const Vec3& focus, double extent = 1.0);

}  // namespace weft
