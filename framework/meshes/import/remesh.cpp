#include "meshes/import/remesh.hpp"

#include <algorithm>
#include <cmath>
#include <set>

#include "meshes/import/pieces.hpp"
#include "meshes/isotropic_remesh.hpp"
#include "meshes/nearest_surface.hpp"
#include "meshes/plane.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

constexpr double kOutlineCorner = 30.0 * kDegree;  // a sharper turn of an outline is a corner of the cloth
constexpr double kOutlineBound = 0.02;             // of the edge length: how far the new outline may leave the old one
constexpr double kCrease = 0.5;                    // cosine between faces: 60 degrees, such as the rim of two layers
constexpr double kShortestCrease = 5.0;            // of the edge length

/// The outline of a flat piece. Its corners are the sharp turns, the named vertices, and as many more as it takes for
/// the sides between them to stay within the bound of the old outline when they are cut into edges.
Outline outline_of(const ImportMesh& mesh, const std::vector<int>& loop, const MeshSize& size,
                   const std::map<int, std::string>& kept) {
  const std::size_t n = loop.size();
  std::vector<Vec2> at;
  for (const int v : loop) at.push_back(mesh.at(v).head<2>());
  std::vector<bool> corner(n, false);
  for (std::size_t i = 0; i < n; ++i) {
    const Vec2 in = at[i] - at[(i + n - 1) % n], out = at[(i + 1) % n] - at[i];
    corner[i] = std::abs(std::atan2(cross(in, out), in.dot(out))) > kOutlineCorner || kept.count(loop[i]) > 0;
  }
  // A smooth outline, such as a circle, gets three corners to start from.
  for (std::size_t i = 0; std::count(corner.begin(), corner.end(), true) < 3; ++i) corner[i * n / 3 % n] = true;
  // Sides that are cut into whole edges leave a curve by about h^2 / 8 R. Where that is too much, the vertex furthest
  // out becomes a corner, as often as needed.
  const auto cut_side = [&](std::size_t from, std::size_t to) {
    double length = 0.0;
    for (std::size_t i = from; i != to; i = (i + 1) % n) length += (at[(i + 1) % n] - at[i]).norm();
    return std::max(1.0, std::round(length / size.at(at[from])));
  };
  for (bool again = true; again;) {
    again = false;
    std::size_t from = 0;
    while (!corner[from]) ++from;
    const std::size_t first = from;
    do {
      std::size_t to = (from + 1) % n;
      while (!corner[to]) to = (to + 1) % n;
      // The curve seen as chords of equal length.
      const double pieces = cut_side(from, to);
      double length = 0.0;
      std::vector<double> along{0.0};
      std::vector<std::size_t> index{from};
      for (std::size_t i = from; i != to; i = (i + 1) % n) {
        length += (at[(i + 1) % n] - at[i]).norm();
        along.push_back(length);
        index.push_back((i + 1) % n);
      }
      const auto point = [&](double s) -> Vec2 {
        const auto j = static_cast<std::size_t>(
            std::clamp<std::ptrdiff_t>(std::upper_bound(along.begin(), along.end(), s) - along.begin() - 1, 0,
                                       static_cast<std::ptrdiff_t>(along.size()) - 2));
        const double t = (s - along[j]) / (along[j + 1] - along[j]);
        return at[index[j]] + t * (at[index[j + 1]] - at[index[j]]);
      };
      double worst = kOutlineBound * size.at(at[from]);
      std::size_t furthest = n;
      for (std::size_t j = 1; j + 1 < along.size(); ++j) {
        const double k = std::min(std::floor(along[j] / length * pieces), pieces - 1.0);
        const Vec2 a = point(k / pieces * length), d = point((k + 1.0) / pieces * length) - a;
        const double off = std::abs(cross(d, at[index[j]] - a)) / std::max(d.norm(), 1e-300);
        if (off > worst && along[j] > 0.4 * length / pieces && length - along[j] > 0.4 * length / pieces) {
          worst = off;
          furthest = index[j];
        }
      }
      if (furthest < n) {
        corner[furthest] = true;
        again = true;
      }
      from = to;
    } while (from != first);
  }
  Outline outline;
  for (std::size_t i = 0; i < n; ++i) {
    const auto name = kept.find(loop[i]);
    outline.points.push_back({at[i], name == kept.end() ? "" : name->second, corner[i]});
  }
  return outline;
}

struct NewMesh {
  std::vector<Vec3> positions;
  std::vector<std::array<int, 3>> faces;
  std::vector<int> kept;  // [vertices before]
  std::string method;
};

/// All pieces are flat, simple polygons, and all kept vertices are on their outlines.
bool suits_mesher(const ImportMesh& mesh, const std::vector<MeshPiece>& pieces, const std::set<int>& kept) {
  if (std::any_of(mesh.positions.begin(), mesh.positions.end(), [](const Vec3& p) { return p.z() != 0.0; }))
    return false;
  std::set<int> outlines;
  for (const MeshPiece& piece : pieces) {
    if (piece.euler != 1 || piece.loops.size() != 1) return false;
    outlines.insert(piece.loops[0].begin(), piece.loops[0].end());
  }
  return std::includes(outlines.begin(), outlines.end(), kept.begin(), kept.end());
}

NewMesh mesh_panels(const ImportMesh& mesh, const std::vector<MeshPiece>& pieces, const MeshSize& size,
                    const std::set<int>& kept) {
  NewMesh result;
  result.method = "weft's mesher of flat panels";
  result.kept.assign(mesh.positions.size(), -1);
  std::map<int, std::string> names;
  for (const int v : kept) names[v] = std::to_string(v);
  for (const MeshPiece& piece : pieces) {
    GeneratedMesh panel;
    try {
      panel = generate_mesh(outline_of(mesh, piece.loops[0], size, names), size);
    } catch (const ConfigError& error) {
      throw ConfigError(mesh.source + ": --remesh: " + error.what());
    }
    const auto first = static_cast<int>(result.positions.size());
    for (Index v = 0; v < panel.mesh.positions.rows(); ++v) result.positions.push_back(panel.mesh.positions.row(v));
    for (Index f = 0; f < panel.mesh.faces.rows(); ++f) {
      const auto face = panel.mesh.faces.row(f);
      result.faces.push_back({face(0) + first, face(1) + first, face(2) + first});
    }
    for (const auto& [name, v] : panel.vertices) {
      result.kept[static_cast<std::size_t>(std::stoi(name))] = static_cast<int>(v) + first;
    }
  }
  return result;
}

NewMesh mesh_surface(const ImportMesh& mesh, const MeshSize& size, const std::set<int>& kept) {
  Surface surface{mesh.positions, mesh.faces, {}, {kept.begin(), kept.end()}};
  std::vector<std::array<int, 2>> creases;
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
    if (end - begin != 2) return;
    const Vec3 a = mesh.area_vector(begin[0].face), b = mesh.area_vector(begin[1].face);
    if (a.dot(b) < kCrease * a.norm() * b.norm()) creases.push_back({begin->first, begin->second});
    bool line = false;
    for (const int v : {begin->first, begin->second}) {
      std::array<int, 2> texture{};
      for (std::size_t i = 0; i < 2; ++i) {
        std::size_t k = 0;
        while (mesh.faces[static_cast<std::size_t>(begin[i].face)][k] != v) ++k;
        texture[i] = mesh.face_texture[static_cast<std::size_t>(begin[i].face)][k];
      }
      line = line ||
             (texture[0] >= 0 && texture[1] >= 0 &&
              mesh.texture[static_cast<std::size_t>(texture[0])] != mesh.texture[static_cast<std::size_t>(texture[1])]);
    }
    if (line) surface.lines.push_back({begin->first, begin->second});
  });
  // A crease of a few edges is a wrinkle of the pose, not a line of the garment.
  DisjointSets joined(mesh.positions.size());
  for (const auto& [a, b] : creases) joined.unite(a, b);
  std::map<int, double> length;
  for (const auto& [a, b] : creases) length[joined.root(a)] += (mesh.at(a) - mesh.at(b)).norm();
  for (const auto& crease : creases) {
    if (length[joined.root(crease[0])] > kShortestCrease * size.edge_m) surface.lines.push_back(crease);
  }
  auto made = remesh_isotropic(surface, [&](const Vec3& p) { return size.at(p.head<2>()); });
  return {std::move(made.positions), std::move(made.faces), std::move(made.kept),
          "isotropic remeshing (Botsch and Kobbelt 2004)"};
}

/// The largest distance of the open boundaries of two meshes from each other, at their vertices and edge midpoints.
double boundary_distance_between(const ImportMesh& a, const ImportMesh& b) {
  const auto open_edges = [](const ImportMesh& mesh) {
    std::vector<std::pair<Vec3, Vec3>> edges;
    for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
      if (end - begin == 1) edges.emplace_back(mesh.at(begin->first), mesh.at(begin->second));
    });
    return edges;
  };
  const auto one_way = [](const std::vector<std::pair<Vec3, Vec3>>& from,
                          const std::vector<std::pair<Vec3, Vec3>>& to) {
    double largest = 0.0;
    for (const auto& [p, q] : from) {
      for (const Vec3& point : {p, Vec3((p + q) / 2.0)}) {
        double nearest = 1e300;
        for (const auto& [c, e] : to) {
          const Vec3 d = e - c;
          const double t = std::clamp((point - c).dot(d) / std::max(d.squaredNorm(), 1e-300), 0.0, 1.0);
          nearest = std::min(nearest, (point - c - t * d).norm());
        }
        largest = std::max(largest, nearest);
      }
    }
    return largest;
  };
  const auto edges_a = open_edges(a), edges_b = open_edges(b);
  if (edges_a.empty() || edges_b.empty()) return 0.0;
  return std::max(one_way(edges_a, edges_b), one_way(edges_b, edges_a));
}

}  // namespace

void remesh(ImportMesh& mesh, RestPositions& rest, const MeshSize& size, std::map<std::string, int>& names,
            Findings& findings) {
  std::set<int> kept;
  for (const auto& [name, v] : names) kept.insert(v);
  const auto pieces = pieces_of(mesh);
  const NewMesh made =
      suits_mesher(mesh, pieces, kept) ? mesh_panels(mesh, pieces, size, kept) : mesh_surface(mesh, size, kept);
  const ImportMesh before = mesh;
  const NearestSurface old_surface(before.positions, before.faces);
  mesh.positions = made.positions;
  mesh.faces = made.faces;
  mesh.texture.clear();
  mesh.face_texture.assign(mesh.faces.size(), {-1, -1, -1});
  mesh.face_number.assign(mesh.faces.size(), 0);
  mesh.vertex_number.assign(mesh.positions.size(), 0);
  for (std::size_t v = 0; v < before.positions.size(); ++v) {
    const int now = made.kept[v];
    if (now >= 0) mesh.vertex_number[static_cast<std::size_t>(now)] = before.vertex_number[v];
  }
  for (int& v : mesh.vertex_of) v = v < 0 ? -1 : made.kept[static_cast<std::size_t>(v)];
  double named_moved = 0.0;
  for (auto& [name, v] : names) {
    const int now = made.kept[static_cast<std::size_t>(v)];
    if (now < 0) throw Error("--remesh: the vertex " + name + " was lost");
    named_moved = std::max(named_moved, (before.at(v) - mesh.at(now)).norm());
    v = now;
  }
  if (rest.rows() > 0) {
    bool own = true;
    for (Index v = 0; v < rest.rows(); ++v) {
      own = own && rest(v, 0) == before.at(static_cast<int>(v)).x() && rest(v, 1) == before.at(static_cast<int>(v)).y();
    }
    RestPositions now(static_cast<Index>(mesh.positions.size()), 2);
    for (Index v = 0; v < now.rows(); ++v) {
      const Vec3& p = mesh.at(static_cast<int>(v));
      const auto hit = old_surface.nearest(p);
      const auto& t = old_surface.face(hit.face);
      now.row(v) = own ? Eigen::RowVector2d(p.x(), p.y())
                       : Eigen::RowVector2d(hit.weights(0) * rest.row(t[0]) + hit.weights(1) * rest.row(t[1]) +
                                            hit.weights(2) * rest.row(t[2]));
    }
    rest = now;
  }

  std::vector<double> lengths;
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide*) {
    lengths.push_back((mesh.at(begin->first) - mesh.at(begin->second)).norm());
  });
  std::sort(lengths.begin(), lengths.end());
  const double surface_moved =
      std::max(distance_from_surface(mesh.positions, mesh.faces, old_surface),
               distance_from_surface(before.positions, before.faces, NearestSurface(mesh.positions, mesh.faces)));
  findings.push_back({"remesh", FindingKind::mended, mesh.vertex_count(),
                      "by " + made.method + ": " + std::to_string(before.vertex_count()) + " vertices became " +
                          std::to_string(mesh.vertex_count()) + ", edges " + length_text(lengths.front()) + " to " +
                          length_text(lengths.back()) + ", median " + length_text(lengths[lengths.size() / 2]) +
                          "; largest distance between the old and the new surface " + length_text(surface_moved) +
                          ", outlines " + length_text(boundary_distance_between(before, mesh)) + ", named vertices " +
                          length_text(named_moved)});
}

}  // namespace weft
