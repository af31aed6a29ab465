#include "evaluation_run.hpp"

#include <algorithm>

#include "experiments/cell_work.hpp"
#include "learning/dataset_files.hpp"
#include "options.hpp"
#include "report/times.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"

namespace weft::app {

void add_evaluation_options(CLI::App& command, Context& context, EvaluationOptions& options) {
  command.add_option("config", options.file, "Experiment file, such as configs/experiments/tshirt.yaml")->required();
  add_accept_option(command, context);
  command
      .add_option(
          "--goals", options.goals,
          "Sources of cases, one column of the result each: fresh (made from the seed), test, validation, train")
      ->check(CLI::IsMember({"fresh", "test", "validation", "train"}));
  command.add_option("--cases", options.cases, "Cases per column")
      ->check(within(std::int64_t{1}, std::int64_t{100000}));
  command.add_option("--data", options.data, "Folder of examples, for cases that are not fresh");
  add_work_options(command, "cell", options.work);
  add_paper_options(command, options.paper);
}

namespace {

/// What the cells of an evaluation's folder belong to.
std::vector<Identity> recorded_in(const std::filesystem::path& out, const std::vector<std::string>& sources) {
  std::vector<Identity> all;
  for (const auto& source : sources)
    for (auto& one : recorded_identities(out / source)) all.push_back(std::move(one));
  return all;
}

}  // namespace

EvaluationRun::EvaluationRun(Context& context, const EvaluationOptions& options, const std::string& kind)
    : out(result_folder(context, "evaluate-" + kind + "-" + std::filesystem::path(options.file).stem().string())),
      given(context, options.file, recorded_in(out, options.goals), out.string()),
      context_(context),
      options_(options),
      kind_(kind),
      command_("evaluate " + kind) {
  require_distinct("--goals", options.goals);
  const auto& params = given.params;
  const auto& task = given.task;
  Host& host = *given.host;
  session = keep_params(given.config, describe_params<SessionParams>(), [](const ParamInfo&) { return true; });
  predictor_ = bound_predictor(place(given.config, "predictor"), task, host);
  const Planner planner(task, predictor_, host.create<Optimiser>(params.optimiser), params.planning, host);
  if (params.correction.simulations > 0) Twin(task, params.correction.simulator, host);
  if (kind == "estimation") {
    const SessionEstimator estimator(task, predictor_, host.create<Optimiser>(params.estimation_optimiser),
                                     params.estimation, params.correction.simulator, host);
  }
  check_simulator(task.simulator, task, host);
  check_world(params.world, task, given.config, host);
}

void EvaluationRun::identify(EvaluationColumn& column, const std::filesystem::path& data) const {
  const auto keys = describe_params<SessionParams>();
  const auto keep = [](const ParamInfo& info) { return info.name != "seed"; };  // each cell has its own
  for (auto& arm : column.plan.arms) {
    SessionParams params;
    const ConfigNode resolved = read_params(arm.config, params);
    IdentityInput input{arm.config, resolved, keys, given.task, *given.registry, keep};
    input.besides = {{"command", command_}, {"cases", column.plan.description}};
    if (column.cases.dataset) input.data = {data};
    arm.identity = make_identity(input);
    // Its cells run with the numeric variants that were chosen here.
    arm.config = with_recorded_variants(arm.config, keys, *given.registry, {arm.identity}, "arm '" + arm.name + "'");
  }
}

void EvaluationRun::begin(std::vector<EvaluationColumn>& columns, const std::filesystem::path& data) {
  const Identity identity = identity_of_command(command_);
  require_unmixed(context_, out, identity);
  for (auto& column : columns) {
    identify(column, data);
    earlier_.push_back(read_sweep(column.plan, source_folder(column.cases.source), context_.accept_changed));
  }
}

void EvaluationRun::write_plan() const {
  make_writable_folder(out);
  write_garment(given.task, out);
  write_text(out / "config.yaml", given.saved_config().to_yaml());
  write_text(out / "provenance.json", given.provenance(identity_of_command(command_)));
}

int EvaluationRun::submit(const std::vector<EvaluationColumn>& columns) const {
  std::vector<std::string> folders;
  std::size_t cells = 0, left = 0;
  for (std::size_t i = 0; i < columns.size(); ++i) {
    folders.push_back(columns[i].cases.source + "/cells");
    cells += columns[i].plan.cells();
    left += cells_left(columns[i].plan, earlier_[i].rows, options_.work.retry());
  }
  return run_on_cluster(context_, options_.work.cluster, sweep_work(command_, out, folders, cells, left), [&] {
    write_plan();
    for (const auto& column : columns) prepare_sweep(column.plan, cell_options(column));
  });
}

SweepOptions EvaluationRun::cell_options(const EvaluationColumn& column) const {
  SweepOptions cells;
  cells.folder = source_folder(column.cases.source);
  cells.accept_changed = context_.accept_changed;
  cells.jobs = given.host->threads();
  cells.registry = given.registry;
  cells.cancel = context_.cancel_flag();
  options_.work.apply(cells);
  return cells;
}

void EvaluationRun::write(const std::string& name, const std::string& json, const std::string& csv,
                          const std::string& times, const std::string& times_of_cells) const {
  write_text(out / (name + ".json"), json);
  write_text(out / (name + ".csv"), csv);
  write_text(out / "times.json", times_json(given.host->threads(), {{name + ".json", times}}));
  write_text(out / "times.csv", times_of_cells);
}

void EvaluationRun::say_rows(const std::vector<EvaluationColumn>& columns) const {
  for (std::size_t i = 0; i < columns.size(); ++i) say_mixed(context_, columns[i].plan, columns[i].rows, earlier_[i]);
}

std::vector<EvaluationColumn> EvaluationRun::run(const MakePlan& make_plan, const MakeRunner& make_runner,
                                                 const std::function<std::string(const SweepRow&)>& line) {
  std::shared_ptr<const Dataset> dataset;
  std::filesystem::path folder;
  if (std::any_of(options_.goals.begin(), options_.goals.end(), [](const auto& source) { return source != "fresh"; })) {
    folder = options_.data.empty() ? given.params.dataset : std::filesystem::path(options_.data);
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
  begin(columns, folder);
  if (options_.work.cluster.is_given()) {
    ended_with_ = submit(columns);
    return columns;
  }
  if (!options_.work.share || !std::filesystem::exists(out / "provenance.json")) write_plan();
  for (auto& column : columns) {
    SweepOptions cells = cell_options(column);
    cells.runner = make_runner(column.cases, cells.folder);
    const CellWork work{kind_, cells.folder, place(given.config, "data"), column.cases, folder};
    cells.request = [&](const ConfigNode& cell) { return cell_request(work, cell, *given.registry); };
    cells.progress = [&](const SweepRow& row, std::size_t done, std::size_t total) {
      const std::string text = std::to_string(done) + "/" + std::to_string(total) + "  " +
                               column.plan.arms[row.arm].name + ", seed " + std::to_string(row.seed) + ": ";
      if (row.failure.empty())
        context_.say(text + line(row));
      else
        context_.complain(text + failure_text(row));
    };
    context_.say(column.plan.description + ": " + std::to_string(column.plan.arms.size()) + " x " +
                 std::to_string(column.plan.seeds.size()) + " runs, " + std::to_string(cells.jobs) + " at a time");
    column.rows = run_sweep(column.plan, cells);
  }
  if (options_.work.share) ended_with_ = exit_code_of_share(columns);
  return columns;
}

int EvaluationRun::exit_code_of_share(const std::vector<EvaluationColumn>& columns) const {
  std::size_t rows = 0, cells = 0;
  for (const auto& column : columns) {
    rows += column.rows.size();
    cells += column.plan.cells();
  }
  return share_exit_code(context_, rows, cells);
}

int EvaluationRun::exit_code(const std::vector<EvaluationColumn>& columns) const {
  std::vector<std::vector<SweepRow>> sweeps;
  std::size_t cells = 0;
  for (const auto& column : columns) {
    sweeps.push_back(column.rows);
    cells += column.plan.cells();
  }
  return sweep_exit_code(context_, sweeps, cells);
}

}  // namespace weft::app
