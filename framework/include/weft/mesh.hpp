#pragma once
#include <filesystem>
#include <string>

#include "weft/export.hpp"
#include "weft/types.hpp"

namespace weft {

/// The triangle mesh of an OBJ file. `vt` are rest coordinates in metres, one per vertex.
struct Mesh {
  Positions positions;  ///< [V, 3] m
  Faces faces;          ///< [F, 3]
  RestPositions rest;   ///< [V, 2] m, or [0, 2] when the file has no vt
  std::string source;   ///< file name, for messages
};

/// Reads triangles from a Wavefront OBJ. Several components are allowed.
/// @throws ConfigError naming file, line and the face or vertex: quads, wrong indices, NaN, several vt for one vertex.
WEFT_API Mesh read_obj(const std::filesystem::path& path);
/// Writes v, f, and vt if there is one. v has at least 9 significant digits; with `exact` it reads back exactly.
WEFT_API void write_obj(const std::filesystem::path& path, const Mesh& mesh, bool exact = false);

/// Edges of the faces, each once, [E, 2] with first < second, sorted.
WEFT_API Edges edges_of(const Faces& faces);
/// Those that belong to one face alone.
WEFT_API Edges open_edges(const Faces& faces);

}  // namespace weft
