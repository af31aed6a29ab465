#include "learning.hpp"

#include <algorithm>
#include <cmath>
#include <thread>

#include "learning/dataset_files.hpp"
#include "learning_steps.hpp"
#include "output.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "simulation/displacement.hpp"
#include "weft/config.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kLearnSchema = "weft learn 1";
constexpr const char* kIterations = "training.iterations";  // a predictor's parameters
constexpr const char* kEvaluateEvery = "training.evaluate_every";
constexpr const char* kWarmup = "training.warmup";
constexpr const char* kModel = "model";
constexpr double kReserve = 0.05;       // of --hours
constexpr double kTrialFitSeconds = 5;  // the fit of the trial, at least

/// The experiment that `weft garment import` wrote to a folder.
fs::path experiment_in(const fs::path& folder) {
  std::vector<fs::path> found;
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.path().filename().string().ends_with("_experiment.yaml")) found.push_back(entry.path());
  if (found.size() == 1) return found.front();
  throw ConfigError(folder.string() +
                    (found.empty() ? ": holds no file NAME_experiment.yaml; `weft garment import` writes one for a "
                                     "garment that can be folded"
                                   : ": holds several files NAME_experiment.yaml; name one of them"));
}

bool has_param(const std::vector<ParamInfo>& params, const std::string& name) {
  return std::any_of(params.begin(), params.end(), [&](const ParamInfo& info) { return info.name == name; });
}

std::string counted_text(std::int64_t n, const char* what) { return std::to_string(n) + " " + what; }

}  // namespace

Learning::Learning(Context& context, const LearnCall& call)
    : context_(context), call_(call), task_context_(context), line_(context) {
  fs::path file = call.task;
  if (fs::is_directory(file)) {
    const fs::path folder = file;
    file = experiment_in(folder);
    if (context.out.empty()) context.out = (folder / "learned").string();
  }
  out_ = result_folder(context, "learn-" + file.stem().string());
  const auto changes = options_for_learning(file);
  // The task's own words come first, so that --set has the last one.
  task_context_.overrides.insert(task_context_.overrides.begin(), changes.begin(), changes.end());
  const Identity earlier = read_identity(out_ / "provenance.json");
  given_ = std::make_unique<Prepared<ExperimentParams>>(
      task_context_, file.string(), std::vector{earlier, planned_identity(out_, "learn")}, out_.string());
  context_.jobs = task_context_.jobs;
  check_simulator(given_->task.simulator, given_->task, *given_->host);
  check_numbers(file);
  identity_ = make_identity_of_call();
  if (!earlier.is_known()) return;
  require_identity(out_.string(), earlier, identity_, context.accept_changed);
  is_accepted_change_ = !identity_.changes_since(earlier).empty();
}

std::vector<std::string> Learning::options_for_learning(const fs::path& file) {
  const Prepared<ExperimentParams> as_it_is(context_, file.string());
  std::vector<std::string> changes;
  const bool learns = !as_it_is.params.predictor.is_null() &&
                      as_it_is.host->create<Predictor>(as_it_is.params.predictor)->trainable() != nullptr;
  if (!learns) {
    changes = {"predictor={plugin: emd}", "planning.instances=", "planning.iterations=", "planning.replan_iterations="};
    if (!as_it_is.config.has("correction")) changes.emplace_back("correction={simulations: 8, max_width: 0.2}");
    note_ = "the task has no predictor that learns: it gets emd, and the defaults of planning with a network";
  } else {
    const auto params =
        as_it_is.registry->params(as_it_is.registry->entry(Predictor::kKind, as_it_is.params.predictor));
    if (!has_param(params, kModel))
      as_it_is.config.fail("predictor has no parameter `model`, so a task cannot name what it learned");
    if (call_.hours > 0.0 && !has_param(params, kIterations))
      throw ConfigError("--hours needs a predictor with the parameter " + std::string(kIterations) + ", such as emd");
    if (!place(as_it_is.config, "predictor.params.model").is_null()) changes.emplace_back("predictor.params.model=");
  }
  // Other seeds give the examples to measure on.
  if (place(as_it_is.config, "data.test_fraction").is_null()) changes.emplace_back("data.test_fraction=0");
  return changes;
}

void Learning::check_numbers(const fs::path& file) const {
  const LearnParams& learn = given_->params.learn;
  if (call_.hours > 0.0) {
    for (const auto& assignment : context_.overrides) {
      if (assignment.starts_with("learn") || assignment.find(kIterations) != std::string::npos)
        throw ConfigError("--set " + assignment + ": --hours finds this number; leave one of the two out");
    }
    return;
  }
  const DatasetOrigin origin{"", given_->seed, given_->params.data.validation_fraction,
                             given_->params.data.test_fraction};
  bool trains = false, validates = false;
  for (std::int64_t i = 0; i < learn.examples; ++i) {
    trains = trains || origin.split(i) == Split::train;
    validates = validates || origin.split(i) == Split::validation;
    if (trains && validates) return;
  }
  throw ConfigError(file.string() + ": learn.examples = " + std::to_string(learn.examples) + ": none of them is for " +
                    (trains ? "validation" : "training") + "; make more");
}

Identity Learning::make_identity_of_call() const {
  const LearnParams& learn = given_->params.learn;
  std::vector<std::pair<std::string, std::string>> besides{
      {"displacement", call_.tune_displacement ? "tuned" : "of the task"}};
  if (call_.hours > 0.0) {
    besides.emplace_back("hours", ConfigNode::number(call_.hours).as_string());
  } else {
    besides.emplace_back("learn.examples", std::to_string(learn.examples));
    besides.emplace_back("learn.calibration_examples", std::to_string(learn.calibration_examples));
    besides.emplace_back("learn.held_out_examples", std::to_string(learn.held_out_examples));
  }
  return given_->identity(
      "learn", [](const ParamInfo& info) { return info.name != "dataset"; }, besides);
}

bool Learning::read_record() {
  const fs::path file = out_ / "learn.json";
  if (!fs::exists(file)) return false;
  const std::string damaged = file.string() + ": is damaged; remove it, and the steps that it lists are done again";
  record_ = parse_json_if_valid(whole_text(file));
  if (!record_.is_object() || record_.value("schema", "") != kLearnSchema) throw ConfigError(damaged);
  try {
    const ordered_json& numbers = record_.at("numbers");
    numbers_ = {{numbers.at("examples").get<std::int64_t>(), numbers.at("calibration_examples").get<std::int64_t>(),
                 numbers.at("held_out_examples").get<std::int64_t>()},
                numbers.value("iterations", std::int64_t{0})};
    if (!record_.at("steps").is_object()) throw ConfigError(damaged);
  } catch (const ordered_json::exception&) {
    throw ConfigError(damaged);
  }
  // Rates are for what is said about the time alone, so without them the steps go on.
  const auto times = parse_json_if_valid(text_of_file(out_ / "times.json"));
  if (times.is_object() && times.contains("learn.json") && times["learn.json"].is_object()) {
    const auto number = [&](const char* key) {
      const auto& all = times["learn.json"];
      return all.contains(key) && all[key].is_number() ? all[key].get<double>() : 0.0;
    };
    rates_ = {number("examples_per_s"), number("iterations_per_s")};
    if (times["learn.json"].contains("seconds") && times["learn.json"]["seconds"].is_object())
      seconds_ = times["learn.json"]["seconds"];
  }
  return true;
}

void Learning::say_plan() const {
  const auto iterations = place(given_->saved_config(), std::string("predictor.params.") + kIterations);
  const LearnParams& n = given_->params.learn;
  if (context_.json) {
    ordered_json json{{"folder", out_.string()}, {"hours", nullptr}};
    if (call_.hours > 0.0) {
      json["hours"] = call_.hours;
    } else {
      json["numbers"] = {{"examples", n.examples},
                         {"calibration_examples", n.calibration_examples},
                         {"held_out_examples", n.held_out_examples}};
      if (!iterations.is_null()) json["numbers"]["iterations"] = iterations.as_int();
    }
    context_.output() << json.dump(2) << '\n';
    return;
  }
  if (!note_.empty()) context_.say(note_);
  const auto seed = static_cast<long long>(given_->seed);
  context_.say("would learn to fold " + given_->task.garment->name + " in " + out_.string());
  if (call_.tune_displacement) context_.say("the displacement: tuned");
  if (call_.hours > 0.0) {
    context_.say("the numbers: what fits in " + ConfigNode::number(call_.hours).as_string() +
                 " hours at the rates that a short trial finds");
    return;
  }
  context_.say("examples/fit: " + std::to_string(n.examples) + ", seed " + std::to_string(seed));
  context_.say("examples/calibration: " + std::to_string(n.calibration_examples) + ", seed " +
               std::to_string(seed + 1));
  context_.say("examples/held_out: " + std::to_string(n.held_out_examples) + ", seed " + std::to_string(seed + 2));
  if (!iterations.is_null()) context_.say("model/fitted.h5: " + std::to_string(iterations.as_int()) + " iterations");
  context_.say("model/model.h5: calibrated; evaluation/: on the held-out examples; task.yaml: plans with the model");
}

void Learning::take_folder() {
  claims_.emplace(out_ / "claims");
  while (!claims_->take("learn")) {
    if (claims_->is_held("learn"))
      throw ConfigError(out_.string() + ": another `weft learn` is at work there; wait for it, or give another --out");
    require_not_stopped();
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
}

void Learning::plan() {
  write_garment(given_->task, out_);
  write_text(out_ / "provenance.json", given_->provenance(identity_));
  ConfigNode saved = given_->saved_config();
  const ordered_json tuned = tune(saved);
  write_text(config_file(), saved.to_yaml());
  measure_rates();
  const std::string iterations = std::string("predictor.params.") + kIterations;
  const ConfigNode planned = place(saved, iterations);
  numbers_ = {given_->params.learn, planned.is_null() ? 0 : planned.as_int()};
  if (call_.hours > 0.0) {
    const double spent = std::chrono::duration<double>(Clock::now() - started_).count();
    const double left = (1.0 - kReserve) * (3600.0 * call_.hours - spent);
    numbers_ = numbers_for(std::max(1.0, left), rates_, trial_examples());
    saved = saved.with(iterations, ConfigNode::integer(numbers_.iterations));
    // A short fit warms up shortly, and is evaluated often enough to choose its best model, unless the task says otherwise.
    for (const auto& [name, least] : {std::pair{kEvaluateEvery, 50}, std::pair{kWarmup, 1}}) {
      const std::string key = std::string("predictor.params.") + name;
      const ConfigNode node = place(saved, key);
      if (node.is_null() || !place(given_->config, key).is_null()) continue;
      const std::int64_t tenth = std::max<std::int64_t>(least, numbers_.iterations / 10);
      saved = saved.with(key, ConfigNode::integer(std::min(node.as_int(), tenth)));
    }
  }
  const LearnParams& n = numbers_.examples;
  saved = saved.with("learn.examples", ConfigNode::integer(n.examples))
              .with("learn.calibration_examples", ConfigNode::integer(n.calibration_examples))
              .with("learn.held_out_examples", ConfigNode::integer(n.held_out_examples));
  write_text(config_file(), saved.to_yaml());
  record_ = {{"schema", kLearnSchema},
             {"garment", given_->task.garment->name},
             {"vertices", given_->task.garment->vertex_count()},
             {"hours", nullptr},
             {"rates", nullptr},
             {"numbers",
              {{"examples", n.examples},
               {"calibration_examples", n.calibration_examples},
               {"held_out_examples", n.held_out_examples}}},
             {"seeds", {{"fit", given_->seed}, {"calibration", given_->seed + 1}, {"held_out", given_->seed + 2}}},
             {"displacement", tuned},
             {"steps", ordered_json::object()}};
  if (numbers_.iterations > 0) record_["numbers"]["iterations"] = numbers_.iterations;
  if (call_.hours > 0.0) {
    record_["hours"] = call_.hours;
    record_["rates"] = {{"examples_per_s", rates_.examples_per_s}, {"iterations_per_s", rates_.iterations_per_s}};
  }
  write_times();
  write_record();
}

ordered_json Learning::tune(ConfigNode& saved) {
  if (!call_.tune_displacement) return nullptr;
  show("displacement", "tuning it with simulated folds");
  const auto simulator = given_->host->create<Simulator>(given_->task.simulator);
  const auto tuned = tune_displacement(given_->task, *simulator, MaterialProperties::Constant(0.5),
                                       [this] { return given_->host->cancelled(); });
  const auto rounded = [](double length) { return std::round(length * 1e4) / 1e4; };
  const double x = rounded(tuned.displacement.x()), y = rounded(tuned.displacement.y());
  saved =
      saved.with("manipulation.displacement_m", ConfigNode::sequence({ConfigNode::number(x), ConfigNode::number(y)}));
  return {{"displacement_m", {x, y}}, {"misfit_mm", tuned.misfit_mm}};
}

std::int64_t Learning::trial_examples() const {
  const DataParams& data = given_->params.data;
  const DatasetOrigin origin{"", given_->seed, data.validation_fraction, data.test_fraction};
  constexpr std::int64_t kMost = 100000;
  std::int64_t train = 0, validation = 0;
  for (std::int64_t i = 0; i < kMost; ++i) {
    const Split split = origin.split(i);
    train += split == Split::train;
    validation += split == Split::validation;
    if ((i + 1) % data.shard_examples == 0 && train > 0 && validation > 0) return i + 1;
  }
  given_->config.fail("data.validation_fraction = " + std::to_string(data.validation_fraction) +
                      ": leaves no example for validation");
}

void Learning::measure_rates() {
  const fs::path folder = out_ / "trial";
  fs::remove_all(folder);
  Context step = step_context(folder);
  GenerateReport made;
  show("trial", "measuring the rates of this machine");
  make_examples(step, {config_file(), trial_examples(), "", call_.work, [](const auto&, auto) {}}, &made);
  require_not_stopped();
  if (2 * made.failed() > made.made) {
    throw Error(counted_text(made.failed(), "of the first ") +
                counted_text(made.made, "examples failed; `weft dataset info ") + folder.string() + "` lists why");
  }
  rates_.examples_per_s = static_cast<double>(made.made) / std::max(1e-3, made.seconds);
  rates_.iterations_per_s = measured_iterations_per_s();
}

double Learning::measured_iterations_per_s() {
  Context step = step_context(out_);
  const Prepared<ExperimentParams> trial(step, config_file());
  const auto predictor = trial.host->create<Predictor>(trial.params.predictor);
  const Dataset dataset = load_dataset(out_ / "trial");
  FitOptions options;
  options.seed = trial.seed;
  double rate = 0.0;
  const FitReport report = predictor->trainable()->fit(dataset, trial.task, options, [&](const FitProgress& p) {
    if (p.iteration > 0 && p.seconds > 0.0) rate = static_cast<double>(p.iteration) / p.seconds;
    return p.seconds < kTrialFitSeconds && !trial.host->cancelled();
  });
  require_not_stopped();
  if (rate == 0.0) rate = static_cast<double>(report.iterations) / std::max(1e-3, report.seconds);
  return std::max(rate, 1e-3);
}

void Learning::keep_trial() const {
  const fs::path trial = out_ / "trial", kept = examples_of("fit");
  if (!fs::exists(trial)) return;
  if (!fs::exists(kept) && numbers_.examples.examples >= trial_examples()) {
    make_folder_for_results(kept.parent_path());
    fs::rename(trial, kept);
  }
  fs::remove_all(trial);
}

int Learning::run() {
  if (call_.work.cluster.dry_run && !call_.work.cluster.is_given()) {
    say_plan();
    return 0;
  }
  if (call_.work.cluster.is_given()) {
    return run_on_cluster(context_, call_.work.cluster, single_work("learn", "learn", out_ / "task.yaml"),
                          [&] { write_planned_identity(out_, "learn", identity_); });
  }
  if (!note_.empty()) context_.say(note_);
  const PlacedFolder placed(out_);
  try {
    take_folder();
    if (is_accepted_change_)
      for (const char* file : {"learn.json", "task.yaml"}) fs::remove(out_ / file);
    if (!read_record()) plan();
    keep_trial();
    step("examples", &Learning::make_all_examples);
    step("training", &Learning::fit);
    step("calibration", &Learning::calibrate);
    step("evaluation", &Learning::evaluate);
    write_task();
  } catch (const Interrupted&) {
    line_.end();
    context_.say("stopped; run the same command again to go on");
    return 1;
  }
  say_end();
  return 0;
}

}  // namespace weft::app
