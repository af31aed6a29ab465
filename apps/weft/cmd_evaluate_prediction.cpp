#include <cstdio>
#include <iostream>

#include "context.hpp"
#include "output.hpp"
#include "page.hpp"
#include "prepared.hpp"
#include "weft/prediction_evaluation.hpp"
#include "weft/refusal.hpp"

namespace weft::app {
namespace {

int evaluate(Context& context, const std::string& file, const std::string& data) {
  const Prepared<ExperimentParams> given(context, file);
  const auto predictor = bound_predictor(place(given.config, "predictor"), given.task, *given.host);
  const std::filesystem::path folder = data.empty() ? given.params.dataset : std::filesystem::path(data);
  if (folder.empty())
    throw ConfigError("weft evaluate prediction: --data FOLDER is required (or `dataset:` in the config)");
  context.say("reading " + folder.string());
  const Dataset dataset = Dataset::load(folder);
  dataset.require_task(given.task);
  warn_unless_held_out(*predictor, dataset, given.params.evaluation.split, *given.host);
  const auto out = output_folder(context, "evaluate-prediction-" + std::filesystem::path(file).stem().string());
  ConfigNode saved = given.saved_config(out);

  const PredictionEvaluation result =
      evaluate_prediction(*predictor, given.task, dataset, given.params.evaluation, given.seed, *given.host);
  const std::string json = prediction_evaluation_json(result);
  write_text(out / "config.yaml", saved.to_yaml());
  write_text(out / "provenance.json", given.provenance());
  write_text(out / "prediction.csv", prediction_evaluation_csv(result));
  write_text(out / "prediction.json", json);
  write_prediction_shapes(result, *given.task.garment, out / "cases.h5");
  if (context.json) std::cout << json;
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
  if (result.failed > 0)
    given.host->log(LogLevel::warning, std::to_string(result.failed) + " cases could not be predicted");
  if (result.shortened > 0)
    given.host->log(LogLevel::warning, std::to_string(result.shortened) +
                                           " cases are longer than the predictor's max_segments(): they count by step "
                                           "up to there, and not as settled shapes");
  write_page(context, out);
  context.say("results in " + out.string());
  return 0;
}

}  // namespace

void register_evaluate_prediction(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("prediction", "Accuracy and calibration of a predictor on held-out examples");
  add_common_options(*command, context);
  auto file = std::make_shared<std::string>();
  auto data = std::make_shared<std::string>();
  command->add_option("config", *file, "Experiment file, such as configs/experiments/tshirt.yaml")->required();
  command->add_option("--data", *data, "Folder of examples");
  command->callback(
      [&context, file, data] { context.action = [&context, file, data] { return evaluate(context, *file, *data); }; });
}

}  // namespace weft::app
