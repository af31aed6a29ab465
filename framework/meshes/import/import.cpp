#include "meshes/import/import.hpp"

#include <Eigen/Geometry>
#include <algorithm>

#include "meshes/import/clean_faces.hpp"
#include "meshes/import/cut.hpp"
#include "meshes/import/mesh_file.hpp"
#include "meshes/import/orientation.hpp"
#include "meshes/import/pieces.hpp"
#include "meshes/import/remesh.hpp"
#include "meshes/import/rest_shape.hpp"
#include "meshes/import/triangulate.hpp"
#include "meshes/import/weld.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

struct Input {
  std::filesystem::path mesh;
  std::map<std::string, Index> vertices;
  bool is_garment = false;
};

/// The mesh file and its names: of the YAML of a garment, or of the mesh alone.
Input input_of(const std::filesystem::path& path) {
  if (path.extension() != ".yaml" && path.extension() != ".yml") return {path, {}, false};
  const ConfigNode node = ConfigNode::load(path);
  node.refuse_unknown_keys({"mesh", "name", "vertices"});
  Input input{node.at("mesh").as_path(), {}, true};
  if (const auto named = node.find("vertices")) {
    for (const std::string& key : named->keys()) input.vertices[key] = named->at(key).as_int();
  }
  return input;
}

/// A closed surface is turned to look outwards: then its volume is positive.
void turn_outwards(ImportMesh& mesh, Findings& findings) {
  double volume = 0.0;
  Vec3 centre = Vec3::Zero();
  for (const Vec3& p : mesh.positions) centre += p / static_cast<double>(mesh.positions.size());
  double size = 0.0;
  for (int f = 0; f < static_cast<int>(mesh.faces.size()); ++f) {
    volume += mesh.area_vector(f).dot(mesh.centre(f) - centre) / 6.0;
    size += mesh.area_vector(f).norm() * (mesh.centre(f) - centre).norm() / 6.0;
  }
  // An open sheet encloses little, and its sides have no inside.
  if (volume > -0.1 * size) return;
  turn_faces(mesh);
  findings.push_back({"orientation", FindingKind::mended, static_cast<std::int64_t>(mesh.faces.size()),
                      "all faces turned to look outwards"});
}

std::string name_of(const std::map<std::string, int>& names, int v) {
  const auto known = std::find_if(names.begin(), names.end(), [v](const auto& entry) { return entry.second == v; });
  return known == names.end() ? std::string() : known->first;
}

/// The names of the outermost vertices of the left side; of another one where a side ends in one vertex.
std::vector<std::string> outermost_side(const ImportMesh& mesh, std::map<std::string, int>& names) {
  const auto outermost = outermost_vertices(mesh);
  constexpr std::array<std::array<const char*, 2>, 4> kSides = {{{"left_top", "left_bottom"},
                                                                 {"right_top", "right_bottom"},
                                                                 {"left_bottom", "right_bottom"},
                                                                 {"left_top", "right_top"}}};
  for (const auto& side : kSides) {
    if (outermost.at(side[0]) == outermost.at(side[1])) continue;
    std::vector<std::string> grasp;
    for (const char* corner : side) {
      const int v = outermost.at(corner);
      if (name_of(names, v).empty()) names["outermost_" + std::string(corner)] = v;  // another vertex has its name
      grasp.push_back(name_of(names, v));
    }
    return grasp;
  }
  throw ConfigError(mesh.source + ": all corners of the garment are one vertex; give --grasp");
}

std::map<std::string, int> resolve_names(const ImportMesh& mesh, const Input& input, const ImportOptions& options,
                                         bool foldable, std::vector<std::string>& grasp, Findings& findings) {
  std::map<std::string, int> names;
  for (const auto& [name, index] : input.vertices) {
    const VertexSpec spec{std::to_string(index + 1), static_cast<int>(index) + 1};
    names[name] = find_vertex(mesh, "vertices." + name + " (from 1)", spec);
  }
  for (const auto& [name, spec] : options.names) names[name] = find_vertex(mesh, "--name " + name, spec);
  if (foldable) {
    for (const auto& [name, v] : outermost_vertices(mesh)) {
      if (name_of(names, v).empty()) names.emplace(name, v);
    }
    if (options.grasp.empty()) grasp = outermost_side(mesh, names);
  }
  for (std::size_t i = 0; i < options.grasp.size(); ++i) {
    const VertexSpec& spec = options.grasp[i];
    // A word is a name; anything else was parsed as a number or a place.
    if (spec.number < 0) {
      if (names.count(spec.text) == 0) {
        std::vector<std::string> known;
        for (const auto& entry : names) known.push_back(entry.first);
        throw ConfigError("--grasp = " + spec.text + ", which names no vertex" +
                          (known.empty() ? std::string(": this garment has no names")
                                         : ", must be " + one_of(known) + nearest_hint(spec.text, known)));
      }
      grasp.push_back(spec.text);
      continue;
    }
    const int v = find_vertex(mesh, "--grasp", spec);
    if (name_of(names, v).empty()) names["grasp_" + std::to_string(i + 1)] = v;
    grasp.push_back(name_of(names, v));
  }
  if (grasp.size() == 2 && names.at(grasp[0]) == names.at(grasp[1])) {
    throw ConfigError("--grasp: both hands hold the same vertex, " + grasp[0]);
  }
  if (!foldable) grasp.clear();
  if (!names.empty()) {
    std::string text = counted(static_cast<std::int64_t>(names.size()), "named vertex", "named vertices") + ": ";
    std::vector<Place> places;
    for (const auto& [name, v] : names) {
      text += (places.empty() ? "" : ", ") + name;
      places.push_back({name, mesh.at(v)});
    }
    if (grasp.size() == 2) text += "; the hands hold " + grasp[0] + " and " + grasp[1];
    findings.push_back({"names", FindingKind::fact, static_cast<std::int64_t>(names.size()), text, places});
  }
  return names;
}

Mesh mesh_of_import(const ImportMesh& from, const RestPositions& rest) {
  Mesh mesh;
  mesh.source = from.source;
  mesh.positions.resize(static_cast<Index>(from.positions.size()), 3);
  for (Index v = 0; v < mesh.positions.rows(); ++v) mesh.positions.row(v) = from.at(static_cast<int>(v)).transpose();
  mesh.faces.resize(static_cast<Index>(from.faces.size()), 3);
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    for (Index k = 0; k < 3; ++k)
      mesh.faces(f, k) = from.faces[static_cast<std::size_t>(f)][static_cast<std::size_t>(k)];
  }
  mesh.rest = rest;
  return mesh;
}

/// Warns of a mesh whose edges differ so much that the shortest ones decide the time that a fold takes.
void say_edges(const ImportMesh& mesh, Findings& findings) {
  std::vector<double> lengths;
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide*) {
    lengths.push_back((mesh.at(begin->first) - mesh.at(begin->second)).norm());
  });
  std::sort(lengths.begin(), lengths.end());
  Finding finding{"edges", FindingKind::fact, static_cast<std::int64_t>(lengths.size()),
                  "edges of " + length_text(lengths.front()) + " to " + length_text(lengths.back()) + ", median " +
                      length_text(lengths[lengths.size() / 2])};
  // weft's own meshes have a ratio of 2; a fold of 0.05 m radius needs edges of a few centimetres.
  if (lengths.back() > 10.0 * lengths.front()) {
    finding.kind = FindingKind::warning;
    finding.text +=
        ": the shortest decide how long a fold takes, the longest how coarse it is; --remesh EDGE evens them";
  } else if (lengths[lengths.size() / 2] > 0.06 * mesh.largest_extent()) {
    finding.kind = FindingKind::warning;
    finding.text += ": too coarse for a fold; --remesh EDGE makes them shorter";
  } else if (mesh.vertex_count() > 5000) {
    finding.kind = FindingKind::warning;
    finding.text +=
        ": " + std::to_string(mesh.vertex_count()) + " vertices are slow to fold; --remesh EDGE makes fewer";
  }
  findings.push_back(finding);
}

}  // namespace

bool ImportedGarment::foldable() const {
  return std::none_of(findings.begin(), findings.end(), [](const Finding& f) { return f.kind == FindingKind::limit; });
}

ImportedGarment import_garment(const std::filesystem::path& path, const ImportOptions& options) {
  ImportedGarment result;
  Findings& findings = result.findings;
  const Input input = input_of(path);
  const MeshFile file = read_mesh_file(input.mesh, findings);
  for (const auto& [name, index] : input.vertices) {
    const auto count = static_cast<Index>(file.polygons.vertices.size());
    if (index < 0 || index >= count) {
      throw ConfigError(path.string() + ": vertices." + name + " = " + std::to_string(index) + ", must be in [0, " +
                        std::to_string(count - 1) + "], the vertices of " + input.mesh.string());
    }
  }
  FileFrame frame = file.frame;
  if (input.is_garment) frame = {"m", "z", "as all garments of weft"};
  if (options.units || options.up) {
    if (options.units) frame.units = options.units;
    if (options.up) frame.up = options.up;
    frame.reason = "as given";
  }
  ImportMesh mesh = triangulate_file(file.polygons, input.mesh.string(), findings);
  to_metres_z_up(mesh, frame, findings);
  result.before = mesh;
  weld(mesh, options.weld_m, findings);
  clean_faces(mesh, findings);
  cut_open(mesh, findings);
  orient_faces(mesh, findings);
  choose_piece(mesh, options.piece, findings);
  fill_holes(mesh, options.fill_edges, findings);
  RestPositions rest = find_rest_shape(mesh, findings);
  if (rest.rows() == 0) turn_outwards(mesh, findings);
  auto names = resolve_names(mesh, input, options, rest.rows() > 0, result.grasp, findings);
  if (options.remesh) remesh(mesh, rest, *options.remesh, names, findings);
  say_edges(mesh, findings);
  result.mesh = mesh_of_import(mesh, rest);
  for (const auto& [name, v] : names) result.vertices[name] = v;
  result.vertex_of = mesh.vertex_of;
  if (result.foldable()) make_garment(result.mesh, path.stem().string(), result.vertices);  // the rules of any garment
  return result;
}

}  // namespace weft
