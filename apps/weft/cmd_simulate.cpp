#include <cstdio>

#include "commands.hpp"
#include "meshes/garment_writer.hpp"
#include "output.hpp"
#include "report/times.hpp"
#include "simulation/scene.hpp"

namespace weft::app {
namespace {

std::string frame_name(Index frame) {
  char name[32];
  std::snprintf(name, sizeof name, "%04lld.obj", static_cast<long long>(frame));
  return name;
}

/// Removes frames of an earlier, longer run, which would look like this run's.
void remove_old_frames(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> old;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const std::string stem = entry.path().stem().string();
    if (entry.path().extension() == ".obj" && stem.find_first_not_of("0123456789") == std::string::npos) {
      old.push_back(entry.path());
    }
  }
  for (const auto& path : old) std::filesystem::remove(path);
}

int simulate(Context& context, const std::string& file) {
  const ConfigNode config = context.load(file);
  SceneRun run = read_scene(config);
  const auto registry = context.registry(config);
  const auto host = context.host(registry, run.seed);
  run.simulator = registry->resolve(Simulator::kKind, run.simulator);

  const auto folder = result_folder(context, std::filesystem::path(file).stem().string());
  require_command(context, folder, "simulate");
  check_scene(run, *host);
  make_writable_folder(folder);
  const auto frames = folder / "frames";
  make_writable_folder(frames);
  remove_old_frames(frames);
  Mesh mesh{run.garment->positions, run.garment->faces, run.garment->rest, run.garment->name};
  write_garment_meshes(folder / "garment.obj", *run.garment);
  write_text(folder / "config.yaml", write_scene(run, "garment.obj").to_yaml());

  const Index last = run.frames();
  context.say("simulating " + run.garment->name + " (" + std::to_string(run.garment->vertex_count()) + " vertices), " +
              std::to_string(last) + " frames");
  const SceneResult result = run_scene(run, *host, [&](const Simulator& simulator, Index frame) {
    if (frame % run.output_every_frames != 0 && frame != last) return;
    mesh.positions = simulator.positions();
    write_obj(frames / frame_name(frame), mesh);
  });
  const std::string summary = scene_summary_json(run, result), times = scene_times_json(result);
  write_text(folder / "provenance.json", provenance_json(*registry, run.seed, identity_of_command("simulate")));
  write_text(folder / "summary.json", summary);
  write_text(folder / "times.json", times_json(host->threads(), {{"summary.json", times}}));
  for (const auto& warning : result.warnings) host->log(LogLevel::warning, warning);
  if (context.json) context.output() << with_times(summary, times);
  char line[200];
  std::snprintf(line, sizeof line, "%lld frames, largest speed %.2g m/s, largest strain %.2g %%, %lld intersections",
                static_cast<long long>(result.frames), result.max_speed, 100.0 * result.final_strain,
                static_cast<long long>(result.intersections));
  context.say(line);
  context.say("results in " + folder.string());
  return result.cancelled ? 1 : 0;
}

}  // namespace

void register_simulate(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("simulate", "Run one simulator on one scene: any mesh, pins, scripted grasps");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto file = std::make_shared<std::string>();
  command->add_option("scene", *file, "Scene file, such as configs/experiments/scenes/drape.yaml")->required();
  command->callback([&context, file] { context.action = [&context, file] { return simulate(context, *file); }; });
}

}  // namespace weft::app
