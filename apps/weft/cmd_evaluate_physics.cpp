#include <algorithm>
#include <cmath>
#include <cstdio>
#include <mutex>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "experiments/csv.hpp"
#include "experiments/evaluation_work.hpp"
#include "experiments/physics/suite.hpp"
#include "output.hpp"
#include "paper_options.hpp"
#include "prepared.hpp"
#include "report/times.hpp"
#include "sdk/json_text.hpp"
#include "session/session.hpp"
#include "simulation/fold.hpp"
#include "simulation/task_config.hpp"
#include "work_options.hpp"

namespace weft::app {
namespace {

std::string to_json(const std::vector<PhysicsRow>& rows) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const auto& r : rows) {
    list.push_back({{"test", r.test},
                    {"case", r.name},
                    {"variant", r.variant},
                    {"quantity", r.quantity},
                    {"reference", r.reference},
                    {"measured", r.measured},
                    {"error", std::isfinite(r.error) ? nlohmann::ordered_json(r.error) : nlohmann::ordered_json()},
                    {"bound", r.bound},
                    {"passed", r.passed},
                    {"note", r.note}});
    if (!r.by_seed.empty()) list.back()["by_seed"] = r.by_seed;
  }
  const auto failed = std::count_if(rows.begin(), rows.end(), [](const PhysicsRow& r) { return !r.passed; });
  return nlohmann::ordered_json{{"comparisons", rows.size()}, {"failed", failed}, {"rows", list}}.dump(2) + '\n';
}

std::string to_csv(const std::vector<PhysicsRow>& rows) {
  std::string csv = "test,case,variant,quantity,reference,measured,error,bound,passed,note\n";
  for (const auto& r : rows) {
    char numbers[160];
    std::snprintf(numbers, sizeof(numbers), "%.9g,%.9g,%.9g,%.9g,%s", r.reference, r.measured, r.error, r.bound,
                  r.passed ? "true" : "false");
    csv += csv_quoted(r.test) + ',' + csv_quoted(r.name) + ',' + csv_quoted(r.variant) + ',' + csv_quoted(r.quantity) +
           ',' + numbers + ',' + csv_quoted(r.note) + '\n';
  }
  return csv;
}

/// The results of an earlier call that are those of this one too. Null if there are none, or a case of them failed to run:
/// it may go well this time.
/// @param config saved: the identity has no numbers of cases.
nlohmann::ordered_json kept_results(const std::filesystem::path& out, const Identity& identity,
                                    const std::string& config) {
  const auto json = parse_json_if_valid(text_of_file(out / "physics.json"));
  if (!json.is_object() || !json.contains("rows")) return nullptr;
  const Identity earlier = read_identity(out / "provenance.json");
  if (!earlier.is_known() || earlier.hash() != identity.hash() || text_of_file(out / "config.yaml") != config)
    return nullptr;
  const auto did_not_run = [](const nlohmann::ordered_json& row) {
    for (const auto status :
         {WorkStatus::refused, WorkStatus::diverged, WorkStatus::crashed, WorkStatus::hung, WorkStatus::lost})
      if (row.value("quantity", "") == to_string(status)) return true;
    return false;
  };
  const auto& rows = json["rows"];
  return std::any_of(rows.begin(), rows.end(), did_not_run) ? nlohmann::ordered_json() : json;
}

int evaluate(Context& context, const std::string& file, const WorkOptions& work, const PaperOptions& paper) {
  const auto out = result_folder(context, "evaluate-" + std::filesystem::path(file).stem().string());
  const ClusterWork on_cluster = single_work("evaluate physics", "evaluate-physics", out / "physics.json");
  const Prepared<PhysicsExperimentParams> given(context, file, {planned_identity(out, on_cluster.label)}, out.string());
  const auto task = std::make_shared<const Task>(given.task);
  const auto cases = physics_cases(given.params.physics, task, given.config);
  check_simulator(task->simulator, *task, *given.host);
  const Identity identity = given.identity("evaluate physics");
  require_unmixed(context, out, identity);
  if (work.cluster.is_given())
    return run_on_cluster(context, work.cluster, on_cluster,
                          [&] { write_planned_identity(out, on_cluster.label, identity); });
  // Once before anything is written, to refuse another identity; the cases are read when it is this process's turn.
  PhysicsCheckpoint(out, identity, cases, context.accept_changed);
  const PlacedFolder placed(out);
  const FolderTurn turn(context, out, "physics");
  PhysicsCheckpoint checkpoint(out, identity, cases, context.accept_changed);
  const auto finish = [&](std::size_t comparisons, std::size_t failed) {
    context.say(std::to_string(comparisons) + " comparisons, " + std::to_string(failed) + " outside their bound");
    write_paper(context, out, paper);
    write_page(context, out);
    context.say("results in " + out.string());
    return failed == 0 ? 0 : 1;
  };
  if (const auto kept = kept_results(out, identity, given.saved_config().to_yaml()); kept.is_object()) {
    const std::string text = kept.dump(2) + '\n';
    write_text(out / "physics.json", text);  // its time says that it is of today's weft too
    checkpoint.remove();                     // left by a process that was killed at its very end
    if (context.json) context.output() << text;
    context.say("everything was measured before");
    return finish(kept.at("rows").size(), kept.at("failed").get<std::size_t>());
  }

  const auto say = [&](const std::vector<PhysicsRow>& some) {
    for (const auto& row : some) context.say(format_physics_row(row));
  };
  std::vector<PhysicsRow> rows;
  if (work.in_process) {
    std::vector<std::vector<PhysicsRow>> results(cases.size());
    std::mutex printing;
    given.host->parallel_for(static_cast<std::int64_t>(cases.size()), [&](std::int64_t i) {
      if (given.host->cancelled()) return;
      if (const auto* earlier = checkpoint.rows(i)) {
        results[i] = *earlier;
        return;
      }
      auto made = run_physics_case_of(given.params, cases[i], *task, *given.host);
      if (given.host->cancelled()) return;  // it may have been cut short
      results[i] = std::move(made);
      checkpoint.add(i, results[i]);
      const std::lock_guard lock(printing);
      say(results[i]);
    });
    for (auto& some : results) std::move(some.begin(), some.end(), std::back_inserter(rows));
  } else {
    const EvaluationWorkers workers{work.worker(), work.cell_limit_s, [&] { return given.host->cancelled(); }};
    rows = run_physics_cases(workers, given.config, cases, *given.registry, *given.host, checkpoint, say);
  }
  if (given.host->cancelled()) throw Interrupted("interrupted; run the same command again to finish it");

  std::error_code ignored;
  std::filesystem::remove(out / "physics.json",
                          ignored);  // until the end it would be taken for that of the other files
  write_garment(given.task, out);
  write_text(out / "config.yaml", given.saved_config().to_yaml());
  write_text(out / "provenance.json", given.provenance(identity));
  write_text(out / "times.json", times_json(given.host->threads(), {}));
  write_text(out / "physics.csv", to_csv(rows));
  write_text(out / "physics.json", to_json(rows));  // the last one: it says that all are there
  checkpoint.remove();
  if (context.json) context.output() << to_json(rows);
  const auto failed = std::count_if(rows.begin(), rows.end(), [](const PhysicsRow& r) { return !r.passed; });
  return finish(rows.size(), static_cast<std::size_t>(failed));
}

}  // namespace

void register_evaluate_physics(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("physics", "A simulator against closed forms, each with its bound");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto file = std::make_shared<std::string>();
  command->add_option("config", *file, "Experiment file, such as configs/experiments/physics.yaml")->required();
  auto work = std::make_shared<WorkOptions>();
  add_process_options(*command, "case", *work);
  auto paper = std::make_shared<PaperOptions>();
  add_paper_options(*command, *paper);
  command->callback([&context, file, work, paper] {
    context.action = [&context, file, work, paper] { return evaluate(context, *file, *work, *paper); };
  });
}

}  // namespace weft::app
