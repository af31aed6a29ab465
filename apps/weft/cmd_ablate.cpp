#include <cstdio>

#include "commands.hpp"
#include "experiments/ablation.hpp"
#include "experiments/cell_work.hpp"
#include "experiments/cells.hpp"
#include "experiments/physics/physics.hpp"
#include "experiments/sweep_rows.hpp"
#include "meshes/garment_writer.hpp"
#include "output.hpp"
#include "paper_options.hpp"
#include "prepared.hpp"
#include "report/times.hpp"
#include "session/session.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"
#include "work_options.hpp"

namespace weft::app {
namespace {

std::string slug(const std::string& name) {
  std::string text;
  for (const char c : name) {
    if (std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' || c == '_')
      text += c;
    else if (!text.empty() && text.back() != '-')
      text += '-';
  }
  return text;
}

/// An arm's config, independent of where its files lie, and its task.
struct SavedArm {
  ConfigNode config;
  Task task;
};

/// Resolves an arm's config, and notes what its cells belong to.
template <class Params>
SavedArm resolve_arm(SweepArm& arm, const ConfigNode& resolved, Task task, const PluginRegistry& registry,
                     std::vector<IdentityInput::Fold> folds = {}) {
  const auto params = describe_params<Params>();
  const auto keep = [](const ParamInfo& info) { return info.name != "seed"; };  // each cell has its own
  arm.identity = make_identity(
      {arm.config, resolved, params, task, registry, keep, {{"command", "ablate"}}, {}, std::move(folds)});
  // Its cells run with the numeric variants that were chosen here.
  arm.config = with_recorded_variants(arm.config, params, registry, {arm.identity}, "arm '" + arm.name + "'");
  return {self_contained(resolved, params, task, registry), std::move(task)};
}

/// Makes the parts that a cell of this arm needs, and drops them, so that errors show before any work starts.
/// @param folder whose earlier cells the arm joins.
SavedArm rehearse(const AblationPlan& plan, SweepArm& arm, const PluginRegistry& registry, Host& host,
                  const std::filesystem::path& folder) {
  try {
    const auto keys =
        plan.measure == "physics" ? describe_params<PhysicsExperimentParams>() : describe_params<SessionParams>();
    arm.config = with_recorded_variants(arm.config, keys, registry, recorded_identities(folder),
                                        (folder / "identities").string());
    if (plan.measure == "physics") {
      PhysicsExperimentParams params;
      const ConfigNode resolved = read_params(arm.config, params);
      const Task task = make_task(params.task, arm.config, host);
      check_simulator(task.simulator, task, host);
      if (!params.other.is_null()) check_simulator(params.other, task, host);
      return resolve_arm<PhysicsExperimentParams>(arm, resolved, task, registry);
    }
    SessionParams params;
    const ConfigNode resolved = read_params(arm.config, params);
    const Task task = make_task(params.task, arm.config, host);
    check_simulator(task.simulator, task, host);
    rehearse_steps(session_steps(params, arm.config), host);
    return resolve_arm<SessionParams>(arm, resolved, task, registry, identity_folds(params, arm.config));
  } catch (const Error& error) {
    throw ConfigError("arm '" + arm.name + "': " + error.what());
  }
}

/// The files with the statistics, and their tables.
void write_tables(const Context& context, const AblationPlan& plan, const std::vector<SweepRow>& rows,
                  const std::filesystem::path& folder, int threads) {
  const std::string json = ablation_json(plan, rows), times = ablation_times_json(plan, rows);
  write_text(folder / "ablation.csv", ablation_csv(plan, rows));
  write_text(folder / "ablation.json", json);
  write_text(folder / "times.csv", ablation_times_csv(plan, rows));
  write_text(folder / "times.json", times_json(threads, {{"ablation.json", times}}));
  if (context.json) context.output() << with_times(json, times);
  std::vector<std::string> metrics = {"error_mm",        "silhouette_iou", "success_10mm",
                                      "first_plan_loss", "evaluations",    "cpu_seconds"};
  if (plan.measure == "physics") {
    metrics = sweep_metrics(rows);
    for (const auto& name : sweep_times(rows)) metrics.push_back(name);
  }
  for (const auto& metric : metrics) context.say(ablation_table(plan, rows, metric));
}

/// What the folder holds besides cells: each arm's config, the garments, the config of the sweep.
void write_plan(const AblationPlan& plan, const ConfigNode& config, std::vector<SavedArm>& saved,
                const std::filesystem::path& folder, const std::string& provenance) {
  make_writable_folder(folder);
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    ConfigNode& one = saved[a].config;
    if (one.at("threads").as_int() == 0) one = one.with("threads", ConfigNode::integer(1));
    // Arms may have garments of their own.
    const Garment &garment = *saved[a].task.garment, &first = *saved[0].task.garment;
    const bool is_first = garment.hash == first.hash && garment.positions == first.positions;
    const std::string name = is_first ? "garment.obj" : "garment-" + arm_hash(plan.arms[a]) + ".obj";
    write_garment(saved[a].task, folder, name);
    one = one.with("garment", garment_node(name, garment));
    write_text(folder / ("arm-" + slug(plan.arms[a].name) + "-" + arm_hash(plan.arms[a]) + ".yaml"), one.to_yaml());
  }
  write_text(folder / "config.yaml", config.to_yaml());
  write_text(folder / "provenance.json", provenance);
}

/// The line about a row that ran. @throws nothing; failures are said by failure_text().
std::string row_text(const AblationPlan& plan, const SweepRow& row) {
  if (!row.failure.empty()) return failure_text(row);
  char text[80];
  if (plan.measure != "physics") {
    std::snprintf(text, sizeof text, "%.1f mm, plans %.1f s", row.metric("error_mm"), row.metric("plan_seconds"));
    return text;
  }
  std::string line;
  for (const auto& [name, value] : row.outcome.metrics) {
    std::snprintf(text, sizeof text, " %.4g; ", value);
    line += name.substr(name.find(": ") + 2) + text;
  }
  return line;
}

int ablate(const Context& context, const std::string& file, const WorkOptions& work, const PaperOptions& paper) {
  ConfigNode config = ConfigNode::load(file);
  for (const auto& assignment : context.overrides) config = apply_override(config, assignment);
  AblationPlan plan = read_ablation(config, context.seed ? &*context.seed : nullptr);
  const auto registry = context.registry(plan.arms.front().config);
  const auto host = context.host(registry, plan.seeds.front());  // takes ^C, and names the threads
  const auto folder = result_folder(context, std::filesystem::path(file).stem().string());
  std::vector<SavedArm> saved;
  for (auto& arm : plan.arms) saved.push_back(rehearse(plan, arm, *registry, *host, folder));
  const Identity identity = identity_of_command("ablate");
  require_unmixed(context, folder, identity);
  const SweepFolder earlier = read_sweep(plan, folder, context.accept_changed);

  SweepOptions options;
  options.folder = folder;
  options.accept_changed = context.accept_changed;
  options.jobs = host->threads();
  options.registry = registry;
  options.cancel = context.cancel_flag();
  options.runner = plan.measure == "physics" ? run_physics_cell : run_session_cell;
  CellWork cells;
  cells.kind = plan.measure == "physics" ? "physics" : "session";
  options.request = [&](const ConfigNode& cell) { return cell_request(cells, cell, *registry); };
  work.apply(options);
  options.progress = [&](const SweepRow& row, std::size_t done, std::size_t total) {
    const std::string line = std::to_string(done) + "/" + std::to_string(total) + "  " + plan.arms[row.arm].name +
                             ", " + (plan.cases.empty() ? "seed " + std::to_string(row.seed) : plan.cases[row.seed]) +
                             ": " + row_text(plan, row);
    row.failure.empty() ? context.say(line) : context.complain(line);
  };
  // Nothing was refused, so from here on the folder changes.
  const auto begin = [&] {
    write_plan(plan, config, saved, folder, provenance_json(*registry, plan.seeds.front(), identity));
  };
  if (work.cluster.is_given()) {
    const auto left = cells_left(plan, earlier.rows, options.retry);
    return run_on_cluster(context, work.cluster, sweep_work("ablate", folder, {"cells"}, plan.cells(), left), [&] {
      begin();
      prepare_sweep(plan, options);
    });
  }
  if (!work.share || !std::filesystem::exists(folder / "provenance.json")) begin();
  const auto counted = [](std::size_t count, const std::string& what) {
    return std::to_string(count) + " " + what + (count == 1 ? "" : "s");
  };
  context.say(counted(plan.arms.size(), "arm") + ", " +
              counted(plan.seeds.size(), plan.cases.empty() ? "seed" : "case") + ", " + std::to_string(options.jobs) +
              " at a time");
  const auto rows = run_sweep(plan, options);
  if (work.share) return share_exit_code(context, rows.size(), plan.cells());
  write_tables(context, plan, rows, folder, host->threads());
  say_mixed(context, plan, rows, earlier);
  write_paper(context, folder, paper);
  write_page(context, folder);
  context.say("results in " + folder.string());
  return sweep_exit_code(context, {rows}, plan.cells());
}

}  // namespace

void register_ablate(CLI::App& app, Context& context) {
  CLI::App* command =
      app.add_subcommand("ablate", "Compare sessions, or simulators, over a grid of settings; resumable");
  add_common_options(*command, context);
  add_accept_option(*command, context);
  auto file = std::make_shared<std::string>();
  command->add_option("config", *file, "Ablation file, such as configs/experiments/optimisers.yaml")->required();
  auto work = std::make_shared<WorkOptions>();
  add_work_options(*command, "cell", *work);
  auto paper = std::make_shared<PaperOptions>();
  add_paper_options(*command, *paper);
  command->callback([&context, file, work, paper] {
    context.action = [&context, file, work, paper] { return ablate(context, *file, *work, *paper); };
  });
}

}  // namespace weft::app
