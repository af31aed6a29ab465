#pragma once
#include "meshes/import/import_mesh.hpp"

namespace weft {

/// Cuts the mesh open where it is no surface (Gueziec et al. 2001, "Cutting and stitching"): at an edge of more than
/// two faces the two that go on flattest stay together, the others get vertices of their own; a vertex whose faces form
/// several fans (a bow-tie) becomes one vertex per fan. The fan of the most faces keeps the vertex.
/// @throws ConfigError naming an edge that still has more than two faces.
void cut_open(ImportMesh& mesh, Findings& findings);

}  // namespace weft
