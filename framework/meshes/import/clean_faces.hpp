#pragma once
#include "meshes/import/import_mesh.hpp"

namespace weft {

/// Removes faces that repeat another one or name a vertex twice, and vertices in no face. A face whose three vertices
/// lie on a line is removed, and its neighbour across the longest edge is cut at the vertex between, so no gap is left.
/// @throws ConfigError naming a face on a line that cannot be removed like that.
void clean_faces(ImportMesh& mesh, Findings& findings);

}  // namespace weft
