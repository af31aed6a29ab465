#include "meshes/import/pieces.hpp"

#include <algorithm>
#include <cstdio>
#include <map>
#include <numeric>
#include <set>

#include "meshes/import/triangulate.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

double length_of(const ImportMesh& mesh, const std::vector<int>& loop) {
  double length = 0.0;
  for (std::size_t i = 0; i < loop.size(); ++i) {
    length += (mesh.at(loop[i]) - mesh.at(loop[(i + 1) % loop.size()])).norm();
  }
  return length;
}

std::string piece_text(const ImportMesh& mesh, const MeshPiece& piece) {
  Vec3 low = mesh.at(mesh.faces[static_cast<std::size_t>(piece.faces.front())][0]), high = low;
  for (const int f : piece.faces) {
    for (const int v : mesh.faces[static_cast<std::size_t>(f)]) {
      low = low.cwiseMin(mesh.at(v));
      high = high.cwiseMax(mesh.at(v));
    }
  }
  char text[160];
  std::snprintf(text, sizeof text, "%d vertices, %.2f x %.2f x %.2f m around (%.2f, %.2f, %.2f)", piece.vertices,
                high.x() - low.x(), high.y() - low.y(), high.z() - low.z(), (low.x() + high.x()) / 2,
                (low.y() + high.y()) / 2, (low.z() + high.z()) / 2);
  return text;
}

std::string loop_text(const std::vector<int>& loop, double length) {
  return counted(static_cast<std::int64_t>(loop.size()), "edge") + ", " + length_text(length) + " around";
}

}  // namespace

std::vector<MeshPiece> pieces_of(const ImportMesh& mesh) {
  DisjointSets sets(mesh.positions.size());
  std::vector<int> next(mesh.positions.size(), -1);  // along the open boundary
  const auto sides = mesh_sides(mesh.faces);
  std::map<int, int> edges_of_piece;
  for_each_edge(sides, [&](const MeshSide* begin, const MeshSide* end) {
    sets.unite(begin->first, begin->second);
    if (end - begin != 1) return;
    const int from = begin->upwards ? begin->first : begin->second;
    next[static_cast<std::size_t>(from)] = begin->upwards ? begin->second : begin->first;
  });
  std::map<int, MeshPiece> by_root;
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    MeshPiece& piece = by_root[sets.root(mesh.faces[f][0])];
    piece.faces.push_back(static_cast<int>(f));
    piece.area += mesh.area_vector(static_cast<int>(f)).norm() / 2.0;
  }
  for_each_edge(sides, [&](const MeshSide* begin, const MeshSide*) { --by_root[sets.root(begin->first)].euler; });
  std::vector<bool> seen(mesh.positions.size(), false);
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    MeshPiece& piece = by_root[sets.root(v)];
    ++piece.vertices;
    std::vector<int> loop;
    for (int at = v; next[static_cast<std::size_t>(at)] >= 0 && !seen[static_cast<std::size_t>(at)];
         at = next[static_cast<std::size_t>(at)]) {
      seen[static_cast<std::size_t>(at)] = true;
      loop.push_back(at);
    }
    if (!loop.empty()) piece.loops.push_back(std::move(loop));
  }
  std::vector<MeshPiece> pieces;
  for (auto& [root, piece] : by_root) {
    piece.euler += piece.vertices + static_cast<int>(piece.faces.size());
    std::vector<std::pair<double, std::vector<int>>> loops;
    for (auto& loop : piece.loops) loops.emplace_back(-length_of(mesh, loop), std::move(loop));
    std::stable_sort(loops.begin(), loops.end(), [](const auto& l, const auto& r) { return l.first < r.first; });
    piece.loops.clear();
    for (auto& [length, loop] : loops) {
      piece.loops.push_back(std::move(loop));
      piece.loop_lengths.push_back(-length);
    }
    pieces.push_back(std::move(piece));
  }
  std::stable_sort(pieces.begin(), pieces.end(), [](const auto& l, const auto& r) { return l.area > r.area; });
  return pieces;
}

void choose_piece(ImportMesh& mesh, int only, Findings& findings) {
  const auto pieces = pieces_of(mesh);
  const auto count = static_cast<std::int64_t>(pieces.size());
  if (only > count) {
    throw ConfigError("--piece = " + std::to_string(only) + ", but " + mesh.source + " has " + counted(count, "piece") +
                      ", the largest is 1");
  }
  Finding finding{"pieces", FindingKind::fact, count, "one piece: " + piece_text(mesh, pieces.front())};
  if (count > 1) {
    finding.kind = FindingKind::warning;
    finding.text = counted(count, "piece") + " that nothing joins";
    for (std::size_t i = 0; i < std::min<std::size_t>(pieces.size(), 5); ++i) {
      finding.text += "; " + std::to_string(i + 1) + ": " + piece_text(mesh, pieces[i]);
      const int v = mesh.faces[static_cast<std::size_t>(pieces[i].faces.front())][0];
      finding.places.push_back(mesh.place(v));
    }
    if (count > 5) finding.text += "; ...";
    finding.text += only == 0 ? "; all are kept, the hands hold the first: --piece N keeps one alone"
                              : "; piece " + std::to_string(only) + " was kept (--piece)";
  }
  if (only > 0 && count > 1) {
    finding.kind = FindingKind::mended;
    std::vector<bool> keep(mesh.faces.size(), false);
    for (const int f : pieces[static_cast<std::size_t>(only - 1)].faces) keep[static_cast<std::size_t>(f)] = true;
    mesh.keep_faces(keep);
    mesh.drop_unused();
  }
  findings.push_back(finding);
}

void fill_holes(ImportMesh& mesh, int edges, Findings& findings) {
  std::set<std::pair<int, int>> known;
  for (const MeshSide& side : mesh_sides(mesh.faces)) known.emplace(side.first, side.second);
  std::int64_t filled = 0, left = 0;
  std::vector<Place> filled_places, left_places;
  std::string openings;
  for (const MeshPiece& piece : pieces_of(mesh)) {
    for (std::size_t i = 1; i < piece.loops.size(); ++i) {
      const auto& loop = piece.loops[i];
      const Place place = mesh.place(loop.front());
      std::vector<int> ring(loop.rbegin(), loop.rend());  // the new faces run against the boundary
      std::vector<Vec3> polygon;
      for (const int v : ring) polygon.push_back(mesh.at(v));
      auto triangles = static_cast<int>(loop.size()) <= edges ? triangulate_polygon(polygon) : std::nullopt;
      if (triangles) {
        // A diagonal that is an edge already would get a third face.
        const auto n = static_cast<int>(ring.size());
        for (const auto& t : *triangles) {
          for (std::size_t k = 0; k < 3; ++k) {
            const int a = t[k], b = t[(k + 1) % 3];
            const bool rim = (a + 1) % n == b || (b + 1) % n == a;
            const auto ends = std::minmax(ring[static_cast<std::size_t>(a)], ring[static_cast<std::size_t>(b)]);
            if (!rim && known.count(ends) > 0) triangles.reset();
            if (!triangles) break;
          }
          if (!triangles) break;
        }
      }
      if (!triangles) {
        ++left;
        left_places.push_back(place);
        openings += (openings.empty() ? "" : "; ") + loop_text(loop, piece.loop_lengths[i]) + " at " + place.element;
        continue;
      }
      ++filled;
      filled_places.push_back(place);
      for (const auto& t : *triangles) {
        ImportMesh::Triangle face{};
        for (std::size_t k = 0; k < 3; ++k) face[k] = ring[static_cast<std::size_t>(t[k])];
        for (std::size_t k = 0; k < 3; ++k) known.insert(std::minmax(face[k], face[(k + 1) % 3]));
        mesh.faces.push_back(face);
        mesh.face_texture.push_back({-1, -1, -1});
        mesh.face_number.push_back(0);
      }
    }
  }
  if (filled > 0) {
    findings.push_back({"holes", FindingKind::mended, filled,
                        counted(filled, "hole") + " of at most " + std::to_string(edges) +
                            " edges filled (--fill 0 keeps them): at " + places_text(filled_places, filled),
                        filled_places});
  }
  if (left > 0) {
    findings.push_back({"holes", FindingKind::fact, left,
                        counted(left, "opening") + " besides the longest boundary: " + openings, left_places});
  }
  if (filled + left == 0) findings.push_back({"holes", FindingKind::fact, 0, "no holes"});
}

}  // namespace weft
