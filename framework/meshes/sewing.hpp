#pragma once
#include <functional>
#include <vector>

#include "meshes/outlines.hpp"
#include "weft/garment.hpp"

namespace weft {

/// A front and a back of the same outline, joined at seams. Drawn flat at z = 0; the back looks down.
struct SewnMesh {
  Mesh mesh;  ///< without a rest shape: it is the drawn one (rest: {from: mesh})
  /// [vertices of the front] the vertex of the back at the same place: the same number where they are joined, -1 for none.
  std::vector<int> back;
  GarmentForm form;  ///< frames, layers (back and seams 0, front 1) and seams
};

/// Joins a flat mesh to another one below at some of the border's edges. Vertices of the front keep their numbers; those of the
/// back follow. An edge inside that joins two vertices of seams is cut in the middle, since four faces would meet there.
/// @param back has the front's vertices at the border.
/// @param is_sewn whether the border's edge between these two places is a seam; at least one must be.
/// @throws Error when there is no seam, or a vertex of a seam is in one of the meshes alone.
SewnMesh sew_front_and_back(const Mesh& front, const Mesh& back,
                            const std::function<bool(const Vec2&, const Vec2&)>& is_sewn);
/// The same with a copy of the front below.
inline SewnMesh sew_front_and_back(const Mesh& front, const std::function<bool(const Vec2&, const Vec2&)>& is_sewn) {
  return sew_front_and_back(front, front, is_sewn);
}

/// Whether an edge near the outline belongs to one of its openings.
bool is_open_at(const Outline& outline, const Vec2& a, const Vec2& b);

/// A tube of a square grid, standing on its edge: `around` faces pairs around, `along` up. Its warp runs around it.
/// @param radius, height m.
Mesh tube(Index around, Index along, double radius, double height);

}  // namespace weft
