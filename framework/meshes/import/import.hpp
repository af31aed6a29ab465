#pragma once
#include <filesystem>
#include <map>
#include <optional>

#include "meshes/import/import_mesh.hpp"
#include "meshes/import/names.hpp"
#include "meshes/import/rest_shape.hpp"
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
  Mesh mesh;  ///< m, z up; `rest` has rows if it is a chart
  RestForm form = RestForm::chart;
  std::vector<double> layers;             ///< [V] of a flat garment; empty: one layer
  std::optional<Garment> kept;            ///< the file was a garment of weft's with layers and frames of its own
  std::map<std::string, Index> vertices;  ///< the names
  std::vector<std::string> grasp;         ///< two of them; empty for a worn garment
  Findings findings;
  ImportMesh before;           ///< the triangles of the file, m, z up
  std::vector<int> vertex_of;  ///< [vertices of the file] the vertex of the mesh; -1: gone

  /// It lies flat, so it can be folded. A worn garment must be laid first.
  bool is_flat() const { return form != RestForm::worn; }
  /// The garment as weft's: with rest shape, layers and names. @throws ConfigError as make_garment().
  Garment garment(const std::string& name) const;
};

/// Names the outermost vertices of a garment and chooses those that the hands hold, as the import does of a flat one.
/// @param options its grasp, if given, was chosen by names or numbers already.
void choose_grasp(ImportedGarment& garment, const ImportOptions& options);

/// Imports a mesh file, or the YAML of a garment with its names. The passes, in this order: file, triangulate, units,
/// up, weld, faces, non-manifold edges, bow-ties, orientation, pieces, holes, flat, rest shape, crossings, names,
/// remesh.
/// Importing the result again changes nothing.
/// @throws ConfigError for what cannot be mended, naming the place.
ImportedGarment import_garment(const std::filesystem::path& path, const ImportOptions& options);

}  // namespace weft
