#pragma once
#include <optional>

#include "meshes/import/import_mesh.hpp"
#include "sdk/obj_file.hpp"

namespace weft {

/// Cuts a polygon into triangles: in its mean plane (Newell's normal), ear by ear, each time the ear with the largest
/// smallest angle. A triangle stays as it is. @return corners of the polygon; nothing when it crosses itself.
std::optional<std::vector<std::array<int, 3>>> triangulate_polygon(const std::vector<Vec3>& polygon);

/// The triangles of a file of polygons. Corners that repeat their neighbour are dropped.
/// @throws ConfigError naming the face and its line when it crosses itself.
ImportMesh triangulate_file(const ObjFile& file, const std::string& source, Findings& findings);

}  // namespace weft
