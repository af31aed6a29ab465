#pragma once
#include <array>
#include <string>
#include <vector>

#include "weft/task.hpp"

namespace weft {

/// How far a shape is from its goal, besides the mean vertex error
/// (mean_distance_mm).
struct ShapeErrors {
  double max_mm = 0.0;      ///< largest vertex error
  double grasped_mm = 0.0;  ///< mean over the grasped vertices; NaN: none of them was seen
  double named_mm = 0.0;    ///< mean over the garment's named vertices; NaN: none
                            ///< of them was seen
  double iou = 0.0;         ///< silhouette_iou()
  double coverage = 0.0;    ///< coverage()
};

/// @param shape, goal [V, 3] m. @param seen [V]: vertices that count; empty:
/// all. The silhouette is that of the whole shape in any case. @throws
/// ShapeError.
ShapeErrors shape_errors(const Positions& shape, const Positions& goal, const Task& task,
                         const std::vector<bool>& seen = {});

/// Mean distance of the vertices that count, mm; NaN: none does. @param counts [V]; empty: all. @throws ShapeError.
double mean_distance_mm(const Positions& shape, const Positions& goal, const std::vector<bool>& counts);

/// Limits of the mean vertex error, mm, below which a fold counts as a success.
inline constexpr std::array<int, 3> kSuccessLimitsMm = {10, 20, 30};
inline bool succeeds(double error_mm, int limit_mm) { return error_mm <= limit_mm; }
/// Its key in results: success_10mm.
inline std::string success_key(int limit_mm) { return "success_" + std::to_string(limit_mm) + "mm"; }

/// Intersection over union of the silhouettes of two shapes seen from above
/// (along -z). A silhouette is the union of the shape's triangles. A cell of a
/// square raster in the plane z = 0 belongs to it if the cell's centre does.
/// @param a, b [V, 3] m. @param cell m, edge of a cell.
/// @return in [0, 1]; NaN if neither covers the centre of a cell, or if a shape
/// is further than 100 m from the origin.
double silhouette_iou(const Positions& a, const Faces& faces_a, const Positions& b, const Faces& faces_b,
                      double cell = 0.001);
/// Of two shapes of one mesh. @throws ShapeError for different numbers of vertices.
double silhouette_iou(const Positions& a, const Positions& b, const Faces& faces, double cell = 0.001);
/// The area that a shape covers, seen from above, as a share of that of the flat garment: 1 if it lies flat.
double coverage(const Positions& shape, const Garment& garment, double cell = 0.001);
/// Area of the silhouette, m^2; NaN for a shape that is further than 100 m from the origin.
double silhouette_area(const Positions& shape, const Faces& faces, double cell = 0.001);

}  // namespace weft
