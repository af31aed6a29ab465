#pragma once
#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "meshes/nearest_surface.hpp"
#include "weft/garment.hpp"
#include "weft/types.hpp"

namespace weft {

/// What a goal without correspondence tells of the goal shape.
enum class GoalKind {
  surface,     ///< triangles
  points,      ///< points on the cloth
  silhouette,  ///< the region that the cloth covers, seen along -z
};

/// Nearest points of a cloth and its goal: of vertices of the cloth on the goal, and of the goal's samples on the cloth.
/// While the pairs are fixed, their differences are linear in the cloth's shape, and the gradient of the squared distances
/// is that of the fixed pairs wherever the nearest points are unique.
struct GoalPairs {
  struct Part {
    Positions onto;                           ///< [vertices of the part, 3] m: on the goal
    std::vector<std::array<Index, 3>> faces;  ///< [samples]: corners of the cloth's face nearest to each sample
    Positions weights;                        ///< [samples, 3]: of those corners
  };
  std::vector<Part> parts;  ///< the surface; the outline, if there is one
};

/// A goal whose points do not correspond to the garment's vertices: a mesh of another triangulation, a point cloud, or a
/// silhouette. With the silhouette all distances are in the plane z = 0, and a point within the region has distance 0.
/// The nearest points of a surface do not tell how far a cloth has slid along it, except near its edge. So a surface with
/// open edges, as the garment has them, is compared by its outline too: open edges with open edges.
class GoalSurface {
 public:
  /// @param positions [G, 3] m. @param faces [F, 3], of the goal; no rows for points.
  /// @throws ShapeError for a goal without an area or, for points, without points.
  GoalSurface(GoalKind kind, const Positions& positions, const Faces& faces, const Garment& garment);

  GoalKind kind() const { return kind_; }
  const Positions& positions() const { return positions_; }
  const Faces& faces() const { return faces_; }

  /// @param shape [V, 3] m: the cloth.
  GoalPairs pairs(const Positions& shape) const;
  /// Differences of the pairs, weighted: 1/2 |r|^2 is the chamfer loss, in mm^2 per coordinate as eq. 4 has it, the sum
  /// over the parts of
  ///     10^6 / 2 D (sum_v a_v |x_v - onto_v|^2 + 1/S sum_s |c_s(x) - s|^2),
  /// a_v being the vertex's share of the garment's area, or of its open edges' length, c_s the nearest point of the cloth
  /// to the sample s, and D = 3, or 2 for a silhouette. @return [residual_count()].
  Vector residuals(const GoalPairs& pairs, const Positions& shape) const;
  /// The change of residuals() with a change of the shape, the pairs fixed. @param change [V, 3] m.
  Vector residual_change(const GoalPairs& pairs, const Positions& change) const;
  /// Its transpose: the gradient of 1/2 |r|^2. @return [V, 3].
  Positions pullback(const GoalPairs& pairs, const Vector& residuals) const;
  Index residual_count() const;

  /// Distance of every vertex of the cloth from the goal, [V], mm.
  Vector distances_mm(const Positions& shape) const;
  /// Mean of both directions: of the distances of the cloth's vertices from the goal, and of the goal's points from the
  /// cloth, mm. A silhouette: in the plane.
  double chamfer_mm(const Positions& shape) const;
  /// Intersection over union of the silhouettes (silhouette_iou); NaN for points.
  double iou(const Positions& shape) const;

 private:
  /// What is compared: the surface, or the outline, whose segments are faces with two equal corners.
  struct Part {
    std::vector<Index> vertices;  // of the cloth
    Vector vertex_factors;        // square roots of the factors of |x_v - onto_v|^2
    Faces cloth;                  // on which the samples' nearest points lie
    NearestSurface goal;
    Positions samples;  // [S, 3] m, spread evenly over the goal
    double sample_factor;
  };
  /// @param measure area or length of each face of the garment. @param samples of the goal.
  Part make_part(const Garment& garment, const Faces& cloth, const Vector& measure, const Faces& goal,
                 Positions samples) const;
  NearestSurface tree_of(const Positions& positions, const Faces& faces) const;

  GoalKind kind_;
  Positions positions_;
  Faces faces_, cloth_;
  Eigen::Array3d axes_;      // 1, or 0 for what is not seen
  std::vector<Part> parts_;  // the surface first
};

/// Whether a planning loss (planning.loss) compares nearest points, not vertices.
inline bool is_surface_loss(const std::string& loss) { return loss == "chamfer" || loss == "silhouette"; }

/// The region of a mask: a PNG, whose white pixels are cloth seen along -z. Row 0 of the picture is at the largest y.
/// @param metres_per_pixel edge of a pixel. @param origin x and y, m, of the lower left corner of the picture.
/// @param positions, faces set to the region in the plane z = 0. @throws ConfigError for a file that is no such picture.
void read_mask(const std::filesystem::path& file, double metres_per_pixel, const Eigen::Vector2d& origin,
               Positions& positions, Faces& faces);

}  // namespace weft
