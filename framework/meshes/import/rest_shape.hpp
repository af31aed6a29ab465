#pragma once
#include "meshes/import/import_mesh.hpp"

namespace weft {

/// What the file's texture coordinates say about the unstretched cloth.
struct TextureFit {
  bool everywhere = false;      ///< every face of the file has them
  bool one_point = false;       ///< they all are one point
  int islands = 0;              ///< parts of the atlas
  std::int64_t seam_edges = 0;  ///< between faces that do not share coordinates
  double scale = 0.0;           ///< one scale that turns them into metres: the median over all edges
  double median_strain = 0.0;   ///< of the mesh's edges against the scaled ones
  std::int64_t mirrored = 0;    ///< faces that run clockwise in the texture
  /// A strain of 2 % in the median: more is no cloth at rest.
  bool has_size() const { return everywhere && !one_point && median_strain <= 0.02; }
  bool one_chart() const { return seam_edges == 0; }
};
TextureFit fit_texture(const ImportMesh& mesh);

/// How the unstretched cloth of a mesh is known.
enum class RestForm {
  chart,      ///< one place in the plane for each vertex
  two_sides,  ///< a front and a back, drawn flat: the mesh is its own rest shape, face by face
  worn        ///< curved: the same, and it must be laid on the table by simulation
};
struct FoundRest {
  RestForm form = RestForm::chart;
  RestPositions chart;  ///< [V, 2] m; no rows for the other forms
};

/// Finds the rest shape. A mesh that is flat within 1e-4 of its extent is laid at z = 0 and is its own rest shape; it
/// keeps vt that are such a shape already. A curved one is laid flat where its texture is one chart of its size. Faces
/// of a chart run counter-clockwise afterwards. Everything else has the lengths that it was drawn with.
FoundRest find_rest_shape(ImportMesh& mesh, Findings& findings);

/// The layer of each vertex of a flat garment: its back and seams 0, its front 1, and pieces that lie over each other
/// one above the other. Empty: it is one layer.
std::vector<double> flat_layers(const ImportMesh& mesh, Findings& findings);

}  // namespace weft
