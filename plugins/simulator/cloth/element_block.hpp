#pragma once
#include "simd.hpp"

namespace weft::cloth {

constexpr int kElementLanes = 16;

/// Sixteen triangles, lane by lane. Padding lanes have zero stiffness and vertex 0.
struct alignas(64) ElementBlock {
  Offset node[6][kElementLanes];  ///< the triangle's corners, then the vertex across from each (or corner 0: weight 0)
  float
      gradient[4]
              [kElementLanes];  ///< u from edges 1, 2; v from edges 1, 2: x_u = g0 (x1 - x0) + g1 (x2 - x0); times unit
  float stiffness[4][kElementLanes];  ///< area (c11, c12, c22, g) / unit, N m
  float
      bend[3][5]
          [kElementLanes];  ///< row k: sqrt(area eigenvalue) times second derivative, of nodes 1..5 relative to node 0
};

}  // namespace weft::cloth
