#include <algorithm>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "cluster_run.hpp"
#include "commands.hpp"
#include "experiments/experiment_config.hpp"
#include "learning_steps.hpp"
#include "options.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "progress_line.hpp"
#include "ranks.hpp"
#include "report/times.hpp"
#include "weft/trainable.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

/// The arguments with which each of several ranks on this machine does what this process was asked to do.
std::vector<std::string> arguments_of_rank(const Context& context, const TrainCall& call,
                                           const std::vector<std::string>& folders, int threads) {
  std::vector<std::string> arguments{"train", call.config, "--out", context.out, "--jobs", std::to_string(threads)};
  if (call.in_memory) arguments.emplace_back("--in-memory");
  for (const auto& folder : folders) arguments.insert(arguments.end(), {"--data", folder});
  for (const auto& assignment : context.overrides) arguments.insert(arguments.end(), {"--set", assignment});
  if (context.seed) arguments.insert(arguments.end(), {"--seed", std::to_string(*context.seed)});
  if (context.accept_changed) arguments.emplace_back("--accept-changed");
  if (context.json) arguments.emplace_back("--json");
  return arguments;
}

/// The place of this process among the ranks of a fit. @throws ConfigError if --ranks asks for another number.
FitRanks ranks_of_call(const fs::path& model, int wanted) {
  const FitRanks ranks = ranks_of_process(model);
  if (wanted > 1 && ranks.size > 1 && wanted != ranks.size) {
    throw ConfigError("--ranks " + std::to_string(wanted) + ", but this is one of " + std::to_string(ranks.size) +
                      " processes that were started as ranks");
  }
  return ranks;
}

/// @throws ConfigError if the predictor cannot be trained over so many ranks.
void require_ranks(const TrainingCapabilities& can, std::int64_t ranks, const ConfigNode& config) {
  if (ranks > 1 && !can.ranks)
    config.fail("predictor cannot be trained over ranks; start one process, or name {plugin: emd}");
  if (can.parts > 0 && can.parts % ranks != 0)
    config.fail("predictor divides a batch into " + std::to_string(can.parts) + " parts, which " +
                std::to_string(ranks) + " ranks cannot share equally; set training.parts, or votes, to a multiple");
}

/// Writes what a fit leaves beside its model. @return its times.
ordered_json write_fit_report(const Prepared<ExperimentParams>& given, const FitReport& report, const fs::path& out) {
  // The resolved config beside the results, with every default of the trained predictor.
  const ordered_json seconds{
      {"seconds", report.seconds},
      {"iterations_per_s", static_cast<double>(report.iterations) / std::max(1e-9, report.seconds)}};
  write_text(out / "training.json", report.json);
  write_text(out / "times.json", times_json(given.host->threads(), {{"training.json", seconds.dump()}}));
  write_text(out / "config.yaml",
             given.registry->resolve_slots(given.resolved, describe_params<ExperimentParams>()).to_yaml());
  return seconds;
}

/// The record beside a model whose fit came to its end: the same command does not fit it again.
std::string finished_record(const std::string& provenance) {
  ordered_json record = ordered_json::parse(provenance);
  record["finished"] = true;
  return record.dump(2) + "\n";
}
bool is_finished(const fs::path& record) {
  const auto parsed = ordered_json::parse(text_of_file(record), nullptr, false);
  return parsed.is_object() && parsed.contains("finished") && parsed["finished"] == true;
}

/// Nothing is left to do. @return the exit code.
int say_fitted(const Context& context, const fs::path& model) {
  context.say(model.string() + " is fitted already; remove it to fit it again");
  if (context.json) context.output() << text_of_file(model.parent_path() / "training.json");
  return 0;
}

/// Prints how far the fit is.
FitObserver fit_lines(const Context& context) {
  return [&context](const FitProgress& p) {
    char line[240];
    std::snprintf(line, sizeof(line),
                  "%7lld of %lld  train %8.4f  validation %8.4f (best %8.4f)  %5.1f mm  rate %.1e  %s to go",
                  static_cast<long long>(p.iteration), static_cast<long long>(p.iterations), p.training_loss,
                  p.validation_loss, p.best_loss, p.validation_error_mm, p.rate, duration_text(p.seconds_left).c_str());
    context.say(line);
    return true;
  };
}

}  // namespace

int train_model(Context& context, const TrainCall& call) {
  const int wanted_ranks = call.ranks;
  std::vector<std::string> folders = call.data;
  const fs::path model = model_file(context, "weft train");
  const FitRanks ranks = ranks_of_call(model, wanted_ranks);
  if (ranks.rank > 0) context.quiet = true;  // rank 0 speaks for all
  const fs::path record = fs::path(model).replace_extension(".provenance.json");
  const fs::path checkpoint = fs::path(model).replace_extension(".checkpoint.h5");
  const bool is_used = fs::exists(model) || fs::exists(checkpoint);
  const Identity earlier = is_used ? read_identity(record) : Identity();
  ClusterWork work = single_work("train", "train-" + model.stem().string(), model);
  work.has_ranks = true;
  const Prepared<ExperimentParams> given(context, call.config, {earlier, planned_identity(work.results, work.label)},
                                         record.string());
  if (given.params.predictor.is_null())
    given.config.fail("predictor is missing; name one that learns, such as {plugin: emd}");
  const auto predictor = given.host->create<Predictor>(given.params.predictor);
  TrainablePredictor* learner = predictor->trainable();
  if (learner == nullptr)
    given.config.fail("predictor does not learn from examples; name one that does, such as {plugin: emd}");
  if (folders.empty() && !given.params.dataset.empty()) folders = {given.params.dataset.string()};
  if (folders.empty()) throw ConfigError("weft train: --data FOLDER is required (or `dataset:` in the config)");

  const TrainingCapabilities can = learner->training_capabilities();
  const std::int64_t planned_ranks =
      call.cluster.is_given() ? ranks_of_profile(call.cluster, work) : std::max<std::int64_t>(wanted_ranks, ranks.size);
  require_ranks(can, planned_ranks, given.config);
  if (wanted_ranks > 1 && ranks.size == 1 && !call.cluster.is_given()) {
    return run_ranks(context,
                     arguments_of_rank(context, call, folders, std::max(1, given.host->threads() / wanted_ranks)),
                     wanted_ranks, [&] { return given.host->cancelled(); });
  }

  const Identity identity = learning_identity(given, "train", folders);
  FitOptions options;
  options.seed = given.seed;
  options.model = model;
  options.checkpoint = checkpoint;
  options.provenance = given.provenance(identity);
  options.accept_changed = context.accept_changed;
  options.ranks = ranks;
  if (is_used) require_identity(model.string(), earlier, identity, context.accept_changed);
  if (fs::exists(model) && !fs::exists(checkpoint) && identity.changes_since(earlier).empty() && is_finished(record))
    return say_fitted(context, model);
  if (call.cluster.is_given())
    return run_on_cluster(context, call.cluster, work,
                          [&] { write_planned_identity(work.results, work.label, identity); });
  const Dataset dataset = read_datasets(context, folders, given.task,
                                        can.stored_shapes && !call.in_memory ? ShapesIn::files : ShapesIn::memory);
  if (ranks.rank > 0) return learner->fit(dataset, given.task, options, {}).finished ? 0 : 1;
  const fs::path out = model.has_parent_path() ? model.parent_path() : fs::path(".");
  make_writable_folder(out);
  char line[240];
  const std::string shared = ranks.size > 1 ? std::to_string(ranks.size) + " ranks, " : "";
  std::snprintf(line, sizeof(line), "training on %zu examples of %s, %zu for validation, %s%d threads%s",
                dataset.select(Split::train).size(), dataset.header.garment_name.c_str(),
                dataset.select(Split::validation).size(), shared.c_str(), given.host->threads(),
                fs::exists(options.checkpoint) ? ", from the checkpoint" : "");
  context.say(line);
  PlacedText placed(record, options.provenance);  // before the first checkpoint, which belongs to it
  FitReport report;
  try {
    report = learner->fit(dataset, given.task, options, call.progress ? call.progress : fit_lines(context));
    placed.keep();
  } catch (...) {
    if (!is_used && (fs::exists(model) || fs::exists(checkpoint))) placed.keep();  // a fit that began, and failed
    throw;
  }
  const ordered_json seconds = write_fit_report(given, report, out);
  if (report.finished) write_text(record, finished_record(options.provenance));
  if (context.json) context.output() << with_times(report.json, seconds.dump());
  std::snprintf(line, sizeof(line), "%s after %lld iterations and %s: %s",
                report.finished ? "done" : "stopped; run the same command again to continue",
                static_cast<long long>(report.iterations), duration_text(report.seconds).c_str(), model.c_str());
  context.say(line);
  return report.finished ? 0 : 1;
}

void register_train(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("train", "Fit a predictor to the examples of `weft generate`");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto call = std::make_shared<TrainCall>();
  command->add_option("config", call->config, "Experiment file, such as configs/experiments/tshirt.yaml")->required();
  command->add_option("--data", call->data, "Folders of examples");
  add_cluster_options(*command, call->cluster);
  command
      ->add_option("--ranks", call->ranks,
                   "Processes on this machine that share each batch; under mpirun or srun their number is known")
      ->check(within(1, 256));
  command->add_flag(
      "--in-memory", call->in_memory,
      "Read all shapes at once, such as from a slow file server. By default each is read when it is used, so a "
      "dataset may be larger than the memory. The model is the same");
  command->callback([&context, call] { context.action = [&context, call] { return train_model(context, *call); }; });
}

}  // namespace weft::app
