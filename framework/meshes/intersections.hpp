#pragma once
#include <array>
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// Number of edge/triangle intersections of the mesh with itself (pairs that share a vertex are not tested).
Index count_intersections(const Positions& positions, const Faces& faces);

/// An edge that passes through a face.
struct Intersection {
  std::array<int, 2> edge;  ///< its vertices
  int face;
  bool between_pieces = false;  ///< no edges lead from one to the other
};
/// The first `most` of them, edge by edge.
std::vector<Intersection> find_intersections(const Positions& positions, const Faces& faces, std::size_t most);

}  // namespace weft
