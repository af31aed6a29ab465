#pragma once
#include <filesystem>

#include "weft/garment.hpp"

namespace weft {

/// Saves a garment so that read_garment() of garment_node() gives the same numbers: the mesh and, of a garment with
/// frames, beside it MESH_rest.obj, which holds every face on its own in its rest frame.
/// @param mesh_file ends in .obj.
void write_garment_meshes(const std::filesystem::path& mesh_file, const Garment& garment);

/// `garment:` of a config beside that mesh.
ConfigNode garment_node(const std::string& mesh_file, const Garment& garment);

}  // namespace weft
