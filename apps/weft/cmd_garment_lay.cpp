#include <cstdio>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "garment_options.hpp"
#include "meshes/garment_writer.hpp"
#include "options.hpp"
#include "sdk/files.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

struct LayRequest {
  std::string file, simulator = "cloth";
  LayParams params;
  std::string command_line;
};

int run_lay(Context& context, const LayRequest& request) {
  const Garment garment = read_garment(ConfigNode::quoted(request.file));
  const LaidGarment laid = lay_with(context, garment, request.simulator, request.params);
  const fs::path folder = context.out.empty() ? fs::path(garment.name + "_laid") : fs::path(context.out);
  make_writable_folder(folder);
  const Garment result = laid_garment(garment, laid);
  const std::string mesh_file = garment.name + ".obj";
  write_garment_meshes(folder / mesh_file, result);
  write_text(folder / (garment.name + ".yaml"),
             "# Made by: " + request.command_line + "\n" + garment_node(mesh_file, result).to_yaml());
  if (context.json) {
    context.output() << nlohmann::ordered_json{{"crossings_before", laid.crossings_before},
                                               {"crossings", laid.crossings},
                                               {"frames", laid.frames},
                                               {"settled", laid.settled},
                                               {"height_m", laid.height},
                                               {"median_strain", laid.median_strain},
                                               {"largest_strain", laid.largest_strain}}
                            .dump(2)
                     << '\n';
  }
  context.say(laid_text(laid));
  context.say("the garment is " + (folder / (garment.name + ".yaml")).string());
  if (laid.crossings == 0) return 0;
  std::fprintf(stderr, "error: %s\n", crossing_text(garment, laid).c_str());
  return 1;
}

}  // namespace

LaidGarment lay_with(Context& context, const Garment& garment, const std::string& simulator, const LayParams& params) {
  const auto registry = context.registry();
  const auto host = context.host(registry, 0);
  return lay_garment(garment, *host->create<Simulator>(ConfigNode::quoted(simulator)), params,
                     [&host] { return host->cancelled(); });
}

Garment laid_garment(const Garment& garment, const LaidGarment& laid) {
  GarmentForm form;
  form.frames = garment.form.frames;
  form.layers = laid.layers;  // no seams: what lies folded is one cloth
  Mesh mesh{laid.positions, garment.faces, garment.has_frames() ? RestPositions(0, 2) : garment.rest, garment.name};
  return make_garment(mesh, garment.name, garment.vertices, std::move(form));
}

std::string laid_text(const LaidGarment& laid) {
  char text[240];
  std::snprintf(text, sizeof text,
                "laid in %lld frames: %.1f mm high, edges strained by %.2g %% in the median, %lld crossings (%lld as "
                "drawn)%s",
                static_cast<long long>(laid.frames), 1e3 * laid.height, 100.0 * laid.median_strain,
                static_cast<long long>(laid.crossings), static_cast<long long>(laid.crossings_before),
                laid.settled ? "" : "; it still moved at the end");
  return text;
}

std::string crossing_text(const Garment& drawn, const LaidGarment& laid) {
  std::string text = "the laid garment crosses itself in " + std::to_string(laid.crossings) + " places";
  if (!laid.crossing_before) return text + ": try `weft garment lay` with a larger --thickness or a longer --fall";
  const Intersection& one = *laid.crossing_before;
  const Vec3 at = 0.5 * (drawn.positions.row(one.edge[0]) + drawn.positions.row(one.edge[1])).transpose();
  char place[140];
  std::snprintf(place, sizeof place, "edge %d-%d with face %d (numbered from 0) near (%.3f, %.3f, %.3f) m", one.edge[0],
                one.edge[1], one.face, at.x(), at.y(), at.z());
  text += "; so does the mesh as drawn, in " + std::to_string(laid.crossings_before) + ", such as " + place;
  return text + (one.between_pieces ? ": two pieces cross there; move them apart, or import one of them alone (--piece)"
                                    : ": mend it there");
}

void register_garment_lay(CLI::App& garment, Context& context) {
  CLI::App* command =
      garment.add_subcommand("lay", "Lay a garment that is drawn as it is worn flat on the table, by simulation");
  add_output_options(*command, context);
  auto request = std::make_shared<LayRequest>();
  command->add_option("garment", request->file, "YAML of a garment")->required();
  command->add_option("--simulator", request->simulator, "Simulator plugin")->capture_default_str();
  add_size_options(*command, request->params);
  command->callback([&context, command, request] {
    request->command_line = recorded_command(*command, "weft garment lay");
    context.action = [&context, request] { return run_lay(context, *request); };
  });
}

}  // namespace weft::app
