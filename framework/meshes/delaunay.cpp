#include "meshes/delaunay.hpp"

#include <boost/polygon/voronoi.hpp>
#include <cmath>
#include <cstdint>

namespace weft {

std::vector<std::array<int, 3>> delaunay(const std::vector<Vec2>& points) {
  using boost::polygon::point_data;
  std::vector<std::array<int, 3>> triangles;
  if (points.size() < 3) return triangles;
  Vec2 low = points[0];
  Vec2 high = points[0];
  for (const Vec2& p : points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const double extent = (high - low).maxCoeff();
  if (!(extent > 0.0)) return triangles;
  const double scale = 1073741824.0 / extent;
  std::vector<point_data<std::int32_t>> sites;
  sites.reserve(points.size());
  for (const Vec2& p : points) {
    sites.emplace_back(static_cast<std::int32_t>(std::lround((p.x() - low.x()) * scale)),
                       static_cast<std::int32_t>(std::lround((p.y() - low.y()) * scale)));
  }
  boost::polygon::voronoi_diagram<double> diagram;
  boost::polygon::construct_voronoi(sites.begin(), sites.end(), &diagram);

  const auto twice_area = [&sites](int a, int b, int c) {
    const auto at = [&sites](int i) { return sites[static_cast<std::size_t>(i)]; };
    const std::int64_t ux = std::int64_t{at(b).x()} - at(a).x();
    const std::int64_t uy = std::int64_t{at(b).y()} - at(a).y();
    const std::int64_t vx = std::int64_t{at(c).x()} - at(a).x();
    const std::int64_t vy = std::int64_t{at(c).y()} - at(a).y();
    return ux * vy - uy * vx;  // below 2^62
  };
  std::vector<int> ring;
  for (const auto& vertex : diagram.vertices()) {
    ring.clear();
    const auto* edge = vertex.incident_edge();
    do {
      ring.push_back(static_cast<int>(edge->cell()->source_index()));
      edge = edge->rot_next();
    } while (edge != vertex.incident_edge());
    for (std::size_t k = 2; k < ring.size(); ++k) {
      const std::int64_t area = twice_area(ring[0], ring[k - 1], ring[k]);
      if (area > 0) triangles.push_back({ring[0], ring[k - 1], ring[k]});
      if (area < 0) triangles.push_back({ring[0], ring[k], ring[k - 1]});
    }
  }
  return triangles;
}

}  // namespace weft
