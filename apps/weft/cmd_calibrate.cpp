#include <unistd.h>

#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "cluster_run.hpp"
#include "commands.hpp"
#include "experiments/experiment_config.hpp"
#include "learning/held_out.hpp"
#include "learning_steps.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "weft/config.hpp"
#include "weft/trainable.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

/// Checks before the work that its result can be written. @param originals files that must not change.
void require_place(const fs::path& file, const std::vector<fs::path>& originals) {
  const auto refuse = [&](const std::string& reason) { throw ConfigError("--out = " + file.string() + ": " + reason); };
  std::error_code error;
  for (const auto& original : originals) {
    if (fs::equivalent(file, original, error)) refuse("is the model to calibrate; name another file");
  }
  if (fs::is_directory(file, error)) refuse("is a folder, must be a file");
  const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
  if (fs::exists(folder, error) && !fs::is_directory(folder)) refuse("its folder cannot be made: it is a file");
  if (fs::exists(folder, error) && ::access(folder.c_str(), W_OK) != 0) refuse("its folder cannot be written to");
}

/// The identity in a MODEL.calibration.json; unknown without one.
Identity calibration_identity(const fs::path& record) {
  const auto json = parse_json_if_valid(whole_text_if_there(record).value_or(""));
  return json.is_object() && json.contains("provenance") ? identity_in(json["provenance"].dump(), record.string())
                                                         : Identity();
}

std::string row_name(const CalibrationRow& row) {
  return std::string(row.from_start ? "from the start" : "within a session") + (row.is_known ? ", known" : ", unknown");
}

/// Factor and added length, for some of the numbers of segments.
void say_rows(const Context& context, const std::vector<CalibrationRow>& rows) {
  std::size_t longest = 0;
  for (const auto& row : rows) longest = std::max(longest, row.factor.size());
  std::vector<std::size_t> columns;
  for (const std::size_t segments : {1, 2, 3, 5, 8, 12, 16, 20, 25}) {
    if (segments <= longest) columns.push_back(segments);
  }
  char text[80];
  std::snprintf(text, sizeof(text), "%-26s %11s  %-10s", "material", "predictions", "segments");
  std::string head = text;
  for (const auto segments : columns) {
    std::snprintf(text, sizeof(text), " %5zu", segments);
    head += text;
  }
  context.say(head);
  for (const auto& row : rows) {
    const auto say = [&](std::string line, const char* what, const std::vector<double>& values, double unit) {
      std::snprintf(text, sizeof(text), "  %-10s", what);
      line += text;
      for (const auto segments : columns) {
        if (segments > values.size())
          std::snprintf(text, sizeof(text), " %5s", "-");
        else
          std::snprintf(text, sizeof(text), " %5.2f", values[segments - 1] / unit);
        line += text;
      }
      context.say(line);
    };
    std::snprintf(text, sizeof(text), "%-26s %11lld", row_name(row).c_str(), static_cast<long long>(row.predictions));
    say(text, "factor", row.factor, 1.0);
    say(std::string(38, ' '), "added mm", row.added_m, 1e-3);
  }
}

}  // namespace

int calibrate_model(Context& context, const CalibrateCall& call) {
  const std::vector<std::string>& folders = call.data;
  const fs::path out = model_file(context, "weft calibrate");
  if (folders.empty()) throw ConfigError("weft calibrate: --data FOLDER is required");
  const ClusterWork work = single_work("calibrate", "calibrate-" + out.stem().string(), out);
  const Prepared<ExperimentParams> given(context, call.config, {planned_identity(work.results, work.label)},
                                         work.results.string());
  const ConfigNode slot = place(given.config, "predictor");
  const auto predictor = bound_predictor(slot, given.task, *given.host);
  TrainablePredictor* learner = predictor->trainable();
  if (learner == nullptr)
    given.config.fail(
        "predictor does not learn, so it cannot be calibrated; name a trained one, such as {plugin: emd}");
  std::vector<fs::path> files;  // of the predictor; the first one is the model
  for (const ConfigNode& named : given.host->files(Predictor::kKind, slot)) files.push_back(named.as_path());
  require_place(out, files);
  const fs::path model = files.empty() ? fs::path() : files.front();

  const Identity identity = learning_identity(given, "calibrate", folders);
  const fs::path record = fs::path(out).replace_extension(".calibration.json");
  if (fs::exists(out)) require_identity(out.string(), calibration_identity(record), identity, context.accept_changed);
  if (call.cluster.is_given())
    return run_on_cluster(context, call.cluster, work,
                          [&] { write_planned_identity(work.results, work.label, identity); });
  const Dataset dataset = read_datasets(context, folders, given.task);
  const auto trained_on = learner->trained_on();
  if (trained_on.empty()) {
    given.host->log(
        LogLevel::warning,
        "the model file does not name its training data: only the validation split of each dataset is used");
  }
  const std::vector<std::size_t> examples = unseen_examples(dataset, trained_on);
  const auto origins = dataset.origins();
  std::vector<std::size_t> counts(origins.size(), 0), all(origins.size(), 0);
  for (const std::size_t i : examples) ++counts[dataset.source(i)];
  for (std::size_t i = 0; i < dataset.examples.size(); ++i) ++all[dataset.source(i)];
  for (std::size_t d = 0; d < counts.size(); ++d) {
    if (counts[d] == 0) {
      throw ConfigError(folders[d] +
                        ": outside its test split it holds only examples that the model was trained on; "
                        "leave it out, or make examples with another seed");
    }
    context.say("calibrating on " + std::to_string(counts[d]) + " of the " + std::to_string(all[d]) + " examples of " +
                folders[d]);
  }
  // Before the model, which belongs to it: a command that is killed between the two goes on.
  PlacedText placed(record,
                    ordered_json{{"provenance", ordered_json::parse(given.provenance(identity))}}.dump(2) + "\n");
  const CalibrationReport report =
      learner->calibrate(dataset, examples, given.task, {.seed = given.seed, .model = out});
  placed.keep();
  say_rows(context, report.rows);

  ordered_json json;
  json["model"] = model.string();
  json["calibrated"] = out.string();
  json["datasets"] = ordered_json::array();
  for (std::size_t d = 0; d < counts.size(); ++d) {
    json["datasets"].push_back({{"folder", folders[d]},
                                {"identity", origins[d].identity},
                                {"seed", origins[d].seed},
                                {"examples", counts[d]}});
  }
  json["examples"] = report.examples;
  json["rows"] = ordered_json::array();
  for (const auto& row : report.rows) {
    json["rows"].push_back({{"begins", row.from_start ? "start" : "within"},
                            {"material", row.is_known ? "known" : "unknown"},
                            {"predictions", row.predictions},
                            {"shapes", row.shapes},
                            {"factor", row.factor},
                            {"added_m", row.added_m}});
  }
  if (!report.json.empty()) json["details"] = ordered_json::parse(report.json);
  json["provenance"] = ordered_json::parse(given.provenance(identity));
  const std::string text = json.dump(2) + "\n";
  write_text(record, text);
  if (context.json) context.output() << text;
  context.say("calibrated on " + std::to_string(report.examples) + " examples: " + out.string());
  return 0;
}

void register_calibrate(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("calibrate", "Refit a trained predictor's sigma to other examples");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto call = std::make_shared<CalibrateCall>();
  command->add_option("config", call->config, "Experiment file whose predictor.params.model names the model")
      ->required();
  command->add_option("--data", call->data, "Folders of examples; sigma is calibrated for the first one's");
  add_cluster_options(*command, call->cluster);
  command->callback(
      [&context, call] { context.action = [&context, call] { return calibrate_model(context, *call); }; });
}

}  // namespace weft::app
