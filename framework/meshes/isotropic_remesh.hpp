#pragma once
#include <array>
#include <functional>
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// A surface to be given triangles of another size.
struct Surface {
  std::vector<Vec3> positions;            ///< m
  std::vector<std::array<int, 3>> faces;  ///< a manifold, consistently oriented
  std::vector<std::array<int, 2>> lines =
      {};                       ///< edges to keep as lines, such as seams; open boundaries are kept anyway
  std::vector<int> fixed = {};  ///< vertices to keep where they are
};

struct RemeshedSurface {
  std::vector<Vec3> positions;
  std::vector<std::array<int, 3>> faces;
  std::vector<std::array<int, 2>> lines;  ///< boundaries and kept lines
  std::vector<int> kept;                  ///< [vertices before] where a fixed vertex or a corner is now; -1: others
};

/// Isotropic remeshing (Botsch and Kobbelt 2004, "A Remeshing Approach to Multiresolution Modeling", section 4): splits
/// edges longer than 4/3 of the target, collapses those shorter than 4/5, flips edges towards six neighbours (four on a
/// boundary), moves vertices to the centre of their neighbours within the tangent plane, and projects them to the
/// surface; ten times. Besides: vertices of boundaries and lines stay on them, move along them only, and where a line
/// turns by more than 30 degrees, ends or branches there is a corner, which stays unless cutting it off moves the line
/// by less than 0.05 of the target. No step may turn a face over. The same input gives the same bits.
/// @param edge_length the target at a place, m, > 0.
RemeshedSurface remesh_isotropic(const Surface& surface, const std::function<double(const Vec3&)>& edge_length);

}  // namespace weft
