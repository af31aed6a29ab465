#include "simulation/seen_vertex.hpp"

#include <algorithm>
#include <numeric>
#include <utility>
#include <vector>

namespace weft {
namespace {

constexpr double kAbove = 1e-6;  // m: a face that is less far above a vertex does not cover it

/// Whether a face lies above a vertex that is not one of its corners.
bool covers(const Positions& shape, const Faces& faces, Index face, Index vertex) {
  Eigen::Matrix2d edges;  // in XY, from corner 0
  Vec2 rise;
  const auto corner = shape.row(faces(face, 0));
  for (int k = 0; k < 3; ++k)
    if (faces(face, k) == vertex) return false;
  for (int k = 0; k < 2; ++k) {
    const auto edge = shape.row(faces(face, k + 1)) - corner;
    edges.col(k) = edge.head<2>().transpose();
    rise(k) = edge.z();
  }
  const double area = edges.determinant();
  if (area == 0.0) return false;
  const Vec2 from = (shape.row(vertex) - corner).head<2>().transpose();
  const double u = (from.x() * edges(1, 1) - from.y() * edges(0, 1)) / area;
  const double v = (edges(0, 0) * from.y() - edges(1, 0) * from.x()) / area;
  if (u < 0.0 || v < 0.0 || u + v > 1.0) return false;
  return corner.z() + u * rise.x() + v * rise.y() > shape(vertex, 2) + kAbove;
}

}  // namespace

Index nearest_seen_vertex(const Positions& shape, const Faces& faces, const Vec2& at) {
  std::vector<Index> order(shape.rows());
  std::iota(order.begin(), order.end(), Index{0});
  const auto distance = [&](Index vertex) { return (shape.row(vertex).head<2>().transpose() - at).squaredNorm(); };
  std::sort(order.begin(), order.end(),
            [&](Index a, Index b) { return std::pair(distance(a), a) < std::pair(distance(b), b); });
  for (const Index vertex : order) {
    bool is_covered = false;
    for (Index face = 0; face < faces.rows() && !is_covered; ++face) is_covered = covers(shape, faces, face, vertex);
    if (!is_covered) return vertex;
  }
  return order.front();  // only where faces go through one another
}

}  // namespace weft
