#pragma once
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "weft/config.hpp"
#include "weft/mesh.hpp"
#include "weft/types.hpp"

namespace weft {

/// What a garment has that one place in the plane for each vertex cannot say.
struct GarmentForm {
  RestFrames frames;           ///< [F, 4] m; no rows: the rest shape is one place in the plane for each vertex
  std::vector<double> layers;  ///< [V] sheets of cloth below each vertex; empty: the garment is one layer
  Edges seams;                 ///< [S, 2] sorted: edges across which no bending moment acts
  /// Whether a place in the plane for each vertex says all.
  bool empty() const { return frames.rows() == 0 && layers.empty() && seams.rows() == 0; }
};

/// A piece of cloth: its rest shape, its initial positions, faces, and named vertices.
/// Immutable once made; topology is fixed for its whole life.
struct Garment {
  std::string name;
  Positions positions;                    ///< [V, 3] m: the initial shape
  RestPositions rest;                     ///< [V, 2] m: unstretched, x = warp, y = weft; with frames: xy, for pictures
  Faces faces;                            ///< [F, 3]
  std::map<std::string, Index> vertices;  ///< named vertices, such as left_sleeve_top
  /// Of what data and models depend on: rest shape, faces, layers and seams.
  std::uint64_t hash = 0;
  /// A garment with frames has the rest shape of each face on its own, so that closed garments and seams need no chart.
  /// Read it with RestShape (weft/rest_shape.hpp).
  GarmentForm form;

  Index vertex_count() const { return positions.rows(); }
  Index face_count() const { return faces.rows(); }
  bool has_frames() const { return form.frames.rows() > 0; }
  /// Number of the vertex's layer: 0 lies on the table, 1 on layer 0.
  double layer(Index vertex) const { return form.layers.empty() ? 0.0 : form.layers[vertex]; }
  /// @throws ConfigError naming the nearest known name.
  WEFT_API Index vertex(const std::string& vertex_name) const;
};

/// Checks the mesh (non-manifold edges or vertices, degenerate or inverted rest faces, NaN, wrong or unused vertices)
/// and makes a garment of it. Without vt and frames the mesh must lie flat; its xy are then the rest shape.
/// @throws ConfigError naming the face or vertex (0-based as in weft, 1-based as in the OBJ).
WEFT_API Garment make_garment(const Mesh& mesh, std::string name, std::map<std::string, Index> vertices = {},
                              GarmentForm form = {});

/// Reads `garment:`: the path of an OBJ, the path of a garment YAML, or a mapping {mesh, name, vertices, rest, layers,
/// seams} (docs/garments.md).
/// @throws ConfigError also for a mesh that is strained by more than 2 % (median edge) against its rest shape, unless
/// `rest.strained` gives the reason.
WEFT_API Garment read_garment(const ConfigNode& node);

/// What a user should look at: a size that no garment has, loose pieces, vertices that are not welded.
WEFT_API std::vector<std::string> garment_warnings(const Garment& garment);

/// Where a simulator's reset() puts the cloth, [V, 3] m. A vertex below contact height (ground + thickness) is lifted to
/// it. In a garment with layers every vertex lies at ground + (layer + 1) thickness + its own z, which is its height above
/// its layer.
WEFT_API Positions positions_on_ground(const Garment& garment, double ground, double thickness);

/// What a height of the lowest layer is measured from: its vertices, all of a garment without layers.
struct LowestLayer {
  double height = 0.0;  ///< m, mean z; of a garment with layers less each vertex's height above its layer
  Index vertices = 0;
};
/// @param seen [V]: which vertices count; empty: all.
WEFT_API LowestLayer lowest_layer(const Garment& garment, const Positions& shape, const std::vector<bool>& seen = {});

/// Mean distance between corresponding vertices, mm: the paper's error measure (Fig. 3).
/// @throws ShapeError if the numbers of vertices differ.
WEFT_API double mean_distance_mm(const Positions& a, const Positions& b);

}  // namespace weft
