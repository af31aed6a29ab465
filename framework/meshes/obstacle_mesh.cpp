#include "meshes/obstacle_mesh.hpp"

#include <cmath>
#include <numbers>

namespace weft {
namespace {

constexpr int kPerQuarter = 4;  // steps around a rounded edge
constexpr int kAroundBar = 48;  // points around a cylinder
constexpr double kSlab = 0.02;  // m, thickness of a drawn half-space

/// The ring of a body's surface at one height, in its own axes. @param outward cosine of the latitude, in [0, 1].
void add_ring(std::vector<Vec3>& points, const Obstacle& o, const Vec3& core, double outward, double z) {
  if (o.kind == Obstacle::Kind::cylinder) {
    for (int k = 0; k < kAroundBar; ++k) {
      const double a = 2.0 * std::numbers::pi * k / kAroundBar, radius = core.x() + o.rounding * outward;
      points.emplace_back(radius * std::cos(a), radius * std::sin(a), z);
    }
    return;
  }
  for (int quarter = 0; quarter < 4; ++quarter)
    for (int k = 0; k <= kPerQuarter; ++k) {
      const double a = 0.5 * std::numbers::pi * (quarter + static_cast<double>(k) / kPerQuarter);
      const double x = quarter == 0 || quarter == 3 ? core.x() : -core.x(), y = quarter < 2 ? core.y() : -core.y();
      points.emplace_back(x + o.rounding * outward * std::cos(a), y + o.rounding * outward * std::sin(a), z);
    }
}

}  // namespace

Mesh obstacle_mesh(const Obstacle& obstacle, const Vec3& focus, double extent) {
  Obstacle o = obstacle;
  if (o.kind == Obstacle::Kind::half_space) {
    const ObstacleDistance at = obstacle_distance(o, focus);
    o.kind = Obstacle::Kind::box;
    o.half_size = {extent, extent, 0.5 * kSlab};
    o.centre = focus - at.distance * at.normal - 0.5 * kSlab * at.normal;
    o.rounding = 0.0;
  }
  const Vec3 core = o.half_size.array() - o.rounding;
  std::vector<Vec3> points;
  for (const double side : {-1.0, 1.0})
    for (int k = 0; k <= kPerQuarter; ++k) {
      const double latitude = 0.5 * std::numbers::pi * (side < 0.0 ? k - kPerQuarter : k) / kPerQuarter;
      add_ring(points, o, core, std::cos(latitude), side * core.z() + o.rounding * std::sin(latitude));
    }
  constexpr int rings = 2 * (kPerQuarter + 1);
  const int around = static_cast<int>(points.size()) / rings;
  Mesh mesh;
  mesh.positions.resize(std::ssize(points), 3);
  mesh.rest.resize(0, 2);
  for (Index i = 0; i < mesh.positions.rows(); ++i) mesh.positions.row(i) = (o.centre + o.axes * points[i]).transpose();
  mesh.faces.resize(2 * (rings - 1) * around + 2 * (around - 2), 3);
  Index f = 0;
  for (int ring = 0; ring + 1 < rings; ++ring)
    for (int k = 0; k < around; ++k) {
      const int a = ring * around + k, b = ring * around + (k + 1) % around;
      mesh.faces.row(f++) << a, b, b + around;
      mesh.faces.row(f++) << a, b + around, a + around;
    }
  const int top = (rings - 1) * around;
  for (int k = 1; k + 1 < around; ++k) {
    mesh.faces.row(f++) << 0, k + 1, k;
    mesh.faces.row(f++) << top, top + k, top + k + 1;
  }
  return mesh;
}

}  // namespace weft
