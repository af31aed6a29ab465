#include "meshes/import/weld.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <set>

namespace weft {
namespace {

/// Calls visit(u, v) for all pairs of vertices within the distance, by a sweep along the longest axis.
template <class Visit>
void near_pairs(const ImportMesh& mesh, double distance, const std::vector<int>& of, Visit&& visit) {
  if (of.empty()) return;
  Vec3 low = mesh.at(of.front()), high = low;
  for (const int v : of) {
    low = low.cwiseMin(mesh.at(v));
    high = high.cwiseMax(mesh.at(v));
  }
  // Sorted by a slanted direction: on a grid of vertices each axis has whole columns of equal coordinates.
  const Vec3 slant = Vec3(0.8017837, 0.5345225, 0.2672612);
  std::vector<std::pair<double, int>> order;
  for (const int v : of) order.emplace_back(slant.dot(mesh.at(v)), v);
  std::sort(order.begin(), order.end());
  const double window = distance * (1.0 + 1e-9) + 1e-15 * (high - low).norm();
  for (std::size_t i = 0; i < order.size(); ++i) {
    for (std::size_t j = i + 1; j < order.size() && order[j].first - order[i].first <= window; ++j) {
      const int u = std::min(order[i].second, order[j].second), v = std::max(order[i].second, order[j].second);
      if ((mesh.at(u) - mesh.at(v)).norm() <= distance) visit(u, v);
    }
  }
}

/// Whether two faces that meet at a place cover part of each other there, as the layers of a garment do. Faces beside each other, as
/// at a seam, do not.
bool covers(const ImportMesh& mesh, int first, int first_corner, int second, int second_corner) {
  constexpr double kOnePlane = 0.9986;  // cosine of 3 degrees between the planes
  const auto corner = [&](int f, int k) {
    const auto& face = mesh.faces[f];
    const auto at = [&](int i) { return mesh.at(face[(k + i) % 3]); };
    return std::array<Vec3, 2>{(at(1) - at(0)).normalized(), (at(2) - at(0)).normalized()};
  };
  const Vec3 normal = mesh.area_vector(first).normalized();
  if (!(std::abs(normal.dot(mesh.area_vector(second).normalized())) > kOnePlane)) return false;
  auto own = corner(first, first_corner), other = corner(second, second_corner);
  // Counter-clockwise about the first one's normal.
  if (own[0].cross(own[1]).dot(normal) < 0.0) std::swap(own[0], own[1]);
  if (other[0].cross(other[1]).dot(normal) < 0.0) std::swap(other[0], other[1]);
  const auto within = [&](const Vec3& d, const std::array<Vec3, 2>& sector) {
    constexpr double kInside = 1e-3;  // sine: sectors beside each other share a side
    return sector[0].cross(d).dot(normal) > kInside && d.cross(sector[1]).dot(normal) > kInside;
  };
  const Vec3 own_middle = own[0] + own[1], other_middle = other[0] + other[1];
  return within(other[0], own) || within(other[1], own) || within(own[0], other) || within(own[1], other) ||
         within(own_middle.normalized(), other) || within(other_middle.normalized(), own);
}

/// The corners of faces at each vertex.
class Corners {
 public:
  explicit Corners(const ImportMesh& mesh) : mesh_(mesh), at_(mesh.positions.size()) {
    for (std::size_t f = 0; f < mesh.faces.size(); ++f)
      for (int k = 0; k < 3; ++k) at_[mesh.faces[f][k]].emplace_back(static_cast<int>(f), k);
  }
  /// Whether the cloth at one vertex covers that at another one in the same place.
  bool cover(int u, int v) const {
    for (const auto& [f, j] : at_[u])
      for (const auto& [g, k] : at_[v])
        if (covers(mesh_, f, j, g, k)) return true;
    return false;
  }

 private:
  const ImportMesh& mesh_;
  std::vector<std::vector<std::pair<int, int>>> at_;  // [V] face and its corner
};

struct Boundary {
  std::vector<bool> open;               // [V]: in an edge of one face
  std::set<std::pair<int, int>> edges;  // all edges
  std::vector<int> piece;               // [V]: of vertices that faces join
};

Boundary boundary_of(const ImportMesh& mesh) {
  Boundary boundary;
  boundary.open.assign(mesh.positions.size(), false);
  DisjointSets pieces(mesh.positions.size());
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
    boundary.edges.emplace_hint(boundary.edges.end(), begin->first, begin->second);
    pieces.unite(begin->first, begin->second);
    if (end - begin == 1) {
      boundary.open[static_cast<std::size_t>(begin->first)] = true;
      boundary.open[static_cast<std::size_t>(begin->second)] = true;
    }
  });
  for (int v = 0; v < mesh.vertex_count(); ++v) boundary.piece.push_back(pieces.root(v));
  return boundary;
}

/// A seam that is almost closed is a frequent fault of exports with few digits.
void say_almost_closed(const ImportMesh& mesh, double within, Findings& findings) {
  const Boundary after = boundary_of(mesh);
  std::vector<int> rim;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    if (after.open[static_cast<std::size_t>(v)]) rim.push_back(v);
  }
  const double gap = 0.05 * mesh.median_edge();
  std::int64_t almost = 0;
  double widest = 0.0;
  std::vector<Place> almost_places;
  near_pairs(mesh, gap, rim, [&](int u, int v) {
    if (after.edges.count({u, v}) > 0 || (mesh.at(u) - mesh.at(v)).norm() <= within) return;
    ++almost;
    widest = std::max(widest, (mesh.at(u) - mesh.at(v)).norm());
    if (almost_places.size() < kMostPlaces) almost_places.push_back(mesh.place(v));
  });
  if (almost > 0) {
    findings.push_back({"weld", FindingKind::warning, almost,
                        counted(almost, "pair") + " of boundary vertices are at most " + length_text(widest) +
                            " apart but not joined (" + places_text(almost_places, almost) +
                            "): an open seam? --weld DISTANCE joins them",
                        almost_places});
  }
}

}  // namespace

void weld(ImportMesh& mesh, double distance, Findings& findings) {
  const double within = distance < 0.0 ? 1e-6 * mesh.largest_extent() : distance;
  const Boundary boundary = boundary_of(mesh);
  const auto open = [&](int v) { return static_cast<bool>(boundary.open[static_cast<std::size_t>(v)]); };
  const auto piece = [&](int v) { return boundary.piece[static_cast<std::size_t>(v)]; };
  std::vector<int> all(mesh.positions.size());
  std::iota(all.begin(), all.end(), 0);

  const Corners corners(mesh);
  std::vector<std::pair<int, int>> joined;
  std::set<std::pair<int, int>> layers;  // pieces whose interiors coincide somewhere
  std::vector<Place> layer_places, over_places;
  std::int64_t layer_count = 0, over = 0;
  near_pairs(mesh, within, all, [&](int u, int v) {
    if (boundary.edges.count({u, v}) > 0) {
      joined.emplace_back(u, v);
    } else if (open(u) && open(v)) {
      // Front and back at an opening. (A repeated face of loose triangles is joined by its neighbours.)
      if (corners.cover(u, v)) {
        ++over;
        if (over_places.size() < kMostPlaces) over_places.push_back(mesh.place(v));
      } else {
        joined.emplace_back(u, v);
      }
    } else {
      layers.emplace(std::min(piece(u), piece(v)), std::max(piece(u), piece(v)));
      if (layer_places.size() < kMostPlaces) layer_places.push_back(mesh.place(v));
      ++layer_count;
    }
  });
  DisjointSets sets(mesh.positions.size());
  std::vector<Place> places;
  std::int64_t welded = 0;
  for (const auto& [u, v] : joined) {
    const bool edge = boundary.edges.count({u, v}) > 0;
    if (!edge && layers.count({std::min(piece(u), piece(v)), std::max(piece(u), piece(v))}) > 0) continue;
    if (sets.root(u) == sets.root(v)) continue;
    sets.unite(u, v);
    ++welded;
    if (places.size() < kMostPlaces) places.push_back(mesh.place(v));
  }
  std::vector<int> to(mesh.positions.size());
  int next = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const int root = sets.root(v);
    to[static_cast<std::size_t>(v)] = root == v ? next++ : to[static_cast<std::size_t>(root)];
  }
  if (welded > 0) {
    findings.push_back({"weld", FindingKind::mended, welded,
                        counted(welded, "vertex", "vertices") + " within " + length_text(within) +
                            " of another one joined with it: " + places_text(places, welded),
                        places});
    mesh.renumber(to);
  } else if (over == 0) {
    findings.push_back(
        {"weld", FindingKind::fact, 0, "no boundary vertices lie within " + length_text(within) + " of each other"});
  }
  if (layer_count > 0) {
    findings.push_back({"weld", FindingKind::warning, layer_count,
                        counted(layer_count, "vertex", "vertices") + " inside the cloth coincide with others (" +
                            places_text(layer_places, layer_count) + "): layers that touch, which are not joined",
                        layer_places});
  }

  if (over > 0) {
    findings.push_back({"weld", FindingKind::fact, over,
                        counted(over, "pair") +
                            " of boundary vertices coincide where the cloth lies over itself, as front and back do at "
                            "an opening: not joined (" +
                            places_text(over_places, over) + ")",
                        over_places});
  }
  say_almost_closed(mesh, within, findings);
}

}  // namespace weft
