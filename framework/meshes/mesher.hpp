#pragma once
#include <map>
#include <string>
#include <vector>

#include "weft/garment.hpp"
#include "weft/params.hpp"

/// Makes flat, single-layer garments: an outline from sizes, and a mesh of well-shaped triangles from the outline.
/// x = left to right, y = bottom to top, centred in x; "left" is the side at negative x. Same input, same bits.
namespace weft {

/// A simple polygon, counter-clockwise. Corners become vertices, with their names; the points between two corners only
/// shape the curve, on which the mesher places its own vertices.
struct Outline {
  struct Point {
    Vec2 at;                ///< m
    std::string name = "";  ///< of the vertex; empty: unnamed
    bool corner = true;
  };
  std::vector<Point> points;
};

struct TowelSize {
  double width_m = 0.4;
  double length_m = 0.4;
  template <class Visitor>
  void visit(Visitor& v) {
    v("width_m", width_m, range(0.02, 5.0, "m"), "Extent in x.");
    v("length_m", length_m, range(0.02, 5.0, "m"), "Extent in y.");
  }
};

/// Shirts with short or long sleeves: body, two straight sleeves, round neck.
struct ShirtSize {
  double width_m = 0.6;
  double length_m = 0.7;
  double sleeve_length_m = 0.11;
  double sleeve_width_m = 0.15;
  double sleeve_angle_deg = 20.0;
  double shoulder_angle_deg = 20.0;
  double armhole_m = 0.165;
  double neck_width_m = 0.17;
  double neck_depth_m = 0.07;
  template <class Visitor>
  void visit(Visitor& v) {
    v("width_m", width_m, range(0.1, 5.0, "m"), "Sleeve tip to sleeve tip; the body is what the sleeves leave.");
    v("length_m", length_m, range(0.1, 5.0, "m"), "Bottom hem to the top of the shoulders.");
    v("sleeve_length_m", sleeve_length_m, range(0.01, 2.0, "m"),
      "Along the top of the sleeve, from the body outwards.");
    v("sleeve_width_m", sleeve_width_m, range(0.01, 1.0, "m"), "Opening at the sleeve's end.");
    v("sleeve_angle_deg", sleeve_angle_deg, range(0.0, 75.0, "deg"), "Of the sleeve below the horizontal.");
    v("shoulder_angle_deg", shoulder_angle_deg, range(0.0, 45.0, "deg"), "Of the shoulder below the horizontal.");
    v("armhole_m", armhole_m, range(0.02, 1.0, "m"), "Height of the sleeve where it meets the body.");
    v("neck_width_m", neck_width_m, range(0.02, 1.0, "m"), "Opening of the collar.");
    v("neck_depth_m", neck_depth_m, range(0.005, 0.5, "m"), "Depth of the collar.");
  }
};

struct TrousersSize {
  double waist_m = 0.38;
  double hip_m = 0.48;
  double length_m = 0.9;
  double inseam_m = 0.62;
  double leg_width_m = 0.19;
  double gap_m = 0.06;
  template <class Visitor>
  void visit(Visitor& v) {
    v("waist_m", waist_m, range(0.05, 3.0, "m"), "Width at the top.");
    v("hip_m", hip_m, range(0.05, 3.0, "m"), "Width at the crotch.");
    v("length_m", length_m, range(0.1, 5.0, "m"), "Hem to waist.");
    v("inseam_m", inseam_m, range(0.02, 4.0, "m"), "Hem to crotch.");
    v("leg_width_m", leg_width_m, range(0.02, 2.0, "m"), "Width of a leg at its hem.");
    v("gap_m", gap_m, range(0.0, 2.0, "m"), "Distance between the legs at the hem.");
  }
};

/// @throws ConfigError when the sizes contradict each other (sleeves wider than the garment, ...).
Outline towel_outline(const TowelSize& size);
Outline shirt_outline(const ShirtSize& size);
Outline trousers_outline(const TrousersSize& size);
/// Sizes of a long-sleeved shirt.
ShirtSize long_sleeve_size();

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
