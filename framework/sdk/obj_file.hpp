#pragma once
#include <array>
#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "weft/export.hpp"
#include "weft/mesh.hpp"

namespace weft {

/// The statements of a Wavefront OBJ file as they stand there: polygons, with a texture coordinate per corner.
struct ObjFile {
  struct Corner {
    int vertex = 0;    ///< from 0
    int texture = -1;  ///< into `texture`; -1: none
  };
  struct Face {
    std::vector<Corner> corners;
    std::size_t line = 0;  ///< in the file, from 1
  };
  std::vector<std::array<double, 3>> vertices;
  std::vector<std::array<double, 2>> texture;
  std::vector<Face> faces;
  std::size_t elements = 0;           ///< lines and points, which are no faces; only without `triangles_only`
  std::vector<std::string> skipped;   ///< such as "a byte-order mark": what the text held besides statements
  std::vector<std::string> comments;  ///< of the lines before the first vertex, without the #
};

/// Reads a file. All indices lie within it. A byte-order mark and a Ctrl-Z at the end are skipped, UTF-16 is converted.
/// @param triangles_only refuse other faces, lines and points.
/// @throws ConfigError naming file, line and the face or vertex: wrong indices, NaN, no vertices or faces.
WEFT_API ObjFile read_obj_file(const std::filesystem::path& path, bool triangles_only);

/// Positions and the first three corners of each face; no rest shape. @param source for messages.
WEFT_API Mesh bare_mesh(const ObjFile& file, const std::string& source);

}  // namespace weft
