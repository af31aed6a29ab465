#include <algorithm>
#include <cmath>
#include <cstdio>

#include "commands.hpp"
#include "output.hpp"
#include "prepared.hpp"
#include "report/times.hpp"
#include "sdk/files.hpp"
#include "session/sequence.hpp"
#include "session/session_file.hpp"

namespace weft::app {
namespace {

std::string success_text(double error_mm) {
  for (const int limit : kSuccessLimitsMm)
    if (succeeds(error_mm, limit)) return "success within " + std::to_string(limit) + " mm";
  return "no success within " + std::to_string(kSuccessLimitsMm.back()) + " mm";
}

/// The lines that end a run. @param lag correction.lag.
void say_result(const Context& context, const SessionResult& result, Index lag) {
  char line[200];
  const char* const seen = result.shapes_are_true ? "" : "observed ";
  if (result.goal.rows() > 0) {
    std::snprintf(line, sizeof(line), "%serror %.1f mm after %zu segments (default control: %.1f mm), IoU %.3f, %s",
                  seen, result.error_mm, result.rounds.size(), result.default_error_mm, result.errors.iou,
                  success_text(result.error_mm).c_str());
    context.say(line);
  }
  if (result.surface) {
    char iou[40] = "";
    if (std::isfinite(result.errors.iou)) std::snprintf(iou, sizeof(iou), ", IoU %.3f", result.errors.iou);
    std::snprintf(line, sizeof(line), "%schamfer distance %.1f mm after %zu segments (default control: %.1f mm)%s",
                  seen, result.chamfer_mm, result.rounds.size(), result.default_chamfer_mm, iou);
    context.say(line);
  }
  if (result.trials.size() > 1) {
    std::string errors;
    for (const auto& trial : result.trials) {
      std::snprintf(line, sizeof(line), "%s%.1f", errors.empty() ? "" : ", ",
                    result.goal.rows() > 0 ? trial.error_mm : trial.chamfer_mm);
      errors += line;
    }
    context.say("trial by trial: " + errors + " mm");
  }
  if (!result.rounds.empty()) {
    const PlanTimes plans = plan_times(result, lag);
    double estimate = 0.0;
    for (const auto& one : result.estimates) estimate = std::max(estimate, one.seconds);
    std::snprintf(
        line, sizeof(line),
        "first plan %.2f s (of %.0f), 95 %% of later plans %.2f s (of %.1f), slowest estimate %.2f s; %td of %td "
        "plans late",
        plans.first, PlanTimes::kFirst, plans.later, plans.limit, estimate, plans.late, plans.plans);
    context.say(line);
  }
}

/// The config that repeats a run: with the counts that a clock decided, and the folder in which a command ran.
/// @param prefix of the fold's own keys: empty, or `manipulations.K.`.
ConfigNode repeatable(ConfigNode saved, const SessionStep& step, const SessionResult& result,
                      const std::string& prefix = "") {
  const SessionParams& params = step.params;
  const EnvironmentParams& environment = params.environment;
  if (!environment.simulated() && environment.folder.empty()) {
    // The command must run in the same folder when the saved config is run from another one.
    const auto started_in = std::filesystem::absolute(place(step.config, "environment.command").folder());
    saved = saved.with("environment.folder", ConfigNode::quoted(started_in.string()));
  }
  if (params.planning.time_budget_s > 0) {
    std::vector<ConfigNode> counts;
    for (const auto& round : result.rounds) counts.push_back(ConfigNode::integer(round.plan.iterations));
    saved = saved.with(prefix + "planning.replay_iterations", ConfigNode::sequence(counts));
  }
  if (params.correction.time_budget_s > 0) {
    std::vector<ConfigNode> dropped;
    for (const Index segment : result.dropped_corrections) dropped.push_back(ConfigNode::integer(segment));
    saved = saved.with(prefix + "correction.dropped", ConfigNode::sequence(dropped));
  }
  return saved;
}

/// The files of one fold. The session comes first, so that it is kept if the disk gets full.
void write_fold(const std::filesystem::path& folder, const Task& task, const ConfigNode& saved,
                const SessionResult& result, const std::string& provenance, int threads) {
  const std::string summary = session_summary_json(result), times = session_times_json(result);
  const auto session = folder / "session.h5";
  write_session(session, result, task, saved, provenance);
  try {
    write_garment(task, folder);
    write_text(folder / "config.yaml", saved.to_yaml());
    write_text(folder / "provenance.json", provenance);
    write_text(folder / "summary.json", summary);
    write_text(folder / "times.json", times_json(threads, {{"summary.json", times}}));
  } catch (const Error& error) {
    throw Error(error.what() + ("; the session is kept in " + session.string()));
  }
}

std::string step_name(Index number) { return "step_" + std::to_string(number + 1); }

int run(Context& context, const std::string& file) {
  const Prepared<SessionParams> given(context, file);
  // Before any work, because both also check the slots that the session does not use; the identity first, because it names the
  // plugins of all folds, in whose folders the saved config must search.
  const Identity identity = given.identity("run");
  ConfigNode whole = given.saved_config();
  const auto folder =
      result_folder(context, std::filesystem::path(file).stem().string() + "-seed" + std::to_string(given.seed));
  require_unmixed(context, folder, identity);
  const auto steps = session_steps(given.params, given.config);
  const bool is_sequence = !given.params.manipulations.is_null();
  const PlacedFolder placed(folder);

  context.say("folding " + given.task.garment->name + " (" + std::to_string(given.task.garment->vertex_count()) +
              " vertices), seed " + std::to_string(given.seed) + ", " + std::to_string(given.host->threads()) +
              (given.host->threads() == 1 ? " thread" : " threads"));
  Index begun = 0;  // trials of all folds
  const auto progress = [&](const SessionRound& round, Index number, double) {
    const Index trials = given.params.trials;
    if (number == 0) {
      const Index fold = begun / trials, trial = begun % trials;
      ++begun;
      if (is_sequence && trial == 0)
        context.say("fold " + std::to_string(fold + 1) + " of " + std::to_string(steps.size()));
      if (trials > 1) context.say("trial " + std::to_string(trial + 1) + " of " + std::to_string(trials));
    }
    char line[200], corrected[80] = "";
    if (round.correction && std::isfinite(round.correction->forecast_mm))
      std::snprintf(corrected, sizeof(corrected), "  corrected from %.1f mm, %zu simulated%s",
                    round.correction->forecast_mm, round.correction->steps.size(),
                    round.correction->dropped ? ", dropped" : "");
    std::snprintf(line, sizeof(line), "segment %2td  plan %5.2f s  %2td segments to go  predicted %5.1f mm%s%s",
                  number + 1, round.seconds(), round.plan.controls.rows() - 1, round.plan.predicted_error_mm,
                  round.plan.releases ? "" : "  (no release yet)", corrected);
    context.say(line);
  };
  const auto done = [&](const SessionStep& step, Index number, const Task& task, const SessionResult& result) {
    if (is_sequence) whole = repeatable(whole, step, result, "manipulations." + std::to_string(number) + ".");
    ConfigNode saved = whole;
    if (is_sequence) {
      saved = self_contained(step.resolved, describe_params<SessionParams>(), task, *given.registry);
      if (number > 0)
        saved = saved.with("start.session", ConfigNode::quoted("../" + step_name(number - 1) + "/session.h5"));
    }
    const auto target = is_sequence ? folder / step_name(number) : folder;
    if (is_sequence) make_folder_for_results(target);
    // The provenance names the plugins that were used, so it is made after the fold.
    write_fold(target, task, repeatable(saved, step, result), result, given.provenance(identity),
               given.host->threads());
    for (const auto& warning : garment_warnings(*task.garment)) given.host->log(LogLevel::warning, warning);
    for (const auto& warning : result.warnings) given.host->log(LogLevel::warning, warning);
    if (context.json && !is_sequence)
      context.output() << with_times(session_summary_json(result), session_times_json(result));
    say_result(context, result, step.params.correction.lag);
    write_page(context, target);
  };
  const SessionResult result = run_sequence(given.params, given.config, *given.host, progress, done);
  if (is_sequence) {
    const std::string summary = sequence_summary_json(result);
    write_garment(given.task, folder);
    write_text(folder / "config.yaml", whole.to_yaml());
    write_text(folder / "provenance.json", given.provenance(identity));
    write_text(folder / "summary.json", summary);
    if (context.json) context.output() << summary;
  }
  const bool all_done = result.released && (!is_sequence || result.steps.size() == steps.size());
  if (*context.cancel_flag() && !all_done) context.complain("interrupted: the session ends before the last release");
  context.say("results in " + folder.string());
  return all_done ? 0 : 1;
}

}  // namespace

void register_run(CLI::App& app, Context& context) {
  CLI::App* command =
      app.add_subcommand("run", "Run one whole session: plan, execute a segment, observe, plan again, release");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto file = std::make_shared<std::string>();
  command->add_option("config", *file, "Task file, such as configs/tasks/tshirt_fold.yaml")->required();
  command->callback([&context, file] { context.action = [&context, file] { return run(context, *file); }; });
}

}  // namespace weft::app
