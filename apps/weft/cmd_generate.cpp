#include <cstdio>
#include <nlohmann/json.hpp>

#include "cluster/job_scripts.hpp"
#include "commands.hpp"
#include "experiments/cell_work.hpp"
#include "experiments/experiment_config.hpp"
#include "learning/dataset_files.hpp"
#include "learning/generate.hpp"
#include "learning_steps.hpp"
#include "options.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "report/times.hpp"
#include "sdk/located_config.hpp"
#include "sdk/machine_failure.hpp"
#include "simulation/task_config.hpp"
#include "work_options.hpp"

namespace weft::app {
namespace {

/// "i/n", i from 1 to n.
void parse_shard(const std::string& text, GenerateOptions& options) {
  long long index = 0, count = 0;
  int used = 0;
  if (std::sscanf(text.c_str(), "%lld/%lld%n", &index, &count, &used) != 2 ||
      static_cast<std::size_t>(used) != text.size() || count < 1 || index < 1 || index > count) {
    throw ConfigError("--shard = " + text + ", must be i/n with 1 <= i <= n, such as 2/4");
  }
  options.shard_index = index - 1;
  options.shard_count = count;
}

/// Whether a key decides the examples: the task, and how they are made.
bool decides_examples(const ParamInfo& info) { return info.decides == Decides::examples; }

/// What the first examples of a folder belong to.
std::vector<Identity> recorded_in(const std::filesystem::path& folder) {
  if (!std::filesystem::is_directory(folder)) return {};
  for (const auto& file : list_shards(folder)) {
    try {
      return {identity_in(read_shard_header(file).provenance, file.string())};
    } catch (const ReadError&) {
      throw;
    } catch (const ConfigError&) {  // damaged: it is made again
    }
  }
  return {};
}

constexpr const char* kLabel = "generate";

/// The files of a dataset as work for a cluster.
ClusterWork files_work(const GenerateOptions& options, const DataParams& data) {
  ClusterWork work;
  work.command = work.label = kLabel;
  work.results = options.folder;
  work.files = {"files", {"."}, "shard-", ".h5", "", {}};
  work.total = (options.examples + data.shard_examples - 1) / data.shard_examples;
  work.left = files_left(data, options.examples, options.folder);
  return work;
}

/// Says what was made, and writes its times. @return the exit code.
int say_made(const Context& context, const GenerateReport& report, const GenerateOptions& options, int threads,
             const std::string& identity) {
  const double rate = report.seconds > 0 ? static_cast<double>(report.made) / report.seconds : 0.0;
  const nlohmann::ordered_json times{{"made", report.made}, {"seconds", report.seconds}, {"examples_per_s", rate}};
  if (!options.is_share) write_text(options.folder / "times.json", times_json(threads, {{"dataset", times.dump()}}));
  if (context.json) {
    context.output() << nlohmann::ordered_json{{"made", report.made},       {"kept", report.kept},
                                               {"failed", report.failed()}, {"files", report.files},
                                               {"seconds", report.seconds}, {"examples_per_s", rate},
                                               {"identity", identity},      {"cancelled", report.cancelled}}
                            .dump(2)
                     << '\n';
  }
  char line[200];
  std::snprintf(line, sizeof(line),
                "%lld examples made in %.1f s (%.2f examples/s, %d threads), %lld kept, %lld failed",
                static_cast<long long>(report.made), report.seconds, rate, threads, static_cast<long long>(report.kept),
                static_cast<long long>(report.failed()));
  context.say(line);
  if (report.cancelled) context.say("stopped; run the same command again to make the rest");
  if (!report.acceptable()) warn_of_failures(report.failures, report.made + report.kept, "examples");
  if (report.cancelled) return 1;
  if (options.is_share) return report.left > 0 ? kOthersAtWork : 0;
  return report.acceptable() ? 0 : 1;
}

/// Prints what was made so far, and how long the rest takes.
GenerateProgress progress_lines(const Context& context) {
  return [&context](const GenerateReport& report, std::int64_t total) {
    const double rate = static_cast<double>(report.made) / std::max(1e-9, report.seconds);
    char line[160];
    std::snprintf(line, sizeof(line), "%6lld of %lld  %.2f examples/s  %.0f s to go  %lld failed",
                  static_cast<long long>(report.made), static_cast<long long>(total), rate,
                  static_cast<double>(total - report.made) / std::max(1e-9, rate),
                  static_cast<long long>(report.failed()));
    context.say(line);
  };
}

}  // namespace

int make_examples(Context& context, const GenerateCall& call, GenerateReport* made) {
  const WorkOptions& work = call.work;
  GenerateOptions options;
  options.examples = call.examples;
  if (!call.shard.empty()) parse_shard(call.shard, options);
  if (context.out.empty()) throw ConfigError("weft generate: --out FOLDER is required");
  options.folder = result_folder(context, "");
  auto recorded = recorded_in(options.folder);
  recorded.push_back(planned_identity(options.folder, kLabel));
  const Prepared<ExperimentParams> given(context, call.config, recorded, options.folder.string());
  check_simulator(given.task.simulator, given.task, *given.host);
  const auto params = describe_params<ExperimentParams>();
  const ConfigNode saved =
      self_contained(keep_params(given.resolved, params, decides_examples), params, given.task, *given.registry);
  const Identity identity = given.identity("generate", decides_examples);
  const DatasetHeader header = header_to_add(
      make_dataset_header(given.task, given.params.data, given.seed, saved, given.provenance(identity), identity),
      identity, options.folder, context.accept_changed);
  // Nothing was refused, so from here on the folder changes. The config of a folder with shards is that of the first.
  const auto begin = [&] {
    make_writable_folder(options.folder);
    const auto config = options.folder / "config.yaml";
    if (!list_shards(options.folder).empty() && std::filesystem::exists(config)) return;
    write_garment(given.task, options.folder);
    write_text(config, header.config);
  };
  if (work.cluster.is_given()) {
    if (!call.shard.empty()) throw ConfigError("--shard: the tasks of --on share all files; leave it out");
    return run_on_cluster(context, work.cluster, files_work(options, given.params.data), [&] {
      begin();
      write_planned_identity(options.folder, kLabel, identity);
    });
  }
  if (!work.share || !std::filesystem::exists(options.folder / "config.yaml")) begin();

  context.say("making " + std::to_string(call.examples) + " examples of " + given.task.garment->name + " (" +
              std::to_string(given.task.garment->vertex_count()) + " vertices), seed " + std::to_string(given.seed) +
              ", " + std::to_string(given.host->threads()) + " threads");
  options.worker = work.worker();
  options.request = example_requests(given.config, searched_folders(*given.registry));
  options.retry = work.retry();
  options.fail_fast = work.fail_fast;
  options.is_share = work.share;
  options.cell_limit_s = work.cell_limit_s;
  options.failed = [&](std::int64_t index, const WorkFailure& failure) {
    context.complain("example " + std::to_string(index) + " " + to_string(failure.status) + ": " + failure.message);
  };
  const GenerateReport report = generate_dataset(given.task, given.params.data, header, options, *given.host,
                                                 call.progress ? call.progress : progress_lines(context));
  if (made != nullptr) *made = report;
  return say_made(context, report, options, given.host->threads(), header.identity);
}

void register_generate(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("generate", "Simulate manipulation examples of random controls and materials");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto call = std::make_shared<GenerateCall>();
  command->add_option("config", call->config, "Experiment or task file, such as configs/experiments/tshirt.yaml")
      ->required();
  command->add_option("--examples", call->examples, "Number of examples; a larger one later adds to the folder")
      ->required()
      ->check(within(std::int64_t{1}, std::int64_t{1000000000}));
  command->add_option("--shard", call->shard, "i/n: make only the i-th of n parts, for many machines");
  add_work_options(*command, "example", call->work);
  command->callback([&context, call] { context.action = [&context, call] { return make_examples(context, *call); }; });
}

}  // namespace weft::app
