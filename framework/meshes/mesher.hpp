#pragma once
#include <map>
#include <string>
#include <vector>

#include "meshes/outlines.hpp"
#include "weft/garment.hpp"

/// Makes a mesh of well-shaped triangles from an outline. The same input gives the same bits.
namespace weft {

/// The target edge length: `fine_edge_m` within `fine_band_m` of a fine line, `edge_m` far from all of them. In between
/// it grows by at most `growth` m per m.
struct MeshSize {
  struct Line {
    Vec2 a, b;
  };
  double edge_m = 0.02;
  double fine_edge_m = 0.0;  ///< 0: uniform
  double fine_band_m = 0.0;  ///< half width of the band
  double growth = 0.15;
  std::vector<Line> fine_lines = {};
  /// Of the lattice that the inner vertices begin on, as a part of its spacing. With another one the outline gets the same
  /// vertices and the inside others.
  Vec2 lattice_shift = Vec2::Zero();
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
/// @throws ConfigError for an outline that is not a simple counter-clockwise polygon, details finer than the edge
/// length, or more than 200,000 expected vertices.
GeneratedMesh generate_mesh(const Outline& outline, const MeshSize& size);

}  // namespace weft
