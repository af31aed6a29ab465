#include <cstdio>
#include <iostream>
#include <sstream>

#include "commands.hpp"
#include "experiments/ablation.hpp"
#include "experiments/cells.hpp"
#include "experiments/physics/physics.hpp"
#include "output.hpp"
#include "session/session.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"

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

/// Makes the parts that a cell of this arm needs, and drops them, so that errors show before any work starts.
/// @return the arm's config, independent of where its files lie.
ConfigNode rehearse(const AblationPlan& plan, const SweepArm& arm, const PluginRegistry& registry, Host& host,
                    const std::filesystem::path& folder) {
  try {
    if (plan.measure == "physics") {
      PhysicsExperimentParams params;
      const ConfigNode resolved = read_params(arm.config, params);
      const Task task = make_task(params.task, arm.config, host);
      check_simulator(task.simulator, task, host);
      if (!params.other.is_null()) check_simulator(params.other, task, host);
      return self_contained(resolved, describe_params<PhysicsExperimentParams>(), task, registry, folder);
    }
    SessionParams params;
    const ConfigNode resolved = read_params(arm.config, params);
    const Task task = make_task(params.task, arm.config, host);
    check_simulator(task.simulator, task, host);
    rehearse_session(params, arm.config, host);
    return self_contained(resolved, describe_params<SessionParams>(), task, registry, folder);
  } catch (const Error& error) {
    throw ConfigError("arm '" + arm.name + "': " + error.what());
  }
}

int ablate(const Context& context, const std::string& file) {
  ConfigNode config = ConfigNode::load(file);
  for (const auto& assignment : context.overrides) config = apply_override(config, assignment);
  const AblationPlan plan = read_ablation(config, context.seed ? &*context.seed : nullptr);
  const auto registry = context.registry(plan.arms.front().config);
  const auto host = context.host(registry, plan.seeds.front());  // takes ^C, and names the threads
  const auto folder = output_folder(context, std::filesystem::path(file).stem().string());
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    ConfigNode saved = rehearse(plan, plan.arms[a], *registry, *host, folder);
    if (saved.at("threads").as_int() == 0) saved = saved.with("threads", ConfigNode::integer(1));
    write_text(folder / ("arm" + std::to_string(a) + "-" + slug(plan.arms[a].name) + ".yaml"), saved.to_yaml());
  }
  write_text(folder / "config.yaml", config.to_yaml());

  write_text(folder / "provenance.json", provenance_json(*registry, *host, plan.seeds.front()));
  SweepOptions options;
  options.folder = folder;
  options.jobs = host->threads();
  options.registry = registry;
  options.cancel = context.cancel_flag();
  options.runner = plan.measure == "physics" ? run_physics_cell : run_session_cell;
  options.progress = [&](const SweepRow& row, std::size_t done, std::size_t total) {
    std::ostringstream line;
    line << done << '/' << total << "  " << plan.arms[row.arm].name << ", "
         << (plan.cases.empty() ? "seed " + std::to_string(row.seed) : plan.cases[row.seed]) << ": ";
    if (row.failure.empty() && plan.measure == "physics") {
      for (const auto& [name, value] : row.outcome.metrics) {
        char text[40];
        std::snprintf(text, sizeof text, " %.4g; ", value);
        line << name.substr(name.find(": ") + 2) << text;
      }
    } else if (row.failure.empty()) {
      char text[80];
      std::snprintf(text, sizeof text, "%.1f mm, plans %.1f s", row.metric("error_mm"), row.metric("plan_seconds"));
      line << text;
    } else {
      line << "failed: " << row.failure;
    }
    context.say(line.str());
  };
  context.say(std::to_string(plan.arms.size()) + " arms, " + std::to_string(plan.seeds.size()) +
              (plan.cases.empty() ? " seeds, " : " cases, ") + std::to_string(options.jobs) + " at a time");
  const auto rows = run_sweep(plan, options);
  const std::string json = ablation_json(plan, rows);
  write_text(folder / "ablation.csv", ablation_csv(plan, rows));
  write_text(folder / "ablation.json", json);
  if (context.json) std::cout << json;
  std::vector<std::string> metrics = {"error_mm", "first_plan_loss", "evaluations", "cpu_seconds"};
  if (plan.measure == "physics") metrics = sweep_metrics(rows);
  for (const auto& metric : metrics) context.say(ablation_table(plan, rows, metric));
  write_page(context, folder);
  context.say("results in " + folder.string());
  const bool complete = rows.size() == plan.cells();
  if (!complete) context.say("interrupted; run the same command again to finish it");
  return complete ? 0 : 1;
}

}  // namespace

void register_ablate(CLI::App& app, Context& context) {
  CLI::App* command =
      app.add_subcommand("ablate", "Compare sessions, or simulators, over a grid of settings; resumable");
  add_common_options(*command, context);
  auto file = std::make_shared<std::string>();
  command->add_option("config", *file, "Ablation file, such as configs/experiments/optimisers.yaml")->required();
  command->callback([&context, file] { context.action = [&context, file] { return ablate(context, *file); }; });
}

}  // namespace weft::app
