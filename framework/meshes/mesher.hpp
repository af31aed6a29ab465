#pragma once
#include <map>
#include <string>
#include <vector>

#include "meshes/outlines.hpp"
#include "weft/garment.hpp"

/// Makes a mesh of well-shaped triangles from an outline. Same input, same bits.
namespace weft {

/// Wanted edge length: `edge_m`, and `fine_edge_m` within `fine_band_m` of any of the fine lines, growing by at most
/// `growth` m per m in between.
struct MeshSize {
  struct Line {
    Vec2 a, b;
  };
  double edge_m = 0.02;
  double fine_edge_m = 0.0;  ///< 0: uniform
  double fine_band_m = 0.0;  ///< half width of the band
  double growth = 0.15;
  std::vector<Line> fine_lines = {};
  double at(const Vec2& p) const;
};

struct MeshQuality {
  double min_angle_deg = 0.0;
  double max_angle_deg = 0.0;
  double edge_min_m = 0.0, edge_median_m = 0.0, edge_max_m = 0.0;
  double area_m2 = 0.0;
};
MeshQuality measure_mesh(const RestPositions& rest, const Faces& faces);

struct GeneratedMesh {
  Mesh mesh;  ///< positions (x, y, 0), rest = (x, y), multiples of 1 um
  std::map<std::string, Index> vertices;
  MeshQuality quality;
};

/// Triangulates the outline: DistMesh (Persson and Strang 2004) with the boundary vertices placed beforehand, density
/// control, and a last pass that raises the smallest angles. Vertices and faces are numbered along a Hilbert curve.
/// @throws ConfigError for an outline that is no simple counter-clockwise polygon or too fine for its edge length;
///         more than 200,000 expected vertices are refused.
GeneratedMesh generate_mesh(const Outline& outline, const MeshSize& size);

}  // namespace weft
