#pragma once
#include <filesystem>
#include <map>
#include <optional>

#include "meshes/import/import_mesh.hpp"
#include "meshes/import/names.hpp"
#include "meshes/mesher.hpp"
#include "weft/garment.hpp"

namespace weft {

struct ImportOptions {
  std::optional<std::string> units = {};  ///< m, cm, mm, in; nothing: what the file says, or a guess
  std::optional<std::string> up = {};     ///< x, y, z, -x, -y, -z
  double weld_m = -1.0;                   ///< negative: 1e-6 of the size
  int fill_edges = 6;                     ///< holes of so many edges are filled
  int piece = 0;                          ///< keep this one alone, from 1 for the largest
  std::vector<std::pair<std::string, VertexSpec>> names = {};
  std::vector<VertexSpec> grasp = {};  ///< two, or none: the outermost vertices of one side
  std::optional<MeshSize> remesh = {};
};

struct ImportedGarment {
  Mesh mesh;                              ///< m, z up; `rest` has no rows where there is a limit
  std::map<std::string, Index> vertices;  ///< the names
  std::vector<std::string> grasp;         ///< two of them; empty where there is a limit
  Findings findings;
  ImportMesh before;           ///< the triangles of the file, m, z up
  std::vector<int> vertex_of;  ///< [vertices of the file] the vertex of the mesh; -1: gone

  /// Today's weft folds it: there is no limit, and make_garment() accepts it.
  bool foldable() const;
};

/// Imports a mesh file, or the YAML of a garment with its names. The passes, in this order: file, triangulate, units,
/// up, weld, faces, non-manifold edges, bow-ties, orientation, pieces, holes, flat, rest shape, names, remesh.
/// Importing the result again changes nothing.
/// @throws ConfigError for what cannot be mended, naming the place.
ImportedGarment import_garment(const std::filesystem::path& path, const ImportOptions& options);

}  // namespace weft
