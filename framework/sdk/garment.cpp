#include "weft/garment.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <optional>
#include <tuple>
#include <vector>

#include "sdk/disjoint_sets.hpp"
#include "sdk/obj_file.hpp"
#include "weft/config.hpp"
#include "weft/hash.hpp"
#include "weft/rest_shape.hpp"

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
  // Corner c of face f is number 3 f + c.
  DisjointSets fans(mesh.faces.rows() * 3);
  const auto corner = [&mesh](Index f, int v) {
    Index k = 0;
    while (mesh.faces(f, k) != v) ++k;
    return 3 * f + k;
  };
  for (std::size_t i = 0; i + 1 < sides.size(); ++i) {
    if (sides[i].first != sides[i + 1].first || sides[i].second != sides[i + 1].second) continue;
    for (const int v : {sides[i].first, sides[i].second}) {
      fans.unite(static_cast<int>(corner(sides[i].face, v)), static_cast<int>(corner(sides[i + 1].face, v)));
    }
  }
  std::vector<Index> fan(mesh.positions.rows(), -1);
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    for (Index k = 0; k < 3; ++k) {
      const int v = mesh.faces(f, k);
      const Index r = fans.root(static_cast<int>(3 * f + k));
      Index& known = fan[v];
      if (known < 0) known = r;
      if (known != r) {
        throw ConfigError(where + vertex_text(v) + " is non-manifold: " + face_text(known / 3) + " and " +
                          face_text(f) + " meet only there (a bow-tie)");
      }
    }
  }
}

/// Whether the mesh lies flat, whatever its height.
bool is_flat(const Positions& positions) {
  const Eigen::RowVector3d size = positions.colwise().maxCoeff() - positions.colwise().minCoeff();
  return size.z() <= 1e-6 * size.head<2>().maxCoeff();
}

RestPositions rest_of(const Mesh& mesh, bool has_frames, const std::string& where) {
  if (mesh.rest.rows() > 0) return mesh.rest;
  if (has_frames) return mesh.positions.leftCols<2>();
  const double low = mesh.positions.col(2).minCoeff();
  const double high = mesh.positions.col(2).maxCoeff();
  if (!is_flat(mesh.positions)) {
    throw ConfigError(where + "the mesh is not flat (z from " + std::to_string(low) + " to " + std::to_string(high) +
                      " m), so its rest shape must be given: as vt (rest coordinates in metres), or by rest: {from: "
                      "mesh} in a garment's YAML; `weft garment import` writes one");
  }
  return mesh.positions.leftCols<2>();
}

void check_shape(const Mesh& mesh, const RestPositions& rest, const RestFrames& frames, const std::string& where) {
  Index inverted = 0;
  Index first_inverted = -1;
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    Eigen::Vector2d u, v;
    if (frames.rows() > 0) {
      u = frames.row(f).head<2>(), v = frames.row(f).tail<2>();
    } else {
      const Eigen::Vector2d a = rest.row(mesh.faces(f, 0));
      u = Eigen::Vector2d(rest.row(mesh.faces(f, 1))) - a;
      v = Eigen::Vector2d(rest.row(mesh.faces(f, 2))) - a;
    }
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

void check_form(const Mesh& mesh, const GarmentForm& form, const std::string& where) {
  const Index vertices = mesh.positions.rows();
  if (form.frames.rows() != 0) {
    require_shape(where + "rows of frames", form.frames.rows(), mesh.faces.rows());
    for (Index f = 0; f < form.frames.rows(); ++f)
      if (!form.frames.row(f).allFinite()) throw ConfigError(where + face_text(f) + " has a frame that is not finite");
  }
  if (!form.layers.empty()) require_shape(where + "layers", static_cast<Index>(form.layers.size()), vertices);
  for (std::size_t v = 0; v < form.layers.size(); ++v) {
    constexpr double kMostLayers = 1000.0;
    if (!(form.layers[v] >= 0.0 && form.layers[v] <= kMostLayers)) {
      throw ConfigError(where + vertex_text(static_cast<Index>(v)) + " has the layer " +
                        std::to_string(form.layers[v]) + ", must be in [0, 1000]");
    }
  }
  if (!form.layers.empty() && *std::min_element(form.layers.begin(), form.layers.end()) > 0.0)
    throw ConfigError(where + "no vertex has the layer 0, which lies on the table");
  for (Index e = 0; e < form.seams.rows(); ++e) {
    const int a = form.seams(e, 0), b = form.seams(e, 1);
    const bool sorted = e == 0 || std::tie(form.seams(e - 1, 0), form.seams(e - 1, 1)) < std::tie(a, b);
    if (a < 0 || a >= b || b >= vertices || !sorted)
      throw ConfigError(where + "seams: edge " + std::to_string(e) + " is no edge in ascending order");
  }
}

std::uint64_t hash_of(const RestPositions& rest, const Faces& faces, const GarmentForm& form) {
  Fnv1a hash;
  const auto add_double = [&hash](double value) {
    value += 0.0;  // -0 and 0 are the same place
    hash.add(&value, sizeof value);
  };
  const auto add_int = [&hash](std::int32_t value) { hash.add(&value, sizeof value); };
  const std::int64_t sizes[2] = {rest.rows(), faces.rows()};
  hash.add(sizes, sizeof sizes);
  if (form.frames.rows() == 0) {
    for (Index i = 0; i < rest.size(); ++i) add_double(rest.data()[i]);
  }
  for (Index i = 0; i < faces.size(); ++i) add_int(faces.data()[i]);
  // Nothing follows for the garments of one chart and one layer, so that their hash stays what it was.
  for (Index i = 0; i < form.frames.size(); ++i) add_double(form.frames.data()[i]);
  for (const double layer : form.layers) add_double(layer);
  for (Index i = 0; i < form.seams.size(); ++i) add_int(form.seams.data()[i]);
  return hash.value();
}

std::map<std::string, Index> read_vertices(const ConfigNode& node) {
  std::map<std::string, Index> vertices;
  for (const std::string& key : node.keys()) vertices[key] = node.at(key).as_int();
  return vertices;
}

// ---------------------------------------------------------------------------------------------------------------------
// Rest shapes, layers and seams of a garment's YAML.

Vec2 texture_at(const ObjFile& file, Index face, Index corner) {
  const int vt = file.faces[face].corners[corner].texture;
  return {file.texture[vt][0], file.texture[vt][1]};
}

void require_texture(const ObjFile& file, const ConfigNode& node, const std::string& name) {
  for (std::size_t f = 0; f < file.faces.size(); ++f) {
    for (const auto& corner : file.faces[f].corners) {
      if (corner.texture >= 0) continue;
      node.fail("needs texture coordinates (vt) at all faces of " + name + ", but " + face_text(static_cast<Index>(f)) +
                " has none");
    }
  }
}

/// Faces from the texture, whose parts may be mirrored: counter-clockwise, x is the warp.
RestFrames frames_of_texture(const ObjFile& file, double scale) {
  RestFrames frames(file.faces.size(), 4);
  for (Index f = 0; f < frames.rows(); ++f) {
    const Vec2 p = texture_at(file, f, 0), u = texture_at(file, f, 1) - p, v = texture_at(file, f, 2) - p;
    const double side = u.x() * v.y() - u.y() * v.x() < 0.0 ? -1.0 : 1.0;
    frames.row(f) << side * u.x(), u.y(), side * v.x(), v.y();
  }
  return scale * frames;
}

/// Turns frames in their plane until the warp runs where the texture's x grows.
void turn_to_texture(RestFrames& frames, const ObjFile& file, const ConfigNode& node) {
  for (Index f = 0; f < frames.rows(); ++f) {
    const Vec2 p = texture_at(file, f, 0), u = texture_at(file, f, 1) - p, v = texture_at(file, f, 2) - p;
    Eigen::Matrix2d edges, texture;
    edges << frames(f, 0), frames(f, 1), frames(f, 2), frames(f, 3);
    texture << u.x(), u.y(), v.x(), v.y();
    const Eigen::Vector2d growth = edges.inverse() * texture.col(0);  // of the texture's x, in the frame
    if (!(growth.norm() > 0.0) || !growth.allFinite())
      node.fail("= texture, but the texture of " + face_text(f) + " has no extent along x");
    const Eigen::Vector2d warp = growth.normalized();
    Eigen::Matrix2d turn;
    turn << warp.x(), -warp.y(), warp.y(), warp.x();
    const Eigen::Matrix2d turned = edges * turn;
    frames.row(f) << turned(0, 0), turned(0, 1), turned(1, 0), turned(1, 1);
  }
}

/// One texture coordinate for each vertex, all faces counter-clockwise: a chart, as read_obj() reads it.
std::optional<RestPositions> chart_of_texture(const ObjFile& file, double scale) {
  RestPositions rest = RestPositions::Zero(file.vertices.size(), 2);
  std::vector<bool> known(file.vertices.size(), false);
  for (Index face = 0; face < std::ssize(file.faces); ++face) {
    for (Index k = 0; k < 3; ++k) {
      const int v = file.faces[face].corners[k].vertex;
      const Vec2 at = scale * texture_at(file, face, k);
      if (known[v] && rest.row(v) != at.transpose()) return std::nullopt;
      known[v] = true;
      rest.row(v) = at.transpose();
    }
    const Vec2 p = texture_at(file, face, 0), u = texture_at(file, face, 1) - p, v = texture_at(file, face, 2) - p;
    if (u.x() * v.y() - u.y() * v.x() < 0.0) return std::nullopt;
  }
  return rest;
}

Vec3 direction_in(const ConfigNode& node) {
  if (node.is_scalar()) {
    const std::string name = node.as_string();
    if (name == "x") return {1.0, 0.0, 0.0};
    if (name == "y") return {0.0, 1.0, 0.0};
    if (name == "z") return {0.0, 0.0, 1.0};
  } else if (node.is_sequence() && node.size() == 3) {
    const Vec3 direction(node[0].as_double(), node[1].as_double(), node[2].as_double());
    if (direction.norm() > 0.0 && direction.allFinite()) return direction;
  }
  node.fail("must be x, y, z or three numbers that are not all zero");
}

/// Twice the area of a face seen from above: below 0 it looks down.
double seen_from_above(const Positions& positions, const Faces& faces, Index f) {
  const Eigen::RowVector3d p = positions.row(faces(f, 0));
  const Eigen::RowVector3d u = positions.row(faces(f, 1)) - p, v = positions.row(faces(f, 2)) - p;
  return u.x() * v.y() - u.y() * v.x();
}

bool all_faces_up(const Mesh& mesh) {
  for (Index f = 0; f < mesh.faces.rows(); ++f)
    if (!(seen_from_above(mesh.positions, mesh.faces, f) > 0.0)) return false;
  return true;
}

/// Reads `rest:` into a chart (mesh.rest) or frames. @param mesh without a rest shape.
void read_rest(const ConfigNode& node, const ObjFile& file, Mesh& mesh, GarmentForm& form) {
  node.refuse_unknown_keys({"from", "scale", "file", "warp", "weft", "strained"});
  const ConfigNode from_node = node.at("from");
  const std::string from = from_node.as_string();
  double scale = 1.0;
  if (const auto given = node.find("scale")) {
    scale = given->as_double();
    if (!(scale > 0.0 && scale < 1e6)) given->fail("= " + given->as_string() + ", must be above 0 and below 1e6");
  }
  const auto warp = node.find("warp"), weft = node.find("weft"), pattern = node.find("file");
  if (warp && weft) weft->fail("is given beside warp; one of them is enough");
  if (pattern && from != "file") pattern->fail("needs rest.from: file");
  const bool by_texture = warp && warp->is_scalar() && warp->as_string() == "texture";
  if (from == "texture") {
    if (warp || weft) (warp ? *warp : *weft).fail("is not needed: the warp is the texture's x");
    require_texture(file, from_node, mesh.source);
    if (const auto chart = chart_of_texture(file, scale))
      mesh.rest = *chart;
    else
      form.frames = frames_of_texture(file, scale);
    return;
  }
  if (from != "mesh" && from != "file") from_node.fail("= " + from + ", must be mesh, texture or file");
  Mesh shape = mesh;
  std::optional<ObjFile> other;
  if (from == "file") {
    const std::filesystem::path path = node.at("file").as_path();
    other = blaming(node.at("file"), [&] { return read_obj_file(path, true); });
    shape = bare_mesh(*other, path.string());
    if (shape.faces.rows() != mesh.faces.rows()) {
      node.at("file").fail("has " + std::to_string(shape.faces.rows()) + " faces, must have one for each of the " +
                           std::to_string(mesh.faces.rows()) + " faces of " + mesh.source);
    }
  }
  Grain grain = usual_grain(shape.positions);
  if (weft) grain = {true, direction_in(*weft)};
  if (warp && !by_texture) grain = {false, direction_in(*warp)};
  if (from == "mesh" && !warp && !weft && is_flat(mesh.positions) && all_faces_up(mesh)) {
    mesh.rest = scale * mesh.positions.leftCols<2>();  // a chart, so the hash is that of today's garments
    return;
  }
  form.frames = frames_of_shape(shape.positions, shape.faces, grain, scale);
  if (!by_texture) return;
  require_texture(other ? *other : file, *warp, shape.source);
  turn_to_texture(form.frames, other ? *other : file, *warp);
}

std::vector<double> read_layers(const ConfigNode& node, const Mesh& mesh) {
  if (node.is_sequence()) {
    std::vector<double> layers;
    for (std::size_t v = 0; v < node.size(); ++v) {
      const double layer = node[v].as_double();
      if (!(layer >= 0.0 && layer <= 1000.0)) node[v].fail("= " + node[v].as_string() + ", must be in [0, 1000]");
      layers.push_back(layer);
    }
    if (static_cast<Index>(layers.size()) != mesh.positions.rows()) {
      node.fail("has " + std::to_string(layers.size()) + " numbers, must have one for each of the " +
                std::to_string(mesh.positions.rows()) + " vertices of " + mesh.source);
    }
    return layers;
  }
  if (!node.is_scalar() || node.as_string() != "sides")
    node.fail("must be sides, or a list of a number for each vertex");
  std::vector<double> layers(mesh.positions.rows(), 1.0);
  bool has_back = false;
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    if (seen_from_above(mesh.positions, mesh.faces, f) > 0.0) continue;
    has_back = true;
    for (Index k = 0; k < 3; ++k) layers[mesh.faces(f, k)] = 0.0;
  }
  if (!has_back) node.fail("= sides, but no face of " + mesh.source + " looks down: it has no back");
  return layers;
}

/// Refuses a mesh whose edges are not those of its rest shape. @param chart the rest shape is a texture, as it stands.
void check_strain(const Garment& garment, const std::string& where, bool chart) {
  constexpr double kMostStrain = 0.02;
  const double strain = median_strain(garment);
  if (strain <= kMostStrain) return;
  std::string text = where + "the mesh is strained by " + std::to_string(std::lround(100.0 * strain)) +
                     " % (median edge) against its rest shape, must be at most 2 %";
  const RestPositions& rest = garment.rest;
  if (chart && rest.minCoeff() > -1e-3 && rest.maxCoeff() < 1.001) {
    const double drawn = (garment.positions.colwise().maxCoeff() - garment.positions.colwise().minCoeff()).maxCoeff();
    const double span = (rest.colwise().maxCoeff() - rest.colwise().minCoeff()).maxCoeff();
    char scale[32];
    std::snprintf(scale, sizeof scale, "%.3g", drawn / std::max(span, 1e-9));
    text +=
        "; its texture coordinates (vt) lie in 0..1, so they are hardly metres: write rest: {from: mesh} in a "
        "garment's YAML, or rest: {from: texture, scale: " +
        std::string(scale) + "}, or let `weft garment import` do it";
  } else {
    text += "; another rest.scale or rest.from fits it, or rest.strained gives the reason";
  }
  throw ConfigError(text);
}

Garment read_garment_mapping(const ConfigNode& node) {
  node.refuse_unknown_keys({"mesh", "name", "vertices", "rest", "layers", "seams"});
  const std::filesystem::path path = node.at("mesh").as_path();
  const auto name = node.find("name"), rest = node.find("rest"), named = node.find("vertices");
  Mesh mesh;
  GarmentForm form;
  if (rest) {
    const ObjFile file = blaming(node.at("mesh"), [&] { return read_obj_file(path, true); });
    mesh = bare_mesh(file, path.string());
    read_rest(*rest, file, mesh, form);
  } else {
    mesh = read_obj(path);
  }
  if (const auto layers = node.find("layers")) form.layers = read_layers(*layers, mesh);
  bool seams_bend = false;
  if (const auto seams = node.find("seams")) {
    seams->refuse_unknown_keys({"bend"});
    seams_bend = seams->at("bend").as_bool();
  }
  if (!form.layers.empty() && !seams_bend) form.seams = edges_between_sides(mesh.positions, mesh.faces);
  std::map<std::string, Index> vertices;
  if (named) {
    vertices = read_vertices(*named);
    for (const auto& [key, index] : vertices) {
      if (index < 0 || index >= mesh.positions.rows()) {
        named->at(key).fail("= " + std::to_string(index) + ", must be in [0, " +
                            std::to_string(mesh.positions.rows() - 1) + "], the vertices of " + path.string());
      }
    }
  }
  const bool chart = !rest && mesh.rest.rows() > 0;
  Garment garment =
      make_garment(mesh, name ? name->as_string() : path.stem().string(), std::move(vertices), std::move(form));
  if (!rest || !rest->has("strained") || rest->at("strained").as_string().empty())
    check_strain(garment, path.string() + ": ", chart);
  return garment;
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

Garment make_garment(const Mesh& mesh, std::string name, std::map<std::string, Index> vertices, GarmentForm form) {
  const std::string where = (mesh.source.empty() ? name : mesh.source) + ": ";
  if (mesh.rest.rows() != 0) require_shape(where + "rest rows", mesh.rest.rows(), mesh.positions.rows());
  check_finite(mesh, where);
  check_indices(mesh, where);
  check_manifold(mesh, where);
  check_form(mesh, form, where);
  form.frames.array() += 0.0;  // -0 becomes 0, so that equal rest shapes have equal hashes and files
  RestPositions rest = rest_of(mesh, form.frames.rows() > 0, where);
  check_shape(mesh, rest, form.frames, where);
  for (const auto& [key, index] : vertices) {
    if (index < 0 || index >= mesh.positions.rows()) {
      throw ConfigError(where + "vertices." + key + " = " + std::to_string(index) + ", must be in [0, " +
                        std::to_string(mesh.positions.rows() - 1) + "]");
    }
  }
  Garment garment;
  garment.name = std::move(name);
  garment.positions = mesh.positions;
  garment.hash = hash_of(rest, mesh.faces, form);
  garment.rest = std::move(rest);
  garment.faces = mesh.faces;
  garment.vertices = std::move(vertices);
  garment.form = std::move(form);
  return garment;
}

Garment read_garment(const ConfigNode& node) {
  if (node.is_mapping()) return read_garment_mapping(node);
  if (!node.is_scalar())
    node.fail("must be the path of an OBJ or garment YAML, or a mapping {mesh, name, vertices, rest, layers, seams}");
  const std::filesystem::path path = node.as_path();
  const std::string extension = path.extension().string();
  if (extension == ".yaml" || extension == ".yml")
    return blaming(node, [&] { return read_garment_mapping(ConfigNode::load(path)); });
  if (extension != ".obj" && extension != ".OBJ") {
    node.fail("= " + node.as_string() + ", must be an .obj mesh or a .yaml garment");
  }
  return blaming(node, [&] {
    Garment garment = make_garment(read_obj(path), path.stem().string());
    check_strain(garment, path.string() + ": ", true);
    return garment;
  });
}

std::vector<std::string> garment_warnings(const Garment& garment) {
  std::vector<std::string> warnings;
  const double size = (garment.positions.colwise().maxCoeff() - garment.positions.colwise().minCoeff()).maxCoeff();
  constexpr double kSmallest = 0.05, kLargest = 4.0;  // m: a handkerchief for a doll, a bed sheet and more
  if (size < kSmallest || size > kLargest) {
    char text[160];
    std::snprintf(text, sizeof text,
                  "garment %s is %.3g m long, which no garment is: its file is in other units? "
                  "`weft garment import --units cm` turns it into metres",
                  garment.name.c_str(), size);
    warnings.emplace_back(text);
  }
  DisjointSets joined(garment.vertex_count());
  for (Index f = 0; f < garment.face_count(); ++f) {
    joined.unite(garment.faces(f, 0), garment.faces(f, 1));
    joined.unite(garment.faces(f, 0), garment.faces(f, 2));
  }
  Index pieces = 0;
  for (int v = 0; v < garment.vertex_count(); ++v) pieces += joined.root(v) == v;
  if (pieces > 1) {
    warnings.push_back(
        "garment " + garment.name + " has " + std::to_string(pieces) +
        " pieces that share no vertex, so they move apart; `weft garment import` welds them or keeps one "
        "(--piece)");
  }
  // Vertices of open borders in one place of one layer.
  const Edges open = open_edges(garment.faces);
  std::vector<Index> border(open.data(), open.data() + open.size());
  std::sort(border.begin(), border.end());
  border.erase(std::unique(border.begin(), border.end()), border.end());
  const auto place = [&](Index v) {
    const double unit = 1e-6 * std::max(size, 1e-300);
    const auto at = [&](int k) { return std::llround(garment.positions(v, k) / unit); };
    return std::make_tuple(at(0), at(1), at(2), garment.layer(v));
  };
  std::stable_sort(border.begin(), border.end(), [&](Index a, Index b) { return place(a) < place(b); });
  Index loose = 0, first = -1;
  for (std::size_t i = 1; i < border.size(); ++i) {
    if (place(border[i]) != place(border[i - 1])) continue;
    ++loose;
    if (first < 0) first = border[i - 1];
  }
  if (loose > 0) {
    warnings.push_back("garment " + garment.name + ": " + std::to_string(loose) +
                       " border vertices lie where another one does, the first at " + vertex_text(first) +
                       ": a seam that is not welded; `weft garment import` welds it");
  }
  return warnings;
}

Positions positions_on_ground(const Garment& garment, double ground, double thickness) {
  Positions positions = garment.positions;
  for (Index v = 0; v < positions.rows(); ++v) {
    if (garment.form.layers.empty())
      positions(v, 2) = std::max(positions(v, 2), ground + thickness);
    else
      positions(v, 2) = (ground + thickness) + garment.layer(v) * thickness + positions(v, 2);
  }
  return positions;
}

LowestLayer lowest_layer(const Garment& garment, const Positions& shape, const std::vector<bool>& seen) {
  const bool is_flat = garment.form.layers.empty();
  if (is_flat && seen.empty()) return {shape.col(2).mean(), shape.rows()};
  LowestLayer lowest;
  for (Index v = 0; v < shape.rows(); ++v) {
    if (garment.layer(v) > 0.0 || (!seen.empty() && !seen[v])) continue;
    lowest.height += shape(v, 2) - (is_flat ? 0.0 : garment.positions(v, 2));
    ++lowest.vertices;
  }
  lowest.height /= std::max<double>(1.0, static_cast<double>(lowest.vertices));
  return lowest;
}

double mean_distance_mm(const Positions& a, const Positions& b) {
  require_shape("mean_distance_mm: rows of b", b.rows(), a.rows());
  if (a.rows() == 0) return 0.0;
  return (a - b).rowwise().norm().mean() * 1000.0;
}

Edges edges_between_sides(const Positions& positions, const Faces& faces) {
  const auto is_down = [&](const Side& side) { return seen_from_above(positions, faces, side.face) <= 0.0; };
  std::vector<std::pair<int, int>> found;
  const std::vector<Side> sides = sides_of(faces);
  for (std::size_t i = 0; i + 1 < sides.size(); ++i) {
    if (sides[i].first != sides[i + 1].first || sides[i].second != sides[i + 1].second) continue;
    if (is_down(sides[i]) != is_down(sides[i + 1])) found.emplace_back(sides[i].first, sides[i].second);
  }
  Edges edges(found.size(), 2);
  for (Index e = 0; e < edges.rows(); ++e) edges.row(e) << found[e].first, found[e].second;
  return edges;
}

Edges open_edges(const Faces& faces) {
  const std::vector<Side> sides = sides_of(faces);
  std::vector<std::pair<int, int>> found;
  for (std::size_t i = 0; i < sides.size(); ++i) {
    const auto same = [&](std::size_t j) {
      return j < sides.size() && sides[j].first == sides[i].first && sides[j].second == sides[i].second;
    };
    if (!same(i + 1) && (i == 0 || !same(i - 1))) found.emplace_back(sides[i].first, sides[i].second);
  }
  Edges edges(found.size(), 2);
  for (Index e = 0; e < edges.rows(); ++e) edges.row(e) << found[e].first, found[e].second;
  return edges;
}

Edges edges_of(const Faces& faces) {
  std::vector<Side> sides = sides_of(faces);
  sides.erase(std::unique(sides.begin(), sides.end(),
                          [](const Side& l, const Side& r) { return l.first == r.first && l.second == r.second; }),
              sides.end());
  Edges edges(sides.size(), 2);
  for (std::size_t i = 0; i < sides.size(); ++i) edges.row(i) << sides[i].first, sides[i].second;
  return edges;
}

}  // namespace weft
