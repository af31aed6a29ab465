#pragma once
#include <filesystem>

#include "meshes/import/units.hpp"
#include "sdk/obj_file.hpp"
#include "weft/types.hpp"

namespace weft {

/// A mesh file of somebody's, as polygons.
struct MeshFile {
  ObjFile polygons;
  FileFrame frame;  ///< what the format or the file says of units and up axis
};

/// Reads OBJ with weft's own reader, whose vertices keep their numbers, and PLY, STL, glTF and GLB with assimp.
/// @throws ConfigError for a file that cannot be read, another format, or a build without assimp, naming the remedy.
MeshFile read_mesh_file(const std::filesystem::path& path, Findings& findings);

/// The points of a point cloud, or the vertices of a mesh, [n, 3]: PLY with assimp, OBJ. @throws as read_mesh_file().
Positions read_points(const std::filesystem::path& path);

/// The first line of the OBJ that an import writes: it says that the file is in metres with z up.
extern const char* const kImportedComment;

}  // namespace weft
