#include "meshes/import/weld.hpp"

#include <algorithm>
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

}  // namespace

void weld(ImportMesh& mesh, double distance, Findings& findings) {
  const double within = distance < 0.0 ? 1e-6 * mesh.largest_extent() : distance;
  const Boundary boundary = boundary_of(mesh);
  const auto open = [&](int v) { return static_cast<bool>(boundary.open[static_cast<std::size_t>(v)]); };
  const auto piece = [&](int v) { return boundary.piece[static_cast<std::size_t>(v)]; };
  std::vector<int> all(mesh.positions.size());
  std::iota(all.begin(), all.end(), 0);

  std::vector<std::pair<int, int>> joined;
  std::set<std::pair<int, int>> layers;  // pieces whose interiors coincide somewhere
  std::vector<Place> layer_places;
  std::int64_t layer_count = 0;
  near_pairs(mesh, within, all, [&](int u, int v) {
    if (boundary.edges.count({u, v}) > 0 || (open(u) && open(v))) {
      joined.emplace_back(u, v);
    } else {
      layers.emplace(std::min(piece(u), piece(v)), std::max(piece(u), piece(v)));
      if (layer_places.size() < kMostPlaces) layer_places.push_back(mesh.place(v));
      ++layer_count;
    }
  });
  DisjointSets sets(mesh.positions.size());
  std::vector<Place> places;
  std::int64_t kept_apart = 0, welded = 0;
  for (const auto& [u, v] : joined) {
    const bool edge = boundary.edges.count({u, v}) > 0;
    if (!edge && layers.count({std::min(piece(u), piece(v)), std::max(piece(u), piece(v))}) > 0) {
      ++kept_apart;
      continue;
    }
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
  } else {
    findings.push_back(
        {"weld", FindingKind::fact, 0, "no boundary vertices lie within " + length_text(within) + " of each other"});
  }
  if (layer_count > 0) {
    findings.push_back({"weld", FindingKind::warning, layer_count,
                        counted(layer_count, "vertex", "vertices") + " inside the cloth coincide with others (" +
                            places_text(layer_places, layer_count) + "): layers that touch; they and the " +
                            counted(kept_apart, "pair") + " on the boundaries of those pieces were not joined",
                        layer_places});
  }

  // A seam that is almost closed is a frequent fault of exports with few digits.
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

}  // namespace weft
