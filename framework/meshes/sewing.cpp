#include "meshes/sewing.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

#include "weft/error.hpp"
#include "weft/rest_shape.hpp"

namespace weft {
namespace {

using Ends = std::pair<int, int>;
/// The faces beside each edge.
std::map<Ends, std::vector<int>> faces_beside(const std::vector<std::array<int, 3>>& faces) {
  std::map<Ends, std::vector<int>> beside;
  for (std::size_t f = 0; f < faces.size(); ++f)
    for (std::size_t k = 0; k < 3; ++k)
      beside[std::minmax(faces[f][k], faces[f][(k + 1) % 3])].push_back(static_cast<int>(f));
  return beside;
}

/// Cuts an edge in the middle, and its two faces with it.
void cut_edge(std::vector<Vec2>& places, std::vector<std::array<int, 3>>& faces, const Ends& edge,
              const std::vector<int>& beside) {
  const auto middle = static_cast<int>(places.size());
  const Vec2 at = 0.5 * (places[edge.first] + places[edge.second]);
  places.push_back(at);
  for (const int f : beside) {
    auto& face = faces[f];
    std::size_t k = 0;
    while (Ends(std::minmax(face[k], face[(k + 1) % 3])) != edge) ++k;
    auto half = face;
    half[k] = middle;
    face[(k + 1) % 3] = middle;
    faces.push_back(half);
  }
}

double segment_distance(const Vec2& p, const Vec2& a, const Vec2& b) {
  const Vec2 e = b - a;
  return (p - a - std::clamp((p - a).dot(e) / e.squaredNorm(), 0.0, 1.0) * e).norm();
}

}  // namespace

SewnMesh sew_front_and_back(const Mesh& front, const std::function<bool(const Vec2&, const Vec2&)>& is_sewn) {
  std::vector<Vec2> places;
  for (Index v = 0; v < front.positions.rows(); ++v) places.push_back(front.positions.row(v).head<2>().transpose());
  std::vector<std::array<int, 3>> faces;
  for (Index f = 0; f < front.faces.rows(); ++f)
    faces.push_back({front.faces(f, 0), front.faces(f, 1), front.faces(f, 2)});
  std::vector<bool> joined(places.size(), false);
  bool any = false;
  for (const auto& [edge, beside] : faces_beside(faces)) {
    const auto a = static_cast<std::size_t>(edge.first), b = static_cast<std::size_t>(edge.second);
    if (beside.size() == 1 && is_sewn(places[a], places[b])) joined[a] = joined[b] = any = true;
  }
  if (!any) throw Error("sew_front_and_back: no edge of the border is a seam");
  for (bool cut = true; cut;) {
    cut = false;
    for (const auto& [edge, beside] : faces_beside(faces)) {
      if (beside.size() != 2 || !joined[edge.first] || !joined[edge.second]) continue;
      cut_edge(places, faces, edge, beside);
      joined.push_back(false);
      cut = true;
      break;  // the list of edges has changed
    }
  }

  SewnMesh sewn;
  const std::size_t n = places.size();
  auto next = static_cast<int>(n);
  for (std::size_t v = 0; v < n; ++v) sewn.back.push_back(joined[v] ? static_cast<int>(v) : next++);
  Mesh& mesh = sewn.mesh;
  mesh.source = front.source;
  mesh.positions = Positions::Zero(next, 3);
  sewn.form.layers.assign(next, 0.0);
  for (std::size_t v = 0; v < n; ++v) {
    mesh.positions.row(static_cast<Index>(v)).head<2>() = places[v].transpose();
    mesh.positions.row(sewn.back[v]).head<2>() = places[v].transpose();
    if (!joined[v]) sewn.form.layers[v] = 1.0;
  }
  const auto half = static_cast<Index>(faces.size());
  mesh.faces.resize(2 * half, 3);
  for (Index f = 0; f < half; ++f) {
    const auto& face = faces[f];
    const auto back = [&](std::size_t k) { return sewn.back[face[k]]; };
    mesh.faces.row(f) << face[0], face[1], face[2];
    mesh.faces.row(half + f) << back(0), back(2), back(1);
  }
  sewn.form.frames = frames_of_shape(mesh.positions, mesh.faces, {true, Vec3(0.0, 1.0, 0.0)});
  sewn.form.seams = edges_between_sides(mesh.positions, mesh.faces);
  return sewn;
}

bool is_open_at(const Outline& outline, const Vec2& a, const Vec2& b) {
  const auto& points = outline.points;
  std::size_t nearest = 0;
  double best = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vec2 &from = points[i].at, &to = points[(i + 1) % points.size()].at;
    const double far = std::max(segment_distance(a, from, to), segment_distance(b, from, to));
    if (far >= best) continue;
    best = far;
    nearest = i;
  }
  return points[nearest].open;
}

Mesh tube(Index around, Index along, double radius, double height) {
  Mesh mesh;
  mesh.source = "tube";
  mesh.positions.resize(around * (along + 1), 3);
  for (Index j = 0; j <= along; ++j)
    for (Index i = 0; i < around; ++i) {
      const double angle = 2.0 * std::numbers::pi * static_cast<double>(i) / static_cast<double>(around);
      mesh.positions.row(j * around + i) << radius * std::cos(angle), radius * std::sin(angle),
          height * static_cast<double>(j) / static_cast<double>(along);
    }
  mesh.faces.resize(2 * around * along, 3);
  Index f = 0;
  for (Index j = 0; j < along; ++j)
    for (Index i = 0; i < around; ++i) {
      const auto a = static_cast<int>(j * around + i), b = static_cast<int>(j * around + (i + 1) % around);
      const int c = a + static_cast<int>(around), d = b + static_cast<int>(around);
      mesh.faces.row(f++) << a, b, d;
      mesh.faces.row(f++) << a, d, c;
    }
  return mesh;
}

}  // namespace weft
