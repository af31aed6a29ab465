#include <cstdio>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "garment_options.hpp"
#include "meshes/import/garment_files.hpp"
#include "options.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "report/garment_page.hpp"
#include "sdk/files.hpp"
#include "simulation/displacement.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

struct ImportRequest {
  std::string file, name, fabric;
  std::vector<std::string> named, grasp, fine_lines;
  std::string units, up;
  MeshSize size;
  double remesh_m = 0.0;
  bool no_tuning = false;
  bool no_lay = false;
  ImportOptions options;
  std::string command_line;
};

const char* kind_text(FindingKind kind) {
  switch (kind) {
    case FindingKind::mended:
      return "mended";
    case FindingKind::warning:
      return "warning";
    default:
      return "fact";
  }
}

ordered_json findings_json(const Findings& findings) {
  auto list = ordered_json::array();
  for (const Finding& finding : findings) {
    ordered_json one{
        {"pass", finding.pass}, {"kind", kind_text(finding.kind)}, {"count", finding.count}, {"text", finding.text}};
    for (const Place& place : finding.places) {
      one["places"].push_back({{"element", place.element}, {"at", {place.at.x(), place.at.y(), place.at.z()}}});
    }
    list.push_back(std::move(one));
  }
  return list;
}

/// A name that YAML and file systems take as it stands.
std::string plain_name(std::string name) {
  for (char& c : name) {
    const bool plain = std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-';
    if (!plain) c = '_';
  }
  return name.empty() || name[0] == '-' ? "garment" + name : name;
}

/// The material space that goes beside the task: --fabric, or the one that ships with weft.
std::string fabric_text(const std::string& given) {
  if (!given.empty()) return ConfigNode::load(given).to_yaml();  // whole, with what it extends
  return shipped_text("configs/fabrics/basic.yaml");
}

/// Reads --units ... --grasp into the options of the import.
void read_options(ImportRequest& request) {
  ImportOptions& options = request.options;
  if (!request.units.empty()) options.units = request.units;
  if (!request.up.empty()) options.up = request.up;
  for (const std::string& text : request.named) options.names.push_back(parse_vertex_name("--name", text));
  for (const std::string& text : request.grasp) {
    const bool is_word = std::isalpha(static_cast<unsigned char>(text[0])) && text.find('(') == std::string::npos;
    options.grasp.push_back(is_word ? VertexSpec{text, -1} : parse_vertex_spec("--grasp", text));
  }
  if (request.remesh_m > 0.0) {
    request.size.edge_m = request.remesh_m;
    read_fine_lines(request.size, request.fine_lines);
    options.remesh = request.size;
  } else if (request.size.fine_edge_m > 0.0) {
    throw ConfigError("--fine needs --remesh EDGE, the edge length elsewhere");
  }
}

/// The displacement of the task, and how it was found.
struct TaskDisplacement {
  Vec2 displacement;
  std::string note;  ///< for the task file
  ordered_json json;
};

/// Tunes the displacement with the task that will be written, in a folder that goes again: nothing is written yet if the
/// user stops it, or if the fabric is refused. @throws Interrupted.
TaskDisplacement tuned_displacement(Context& context, const ImportRequest& request, const ImportedGarment& garment,
                                    const fs::path& folder, const std::string& name, Findings& findings) {
  const auto hand = [&](std::size_t i) { return garment.vertices.at(garment.grasp[i]); };
  const bool left_side =
      request.grasp.empty() && garment.mesh.positions(hand(0), 0) < garment.mesh.positions.col(0).mean();
  TaskDisplacement result{
      fold_in_two(garment.mesh, hand(0), hand(1), left_side), "from the garment's size, not tuned", {}};
  if (!request.no_tuning) {
    context.say("tuning the displacement with simulated folds");
    const TemporaryFolder place(folder);
    write_garment_files(place.path(), name, garment, request.command_line);
    write_text(place.path() / "fabric.yaml", fabric_text(request.fabric));
    const fs::path task_file = place.path() / (name + "_fold.yaml");
    write_text(task_file, task_text(name, garment.grasp, result.displacement, result.note));
    const Prepared<SessionParams> given(context, task_file.string());
    const auto simulator = given.host->create<Simulator>(given.task.simulator);
    try {
      const auto tuned = tune_displacement(given.task, *simulator, MaterialProperties::Constant(0.5),
                                           [&] { return given.host->cancelled(); });
      result.displacement = tuned.displacement;
      char note[120];
      std::snprintf(note, sizeof note, "tuned: the folded half lies %.1f mm from its mirror image in the mean",
                    tuned.misfit_mm);
      result.note = note;
      findings.push_back({"displacement", FindingKind::fact, tuned.evaluations,
                          result.note + " (" + std::to_string(tuned.evaluations) + " folds simulated)"});
      result.json["misfit_mm"] = tuned.misfit_mm;
    } catch (const Diverged& error) {
      findings.push_back({"displacement", FindingKind::warning, 1,
                          "not tuned, it comes from the garment's size: a fold failed: " + std::string(error.what())});
    }
  }
  result.json["displacement_m"] = {result.displacement.x(), result.displacement.y()};
  return result;
}

/// Writes fabric, task and experiment.
void write_task(const ImportRequest& request, const ImportedGarment& garment, const fs::path& folder,
                const std::string& name, const TaskDisplacement& displacement) {
  write_text(folder / "fabric.yaml", fabric_text(request.fabric));
  write_text(folder / (name + "_experiment.yaml"), experiment_text(name));
  write_text(folder / (name + "_fold.yaml"),
             task_text(name, garment.grasp, displacement.displacement, displacement.note));
}

GarmentPage page_of(const ImportedGarment& garment, const std::string& name, const Findings& findings) {
  GarmentPage page;
  page.name = name;
  page.mesh_file = name + ".obj";
  page.positions = garment.mesh.positions;
  page.faces = garment.mesh.faces;
  page.vertices = garment.vertices;
  page.positions_before.resize(garment.before.positions.size(), 3);
  for (Index v = 0; v < page.positions_before.rows(); ++v)
    page.positions_before.row(v) = garment.before.at(static_cast<int>(v)).transpose();
  page.faces_before.resize(garment.before.faces.size(), 3);
  for (Index f = 0; f < page.faces_before.rows(); ++f) {
    const auto& face = garment.before.faces[f];
    page.faces_before.row(f) << face[0], face[1], face[2];
  }
  page.findings = findings_json(findings);
  return page;
}

void say_findings(const Context& context, const Findings& findings) {
  for (const Finding& finding : findings) {
    char line[64];
    std::snprintf(line, sizeof line, "%-8s %-18s ", finding.kind == FindingKind::fact ? "" : kind_text(finding.kind),
                  finding.pass.c_str());
    context.say(line + finding.text);
  }
}

/// Lays a garment that is drawn as it is worn. @return its crossings, as a text; empty: none.
std::string lay(Context& context, const ImportRequest& request, ImportedGarment& garment, const std::string& name) {
  context.say("laying the garment on the table by simulation");
  const Garment worn = garment.garment(name);
  const LaidGarment laid = lay_with(context, worn, "cloth", {});
  garment.mesh.positions = laid.positions;
  garment.form = RestForm::two_sides;
  garment.layers = laid.layers;
  choose_grasp(garment, request.options);
  Garment whole = laid_garment(worn, laid);
  whole.vertices = garment.vertices;
  garment.kept = std::move(whole);
  garment.findings.push_back({"lay", FindingKind::mended, garment.mesh.positions.rows(), laid_text(laid)});
  if (laid.crossings == 0) return "";
  const std::string crossing = crossing_text(worn, laid);
  garment.findings.push_back({"lay", FindingKind::warning, laid.crossings, crossing});
  return crossing;
}

int run_import(Context& context, ImportRequest request) {
  read_options(request);
  if (!request.fabric.empty()) read_material_space(ConfigNode::quoted(request.fabric));
  const fs::path file = request.file;
  const std::string name = request.name.empty() ? plain_name(file.stem().string()) : request.name;
  if (name != plain_name(name)) throw ConfigError("--garment-name = " + name + ", must be letters, digits, _ and -");
  const fs::path folder = context.out.empty() ? fs::path(name) : fs::path(context.out);
  ImportedGarment garment = import_garment(file, request.options);
  for (const char* ending : {".obj", ".yaml"}) {
    const fs::path target = folder / (name + ending);
    std::error_code ignored;  // of a target that does not exist yet
    const bool is_mesh = garment.mesh.source == target.string() || fs::equivalent(target, garment.mesh.source, ignored);
    if (is_mesh || fs::equivalent(target, file, ignored))
      throw ConfigError(target.string() + " would replace the file that is imported; name another folder with --out");
  }
  Context::catch_signals();
  const PlacedFolder placed(folder);

  say_findings(context, garment.findings);
  const std::size_t said = garment.findings.size();
  std::string crossing;
  if (!garment.is_flat() && !request.no_lay) crossing = lay(context, request, garment, name);
  const bool foldable = garment.is_flat() && crossing.empty();
  TaskDisplacement displacement;
  if (foldable) displacement = tuned_displacement(context, request, garment, folder, name, garment.findings);
  write_garment_files(folder, name, garment, request.command_line);
  std::vector<std::string> files{name + ".obj", name + ".yaml"};
  ordered_json json{{"source", request.file},
                    {"garment", name},
                    {"vertices", garment.mesh.positions.rows()},
                    {"faces", garment.mesh.faces.rows()},
                    {"foldable", foldable},
                    {"named", garment.vertices}};
  if (garment.kept && garment.kept->has_frames()) files.push_back(name + "_rest.obj");
  if (foldable) {
    json["grasp"] = garment.grasp;
    json.update(displacement.json);
    write_task(request, garment, folder, name, displacement);
    for (const char* ending : {"_fold.yaml", "_experiment.yaml"}) files.push_back(name + ending);
    files.emplace_back("fabric.yaml");
  }
  say_findings(context, {garment.findings.begin() + static_cast<std::ptrdiff_t>(said), garment.findings.end()});
  GarmentPage page = page_of(garment, name, garment.findings);
  page.head = garment_head(ConfigNode::load(folder / (name + ".yaml")), name, page.mesh_file);
  const std::string no_page = write_garment_page(folder / "import.html", page);
  files.emplace_back("import.json");
  if (no_page.empty()) files.emplace_back("import.html");
  json["files"] = files;
  json["findings"] = findings_json(garment.findings);
  // The file's vertices keep their place unless some were joined, removed or made.
  ordered_json whole = json;
  whole["vertex_of"] = garment.vertex_of;
  write_text(folder / "import.json", whole.dump(1) + "\n");
  if (context.json) context.output() << json.dump(2) << '\n';
  context.say(folder.string() + ": " + std::to_string(files.size()) + " files");
  context.say(no_page.empty() ? "to look at it, open " + (folder / "import.html").string()
                              : "no import.html: " + no_page);
  if (!crossing.empty()) {
    std::fprintf(stderr, "error: imported and laid, but there is no task: %s\n", crossing.c_str());
    return 1;
  }
  context.say(foldable
                  ? "to fold it: weft run " + (folder / (name + "_fold.yaml")).string()
                  : "it stands as it was drawn; to lay it: weft garment lay " + (folder / (name + ".yaml")).string());
  if (foldable) context.say("to learn a network for it: weft learn " + folder.string());
  return 0;
}

}  // namespace

void register_garment_import(CLI::App& garment, Context& context) {
  CLI::App* command = garment.add_subcommand(
      "import", "Make a garment, a task and an experiment from a mesh file (OBJ; PLY, STL, glTF with assimp)");
  add_output_options(*command, context);
  auto request = std::make_shared<ImportRequest>();
  ImportOptions& options = request->options;
  command->add_option("file", request->file, "Mesh file, or the YAML of a garment")->required();
  command->add_option("--units", request->units, "m, cm, mm or in; default: what the file says, or a guess");
  command->add_option("--up", request->up, "Axis that is up: x, y, z, -x, -y or -z; default likewise");
  command->add_option("--garment-name", request->name, "Name of the garment and its files; default: that of the file");
  command
      ->add_option("--name", request->named,
                   "NAME=VERTEX: name a vertex; VERTEX is its number in the file from 1, or nearest(x,y) or "
                   "nearest(x,y,z) in metres (repeatable)")
      ->allow_extra_args(false);
  command
      ->add_option("--grasp", request->grasp,
                   "The two vertices that the hands hold, by name or as in --name; default: the outermost on the left")
      ->expected(2);
  command->add_option("--remesh", request->remesh_m, "Give the mesh edges of this length [m]")
      ->check(within(1e-4, 1.0));
  add_fine_options(*command, request->size, request->fine_lines);
  command
      ->add_option("--weld", options.weld_m,
                   "Join boundary vertices within this distance [m]; default: 1e-6 of the size")
      ->check(within(0.0, 0.1));
  command->add_option("--fill", options.fill_edges, "Fill holes of at most this many edges; 0: none")
      ->check(within(0, 1000))
      ->capture_default_str();
  command->add_option("--piece", options.piece, "Keep this piece alone; 1 is the largest, 0 keeps all")
      ->check(within(0, 1000000))
      ->capture_default_str();
  command->add_option("--fabric", request->fabric, "Material space of the task; default: the one that ships with weft");
  command->add_flag("--no-lay", request->no_lay,
                    "Leave a garment that is drawn as it is worn as it stands; no task then");
  command->add_flag("--no-tuning", request->no_tuning, "Take the displacement from the garment's size alone");
  command->callback([&context, command, request] {
    request->command_line = recorded_command(*command, "weft garment import");
    context.action = [&context, request] { return run_import(context, *request); };
  });
}

}  // namespace weft::app
