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
#include "meshes/import/untangle.hpp"
#include "meshes/import/weld.hpp"
#include "weft/config.hpp"
#include "weft/rest_shape.hpp"

namespace weft {
namespace {

struct Input {
  std::filesystem::path mesh;
  std::map<std::string, Index> vertices;
  bool is_garment = false;
  bool is_finished = false;  ///< it has layers, or a rest shape in another file: nothing of it is guessed again
};

/// The mesh file and its names: of the YAML of a garment, or of the mesh alone.
Input input_of(const std::filesystem::path& path) {
  if (path.extension() != ".yaml" && path.extension() != ".yml") return {path, {}, false, false};
  const ConfigNode node = ConfigNode::load(path);
  node.refuse_unknown_keys({"mesh", "name", "vertices", "rest", "layers", "seams"});
  Input input{node.at("mesh").as_path(), {}, true, false};
  const auto rest = node.find("rest"), layers = node.find("layers");
  input.is_finished = (rest && rest->at("from").as_string() != "mesh") || (layers && layers->is_sequence());
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
                                         bool flat, std::vector<std::string>& grasp, Findings& findings) {
  std::map<std::string, int> names;
  for (const auto& [name, index] : input.vertices) {
    const VertexSpec spec{std::to_string(index + 1), static_cast<int>(index) + 1};
    names[name] = find_vertex(mesh, "vertices." + name + " (from 1)", spec);
  }
  for (const auto& [name, spec] : options.names) names[name] = find_vertex(mesh, "--name " + name, spec);
  if (flat) {
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
  if (!flat) grasp.clear();
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

ImportMesh import_mesh_of(const Mesh& from) {
  ImportMesh mesh;
  mesh.source = from.source;
  for (Index v = 0; v < from.positions.rows(); ++v) {
    mesh.positions.emplace_back(from.positions.row(v).transpose());
    mesh.vertex_number.push_back(static_cast<int>(v) + 1);
    mesh.vertex_of.push_back(static_cast<int>(v));
  }
  for (Index f = 0; f < from.faces.rows(); ++f) {
    mesh.faces.push_back({from.faces(f, 0), from.faces(f, 1), from.faces(f, 2)});
    mesh.face_texture.push_back({-1, -1, -1});
    mesh.face_number.push_back(static_cast<int>(f) + 1);
  }
  return mesh;
}

}  // namespace

Garment ImportedGarment::garment(const std::string& name) const {
  if (kept) {
    Garment garment = *kept;
    garment.name = name;
    return garment;
  }
  GarmentForm given;
  given.layers = layers;
  if (form != RestForm::chart) given.frames = frames_of_shape(mesh.positions, mesh.faces, usual_grain(mesh.positions));
  if (!layers.empty()) given.seams = edges_between_sides(mesh.positions, mesh.faces);
  return make_garment(mesh, name, vertices, std::move(given));
}

void choose_grasp(ImportedGarment& garment, const ImportOptions& options) {
  const ImportMesh mesh = import_mesh_of(garment.mesh);
  std::map<std::string, int> names;
  for (const auto& [name, v] : garment.vertices) names[name] = static_cast<int>(v);
  std::vector<std::string> held;
  for (std::size_t i = 0; i < options.grasp.size(); ++i) {
    const std::string numbered = "grasp_" + std::to_string(i + 1);
    held.push_back(options.grasp[i].number < 0 ? options.grasp[i].text : numbered);
  }
  for (const auto& [name, v] : outermost_vertices(mesh))
    if (name_of(names, v).empty()) names.emplace(name, v);
  garment.grasp = held.empty() ? outermost_side(mesh, names) : held;
  for (const auto& [name, v] : names) garment.vertices[name] = v;
}

/// A garment that weft wrote, with layers or a rest shape in a file: only the hands are chosen.
ImportedGarment keep_garment(const std::filesystem::path& path, const ImportOptions& options) {
  if (options.remesh || options.units || options.up)
    throw ConfigError(path.string() +
                      " has layers or a rest shape of its own, which a change of its mesh would lose: "
                      "import the mesh that it was made from");
  ImportedGarment result;
  const ConfigNode node = ConfigNode::load(path);
  Garment garment = read_garment(ConfigNode::quoted(path.string()));
  result.mesh = {garment.positions, garment.faces, garment.has_frames() ? RestPositions(0, 2) : garment.rest,
                 node.at("mesh").as_path().string()};
  result.form = garment.has_frames() ? RestForm::two_sides : RestForm::chart;
  result.layers = garment.form.layers;
  result.vertices = garment.vertices;
  result.before = import_mesh_of(result.mesh);
  for (const auto& [name, spec] : options.names)
    result.vertices[name] = spec.number > 0 ? spec.number - 1 : nearest_vertex(result.mesh.positions, spec);
  for (std::size_t i = 0; i < options.grasp.size(); ++i) {
    const VertexSpec& spec = options.grasp[i];
    if (spec.number < 0)
      garment.vertex(spec.text);  // throws for an unknown name
    else
      result.vertices["grasp_" + std::to_string(i + 1)] =
          spec.number > 0 ? spec.number - 1 : nearest_vertex(result.mesh.positions, spec);
  }
  for (const auto& [name, v] : result.vertices)
    if (v >= garment.vertex_count()) throw ConfigError(name + ": the garment has no vertex " + std::to_string(v + 1));
  choose_grasp(result, options);
  result.findings.push_back({"garment", FindingKind::fact, garment.vertex_count(),
                             "one of weft's, with its rest shape and layers: kept as it is"});
  garment.vertices = result.vertices;
  for (Index v = 0; v < garment.vertex_count(); ++v) result.vertex_of.push_back(static_cast<int>(v));
  result.kept = std::move(garment);
  return result;
}

ImportedGarment import_garment(const std::filesystem::path& path, const ImportOptions& options) {
  ImportedGarment result;
  Findings& findings = result.findings;
  const Input input = input_of(path);
  if (input.is_finished) return keep_garment(path, options);
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
  // Before its size and its up axis are looked at: a vertex in no face may lie anywhere.
  if (const int unused = mesh.drop_unused(); unused > 0)
    findings.push_back(
        {"faces", FindingKind::mended, unused, counted(unused, "vertex", "vertices") + " in no face removed"});
  to_metres_z_up(mesh, frame, findings);
  result.before = mesh;
  weld(mesh, options.weld_m, findings);
  clean_faces(mesh, findings);
  cut_open(mesh, findings);
  orient_faces(mesh, findings);
  choose_piece(mesh, options.piece, findings);
  fill_holes(mesh, options.fill_edges, findings);
  FoundRest rest = find_rest_shape(mesh, findings);
  result.form = rest.form;
  if (!result.is_flat()) {
    turn_outwards(mesh, findings);
    untangle(mesh, findings);
  }
  auto names = resolve_names(mesh, input, options, result.is_flat(), result.grasp, findings);
  if (options.remesh) remesh(mesh, rest.chart, *options.remesh, names, findings);
  if (result.is_flat()) result.layers = flat_layers(mesh, findings);
  say_edges(mesh, findings);
  result.mesh = to_mesh(mesh);
  result.mesh.rest = rest.chart;
  for (const auto& [name, v] : names) result.vertices[name] = v;
  result.vertex_of = mesh.vertex_of;
  result.garment(path.stem().string());  // the rules of any garment
  return result;
}

}  // namespace weft
