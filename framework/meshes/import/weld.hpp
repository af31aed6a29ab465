#pragma once
#include "meshes/import/import_mesh.hpp"

namespace weft {

/// Joins vertices that lie within `distance` of each other: those on open boundaries, which is where an unwelded seam
/// is, and the ends of an edge that short. Interior vertices stay: layers that touch are not sewn together. Where the
/// interiors of two pieces coincide, their boundaries are not joined either, and a warning says so.
/// @param distance m; negative: 1e-6 of the largest extent.
void weld(ImportMesh& mesh, double distance, Findings& findings);

}  // namespace weft
