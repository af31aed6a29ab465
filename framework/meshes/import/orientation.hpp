#pragma once
#include "meshes/import/import_mesh.hpp"

namespace weft {

/// Turns faces until neighbours look to the same side. In each piece the side of the most faces wins.
/// @throws ConfigError naming an edge of a surface with one side only (a Moebius strip).
void orient_faces(ImportMesh& mesh, Findings& findings);

/// Turns around all faces.
void turn_faces(ImportMesh& mesh);

}  // namespace weft
