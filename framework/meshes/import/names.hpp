#pragma once
#include <map>

#include "meshes/import/import_mesh.hpp"

namespace weft {

/// Where a name goes: a vertex by its number in the file, or the one nearest to a place.
struct VertexSpec {
  std::string text;  ///< as it was given
  int number = 0;    ///< from 1; 0: by place
  Vec3 at = Vec3::Zero();
  bool in_plane = true;  ///< only x and y count
};
/// Reads "17", "nearest(0.1,-0.2)" or "nearest(0.1,-0.2,0.5)", in metres. @throws ConfigError naming `option`.
VertexSpec parse_vertex_spec(const std::string& option, const std::string& text);
/// Reads NAME=SPEC. @throws ConfigError.
std::pair<std::string, VertexSpec> parse_vertex_name(const std::string& option, const std::string& text);

/// The row nearest to the place of a spec. Of equally near ones the first.
Index nearest_vertex(const Positions& positions, const VertexSpec& spec);

/// The vertex of a spec. @throws ConfigError for a number that the file does not have, or whose vertex was removed.
int find_vertex(const ImportMesh& mesh, const std::string& option, const VertexSpec& spec);

/// The outermost vertices of the largest piece, along the diagonals: left_bottom, left_top, right_bottom, right_top.
std::map<std::string, int> outermost_vertices(const ImportMesh& mesh);

}  // namespace weft
