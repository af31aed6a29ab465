#pragma once
#include "weft/types.hpp"

namespace weft {

/// Number of edge/triangle intersections of the mesh with itself (pairs that share a vertex are not tested).
Index count_intersections(const Positions& positions, const Faces& faces);

}  // namespace weft
