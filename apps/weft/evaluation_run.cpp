#include "evaluation_run.hpp"

#include <algorithm>

#include "learning/dataset_files.hpp"
#include "options.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"

namespace weft::app {

void add_evaluation_options(CLI::App& command, EvaluationOptions& options) {
  command.add_option("config", options.file, "Experiment file, such as configs/experiments/tshirt.yaml")->required();
  command
      .add_option(
          "--goals", options.goals,
          "Sources of cases, one column of the result each: fresh (made from the seed), test, validation, train")
      ->check(CLI::IsMember({"fresh", "test", "validation", "train"}));
  command.add_option("--cases", options.cases, "Cases per column")
      ->check(within(std::int64_t{1}, std::int64_t{100000}));
  command.add_option("--data", options.data, "Folder of examples, for cases that are not fresh");
}

EvaluationRun::EvaluationRun(Context& context, const EvaluationOptions& options, const std::string& name)
    : given(context, options.file), context_(context), options_(options) {
  require_distinct("--goals", options.goals);
  const auto& params = given.params;
  const auto& task = given.task;
  Host& host = *given.host;
  session = keep_params(given.config, describe_params<SessionParams>(), [](const ParamInfo&) { return true; });
  predictor_ = bound_predictor(place(given.config, "predictor"), task, host);
  const Planner planner(task, predictor_, host.create<Optimiser>(params.optimiser), params.planning, host);
  if (params.refinement.plans > 0) bound_predictor(params.refinement.predictor, task, host);
  if (name == "evaluate-estimation") {
    const Estimator estimator(task, predictor_, host.create<Optimiser>(params.estimation_optimiser), params.estimation,
                              host);
  }
  check_simulator(task.simulator, task, host);
  out = output_folder(context, name + "-" + std::filesystem::path(options.file).stem().string());
  write_text(out / "config.yaml", given.saved_config(out).to_yaml());
  write_text(out / "provenance.json", given.provenance());
}

std::vector<EvaluationColumn> EvaluationRun::run(const MakePlan& make_plan, const MakeRunner& make_runner,
                                                 const std::function<std::string(const SweepRow&)>& line) {
  std::shared_ptr<const Dataset> dataset;
  if (std::any_of(options_.goals.begin(), options_.goals.end(), [](const auto& source) { return source != "fresh"; })) {
    const std::filesystem::path folder =
        options_.data.empty() ? given.params.dataset : std::filesystem::path(options_.data);
    if (folder.empty())
      throw ConfigError("cases of a split need a dataset: --data FOLDER (or `dataset:` in the config)");
    context_.say("reading " + folder.string());
    dataset = std::make_shared<const Dataset>(load_dataset(folder));
    dataset->require_task(given.task);
  }
  std::vector<EvaluationColumn> columns;
  for (const auto& source : options_.goals) {
    EvaluationColumn column;
    column.cases = choose_cases(source, options_.cases, given.seed, source == "fresh" ? nullptr : dataset);
    if (source != "fresh") warn_unless_held_out(*predictor_, *dataset, source, *given.host);
    column.plan = make_plan(column.cases);
    columns.push_back(std::move(column));
  }
  for (auto& column : columns) {
    SweepOptions cells;
    cells.folder = source_folder(column.cases.source);
    cells.jobs = given.host->threads();
    cells.registry = given.registry;
    cells.cancel = context_.cancel_flag();
    cells.runner = make_runner(column.cases, cells.folder);
    cells.progress = [&](const SweepRow& row, std::size_t done, std::size_t total) {
      context_.say(std::to_string(done) + "/" + std::to_string(total) + "  " + column.plan.arms[row.arm].name +
                   ", seed " + std::to_string(row.seed) + ": " +
                   (row.failure.empty() ? line(row) : "failed: " + row.failure));
    };
    context_.say(column.plan.description + ": " + std::to_string(column.plan.arms.size()) + " x " +
                 std::to_string(column.plan.seeds.size()) + " runs, " + std::to_string(cells.jobs) + " at a time");
    column.rows = run_sweep(column.plan, cells);
    complete = complete && column.rows.size() == column.plan.cells();
  }
  return columns;
}

}  // namespace weft::app
