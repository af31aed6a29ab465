#pragma once
#include <map>

#include "meshes/import/import_mesh.hpp"
#include "meshes/mesher.hpp"

namespace weft {

/// Gives the mesh triangles of another size: flat panels by generate_mesh(), everything else (curved, with holes, or
/// with a named vertex inside) by remesh_isotropic(). Named vertices and corners of outlines stay in place; texture
/// seams and edges sharper than 60 degrees stay lines. The findings state how far outline and surface moved.
/// @param rest as find_rest_shape() returned it; replaced. @param names the vertices to keep; renumbered.
void remesh(ImportMesh& mesh, RestPositions& rest, const MeshSize& size, std::map<std::string, int>& names,
            Findings& findings);

}  // namespace weft
