#include <cmath>
#include <cstdio>

#include "commands.hpp"
#include "experiments/evaluation_work.hpp"
#include "experiments/experiment_config.hpp"
#include "experiments/prediction_evaluation.hpp"
#include "learning_steps.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "report/times.hpp"
#include "simulation/fold.hpp"
#include "weft/config.hpp"
#include "work_options.hpp"

namespace weft::app {
namespace {

/// Share within one sigma and mean normalised squared error by segments ahead, for some of these.
void say_calibration(const Context& context, const PredictionEvaluation& result) {
  std::vector<std::size_t> columns;
  for (const std::size_t segments : {1, 2, 3, 5, 8, 12, 16, 20, 25}) {
    if (segments <= result.by_step.size()) columns.push_back(segments);
  }
  char text[64];
  std::string head = "by segments ahead             ";
  for (const std::size_t segments : columns) {
    std::snprintf(text, sizeof(text), " %6zu", segments);
    head += text;
  }
  context.say(head);
  const auto row = [&](const char* name, const char* what, const std::vector<PredictionFigures>& figures, int decimals,
                       const auto& value_of) {
    std::snprintf(text, sizeof(text), "%-20s %-9s", name, what);
    std::string line = text;
    for (const std::size_t segments : columns) {
      std::snprintf(text, sizeof(text), "      -");
      if (segments <= figures.size() && figures[segments - 1].n > 0) {
        const double value = value_of(figures[segments - 1]);
        if (std::isfinite(value)) std::snprintf(text, sizeof(text), " %6.*f", decimals, value);
      }
      line += text;
    }
    context.say(line);
  };
  using Figures = PredictionFigures;
  const auto rows = [&](const char* name, const std::vector<Figures>& figures) {
    row(name, "n", figures, 0, [](const Figures& f) { return static_cast<double>(f.n); });
    row("", "coverage", figures, 3, [](const Figures& f) { return f.coverage_1sigma; });
    row("", "nse", figures, 2, [](const Figures& f) { return f.nse; });
    row("", "  +-", figures, 2, [](const Figures& f) { return f.nse_se; });
  };
  rows("from start", result.by_step);
  rows("from random segment", result.by_step_from_random);
  rows("without knowledge", result.by_step_no_knowledge);
}

/// What became of the batches. @return the command's exit code.
int say_failures(const Context& context, const Prepared<ExperimentParams>& given, const PredictionEvaluation& result) {
  if (result.failed > 0)
    given.host->log(LogLevel::warning, std::to_string(result.failed) + " cases could not be predicted");
  if (result.shortened > 0)
    given.host->log(LogLevel::warning, std::to_string(result.shortened) +
                                           " cases are longer than the predictor's max_segments(): they count by step "
                                           "up to there, and not as settled shapes");
  for (const auto& [failure, cases] : result.failures)
    context.complain(std::to_string(cases) + " cases " + to_string(failure.status) + ": " + failure.message);
  return result.failures.empty() ? 0 : 1;
}

/// The settled shapes and the baselines, a row each.
void say_settled(const Context& context, const PredictionEvaluation& result) {
  char line[200];
  context.say("settled shape           n   mean mm  median mm     nll  coverage    nse  sigma mm");
  const auto row = [&](const char* name, const PredictionFigures& f) {
    std::snprintf(line, sizeof(line), "%-20s %4td  %8.2f  %9.2f  %6.2f  %8.3f  %5.2f  %8.2f", name, f.n, f.mean_mm,
                  f.median_mm, f.nll, f.coverage_1sigma, f.nse, f.sigma_mm);
    context.say(line);
  };
  row("from start", result.from_start);
  row("from random segment", result.from_random);
  row("without knowledge", result.no_knowledge);
  for (const auto& [name, f] : result.baselines) {
    std::snprintf(line, sizeof(line), "%-22s %2td  %8.2f  %9.2f", name.c_str(), f.n, f.mean_mm, f.median_mm);
    context.say(line);
  }
}

}  // namespace

int evaluate_predictor(Context& context, const PredictionCall& call, PredictionEvaluation* figures) {
  const WorkOptions& work = call.work;
  std::vector<std::string> folders = call.data;
  const auto out = result_folder(context, "evaluate-prediction-" + std::filesystem::path(call.config).stem().string());
  const ClusterWork on_cluster = single_work("evaluate prediction", "evaluate-prediction", out / "prediction.json");
  const Prepared<ExperimentParams> given(context, call.config, {planned_identity(out, on_cluster.label)}, out.string());
  const auto predictor = bound_predictor(place(given.config, "predictor"), given.task, *given.host);
  if (folders.empty() && !given.params.dataset.empty()) folders = {given.params.dataset.string()};
  if (folders.empty())
    throw ConfigError("weft evaluate prediction: --data FOLDER is required (or `dataset:` in the config)");
  const Dataset dataset = read_datasets(context, folders, given.task);
  warn_unless_held_out(*predictor, dataset, given.params.evaluation.split, *given.host);
  // The examples are there; how they were made is their own identity.
  const auto keep = [](const ParamInfo& info) { return info.name != "dataset" && !info.name.starts_with("data."); };
  const Identity identity = given.identity("evaluate prediction", keep, {}, {folders.begin(), folders.end()});
  require_unmixed(context, out, identity);
  if (work.cluster.is_given())
    return run_on_cluster(context, work.cluster, on_cluster,
                          [&] { write_planned_identity(out, on_cluster.label, identity); });
  const PlacedFolder placed(out);
  const FolderTurn turn(context, out, "prediction");

  const EvaluationWorkers workers{work.worker(), work.cell_limit_s, [&] { return given.host->cancelled(); }};
  PredictBatch predict;  // empty: in this process
  if (!work.in_process)
    predict = predict_in_child(workers, given.config, dataset, folders, *given.registry, *given.host);
  const PredictionEvaluation result =
      evaluate_prediction(*predictor, given.task, dataset, given.params.evaluation, given.seed, *given.host, predict);
  if (given.host->cancelled()) throw Interrupted("interrupted; run the same command again");
  const std::string json = prediction_evaluation_json(result), times = prediction_times_json(result);
  write_garment(given.task, out);
  write_text(out / "config.yaml", given.saved_config().to_yaml());
  write_text(out / "provenance.json", given.provenance(identity));
  write_text(out / "times.json", times_json(given.host->threads(), {{"prediction.json", times}}));
  write_text(out / "prediction.csv", prediction_evaluation_csv(result));
  write_text(out / "prediction.json", json);
  write_prediction_shapes(result, *given.task.garment, out / "cases.h5");
  if (context.json) context.output() << with_times(json, times);
  say_settled(context, result);
  say_calibration(context, result);
  const int code = say_failures(context, given, result);
  write_paper(context, out, call.paper);
  write_page(context, out);
  context.say("results in " + out.string());
  if (figures != nullptr) *figures = result;
  return code;
}

void register_evaluate_prediction(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("prediction", "Accuracy and calibration of a predictor on held-out examples");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto call = std::make_shared<PredictionCall>();
  command->add_option("config", call->config, "Experiment file, such as configs/experiments/tshirt.yaml")->required();
  command->add_option("--data", call->data, "Folders of examples");
  add_process_options(*command, "batch", call->work);
  add_paper_options(*command, call->paper);
  command->callback(
      [&context, call] { context.action = [&context, call] { return evaluate_predictor(context, *call); }; });
}

}  // namespace weft::app
