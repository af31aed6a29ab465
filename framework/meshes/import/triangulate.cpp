#include "meshes/import/triangulate.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "meshes/plane.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

double smallest_angle_of_ear(const Vec2& a, const Vec2& b, const Vec2& c) {
  const auto angle = [](const Vec2& p, const Vec2& q, const Vec2& r) {
    return std::atan2(std::abs(cross(q - p, r - p)), (q - p).dot(r - p));
  };
  return std::min({angle(a, b, c), angle(b, c, a), angle(c, a, b)});
}

}  // namespace

std::optional<std::vector<std::array<int, 3>>> triangulate_polygon(const std::vector<Vec3>& polygon) {
  const std::size_t n = polygon.size();
  std::vector<std::array<int, 3>> triangles;
  if (n == 3) return std::vector<std::array<int, 3>>{{0, 1, 2}};
  Vec3 normal = Vec3::Zero();
  for (std::size_t i = 0; i < n; ++i) normal += polygon[i].cross(polygon[(i + 1) % n]);
  if (!(normal.norm() > 0.0)) return std::nullopt;
  normal.normalize();
  const Vec3 u = normal.unitOrthogonal();
  const Vec3 v = normal.cross(u);
  std::vector<Vec2> points;
  for (const Vec3& p : polygon) points.emplace_back(p.dot(u), p.dot(v));
  std::vector<int> ring(n);
  for (std::size_t i = 0; i < n; ++i) ring[i] = static_cast<int>(i);
  while (ring.size() > 3) {
    std::size_t best = ring.size();
    double best_angle = 0.0;
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const std::size_t m = ring.size();
      const Vec2& a = points[static_cast<std::size_t>(ring[(i + m - 1) % m])];
      const Vec2& b = points[static_cast<std::size_t>(ring[i])];
      const Vec2& c = points[static_cast<std::size_t>(ring[(i + 1) % m])];
      if (cross(b - a, c - b) <= 0.0) continue;
      const bool empty = std::none_of(ring.begin(), ring.end(), [&](int j) {
        const Vec2& p = points[static_cast<std::size_t>(j)];
        if (&p == &a || &p == &b || &p == &c) return false;
        return cross(b - a, p - a) >= 0.0 && cross(c - b, p - b) >= 0.0 && cross(a - c, p - c) >= 0.0;
      });
      if (!empty) continue;
      // The ear and what is left of a quad are chosen together.
      double angle = smallest_angle_of_ear(a, b, c);
      if (m == 4) {
        angle = std::min(angle, smallest_angle_of_ear(c, points[static_cast<std::size_t>(ring[(i + 2) % m])], a));
      }
      if (angle > best_angle + 1e-9) {
        best_angle = angle;
        best = i;
      }
    }
    if (best == ring.size()) return std::nullopt;
    const std::size_t m = ring.size();
    triangles.push_back({ring[(best + m - 1) % m], ring[best], ring[(best + 1) % m]});
    ring.erase(ring.begin() + static_cast<std::ptrdiff_t>(best));
  }
  triangles.push_back({ring[0], ring[1], ring[2]});
  return triangles;
}

ImportMesh triangulate_file(const ObjFile& file, const std::string& source, Findings& findings) {
  ImportMesh mesh;
  mesh.source = source;
  for (const auto& v : file.vertices) {
    mesh.positions.emplace_back(v[0], v[1], v[2]);
    mesh.vertex_number.push_back(static_cast<int>(mesh.positions.size()));
    mesh.vertex_of.push_back(static_cast<int>(mesh.positions.size()) - 1);
  }
  for (const auto& vt : file.texture) mesh.texture.emplace_back(vt[0], vt[1]);
  std::int64_t quads = 0, polygons = 0, points = 0;
  std::vector<Vec3> polygon;
  for (std::size_t f = 0; f < file.faces.size(); ++f) {
    std::vector<ObjFile::Corner> corners;
    for (const ObjFile::Corner& corner : file.faces[f].corners) {
      if (corners.empty() || corner.vertex != corners.back().vertex) corners.push_back(corner);
    }
    while (corners.size() > 1 && corners.front().vertex == corners.back().vertex) corners.pop_back();
    if (corners.size() < 3) {
      ++points;
      continue;
    }
    if (corners.size() == 4) ++quads;
    if (corners.size() > 4) ++polygons;
    polygon.clear();
    for (const ObjFile::Corner& corner : corners) polygon.push_back(mesh.at(corner.vertex));
    const auto triangles = triangulate_polygon(polygon);
    if (!triangles) {
      throw ConfigError(source + ":" + std::to_string(file.faces[f].line) + ": face " + std::to_string(f + 1) +
                        " crosses itself or has no area: its " + std::to_string(corners.size()) +
                        " corners give no triangles; cut it up in a modelling program");
    }
    for (const auto& triangle : *triangles) {
      ImportMesh::Triangle vertices{}, textures{};
      for (std::size_t k = 0; k < 3; ++k) {
        const ObjFile::Corner& corner = corners[static_cast<std::size_t>(triangle[k])];
        vertices[k] = corner.vertex;
        textures[k] = corner.texture;
      }
      mesh.faces.push_back(vertices);
      mesh.face_texture.push_back(textures);
      mesh.face_number.push_back(static_cast<int>(f) + 1);
    }
  }
  if (mesh.faces.empty()) throw ConfigError(source + ": no face has an area");
  Finding finding{"triangulate", FindingKind::fact, quads + polygons, "all faces are triangles"};
  if (quads + polygons > 0) {
    finding.kind = FindingKind::mended;
    finding.text = counted(quads, "quad") + " and " + counted(polygons, "larger polygon") + " cut into triangles";
  }
  findings.push_back(finding);
  if (points > 0) {
    findings.push_back({"triangulate", FindingKind::mended, points,
                        counted(points, "face") + " with fewer than three different corners removed"});
  }
  return mesh;
}

}  // namespace weft
