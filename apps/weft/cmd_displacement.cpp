#include <cstdio>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "prepared.hpp"
#include "session/session.hpp"
#include "simulation/displacement.hpp"
#include "simulation/task_config.hpp"

namespace weft::app {
namespace {

int tune(Context& context, const std::string& file) {
  const Prepared<SessionParams> given(context, file);
  check_simulator(given.task.simulator, given.task, *given.host);
  const auto simulator = given.host->create<Simulator>(given.task.simulator);
  const auto result = tune_displacement(given.task, *simulator, MaterialProperties::Constant(0.5),
                                        [&] { return given.host->cancelled(); });
  if (context.json) {
    context.output() << nlohmann::ordered_json{{"displacement_m", {result.displacement.x(), result.displacement.y()}},
                                               {"misfit_mm", result.misfit_mm},
                                               {"folds", result.evaluations}}
                            .dump(2)
                     << '\n';
  } else {
    std::printf("displacement_m: [%.4f, %.4f]\n", result.displacement.x(), result.displacement.y());
    char line[120];
    std::snprintf(line, sizeof(line), "# mean misfit of the folded half: %.1f mm, %td folds simulated",
                  result.misfit_mm, result.evaluations);
    context.say(line);
  }
  return 0;
}

}  // namespace

void register_displacement(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand(
      "displacement", "Tune the length of d so that half the default control folds the garment in two");
  add_common_options(*command, context);
  auto file = std::make_shared<std::string>();
  command->add_option("config", *file, "Task file; its manipulation.displacement_m gives the direction")->required();
  command->callback([&context, file] { context.action = [&context, file] { return tune(context, *file); }; });
}

}  // namespace weft::app
