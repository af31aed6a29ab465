#pragma once
#include <cstdint>
#include <optional>
#include <string>

#include "weft/export.hpp"
#include "weft/types.hpp"

namespace weft {

/// A convex body that stands still in the scene. Cloth keeps its thickness above the surface and slides on it by
/// Coulomb's law, as on the ground.
struct Obstacle {
  enum class Kind : std::uint8_t { half_space, box, cylinder };
  Kind kind = Kind::half_space;
  std::string name = "half_space";  ///< for messages: "table"
  Vec3 centre = Vec3::Zero();       ///< m; of a half-space a point of its surface
  /// Columns: the body's own axes x, y, z, orthonormal, in the world. The half-space is below its z; the axis of a
  /// cylinder is z.
  Eigen::Matrix<double, 3, 3, Eigen::DontAlign> axes = Eigen::Matrix3d::Identity();
  /// m, along the body's axes, its rounded edges included. Cylinder: radius, radius, half of its length.
  Vec3 half_size = Vec3::Zero();
  double rounding = 0.0;           ///< m, radius of the edges, >= 0 and <= the smallest of half_size
  std::optional<double> friction;  ///< of cloth on it, >= 0; nullopt: Fabric::friction
};

/// Distance of a point to an obstacle and its gradient.
struct ObstacleDistance {
  double distance = 0.0;       ///< m, negative inside
  Vec3 normal = Vec3::Zero();  ///< unit; the direction in which the distance grows
};

/// Exact outside. With q = |p| - (half_size - rounding) in the body's axes, for a cylinder (radial, axial):
///     distance = |max(q, 0)| + min(max_i q_i, 0) - rounding        [Quilez, "Distance functions": rounded box]
/// It is a convex function of the point, because the body is convex.
WEFT_API ObstacleDistance obstacle_distance(const Obstacle& obstacle, const Vec3& point);

/// The flat side above which a point lies, further than `margin` (m) from where the surface bends: 1, 2, ...; 0: none.
/// Between two points above one flat side the distance is linear.
WEFT_API int flat_side(const Obstacle& obstacle, const Vec3& point, double margin);

/// The point of an edge or face of the mesh that is nearest to an obstacle, or deepest in it.
struct ObstacleContact {
  double weight[3] = {0.0, 0.0, 0.0};  ///< of the corners, sum 1
  ObstacleDistance at;
};

/// Cloth bends over convex edges between its vertices. So an edge a b of the mesh touches an obstacle where the
/// distance along it is least: at a root of normal . (b - a), which grows along the edge.
/// @return nullopt where the least distance is at an end, which is the vertex's own contact.
WEFT_API std::optional<ObstacleContact> nearest_in_edge(const Obstacle& obstacle, const Vec3& a, const Vec3& b,
                                                        const ObstacleDistance& at_a, const ObstacleDistance& at_b);

/// A corner of a box, or a point of a cylinder's rim, that presses into a face a b c between its edges.
/// @return nullopt if no such point lies inside the face.
WEFT_API std::optional<ObstacleContact> nearest_in_face(const Obstacle& obstacle, const Vec3& a, const Vec3& b,
                                                        const Vec3& c);

}  // namespace weft
