#include "commands.hpp"
#include "learning.hpp"
#include "options.hpp"

namespace weft::app {

void register_learn(CLI::App& app, Context& context) {
  CLI::App* command =
      app.add_subcommand("learn", "From a task to a model: examples, training, calibration, evaluation, a new task");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto call = std::make_shared<LearnCall>();
  command
      ->add_option("task", call->task,
                   "Task or experiment file, such as configs/tasks/towel_fold.yaml, or the folder of `weft garment "
                   "import`")
      ->required();
  command
      ->add_option("--hours", call->hours,
                   "Time to spend: becomes numbers of examples and iterations, which are saved; default: those of the "
                   "config (learn.examples and others)")
      ->check(within(0.001, 10000.0))
      ->type_name("H");
  command->add_flag("--tune-displacement", call->tune_displacement,
                    "Tune the length of d first, as `weft displacement` does; `weft garment import` has done it");
  add_process_options(*command, "example", call->work);
  CLI::Option* dry_run = command->get_option("--dry-run");
  dry_run->remove_needs(command->get_option("--on"));
  dry_run->description("Print what would be made, or with --on the scripts of the jobs, and write nothing");
  command->callback([&context, call] { context.action = [&context, call] { return Learning(context, *call).run(); }; });
}

}  // namespace weft::app
