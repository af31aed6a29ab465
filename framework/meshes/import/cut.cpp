#include "meshes/import/cut.hpp"

#include <algorithm>
#include <map>
#include <set>

#include "weft/error.hpp"

namespace weft {
namespace {

/// Of the sides of one edge, the two whose faces go on flattest: the largest dot product of their unit normals, taken
/// as if both faces looked to the same side.
std::pair<const MeshSide*, const MeshSide*> flattest_pair(const ImportMesh& mesh, const MeshSide* begin,
                                                          const MeshSide* end) {
  std::pair<const MeshSide*, const MeshSide*> best{begin, begin + 1};
  double most = -2.0;
  for (const MeshSide* a = begin; a != end; ++a) {
    for (const MeshSide* b = a + 1; b != end; ++b) {
      const double sign = a->upwards == b->upwards ? -1.0 : 1.0;
      const double flat = sign * mesh.area_vector(a->face).normalized().dot(mesh.area_vector(b->face).normalized());
      if (flat > most) {
        most = flat;
        best = {a, b};
      }
    }
  }
  return best;
}

/// Splits each vertex into one per fan. @param cut_all cut all faces apart at an edge of more than two.
void split_fans(ImportMesh& mesh, bool cut_all, std::map<int, Place>& split) {
  // Corner k of face f is number 3 f + k.
  DisjointSets corners(3 * mesh.faces.size());
  const auto corner_at = [&](int f, int v) {
    int k = 0;
    while (mesh.faces[static_cast<std::size_t>(f)][static_cast<std::size_t>(k)] != v) ++k;
    return 3 * f + k;
  };
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
    if (end - begin < 2 || (cut_all && end - begin > 2)) return;
    const auto [a, b] = end - begin == 2 ? std::pair{begin, begin + 1} : flattest_pair(mesh, begin, end);
    for (const int v : {begin->first, begin->second}) corners.unite(corner_at(a->face, v), corner_at(b->face, v));
  });
  std::map<int, int> fan_size;  // by root corner
  for (int c = 0; c < static_cast<int>(3 * mesh.faces.size()); ++c) ++fan_size[corners.root(c)];
  std::vector<int> kept(mesh.positions.size(), -1);  // the root corner of the fan that keeps the vertex
  for (const auto& [root, size] : fan_size) {
    int& fan = kept[static_cast<std::size_t>(
        mesh.faces[static_cast<std::size_t>(root / 3)][static_cast<std::size_t>(root % 3)])];
    if (fan < 0 || size > fan_size.at(fan)) fan = root;
  }
  std::map<int, int> copy;  // root corner -> its new vertex
  for (int c = 0; c < static_cast<int>(3 * mesh.faces.size()); ++c) {
    int& v = mesh.faces[static_cast<std::size_t>(c / 3)][static_cast<std::size_t>(c % 3)];
    const int root = corners.root(c);
    if (kept[static_cast<std::size_t>(v)] == root) continue;
    const auto [entry, fresh] = copy.emplace(root, mesh.vertex_count());
    if (fresh) {
      split.emplace(v, mesh.place(v));
      mesh.positions.push_back(Vec3(mesh.at(v)));
      mesh.vertex_number.push_back(mesh.vertex_number[static_cast<std::size_t>(v)]);
    }
    v = entry->second;
  }
}

/// The edges of more than two faces; their vertices go into `ends`.
std::vector<Place> crowded_edges(const ImportMesh& mesh, std::set<int>& ends) {
  std::vector<Place> places;
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
    if (end - begin < 3) return;
    ends.insert({begin->first, begin->second});
    places.push_back({"edge " + std::to_string(mesh.vertex_number[static_cast<std::size_t>(begin->first)]) + "-" +
                          std::to_string(mesh.vertex_number[static_cast<std::size_t>(begin->second)]) + " of " +
                          std::to_string(end - begin) + " faces",
                      (mesh.at(begin->first) + mesh.at(begin->second)) / 2.0});
  });
  return places;
}

}  // namespace

void cut_open(ImportMesh& mesh, Findings& findings) {
  std::set<int> ends;
  const std::vector<Place> edges = crowded_edges(mesh, ends);
  std::map<int, Place> split;
  split_fans(mesh, false, split);
  std::set<int> left;
  if (!crowded_edges(mesh, left).empty()) split_fans(mesh, true, split);
  const auto remaining = crowded_edges(mesh, left);
  if (!remaining.empty()) {
    throw ConfigError(mesh.source + ": " + remaining.front().element +
                      " cannot be cut open: remove all but two of its faces");
  }
  const auto count = static_cast<std::int64_t>(edges.size());
  if (count > 0) {
    findings.push_back({"non-manifold edges", FindingKind::warning, count,
                        counted(count, "edge") + " of more than two faces: " + places_text(edges, count) +
                            "; the two faces that go on flattest stay together, the others are cut off there",
                        edges});
  } else {
    findings.push_back({"non-manifold edges", FindingKind::fact, 0, "no edge has more than two faces"});
  }
  std::vector<Place> bows;
  for (const auto& [v, place] : split) {
    if (ends.count(v) == 0) bows.push_back(place);
  }
  const auto bow_count = static_cast<std::int64_t>(bows.size());
  if (bow_count > 0) {
    findings.push_back({"bow-ties", FindingKind::mended, bow_count,
                        counted(bow_count, "vertex", "vertices") +
                            " where faces meet at a point only, split: " + places_text(bows, bow_count),
                        bows});
  } else {
    findings.push_back({"bow-ties", FindingKind::fact, 0, "no vertex joins faces that share no edge"});
  }
}

}  // namespace weft
