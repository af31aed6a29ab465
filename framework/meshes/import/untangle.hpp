#pragma once
#include "meshes/import/import_mesh.hpp"

namespace weft {

/// Where a worn garment passes through itself in a few places, smooths it there until it does not. Such places are faces
/// that a modeller has pushed through each other. Leaves what crosses in many places, or two pieces that cross.
void untangle(ImportMesh& mesh, Findings& findings);

}  // namespace weft
