#pragma once
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>

#include "weft/config.hpp"
#include "weft/mesh.hpp"
#include "weft/types.hpp"

namespace weft {

/// A piece of cloth: rest shape in 2D, flat or given initial positions, faces, and named vertices.
/// Immutable once made; topology is fixed for its whole life.
struct Garment {
  std::string name;
  Positions positions;                    ///< [V, 3] m: the initial shape; a 2D garment lies flat
  RestPositions rest;                     ///< [V, 2] m: unstretched, x = warp, y = weft
  Faces faces;                            ///< [F, 3]
  std::map<std::string, Index> vertices;  ///< named vertices, such as left_sleeve_top
  std::uint64_t hash = 0;                 ///< of rest positions and faces; recorded with data and models

  Index vertex_count() const { return positions.rows(); }
  Index face_count() const { return faces.rows(); }
  /// @throws ConfigError naming the nearest known name.
  WEFT_API Index vertex(const std::string& vertex_name) const;
};

/// Checks the mesh (non-manifold edges or vertices, degenerate or inverted rest faces, NaN, wrong or unused vertices)
/// and makes a garment of it. Without vt the mesh must lie flat; its xy are then the rest shape.
/// @throws ConfigError naming the face or vertex (0-based as in weft, 1-based as in the OBJ).
WEFT_API Garment make_garment(const Mesh& mesh, std::string name, std::map<std::string, Index> vertices = {});

/// Reads `garment:`: the path of an OBJ, the path of a garment YAML, or a mapping {mesh: x.obj, name, vertices: {...}}.
WEFT_API Garment read_garment(const ConfigNode& node);

/// Mean distance between corresponding vertices, mm: the paper's error measure (Fig. 3).
/// @throws ShapeError if the numbers of vertices differ.
WEFT_API double mean_distance_mm(const Positions& a, const Positions& b);

}  // namespace weft
