#pragma once
#include <string>
#include <vector>

#include "weft/params.hpp"
#include "weft/types.hpp"

/// Outlines of flat garments from their sizes.
/// x = left to right, y = bottom to top, centred in x; "left" is the side at negative x.
namespace weft {

/// A simple, counter-clockwise polygon. Corners become vertices with their names. The points between two corners only
/// shape the curve; the mesher places its own vertices on it.
struct Outline {
  struct Point {
    Vec2 at;                ///< m
    std::string name = "";  ///< of the vertex; empty: unnamed
    bool corner = true;
    bool open = false;  ///< the side from here to the next point is an opening of a garment of two layers: no seam
  };
  std::vector<Point> points;
};

/// Enclosed area, m^2; positive if the outline runs counter-clockwise.
double signed_area(const Outline& outline);
/// @throws ConfigError unless the outline is a simple, counter-clockwise polygon of at least 3 corners.
void check_outline(const Outline& outline);

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
    v("width_m", width_m, range(0.1, 5.0, "m"), "Sleeve tip to sleeve tip; the body is this less the sleeves.");
    v("length_m", length_m, range(0.1, 5.0, "m"), "Bottom hem to the top of the shoulders.");
    v("sleeve_length_m", sleeve_length_m, range(0.01, 2.0, "m"),
      "Along the top of the sleeve, from the body outwards.");
    v("sleeve_width_m", sleeve_width_m, range(0.01, 1.0, "m"), "Opening at the sleeve's end.");
    v("sleeve_angle_deg", sleeve_angle_deg, range(0.0, 75.0, "deg"), "Angle of the sleeve below the horizontal.");
    v("shoulder_angle_deg", shoulder_angle_deg, range(0.0, 45.0, "deg"), "Angle of the shoulder below the horizontal.");
    v("armhole_m", armhole_m, range(0.02, 1.0, "m"), "Height of the sleeve at the body.");
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

/// @throws ConfigError if the sizes contradict each other, such as sleeves wider than the garment.
Outline towel_outline(const TowelSize& size);
Outline shirt_outline(const ShirtSize& size);
Outline trousers_outline(const TrousersSize& size);
/// Sizes of a long-sleeved shirt.
ShirtSize long_sleeve_size();

}  // namespace weft
