#include <cstdio>

#include "commands.hpp"
#include "evaluation_run.hpp"
#include "experiments/planning_evaluation.hpp"
#include "options.hpp"
#include "report/times.hpp"

namespace weft::app {
namespace {

int evaluate(Context& context, const EvaluationOptions& options, const std::vector<double>& widths) {
  require_distinct("--widths", widths);
  EvaluationRun evaluation(context, options, "planning");
  const auto columns = evaluation.run(
      [&](const EvaluationCases& cases) { return planning_evaluation(evaluation.session, widths, cases); },
      planning_runner,
      [](const SweepRow& row) {
        char text[120];
        std::snprintf(text, sizeof text, "%.1f mm (default control: %.1f mm), first plan %.2f s",
                      row.metric("error_mm"), row.metric("default_error_mm"), row.metric("first_plan_seconds"));
        return std::string(text);
      });
  if (const auto code = evaluation.ended_with()) return *code;
  const std::string json = planning_evaluation_json(columns), times = planning_times_json(columns);
  evaluation.write("planning", json, planning_evaluation_csv(columns), times, planning_times_csv(columns));
  const auto& first = columns.front();
  write_planning_shapes(first, *evaluation.given.task.garment, evaluation.source_folder(first.cases.source),
                        evaluation.out / "cases.h5");
  if (context.json) context.output() << with_times(json, times);
  for (const auto& column : columns) context.say(planning_evaluation_table(column));
  evaluation.say_rows(columns);
  write_paper(context, evaluation.out, options.paper);
  write_page(context, evaluation.out);
  context.say("results in " + evaluation.out.string());
  return evaluation.exit_code(columns);
}

}  // namespace

void register_evaluate_planning(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand(
      "planning", "Error of whole sessions against the width of the material knowledge (Fig. 3); resumable");
  add_common_options(*command, context);
  auto options = std::make_shared<EvaluationOptions>();
  auto widths = std::make_shared<std::vector<double>>();
  for (int i = 1; i <= 10; ++i) widths->push_back(i / 10.0);
  add_evaluation_options(*command, context, *options);
  command->add_option("--widths", *widths, "Widths w of the knowledge of all properties")->check(within(0.0, 1.0));
  command->callback([&context, options, widths] {
    context.action = [&context, options, widths] { return evaluate(context, *options, *widths); };
  });
}

}  // namespace weft::app
