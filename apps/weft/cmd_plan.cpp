#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "identity/sha256.hpp"
#include "options.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "report/times.hpp"
#include "session/replay.hpp"
#include "simulation/task_config.hpp"

// `weft plan` and `weft estimate`: one half of a session alone.

namespace weft::app {
namespace {

using nlohmann::ordered_json;

struct Options {
  std::string config, session;
  int segment = 1;
};

ordered_json to_json(const Controls& rows) {
  auto list = ordered_json::array();
  for (Index r = 0; r < rows.rows(); ++r) {
    const Vector row = rows.row(r).transpose();
    list.push_back(std::vector<double>(row.data(), row.data() + row.size()));
  }
  return list;
}
std::vector<double> to_list(const PropertyVector& v) { return {v.data(), v.data() + v.size()}; }

ordered_json to_json(const LonePlan& lone) {
  const Plan& plan = lone.plan;
  return {{"segments", plan.controls.rows()},
          {"releases", plan.releases},
          {"predicted_error_mm", plan.predicted_error_mm},
          {"loss", plan.loss},
          {"losses", plan.losses},
          {"instance", plan.instance},
          {"ended", to_json(plan.ended)},
          {"iterations", plan.iterations},
          {"evaluations", plan.evaluations},
          {"correction", lone.correction ? to_json(*lone.correction, 0) : ordered_json()},
          {"knowledge", {{"centre", to_list(lone.knowledge.centre)}, {"width", to_list(lone.knowledge.width)}}},
          {"controls", to_json(plan.controls)}};
}
ordered_json to_json(const LoneEstimates& lone) {
  auto list = ordered_json::array();
  for (std::size_t j = 0; j < lone.estimates.size(); ++j) {
    const Estimate& one = lone.estimates[j];
    list.push_back({{"segment", j + 1},
                    {"centre", to_list(one.knowledge.centre)},
                    {"width", to_list(one.knowledge.width)},
                    {"loss", one.loss},
                    {"nll", one.nll},
                    {"misfit", one.misfit},
                    {"ended", to_json(one.ended)}});
  }
  return {{"true_material", lone.true_material ? ordered_json(to_list(*lone.true_material)) : ordered_json()},
          {"estimates", list}};
}

ordered_json times_of(const LonePlan& lone) {
  return {{"plan_seconds", lone.plan.seconds},
          {"plan_and_correction_seconds", lone.correction ? ordered_json(lone.correction->seconds) : ordered_json()}};
}
ordered_json times_of(const LoneEstimates& lone) {
  auto list = ordered_json::array();
  for (const Estimate& one : lone.estimates) list.push_back({{"estimate_seconds", one.seconds}});
  return {{"estimates", list}};
}

/// Reads the config and the recorded session, lets `compute` work, saves what it returns as NAME.json and times.json.
template <class Compute>
int run_alone(Context& context, const Options& options, const std::string& name, const Compute& compute) {
  const Prepared<SessionParams> given(context, options.config);
  std::optional<SessionRecord> recorded;
  std::vector<std::pair<std::string, std::string>> besides;
  if (!options.session.empty()) {
    recorded = read_session(session_file(options.session));
    besides = {{"session", "sha256 " + sha256_of_file(session_file(options.session))},
               {"segment", std::to_string(options.segment)}};
  } else {
    check_simulator(given.task.simulator, given.task, *given.host);
    check_world(given.params.world, given.task, given.config, *given.host);  // which makes the fresh session
  }
  const auto stem = std::filesystem::path(options.config).stem().string();
  const auto folder = result_folder(context, name + "-" + stem + "-seed" + std::to_string(given.seed));
  const Identity identity = given.identity(
      name, [](const ParamInfo&) { return true; }, besides);
  require_command(context, folder, name);
  const PlacedFolder placed(folder);
  const auto result = compute(given, recorded ? &*recorded : nullptr);
  if (*context.cancel_flag()) throw Error("interrupted: a search that was cut short is not kept; nothing was written");
  const std::string json = to_json(result).dump(2) + "\n", times = times_of(result).dump();
  write_text(folder / (name + ".json"), json);  // first, so that it is kept if the disk gets full
  write_garment(given.task, folder);
  write_text(folder / "config.yaml", given.saved_config().to_yaml());
  write_text(folder / "provenance.json", given.provenance(identity));
  write_text(folder / "times.json", times_json(given.host->threads(), {{name + ".json", times}}));
  if (context.json) context.output() << with_times(json, times);
  context.say("results in " + folder.string());
  return 0;
}

int plan(Context& context, const Options& options) {
  return run_alone(context, options, "plan", [&](const Prepared<SessionParams>& given, const SessionRecord* recorded) {
    const LonePlan lone = plan_alone(given.params, given.config, recorded, options.segment, *given.host);
    char line[200], corrected[80] = "";
    if (lone.correction && std::isfinite(lone.correction->forecast_mm))
      std::snprintf(corrected, sizeof(corrected), ", corrected from %.1f mm, %zu simulated",
                    lone.correction->forecast_mm, lone.correction->steps.size());
    std::snprintf(line, sizeof(line), "plan of %td segments%s, predicted error %.1f mm%s, %.2f s",
                  lone.plan.controls.rows(), lone.plan.releases ? "" : " (no release yet)",
                  lone.plan.predicted_error_mm, corrected,
                  lone.correction ? lone.correction->seconds : lone.plan.seconds);
    context.say(line);
    return lone;
  });
}

int estimate(Context& context, const Options& options) {
  return run_alone(
      context, options, "estimate", [&](const Prepared<SessionParams>& given, const SessionRecord* recorded) {
        const LoneEstimates lone = estimate_alone(given.params, given.config, recorded, *given.host);
        char line[200];
        context.say("centre (width) of  friction       bend           stretch        thickness");
        const auto row = [&](const std::string& label, const MaterialKnowledge& k) {
          std::snprintf(line, sizeof(line), "%-18s %.2f (%.2f)    %.2f (%.2f)    %.2f (%.2f)    %.2f (%.2f)",
                        label.c_str(), k.centre(0), k.width(0), k.centre(1), k.width(1), k.centre(2), k.width(2),
                        k.centre(3), k.width(3));
          context.say(line);
        };
        for (std::size_t j = 0; j < lone.estimates.size(); ++j)
          row("segment " + std::to_string(j + 1), lone.estimates[j].knowledge);
        if (lone.true_material) row("truth", MaterialKnowledge::certain(*lone.true_material));
        return lone;
      });
}

using Command = int (*)(Context&, const Options&);

CLI::App* add_command(CLI::App& app, Context& context, const char* name, const char* description, Command run,
                      const std::shared_ptr<Options>& options) {
  CLI::App* command = app.add_subcommand(name, description);
  add_common_options(*command, context);
  add_accept_option(*command, context);
  command->add_option("config", options->config, "Task file, such as configs/tasks/tshirt_fold.yaml")->required();
  command->callback(
      [&context, options, run] { context.action = [&context, options, run] { return run(context, *options); }; });
  return command;
}

}  // namespace

void register_plan(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  CLI::App* command =
      add_command(app, context, "plan", "Plan alone: the first plan of a session, or one of a recorded session again",
                  plan, options);
  CLI::Option* session = command->add_option("--session", options->session,
                                             "session.h5, or the folder of a run: plan again from its observations");
  command->add_option("--segment", options->segment, "Plan before this segment; 1: at the start")
      ->check(within(1, std::numeric_limits<int>::max()))
      ->needs(session);
}

void register_estimate(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  CLI::App* command =
      add_command(app, context, "estimate",
                  "Estimate the material alone: after every segment of a recorded session, or of the default fold",
                  estimate, options);
  command->add_option("--session", options->session, "session.h5, or the folder of a run, whose observations are used");
}

}  // namespace weft::app
