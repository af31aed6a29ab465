#include <cstdio>
#include <nlohmann/json.hpp>
#include <sstream>

#include "commands.hpp"
#include "garment_options.hpp"
#include "meshes/mesher.hpp"
#include "meshes/sewing.hpp"
#include "options.hpp"
#include "sdk/files.hpp"

namespace weft::app {
namespace {

struct Request {
  std::string kind;
  std::function<Outline()> outline;
  MeshSize size;
  std::vector<std::string> fine_lines;
  bool yaml = false;
  bool two_layers = false;
  std::string command_line;  ///< makes the same files again; without folders
};

void write_yaml(const std::filesystem::path& path, const Request& request, const GeneratedMesh& result,
                const std::string& mesh_file) {
  std::ostringstream out;
  char line[200];
  std::snprintf(line, sizeof line, "# %ld vertices, %ld faces, smallest angle %.1f deg, edges %.1f to %.1f mm\n",
                static_cast<long>(result.mesh.positions.rows()), static_cast<long>(result.mesh.faces.rows()),
                result.quality.min_angle_deg, result.quality.edge_min_m * 1e3, result.quality.edge_max_m * 1e3);
  out << "# Made by: " << request.command_line << '\n' << line;
  std::vector<std::pair<std::string, ConfigNode>> vertices;
  for (const auto& [name, index] : result.vertices) vertices.emplace_back(name, ConfigNode::integer(index));
  std::vector<std::pair<std::string, ConfigNode>> entries{{"name", ConfigNode::scalar(request.kind)},
                                                          {"mesh", ConfigNode::scalar(mesh_file)}};
  if (request.two_layers) {
    entries.emplace_back("rest", ConfigNode::mapping({{"from", ConfigNode::scalar("mesh")}}));
    entries.emplace_back("layers", ConfigNode::scalar("sides"));
  }
  entries.emplace_back("vertices", ConfigNode::mapping(std::move(vertices)));
  out << ConfigNode::mapping(std::move(entries)).to_yaml();
  write_text(path, out.str());
}

/// Joins the generated front to a back at the outline's seams. Named vertices at openings get a second one, back_NAME. Inside the
/// outline no vertex of the back lies under one of the front: such a vertex would touch all faces around the other one, and
/// simulations took up to twice the time.
void add_back(GeneratedMesh& result, const Outline& outline, MeshSize size) {
  size.lattice_shift = {0.5, 1.0 / 3.0};
  const GeneratedMesh below = generate_mesh(outline, size);
  SewnMesh sewn = sew_front_and_back(result.mesh, below.mesh,
                                     [&](const Vec2& a, const Vec2& b) { return !is_open_at(outline, a, b); });
  const auto front = result.vertices;
  for (const auto& [name, index] : front) {
    const int back = sewn.back[index];
    if (back >= 0 && back != index) result.vertices["back_" + name] = back;
  }
  const double area = result.quality.area_m2 + below.quality.area_m2;  // the back's faces count as negative below
  result.quality = measure_mesh(sewn.mesh.positions.leftCols<2>(), sewn.mesh.faces);
  result.quality.area_m2 = area;
  result.mesh = std::move(sewn.mesh);
  make_garment(result.mesh, "generated", result.vertices, sewn.form);  // checks it as any input
}

int run_garment(const Context& context, Request request) {
  if (context.out.empty()) throw ConfigError("weft garment: --out FILE.obj is required");
  std::filesystem::path mesh_path = context.out;
  if (mesh_path.extension() != ".obj") throw ConfigError("--out = " + context.out + ", must end in .obj");
  read_fine_lines(request.size, request.fine_lines);
  const Outline outline = request.outline();
  GeneratedMesh result = generate_mesh(outline, request.size);
  if (request.two_layers) add_back(result, outline, request.size);
  if (mesh_path.has_parent_path()) make_writable_folder(mesh_path.parent_path());
  write_obj(mesh_path, result.mesh);
  if (request.yaml || request.two_layers) {
    write_yaml(std::filesystem::path(mesh_path).replace_extension(".yaml"), request, result,
               mesh_path.filename().string());
  }

  const MeshQuality& q = result.quality;
  if (context.json) {
    nlohmann::ordered_json json{{"vertices", result.mesh.positions.rows()},
                                {"faces", result.mesh.faces.rows()},
                                {"min_angle_deg", q.min_angle_deg},
                                {"max_angle_deg", q.max_angle_deg},
                                {"edge_m", {{"min", q.edge_min_m}, {"median", q.edge_median_m}, {"max", q.edge_max_m}}},
                                {"area_m2", q.area_m2},
                                {"named", result.vertices}};
    context.output() << json.dump(2) << '\n';
    return 0;
  }
  char text[256];
  std::snprintf(
      text, sizeof text,
      "%s: %ld vertices, %ld faces, area %.4f m2\nangles %.1f to %.1f deg\nedges min %.2f, median %.2f, max %.2f mm",
      context.out.c_str(), static_cast<long>(result.mesh.positions.rows()), static_cast<long>(result.mesh.faces.rows()),
      q.area_m2, q.min_angle_deg, q.max_angle_deg, q.edge_min_m * 1e3, q.edge_median_m * 1e3, q.edge_max_m * 1e3);
  context.say(text);
  return 0;
}

template <class Size>
void add_kind(CLI::App& garment, Context& context, const std::string& kind, const std::string& text,
              const Size& defaults, Outline (*outline)(const Size&)) {
  CLI::App* command = garment.add_subcommand(kind, text);
  add_output_options(*command, context);
  auto size = std::make_shared<Size>(defaults);
  auto request = std::make_shared<Request>();
  request->kind = kind;
  request->outline = [size, outline] { return outline(*size); };
  add_size_options(*command, *size);
  command->add_option("--edge", request->size.edge_m, "Edge length [m]")
      ->check(within(1e-4, 1.0))
      ->capture_default_str();
  add_fine_options(*command, request->size, request->fine_lines);
  command->add_flag("--yaml", request->yaml, "Also write the garment's YAML (named vertices) beside the mesh");
  command->add_flag("--two-layers", request->two_layers,
                    "A front and a back, joined at the seams; writes the YAML too, which says how they lie");
  command->callback([&context, command, request, kind] {
    request->command_line = recorded_command(*command, "weft garment " + kind);
    context.action = [&context, request] { return run_garment(context, *request); };
  });
}

}  // namespace

void register_garment(CLI::App& app, Context& context) {
  CLI::App* garment =
      app.add_subcommand("garment", "Import, lay, look at, fold, or generate a garment: weft garment import FILE");
  garment->require_subcommand(1);
  add_kind<TowelSize>(*garment, context, "towel", "A rectangle", {}, towel_outline);
  add_kind<ShirtSize>(*garment, context, "tshirt", "A shirt with short sleeves", {}, shirt_outline);
  add_kind<ShirtSize>(*garment, context, "long_sleeve", "A shirt with long sleeves", long_sleeve_size(), shirt_outline);
  add_kind<TrousersSize>(*garment, context, "trousers", "Trousers", {}, trousers_outline);
  register_garment_import(*garment, context);
  register_garment_lay(*garment, context);
  register_garment_fold(*garment, context);
  register_garment_show(*garment, context);
}

}  // namespace weft::app
