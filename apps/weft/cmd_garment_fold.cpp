#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "meshes/intersections.hpp"
#include "options.hpp"
#include "prepared.hpp"
#include "simulation/fold.hpp"
#include "simulation/hand_limits.hpp"

namespace weft::app {
namespace {

/// One fold with the default control and the middle of the material space: a look at a garment before any plan.
int fold_once(Context& context, const std::string& file, const std::string& mesh_file) {
  const Prepared<SessionParams> given(context, file);
  check_simulator(given.task.simulator, given.task, *given.host);
  const auto simulator = given.host->create<Simulator>(given.task.simulator);
  const Trajectory& trajectory = *given.task.trajectory;
  const Controls controls =
      within_limits(given.task, trajectory.initial_state(given.task.manipulation), {}, trajectory.default_controls(60))
          .controls;
  const Garment& garment = *given.task.garment;
  const FoldResult fold = simulate_fold(*simulator, given.task, MaterialProperties::Constant(0.5), controls,
                                        [&] { return given.host->cancelled(); });
  Index crossings = 0;
  for (const Positions& shape : fold.shapes) crossings = std::max(crossings, count_intersections(shape, garment.faces));
  const Positions& end = fold.shapes.back();
  const auto width = [&](const Positions& x) {
    const Vector along = x.leftCols<2>() * given.task.manipulation.displacement.normalized();
    return along.maxCoeff() - along.minCoeff();
  };
  const double share = width(end) / width(fold.shapes.front());
  if (!mesh_file.empty()) write_obj(mesh_file, {end, garment.faces, RestPositions(0, 2), garment.name});
  if (context.json) {
    context.output() << nlohmann::ordered_json{{"segments", fold.segments},
                                               {"released", fold.released},
                                               {"settled", fold.settle.settled},
                                               {"settle_frames", fold.settle.frames},
                                               {"crossings", crossings},
                                               {"width_share", share},
                                               {"height_m", end.col(2).maxCoeff()},
                                               {"max_grasp_strain", fold.max_grasp_strain}}
                            .dump(2)
                     << '\n';
  }
  char text[240];
  std::snprintf(
      text, sizeof text,
      "%lld segments%s, settled after %lld frames%s; %lld crossings at most after any segment; %.0f %% of the "
      "width, %.1f mm high",
      static_cast<long long>(fold.segments), fold.released ? "" : " (not released)",
      static_cast<long long>(fold.settle.frames), fold.settle.settled ? "" : " (it still moved)",
      static_cast<long long>(crossings), 100.0 * share, 1e3 * end.col(2).maxCoeff());
  context.say(text);
  return crossings == 0 ? 0 : 1;
}

}  // namespace

void register_garment_fold(CLI::App& garment, Context& context) {
  CLI::App* command = garment.add_subcommand(
      "fold", "Fold a task's garment once with the default control; exits with 1 if the cloth crosses itself");
  add_common_options(*command, context);
  auto file = std::make_shared<std::string>(), mesh = std::make_shared<std::string>();
  command->add_option("config", *file, "Task file")->required();
  command->add_option("--mesh", *mesh, "Write the settled shape as an OBJ");
  command->callback(
      [&context, file, mesh] { context.action = [&context, file, mesh] { return fold_once(context, *file, *mesh); }; });
}

}  // namespace weft::app
