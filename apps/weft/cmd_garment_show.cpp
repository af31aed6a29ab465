#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "meshes/import/names.hpp"
#include "options.hpp"
#include "report/garment_page.hpp"
#include "sdk/files.hpp"
#include "sdk/obj_file.hpp"
#include "weft/config.hpp"
#include "weft/mesh.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

struct ShowRequest {
  std::string file;
  std::vector<std::string> named;
};

/// A garment as its files say it, also one that weft cannot fold yet.
struct ShownGarment {
  std::string name;
  fs::path mesh_path;
  std::string mesh_file;  ///< as the YAML names it
  std::map<std::string, Index> vertices;
  std::string head;  ///< the YAML but for the vertices
};

ShownGarment read_shown(const fs::path& file) {
  if (file.extension() != ".yaml" && file.extension() != ".yml")
    return {file.stem().string(),
            file,
            file.filename().string(),
            {},
            garment_head({}, file.stem().string(), file.filename().string())};
  const ConfigNode node = ConfigNode::load(file);
  ShownGarment garment{file.stem().string(), node.at("mesh").as_path(), node.at("mesh").as_string(), {}, {}};
  if (const auto name = node.find("name")) garment.name = name->as_string();
  garment.head = garment_head(node, garment.name, garment.mesh_file);
  if (const auto named = node.find("vertices")) {
    for (const std::string& key : named->keys()) garment.vertices[key] = named->at(key).as_int();
  }
  return garment;
}

int run_show(const Context& context, const ShowRequest& request) {
  ShownGarment garment = read_shown(request.file);
  const Mesh mesh = bare_mesh(read_obj_file(garment.mesh_path, true), garment.mesh_path.string());
  for (const auto& [name, index] : garment.vertices) {
    if (index < 0 || index >= mesh.positions.rows())
      throw ConfigError(request.file + ": vertices." + name + " = " + std::to_string(index) + ", must be in [0, " +
                        std::to_string(mesh.positions.rows() - 1) + "], the vertices of " + garment.mesh_path.string());
  }
  for (const std::string& text : request.named) {
    const auto [name, spec] = parse_vertex_name("--name", text);
    if (spec.number > mesh.positions.rows())
      throw ConfigError("--name " + text + ": " + garment.mesh_path.string() + " has only " +
                        std::to_string(mesh.positions.rows()) + " vertices");
    garment.vertices[name] = spec.number > 0 ? spec.number - 1 : nearest_vertex(mesh.positions, spec);
  }
  if (!request.named.empty()) {
    std::vector<std::pair<std::string, ConfigNode>> vertices;
    for (const auto& [name, index] : garment.vertices) vertices.emplace_back(name, ConfigNode::integer(index));
    if (context.json) {
      context.output() << nlohmann::ordered_json{{"name", garment.name},
                                                 {"mesh", garment.mesh_file},
                                                 {"vertices", garment.vertices}}
                              .dump(2)
                       << '\n';
    } else {
      context.output() << garment.head
                       << ConfigNode::mapping({{"vertices", ConfigNode::mapping(std::move(vertices))}}).to_yaml();
    }
    if (context.out.empty()) return 0;
  }
  const fs::path page = context.out.empty() ? fs::path(garment.name + ".html") : fs::path(context.out);
  if (page.has_parent_path()) make_writable_folder(page.parent_path());
  const std::string why_not = write_garment_page(
      page, {garment.name, garment.mesh_file, mesh.positions, mesh.faces, garment.vertices, garment.head});
  if (!why_not.empty()) throw Error("no page can be written: " + why_not);
  if (request.named.empty()) context.say("to look at it and to name its vertices, open " + page.string());
  return 0;
}

}  // namespace

void register_garment_show(CLI::App& garment, Context& context) {
  CLI::App* command = garment.add_subcommand(
      "show", "Write the page of a garment, where a click names a vertex; with --name, print the YAML instead");
  add_output_options(*command, context);
  auto request = std::make_shared<ShowRequest>();
  command->add_option("garment", request->file, "YAML or OBJ of a garment")->required();
  command
      ->add_option(
          "--name", request->named,
          "NAME=VERTEX: name a vertex without the page; VERTEX is nearest(x,y) or nearest(x,y,z) in metres, or its "
          "OBJ number from 1 (repeatable)")
      ->allow_extra_args(false);
  command->callback(
      [&context, request] { context.action = [&context, request] { return run_show(context, *request); }; });
}

}  // namespace weft::app
