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

/// A front or a back: its vertices and faces, and which vertices are in seams.
struct Side {
  std::vector<Vec2> places;
  std::vector<std::array<int, 3>> faces;
  std::vector<bool> joined;

  Side(const Mesh& mesh, const std::function<bool(const Vec2&, const Vec2&)>& is_sewn) {
    for (Index v = 0; v < mesh.positions.rows(); ++v) places.push_back(mesh.positions.row(v).head<2>().transpose());
    for (Index f = 0; f < mesh.faces.rows(); ++f)
      faces.push_back({mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2)});
    joined.assign(places.size(), false);
    bool any = false;
    for (const auto& [edge, beside] : faces_beside(faces)) {
      const auto a = static_cast<std::size_t>(edge.first), b = static_cast<std::size_t>(edge.second);
      if (beside.size() == 1 && is_sewn(places[a], places[b])) joined[a] = joined[b] = any = true;
    }
    if (!any) throw Error("sew_front_and_back: no edge of the border is a seam");
    while (cut_between_seams()) {
    }
  }

 private:
  bool cut_between_seams() {
    for (const auto& [edge, beside] : faces_beside(faces)) {
      if (beside.size() != 2 || !joined[edge.first] || !joined[edge.second]) continue;
      cut_edge(places, faces, edge, beside);
      joined.push_back(false);
      return true;  // the list of edges has changed
    }
    return false;
  }
};

double segment_distance(const Vec2& p, const Vec2& a, const Vec2& b) {
  const Vec2 e = b - a;
  return (p - a - std::clamp((p - a).dot(e) / e.squaredNorm(), 0.0, 1.0) * e).norm();
}

}  // namespace

SewnMesh sew_front_and_back(const Mesh& front, const Mesh& back,
                            const std::function<bool(const Vec2&, const Vec2&)>& is_sewn) {
  const Side above(front, is_sewn), below(back, is_sewn);
  SewnMesh sewn;
  std::map<std::pair<double, double>, std::size_t> front_at;
  for (std::size_t v = 0; v < above.places.size(); ++v) front_at[{above.places[v].x(), above.places[v].y()}] = v;
  sewn.back.assign(above.places.size(), -1);
  std::vector<int> number;  // of the back's vertices
  std::size_t shared = 0;
  auto next = static_cast<int>(above.places.size());
  for (std::size_t v = 0; v < below.places.size(); ++v) {
    const auto same = front_at.find({below.places[v].x(), below.places[v].y()});
    const bool joined = below.joined[v] && same != front_at.end() && above.joined[same->second];
    number.push_back(joined ? static_cast<int>(same->second) : next++);
    shared += joined;
    if (same != front_at.end()) sewn.back[same->second] = number.back();
  }
  const auto in_seams = [](const Side& side) { return std::count(side.joined.begin(), side.joined.end(), true); };
  if (static_cast<std::ptrdiff_t>(shared) != in_seams(above) || in_seams(above) != in_seams(below))
    throw Error("sew_front_and_back: front and back have not the same vertices at the seams");

  Mesh& mesh = sewn.mesh;
  mesh.source = front.source;
  mesh.positions = Positions::Zero(next, 3);
  sewn.form.layers.assign(next, 0.0);
  for (std::size_t v = 0; v < above.places.size(); ++v) {
    mesh.positions.row(static_cast<Index>(v)).head<2>() = above.places[v].transpose();
    if (!above.joined[v]) sewn.form.layers[v] = 1.0;
  }
  for (std::size_t v = 0; v < below.places.size(); ++v)
    mesh.positions.row(number[v]).head<2>() = below.places[v].transpose();
  const auto half = static_cast<Index>(above.faces.size());
  mesh.faces.resize(half + static_cast<Index>(below.faces.size()), 3);
  for (Index f = 0; f < half; ++f) mesh.faces.row(f) << above.faces[f][0], above.faces[f][1], above.faces[f][2];
  for (Index f = half; f < mesh.faces.rows(); ++f) {
    const auto& face = below.faces[f - half];
    mesh.faces.row(f) << number[face[0]], number[face[2]], number[face[1]];
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
