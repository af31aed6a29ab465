#include "weft/garment.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <tuple>
#include <vector>

#include "weft/config.hpp"
#include "weft/hash.hpp"

namespace weft {
namespace {

// A triangle flatter than this (smallest height over longest edge) has no usable rest frame.
constexpr double kFlattest = 1e-6;

std::string vertex_text(Index v) { return "vertex " + std::to_string(v) + " (OBJ " + std::to_string(v + 1) + ")"; }
std::string face_text(Index f) { return "face " + std::to_string(f) + " (OBJ " + std::to_string(f + 1) + ")"; }

/// One side of a face: its two vertices in ascending order, the face, and whether the face runs it upwards.
struct Side {
  int first, second;
  Index face;
  bool upwards;
};

std::vector<Side> sides_of(const Faces& faces) {
  std::vector<Side> sides;
  sides.reserve(faces.rows() * 3);
  for (Index f = 0; f < faces.rows(); ++f) {
    for (Index k = 0; k < 3; ++k) {
      const int a = faces(f, k);
      const int b = faces(f, (k + 1) % 3);
      sides.push_back({std::min(a, b), std::max(a, b), f, a < b});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const Side& l, const Side& r) {
    return std::tie(l.first, l.second, l.face) < std::tie(r.first, r.second, r.face);
  });
  return sides;
}

void check_indices(const Mesh& mesh, const std::string& where) {
  const Index count = mesh.positions.rows();
  if (count == 0) throw ConfigError(where + "no vertices");
  if (mesh.faces.rows() == 0) throw ConfigError(where + "no faces");
  std::vector<bool> used(count, false);
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    for (Index k = 0; k < 3; ++k) {
      const int v = mesh.faces(f, k);
      if (v < 0 || v >= count) {
        throw ConfigError(where + face_text(f) + " names vertex " + std::to_string(v) + ", must be in [0, " +
                          std::to_string(count - 1) + "]");
      }
      used[v] = true;
      if (v == mesh.faces(f, (k + 1) % 3)) {
        throw ConfigError(where + face_text(f) + " is degenerate: it names " + vertex_text(v) + " twice");
      }
    }
  }
  for (Index v = 0; v < count; ++v) {
    if (!used[v]) throw ConfigError(where + vertex_text(v) + " is in no face");
  }
}

void check_finite(const Mesh& mesh, const std::string& where) {
  for (Index v = 0; v < mesh.positions.rows(); ++v) {
    if (!mesh.positions.row(v).allFinite()) {
      throw ConfigError(where + vertex_text(v) + " has a position that is not finite");
    }
  }
  for (Index v = 0; v < mesh.rest.rows(); ++v) {
    if (!mesh.rest.row(v).allFinite()) {
      throw ConfigError(where + vertex_text(v) + " has a rest position that is not finite");
    }
  }
  // Far larger than any cloth. The limit protects areas and squared lengths from overflow and cancellation.
  constexpr double kLargest = 1e6;
  for (Index v = 0; v < mesh.positions.rows(); ++v) {
    const double largest = std::max(mesh.positions.row(v).cwiseAbs().maxCoeff(),
                                    v < mesh.rest.rows() ? mesh.rest.row(v).cwiseAbs().maxCoeff() : 0.0);
    if (largest > kLargest) throw ConfigError(where + vertex_text(v) + " lies more than 1e6 m from the origin");
  }
}

bool same_vertices(const Faces& faces, Index f, Index g) {
  const auto has = [&faces, f](int v) { return faces(f, 0) == v || faces(f, 1) == v || faces(f, 2) == v; };
  return has(faces(g, 0)) && has(faces(g, 1)) && has(faces(g, 2));
}

void check_manifold(const Mesh& mesh, const std::string& where) {
  const std::vector<Side> sides = sides_of(mesh.faces);
  for (std::size_t i = 0; i < sides.size();) {
    std::size_t end = i + 1;
    while (end < sides.size() && sides[end].first == sides[i].first && sides[end].second == sides[i].second) ++end;
    const std::string edge = "edge " + std::to_string(sides[i].first) + "-" + std::to_string(sides[i].second) +
                             " (OBJ " + std::to_string(sides[i].first + 1) + "-" + std::to_string(sides[i].second + 1) +
                             ")";
    if (end - i > 1 && same_vertices(mesh.faces, sides[i].face, sides[i + 1].face)) {
      throw ConfigError(where + face_text(sides[i + 1].face) + " repeats " + face_text(sides[i].face));
    }
    if (end - i > 2) {
      throw ConfigError(where + edge + " is non-manifold: it belongs to " + std::to_string(end - i) + " faces, " +
                        face_text(sides[i].face) + ", " + face_text(sides[i + 1].face) + ", " +
                        face_text(sides[i + 2].face) + (end - i > 3 ? ", ..." : ""));
    }
    if (end - i == 2 && sides[i].upwards == sides[i + 1].upwards) {
      throw ConfigError(where + face_text(sides[i].face) + " and " + face_text(sides[i + 1].face) +
                        " are oriented inconsistently: both run their common " + edge + " the same way");
    }
    i = end;
  }

  // A vertex is manifold if its faces form one fan: joining the faces that share an edge at the vertex gives one group.
  // Corner c of face f is node 3 f + c of a union-find forest.
  std::vector<Index> parent(mesh.faces.rows() * 3);
  for (std::size_t i = 0; i < parent.size(); ++i) parent[i] = i;
  const auto root = [&parent](Index i) {
    while (parent[i] != i) {
      parent[i] = parent[parent[i]];
      i = parent[i];
    }
    return i;
  };
  const auto corner = [&mesh](Index f, int v) {
    Index k = 0;
    while (mesh.faces(f, k) != v) ++k;
    return 3 * f + k;
  };
  for (std::size_t i = 0; i + 1 < sides.size(); ++i) {
    if (sides[i].first != sides[i + 1].first || sides[i].second != sides[i + 1].second) continue;
    for (const int v : {sides[i].first, sides[i].second}) {
      const Index a = root(corner(sides[i].face, v));
      const Index b = root(corner(sides[i + 1].face, v));
      parent[std::max(a, b)] = std::min(a, b);
    }
  }
  std::vector<Index> fan(mesh.positions.rows(), -1);
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    for (Index k = 0; k < 3; ++k) {
      const int v = mesh.faces(f, k);
      const Index r = root(3 * f + k);
      Index& known = fan[v];
      if (known < 0) known = r;
      if (known != r) {
        throw ConfigError(where + vertex_text(v) + " is non-manifold: " + face_text(known / 3) + " and " +
                          face_text(f) + " meet only there (a bow-tie)");
      }
    }
  }
}

RestPositions rest_of(const Mesh& mesh, const std::string& where) {
  if (mesh.rest.rows() > 0) return mesh.rest;
  const double low = mesh.positions.col(2).minCoeff();
  const double high = mesh.positions.col(2).maxCoeff();
  const double extent =
      (mesh.positions.colwise().maxCoeff() - mesh.positions.colwise().minCoeff()).template head<2>().maxCoeff();
  if (high - low > 1e-6 * extent) {
    throw ConfigError(where + "the mesh is not flat (z from " + std::to_string(low) + " to " + std::to_string(high) +
                      " m), so its rest shape must be given as vt (rest coordinates in metres)");
  }
  return mesh.positions.leftCols<2>();
}

void check_shape(const Mesh& mesh, const RestPositions& rest, const std::string& where) {
  Index inverted = 0;
  Index first_inverted = -1;
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    const Eigen::Vector2d a = rest.row(mesh.faces(f, 0));
    const Eigen::Vector2d u = Eigen::Vector2d(rest.row(mesh.faces(f, 1))) - a;
    const Eigen::Vector2d v = Eigen::Vector2d(rest.row(mesh.faces(f, 2))) - a;
    const double longest = std::max({u.squaredNorm(), v.squaredNorm(), (u - v).squaredNorm()});
    const double twice_area = u.x() * v.y() - u.y() * v.x();
    if (!(std::abs(twice_area) > kFlattest * longest)) {
      throw ConfigError(where + face_text(f) + " is degenerate: its vertices " + std::to_string(mesh.faces(f, 0)) +
                        ", " + std::to_string(mesh.faces(f, 1)) + ", " + std::to_string(mesh.faces(f, 2)) +
                        " lie on a line in the rest shape");
    }
    if (twice_area < 0.0) {
      ++inverted;
      if (first_inverted < 0) first_inverted = f;
    }
    const Eigen::Vector3d p = mesh.positions.row(mesh.faces(f, 0));
    const Eigen::Vector3d q = Eigen::Vector3d(mesh.positions.row(mesh.faces(f, 1))) - p;
    const Eigen::Vector3d r = Eigen::Vector3d(mesh.positions.row(mesh.faces(f, 2))) - p;
    if (!(q.cross(r).norm() > kFlattest * std::max({q.squaredNorm(), r.squaredNorm(), (q - r).squaredNorm()}))) {
      throw ConfigError(where + face_text(f) + " is degenerate: its vertices " + std::to_string(mesh.faces(f, 0)) +
                        ", " + std::to_string(mesh.faces(f, 1)) + ", " + std::to_string(mesh.faces(f, 2)) +
                        " lie on a line in the given positions");
    }
  }
  if (inverted > 0) {
    throw ConfigError(where + face_text(first_inverted) +
                      " is inverted: its vertices run clockwise in the rest shape (" + std::to_string(inverted) +
                      " of " + std::to_string(mesh.faces.rows()) + " faces do" +
                      (inverted == mesh.faces.rows() ? "; reverse the faces" : "") + ")");
  }
}

std::uint64_t hash_of(const RestPositions& rest, const Faces& faces) {
  Fnv1a hash;
  const std::int64_t sizes[2] = {rest.rows(), faces.rows()};
  hash.add(sizes, sizeof sizes);
  for (Index v = 0; v < rest.rows(); ++v) {
    for (Index k = 0; k < 2; ++k) {
      const double value = rest(v, k) + 0.0;  // -0 and 0 are the same place
      hash.add(&value, sizeof value);
    }
  }
  for (Index f = 0; f < faces.rows(); ++f) {
    for (Index k = 0; k < 3; ++k) {
      const std::int32_t value = faces(f, k);
      hash.add(&value, sizeof value);
    }
  }
  return hash.value();
}

std::map<std::string, Index> read_vertices(const ConfigNode& node) {
  std::map<std::string, Index> vertices;
  for (const std::string& key : node.keys()) vertices[key] = node.at(key).as_int();
  return vertices;
}

Garment read_garment_mapping(const ConfigNode& node) {
  node.refuse_unknown_keys({"mesh", "name", "vertices"});
  const std::filesystem::path path = node.at("mesh").as_path();
  const auto name = node.find("name");
  std::map<std::string, Index> vertices;
  if (const auto named = node.find("vertices")) {
    vertices = read_vertices(*named);
    const Mesh mesh = read_obj(path);
    for (const auto& [key, index] : vertices) {
      if (index < 0 || index >= mesh.positions.rows()) {
        named->at(key).fail("= " + std::to_string(index) + ", must be in [0, " +
                            std::to_string(mesh.positions.rows() - 1) + "], the vertices of " + path.string());
      }
    }
    return make_garment(mesh, name ? name->as_string() : path.stem().string(), std::move(vertices));
  }
  return make_garment(read_obj(path), name ? name->as_string() : path.stem().string());
}

}  // namespace

Index Garment::vertex(const std::string& vertex_name) const {
  const auto found = vertices.find(vertex_name);
  if (found != vertices.end()) return found->second;
  std::vector<std::string> known;
  for (const auto& entry : vertices) known.push_back(entry.first);
  throw ConfigError(
      "garment " + name + ": no vertex is named '" + vertex_name + "'" +
      (known.empty() ? "; this garment names none" : ", must be " + one_of(known) + nearest_hint(vertex_name, known)));
}

Garment make_garment(const Mesh& mesh, std::string name, std::map<std::string, Index> vertices) {
  const std::string where = (mesh.source.empty() ? name : mesh.source) + ": ";
  if (mesh.rest.rows() != 0) require_shape(where + "rest rows", mesh.rest.rows(), mesh.positions.rows());
  check_finite(mesh, where);
  check_indices(mesh, where);
  check_manifold(mesh, where);
  RestPositions rest = rest_of(mesh, where);
  check_shape(mesh, rest, where);
  for (const auto& [key, index] : vertices) {
    if (index < 0 || index >= mesh.positions.rows()) {
      throw ConfigError(where + "vertices." + key + " = " + std::to_string(index) + ", must be in [0, " +
                        std::to_string(mesh.positions.rows() - 1) + "]");
    }
  }
  Garment garment;
  garment.name = std::move(name);
  garment.positions = mesh.positions;
  garment.hash = hash_of(rest, mesh.faces);
  garment.rest = std::move(rest);
  garment.faces = mesh.faces;
  garment.vertices = std::move(vertices);
  return garment;
}

Garment read_garment(const ConfigNode& node) {
  if (node.is_mapping()) return read_garment_mapping(node);
  if (!node.is_scalar()) node.fail("must be the path of an OBJ or garment YAML, or a mapping {mesh, name, vertices}");
  const std::filesystem::path path = node.as_path();
  const std::string extension = path.extension().string();
  if (extension == ".yaml" || extension == ".yml")
    return blaming(node, [&] { return read_garment_mapping(ConfigNode::load(path)); });
  if (extension != ".obj" && extension != ".OBJ") {
    node.fail("= " + node.as_string() + ", must be an .obj mesh or a .yaml garment");
  }
  return blaming(node, [&] { return make_garment(read_obj(path), path.stem().string()); });
}

double mean_distance_mm(const Positions& a, const Positions& b) {
  require_shape("mean_distance_mm: rows of b", b.rows(), a.rows());
  if (a.rows() == 0) return 0.0;
  return (a - b).rowwise().norm().mean() * 1000.0;
}

Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor> edges_of(const Faces& faces) {
  std::vector<Side> sides = sides_of(faces);
  sides.erase(std::unique(sides.begin(), sides.end(),
                          [](const Side& l, const Side& r) { return l.first == r.first && l.second == r.second; }),
              sides.end());
  Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor> edges(sides.size(), 2);
  for (std::size_t i = 0; i < sides.size(); ++i) edges.row(i) << sides[i].first, sides[i].second;
  return edges;
}

}  // namespace weft
