#pragma once
#include <functional>
#include <vector>

#include "meshes/outlines.hpp"
#include "weft/garment.hpp"

namespace weft {

/// A front and a back of the same shape, joined at seams. Drawn flat at z = 0; the back looks down.
struct SewnMesh {
  Mesh mesh;              ///< without a rest shape: it is the drawn one (rest: {from: mesh})
  std::vector<int> back;  ///< [vertices of the front] the vertex of the back; the same number where they are joined
  GarmentForm form;       ///< frames, layers (back and seams 0, front 1) and seams
};

/// Joins a flat mesh to its copy below at some of the border's edges. Vertices keep their numbers; those of the back
/// follow. An edge inside that joins two vertices of seams is cut in the middle, since four faces would meet there.
/// @param is_sewn whether the border's edge between these two places is a seam; at least one must be.
SewnMesh sew_front_and_back(const Mesh& front, const std::function<bool(const Vec2&, const Vec2&)>& is_sewn);

/// Whether an edge near the outline belongs to one of its openings.
bool is_open_at(const Outline& outline, const Vec2& a, const Vec2& b);

/// A tube of a square grid, standing on its edge: `around` faces pairs around, `along` up. Its warp runs around it.
/// @param radius, height m.
Mesh tube(Index around, Index along, double radius, double height);

}  // namespace weft
