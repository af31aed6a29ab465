#include <algorithm>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "commit.hpp"
#include "experiments/benchmark/run.hpp"
#include "experiments/cell_work.hpp"
#include "experiments/json_numbers.hpp"
#include "identity/sha256.hpp"
#include "loader/processors.hpp"
#include "options.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "progress_line.hpp"
#include "report/measurement.hpp"
#include "sdk/json_text.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

struct BenchmarkCall {
  std::vector<std::string> parts;
  std::string config;
  std::vector<std::string> simulators = {"cloth", "bullet"};
  int repeats = 0;
  double limit_s = 0.0;  ///< 0: the default
  bool quick = false, again = false;
};

/// With --quick: the tests' task, and plans that hardly search.
constexpr const char* kQuickOverrides[] = {
    "predictor.params.untrained=true",
    "planning={instances: 2, iterations: 2, replan_iterations: 1}",
    "estimation={instances: 2, iterations: 2, later_iterations: 1}",
    "goal.random.min_distance_mm=5",
    "max_segments=12",
};

constexpr std::pair<const char*, const char*> kTitles[] = {
    {"frames", "Frames of a simulation"},
    {"folds", "Examples"},
    {"training", "Training"},
    {"planning", "Planning"},
};

/// The command that measures a part, without what does not change a number.
std::string command_of(const std::string& part, const BenchmarkCall& call, const Context& context) {
  std::string text = "weft benchmark " + part;
  if (call.quick) text += " --quick";
  if (!call.config.empty()) text += " --config " + call.config;
  if (call.repeats > 0) text += " --repeats " + std::to_string(call.repeats);
  if (part == "frames" && call.simulators != BenchmarkCall().simulators) {
    text += " --simulator";
    for (const auto& name : call.simulators) text += " " + name;
  }
  for (const auto& assignment : context.overrides) text += " --set '" + assignment + "'";
  return text;
}

/// {file, sha256} of the files that the predictor's slot names and that are there.
ordered_json models_of(const Prepared<ExperimentParams>& given) {
  auto models = ordered_json::array();
  for (const auto& node : given.registry->files("predictor", given.config.at("predictor")))
    if (const fs::path file = node.as_path(); fs::exists(file))
      models.push_back({{"file", file.filename().string()}, {"sha256", sha256_of_file(file)}});
  return models;
}

/// speed.json as it is on the disk, in the form that measurement_page() takes, with `rows` besides.
class SpeedFile {
 public:
  /// Reads what an earlier run left. @throws ConfigError for a damaged file.
  explicit SpeedFile(fs::path folder) : file_(std::move(folder) / "speed.json") {
    const std::string text = text_of_file(file_);
    if (text.empty()) return;
    try {
      const ordered_json json = parse_json(text);
      rows = benchmark::measured_of(json.at("rows"));
      for (const auto& step : json.at("steps")) commands_[step.at("name")] = step.at("commands").at(0);
    } catch (const nlohmann::json::exception& error) {
      throw ConfigError(file_.string() + ": is damaged: " + error.what());
    }
  }
  void set_command(const std::string& part, const std::string& command) { commands_[part] = command; }

  /// @param head the keys that do not depend on the rows.
  void write(ordered_json json) const {
    json["steps"] = json["tables"] = ordered_json::array();
    for (const auto& [part, title] : kTitles) {
      const auto tables = benchmark::tables_of(part, rows);
      if (tables.empty()) continue;
      json["steps"].push_back(
          {{"name", part}, {"title", title}, {"commands", {commands_.at(part)}}, {"seeds", nullptr}, {"failed", 0}});
      json["tables"].insert(json["tables"].end(), tables.begin(), tables.end());
    }
    json["figures"] = ordered_json::array();
    json["rows"] = benchmark::to_json(rows);
    write_text(file_, text_of_json(json));
    write_text(fs::path(file_).replace_extension(".md"), measurement_page(json));
  }

  std::vector<benchmark::Measured> rows;

 private:
  fs::path file_;
  std::map<std::string, std::string> commands_;
};

/// Forgets the rows of other things than these, or refuses the folder. @param parts whose rows are measured again with --again.
void keep_or_forget(const BenchmarkCall& call, const std::vector<std::string>& parts, const fs::path& out,
                    const Identity& identity, SpeedFile& speed) {
  const auto changes = fs::exists(out / "provenance.json")
                           ? identity.changes_since(read_identity(out / "provenance.json"))
                           : std::vector<std::string>();
  if (!changes.empty() && !call.again) {
    std::string text = out.string() + ": holds measurements of something else:";
    for (const auto& change : changes) text += "\n  " + change;
    throw ConfigError(text + "\nNothing was changed. Give another --out, or --again to measure all of it again");
  }
  if (!changes.empty()) {
    speed.rows.clear();
    fs::remove_all(out / "examples");
  } else if (call.again) {
    std::erase_if(speed.rows, [&](const benchmark::Measured& one) {
      return std::find(parts.begin(), parts.end(), one.row.at("part").get<std::string>()) != parts.end();
    });
  }
}

/// The rows of the plan, with what is known of them. They are taken out of `known`.
/// @param has_limit another limit is given: it may be a larger one.
std::vector<benchmark::Measured> taken_rows(const benchmark::Plan& plan, bool has_limit,
                                            std::vector<benchmark::Measured>& known) {
  std::vector<benchmark::Measured> taken;
  for (const auto& row : benchmark::rows_of(plan)) {
    const auto earlier = std::find_if(known.begin(), known.end(), [&](const auto& one) { return one.row == row; });
    taken.push_back(earlier == known.end() ? benchmark::Measured{row} : *earlier);
    if (earlier != known.end()) known.erase(earlier);
    std::string& left_out = taken.back().left_out;  // a crash may have been an accident
    if (left_out.starts_with(benchmark::kCrashed) || (has_limit && left_out.starts_with(benchmark::kTooLong)))
      left_out.clear();
  }
  return taken;
}

std::string measured_text(const benchmark::Measured& one) {
  if (!one.left_out.empty()) return "left out: " + one.left_out;
  const auto& last = one.samples.back();
  char text[80];
  std::snprintf(text, sizeof(text), "%.3g ms CPU, %.3g ms, %.0f MB", last.at("cpu_ms").get<double>(),
                last.at("wall_ms").get<double>(), last.at("peak_mb").get<double>());
  return text;
}

int run_benchmark(Context& context, BenchmarkCall call) {
  if (call.parts.empty()) call.parts = benchmark::part_names();
  require_distinct("PART", call.parts);
  require_distinct("--simulator", call.simulators);
  const fs::path out = result_folder(context, "benchmark");
  const fs::path configs = tree_of_weft() / "share/weft/configs";
  const fs::path file = !call.config.empty()
                            ? fs::path(call.config)
                            : configs / "experiments" / (call.quick ? "towel_small.yaml" : "tshirt.yaml");
  const auto given_overrides = context.overrides;
  if (call.quick)
    context.overrides.insert(context.overrides.begin(), std::begin(kQuickOverrides), std::end(kQuickOverrides));
  const Prepared<ExperimentParams> given(context, file.string());
  context.overrides = given_overrides;

  benchmark::Plan plan;
  plan.parts = call.parts;
  plan.simulators = call.simulators;
  plan.kernels = benchmark::variants_of(*given.registry, given.config.at("predictor"));
  plan.processors = given.host->threads();
  plan.is_quick = call.quick;
  const std::string machine = processor_name();
  std::vector<fs::path> fabrics;
  for (const auto& name : benchmark::fabric_names()) fabrics.push_back(configs / "fabrics" / (name + ".yaml"));
  const Identity identity = given.identity(
      "benchmark", [](const ParamInfo&) { return true; },
      {{"commit", commit()}, {"machine", machine}, {"size", call.quick ? "quick" : "full"}}, fabrics);
  SpeedFile speed(out);
  keep_or_forget(call, call.parts, out, identity, speed);

  const PlacedFolder placed(out);
  write_text(out / "provenance.json", given.provenance(identity));
  // The rows that are asked for come first, those of other parts stay as they are.
  std::vector<benchmark::Measured> asked = taken_rows(plan, call.limit_s > 0.0, speed.rows);
  const std::vector<benchmark::Measured> others = speed.rows;
  for (const auto& part : call.parts) speed.set_command(part, command_of(part, call, context));
  const ordered_json head{{"schema", kMeasurementSchema},
                          {"name", "speed"},
                          {"title", "Measured: speed"},
                          {"about", "What each row is and what bounds it: [speed](../speed.md)."},
                          {"size", call.quick ? "quick" : "full"},
                          {"command", call.quick ? "weft benchmark --quick" : "weft benchmark"},
                          {"commit", commit()},
                          {"models", models_of(given)},
                          {"machine", {{"processor", machine}, {"cores", allowed_processors()}}},
                          {"date", today()}};
  const auto write = [&] {
    speed.rows = asked;
    speed.rows.insert(speed.rows.end(), others.begin(), others.end());
    speed.write(head);
  };

  ProgressLine progress(context);
  benchmark::RunOptions options;
  options.repeats = call.repeats > 0 ? call.repeats : call.quick ? 1 : 5;
  if (call.limit_s > 0.0) options.limit_s = call.limit_s;
  options.worker = this_program({"worker"});
  options.cancelled = [&] { return given.host->cancelled(); };
  options.done = [&](const benchmark::Measured& one, std::size_t done, std::size_t total) {
    progress.show(std::to_string(done) + "/" + std::to_string(total) + "  " + benchmark::name_of(one.row) + ": " +
                  measured_text(one));
    write();
  };
  const benchmark::Setup setup{given.config, configs / "fabrics", out, searched_folders(*given.registry), call.quick};
  const auto crashes = benchmark::measure_all(asked, setup, options);
  progress.end();
  write();
  for (const auto& crash : crashes) context.complain("warning: " + crash);
  if (given.host->cancelled()) {
    context.say("stopped; the same command measures the rest");
    return 1;
  }
  if (context.json) context.output() << text_of_file(out / "speed.json");
  context.say("results in " + out.string() + ": speed.json, speed.md");
  return crashes.empty() ? 0 : 1;
}

}  // namespace

void register_benchmark(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand(
      "benchmark", "Measure how fast this machine simulates, makes examples, trains and plans: speed.json, speed.md");
  add_common_options(*command, context);
  auto call = std::make_shared<BenchmarkCall>();
  command->add_option("part", call->parts, "frames, folds, training, planning; default: all")
      ->check(CLI::IsMember(benchmark::part_names()));
  command->add_option("--config", call->config,
                      "Experiment file of folds, training and planning; default: the T-shirt's");
  command->add_option("--simulator", call->simulators, "Simulators whose frames are measured; default: cloth bullet");
  command->add_option("--repeats", call->repeats, "Measurements of every row; default: 5, with --quick 1")
      ->check(within(1, 1000));
  command
      ->add_option("--limit", call->limit_s,
                   "CPU time in s that one measurement may take; default: 600; rows that take more are left out")
      ->check(within(0.1, 1e6));
  command->add_flag("--quick", call->quick, "The smallest sizes: whether all of it works, in some 20 s");
  command->add_flag("--again", call->again, "Measure the parts again that --out holds");
  command->callback([&context, call] { context.action = [&context, call] { return run_benchmark(context, *call); }; });
}

}  // namespace weft::app
