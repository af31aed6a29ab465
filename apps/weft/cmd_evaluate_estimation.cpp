
#include "commands.hpp"
#include "evaluation_run.hpp"
#include "experiments/estimation_evaluation.hpp"
#include "report/times.hpp"

namespace weft::app {
namespace {

int evaluate(Context& context, const EvaluationOptions& options, std::vector<std::string> methods) {
  EvaluationRun evaluation(context, options, "estimation");
  if (methods.empty()) methods = {evaluation.given.params.estimation.method};
  const auto columns = evaluation.run(
      [&](const EvaluationCases& cases) {
        return estimation_evaluation(evaluation.session, methods, evaluation.given.params.data, cases);
      },
      [&](const EvaluationCases& cases, const std::filesystem::path& folder) {
        return estimation_runner(cases, evaluation.given.params.data, folder);
      },
      [](const SweepRow&) { return std::string("done"); });
  if (const auto code = evaluation.ended_with()) return *code;
  const std::string json = estimation_evaluation_json(columns), times = estimation_times_json(columns);
  const std::string whole = with_times(json, times);
  evaluation.write("estimation", json, estimation_evaluation_csv(columns), times, estimation_times_csv(columns));
  const auto& first = columns.front();
  write_estimation_shapes(first, *evaluation.given.task.garment, evaluation.source_folder(first.cases.source),
                          evaluation.out / "cases.h5");
  if (context.json) context.output() << whole;
  context.say(estimation_evaluation_table(whole));
  evaluation.say_rows(columns);
  write_paper(context, evaluation.out, options.paper);
  write_page(context, evaluation.out);
  context.say("results in " + evaluation.out.string());
  return evaluation.exit_code(columns);
}

}  // namespace

void register_evaluate_estimation(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand(
      "estimation",
      "Material estimates while manipulations are replayed (Table 1, Fig. 4), and their calibration; resumable");
  add_common_options(*command, context);
  auto options = std::make_shared<EvaluationOptions>();
  auto methods = std::make_shared<std::vector<std::string>>();
  add_evaluation_options(*command, context, *options);
  command->add_option("--methods", *methods, "estimation.method of each arm; default: the config's")
      ->check(CLI::IsMember(param_named(describe_params<SessionParams>(), "estimation.method").choices));
  command->callback([&context, options, methods] {
    context.action = [&context, options, methods] { return evaluate(context, *options, *methods); };
  });
}

}  // namespace weft::app
