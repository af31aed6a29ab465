#include "meshes/import/untangle.hpp"

#include <algorithm>
#include <set>

#include "meshes/intersections.hpp"

namespace weft {
namespace {

// With more places than this the garment is tangled as a whole, and smoothing would change its shape.
constexpr std::size_t kMostCrossings = 40;
constexpr int kSmoothings = 60;
// A vertex may move by so many median edges.
constexpr double kFarthestMove = 2.0;

/// The neighbours that a vertex is smoothed towards: along the boundary for its vertices, else all.
std::vector<std::set<int>> neighbours_of(const ImportMesh& mesh) {
  std::vector<std::set<int>> all(mesh.positions.size()), open(mesh.positions.size());
  const auto join = [](std::vector<std::set<int>>& sets, const MeshSide& side) {
    sets[side.first].insert(side.second);
    sets[side.second].insert(side.first);
  };
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
    join(all, *begin);
    if (end - begin == 1) join(open, *begin);
  });
  for (std::size_t v = 0; v < all.size(); ++v)
    if (!open[v].empty()) all[v] = std::move(open[v]);
  return all;
}

}  // namespace

void untangle(ImportMesh& mesh, Findings& findings) {
  Mesh drawn = to_mesh(mesh);
  auto crossings = find_intersections(drawn.positions, drawn.faces, kMostCrossings + 1);
  if (crossings.empty() || crossings.size() > kMostCrossings) return;
  Finding finding{"crossings", FindingKind::mended, static_cast<std::int64_t>(crossings.size()), ""};
  std::set<int> places;
  for (const Intersection& one : crossings) {
    if (one.between_pieces) return;
    places.insert(one.edge[0]);
  }
  for (const int v : places) finding.places.push_back(mesh.place(v));

  const auto neighbours = neighbours_of(mesh);
  std::set<int> moved;
  for (int round = 0; round < kSmoothings && !crossings.empty(); ++round) {
    for (const Intersection& one : crossings) {
      moved.insert(one.edge.begin(), one.edge.end());
      for (int k = 0; k < 3; ++k) moved.insert(drawn.faces(one.face, k));
    }
    Positions smoothed = drawn.positions;
    for (const int v : moved) {
      Eigen::RowVector3d mean = Eigen::RowVector3d::Zero();
      for (const int other : neighbours[v]) mean += drawn.positions.row(other);
      mean /= static_cast<double>(neighbours[v].size());
      smoothed.row(v) = 0.5 * (drawn.positions.row(v) + mean);
    }
    drawn.positions = smoothed;
    crossings = find_intersections(drawn.positions, drawn.faces, kMostCrossings);
  }
  double farthest = 0.0;
  for (const int v : moved) farthest = std::max(farthest, (drawn.positions.row(v).transpose() - mesh.at(v)).norm());
  if (!crossings.empty() || farthest > kFarthestMove * mesh.median_edge()) return;
  for (const int v : moved) mesh.positions[v] = drawn.positions.row(v).transpose();
  finding.text = counted(finding.count, "edge") +
                 " through a face: " + counted(static_cast<std::int64_t>(moved.size()), "vertex", "vertices") +
                 " moved by at most " + length_text(farthest) + ": " +
                 places_text(finding.places, static_cast<std::int64_t>(places.size()));
  findings.push_back(finding);
}

}  // namespace weft
