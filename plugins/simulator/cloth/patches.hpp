#pragma once
#include <cstdint>
#include <vector>

#include "simd.hpp"
#include "topology.hpp"

namespace weft::cloth {

/// Boxes of eight primitives, lane by lane; empty lanes are inverted.
struct alignas(32) BoxBlock {
  float low[3][8], high[3][8];
  std::int32_t corner[3][8];  ///< vertices of the primitive; an edge, a vertex and empty lanes repeat others
  std::int32_t id[8];         ///< vertex, edge or face; -1: empty lane
  unsigned strayed;           ///< lanes with a vertex that candidates are searched for
};

/// A patch of at most eight neighbouring faces, with the vertices and edges that it owns (each belongs to one patch).
struct Patch {
  std::int32_t faces[2], vertices[2], edges[2];  ///< [begin, end) in blocks
};

/// Tree of boxes over the patches, split by place. Children come after their parent.
struct PatchNode {
  float low[3], high[3];
  float axis[3];             ///< mean normal of the faces
  float angle;               ///< rad, largest angle between it and a face's normal; above pi: no cone
  std::int32_t left, right;  ///< children, or -1
  std::int32_t patch;        ///< of a leaf
  /// The rest shape is one piece, nearly convex: while its normals stay within a cone below 90 degrees it projects
  /// one to one along the axis, and no two of its parts can touch [Volino and Magnenat-Thalmann 1994].
  bool convex;
  bool strayed;  ///< has a vertex that candidates are searched for
};

/// The mesh in patches, under a tree. Boxes, cones and marks are those of the last search (contact_search.cpp).
struct PatchTree {
  /// Splits the faces of each part at the median of their centres (Topology::place) until at most eight are left.
  explicit PatchTree(const Topology& topology);

  std::vector<Patch> patches;
  std::vector<PatchNode> nodes;  ///< the root comes first
  /// [patches + 1], and leaves, sorted: those that share a vertex with a patch, itself among them; and their neighbours.
  std::vector<std::int32_t> near_start, near, around_start, around;
  /// [patches] what is around the patch has no border of the mesh, or is one piece and nearly convex.
  std::vector<std::uint8_t> round;
  std::vector<BoxBlock> faces, vertices, edges;
};

}  // namespace weft::cloth
