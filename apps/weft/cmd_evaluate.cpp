#include "commands.hpp"

namespace weft::app {

void register_evaluate(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("evaluate", "Measure a part of weft against known results");
  command->require_subcommand(1);
  register_evaluate_physics(*command, context);
  register_evaluate_prediction(*command, context);
  register_evaluate_planning(*command, context);
  register_evaluate_estimation(*command, context);
}

}  // namespace weft::app
