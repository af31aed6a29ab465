// The steps of `weft learn`, and what it says about them.
#include <algorithm>

#include "experiments/shortfalls.hpp"
#include "learning.hpp"
#include "learning/dataset_files.hpp"
#include "learning_steps.hpp"
#include "output.hpp"
#include "report/times.hpp"
#include "sdk/files.hpp"
#include "sdk/formatted.hpp"
#include "sdk/json_text.hpp"
#include "simulation/fold.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr std::int64_t kMostFailed = 10;  // per cent of the examples, beyond which learning stops

}  // namespace

Context Learning::step_context(const fs::path& out) const {
  Context step = context_;
  step.overrides.clear();
  step.seed.reset();
  step.out = out.string();
  step.json = false;
  step.is_step = true;
  return step;
}

std::string Learning::set_model(const char* file) const {
  return "predictor.params.model=" + ordered_json((out_ / "model" / file).string()).dump();
}

void Learning::require_not_stopped() const {
  if (*context_.cancel_flag()) throw Interrupted("stopped");
}

void Learning::write_record() const { write_text(out_ / "learn.json", record_.dump(2) + "\n"); }

void Learning::write_times() const {
  const ordered_json times{
      {"examples_per_s", rates_.examples_per_s}, {"iterations_per_s", rates_.iterations_per_s}, {"seconds", seconds_}};
  write_text(out_ / "times.json", times_json(given_->host->threads(), {{"learn.json", times.dump()}}));
}

std::string Learning::left_in_all(double now, std::int64_t examples, std::int64_t iterations) const {
  if (!(rates_.examples_per_s > 0.0) || !(rates_.iterations_per_s > 0.0)) return "";
  const double later =
      static_cast<double>(examples) / rates_.examples_per_s +
      static_cast<double>(iterations) / rates_.iterations_per_s +
      kCalibrationCost * static_cast<double>(numbers_.examples.calibration_examples) / rates_.examples_per_s;
  return "; " + duration_text(now + later) + " to go in all";
}

void Learning::show(const char* name, const std::string& text) { line_.show(std::string(name) + ": " + text); }

void Learning::step(const std::string& name, ordered_json (Learning::*work)()) {
  if (record_.at("steps").contains(name)) return;
  const Clock::time_point began = Clock::now();
  const ordered_json found = (this->*work)();
  line_.end();
  const double earlier = seconds_.contains(name) && seconds_[name].is_number() ? seconds_[name].get<double>() : 0.0;
  seconds_[name] = earlier + std::chrono::duration<double>(Clock::now() - began).count();
  record_["steps"][name] = found;
  write_times();
  write_record();
}

ordered_json Learning::make_all_examples() {
  const struct {
    const char* name;
    std::int64_t examples;
  } parts[] = {{"fit", numbers_.examples.examples},
               {"calibration", numbers_.examples.calibration_examples},
               {"held_out", numbers_.examples.held_out_examples}};
  const auto& data = given_->params.data;
  const auto missing = [&](std::int64_t examples, const char* part) {  // those in files that are not there
    const std::int64_t files = (examples + data.shard_examples - 1) / data.shard_examples;
    return std::max<std::int64_t>(
        0, examples - data.shard_examples * (files - files_left(data, examples, examples_of(part))));
  };
  std::int64_t all = 0, failed = 0, left = 0;
  for (const auto& part : parts) {
    all += part.examples;
    left += missing(part.examples, part.name);
  }
  ordered_json found;
  for (std::size_t k = 0; k < std::size(parts); ++k) {
    const auto& part = parts[k];
    const std::int64_t left_here = missing(part.examples, part.name);
    left -= left_here;
    Context step = step_context(examples_of(part.name));
    step.seed = given_->seed + k;
    GenerateReport made;
    const auto progress = [&](const GenerateReport& report, std::int64_t total) {
      const double rate = static_cast<double>(report.made) / std::max(1e-3, report.seconds);
      const std::int64_t to_go = total - report.made;
      show("examples", std::to_string(all - left - to_go) + " of " + std::to_string(all) + ", " +
                           formatted("%.2f a second", rate) +
                           left_in_all(static_cast<double>(to_go) / rate, left, numbers_.iterations));
    };
    show("examples", std::to_string(all - left - left_here) + " of " + std::to_string(all) +
                         left_in_all(0.0, left + left_here, numbers_.iterations));
    make_examples(step, {config_file(), part.examples, "", call_.work, progress}, &made);
    require_not_stopped();
    found[part.name] = {{"examples", part.examples}, {"failed", made.failed()}};
    failed += made.failed();
  }
  if (100 * failed > kMostFailed * all) {
    throw Error(std::to_string(failed) + " of " + std::to_string(all) + " examples failed, more than " +
                std::to_string(kMostFailed) + " in a hundred; `weft dataset info` of the folders in " +
                (out_ / "examples").string() + " lists why");
  }
  return found;
}

ordered_json Learning::fit() {
  Context step = step_context(out_ / "model" / "fitted.h5");
  const auto progress = [&](const FitProgress& p) {
    std::string text = std::to_string(p.iteration) + " of " + std::to_string(p.iterations) + " iterations, ";
    if (p.seconds_left > 0.0)
      text += formatted("%.1f a second, ", static_cast<double>(p.iterations - p.iteration) / p.seconds_left);
    text += formatted("training loss %.3f", p.training_loss);
    if (p.validation_error_mm > 0.0)  // after the first evaluation
      text += formatted(", validation %.3f", p.validation_loss) + formatted(", %.1f mm", p.validation_error_mm);
    show("training", text + left_in_all(p.seconds_left, 0, 0));
    return true;
  };
  show("training", "reading the examples" + left_in_all(0.0, 0, numbers_.iterations));
  const int code =
      train_model(step, {.config = config_file(), .data = {examples_of("fit").string()}, .progress = progress});
  require_not_stopped();
  if (code != 0) throw Error("the fit did not end; run the same command again to go on");
  ordered_json found = ordered_json::object();
  const auto training = parse_json_if_valid(text_of_file(out_ / "model" / "training.json"));
  for (const char* key : {"iterations", "stopped_by", "best"})
    if (training.is_object() && training.contains(key)) found[key] = training[key];
  return found;
}

ordered_json Learning::calibrate() {
  Context step = step_context(out_ / "model" / "model.h5");
  step.overrides = {set_model("fitted.h5")};
  show("calibration", "refitting sigma" + left_in_all(0.0, 0, 0));
  calibrate_model(step, {config_file(), {examples_of("calibration").string()}});
  require_not_stopped();
  const auto record = parse_json_if_valid(text_of_file(out_ / "model" / "model.calibration.json"));
  ordered_json found = ordered_json::object();
  if (record.is_object() && record.contains("examples")) found["examples"] = record["examples"];
  return found;
}

ordered_json Learning::evaluate() {
  show("evaluation", "predicting the held-out examples");
  line_.end();
  Context step = step_context(out_ / "evaluation");
  step.is_step = context_.json;  // its table is what this command ends with
  step.overrides = {set_model("model.h5"), "evaluation.split=all"};
  PredictionEvaluation figures;
  const int code = evaluate_predictor(step, {config_file(), {examples_of("held_out").string()}, call_.work}, &figures);
  require_not_stopped();
  has_evaluated_ = true;
  if (code != 0) throw Error("not all held-out examples could be predicted");
  // The folder may be moved, and equal ones are equal wherever they were made.
  const fs::path saved = out_ / "evaluation" / "config.yaml";
  write_text(saved,
             ConfigNode::load(saved).with("predictor.params.model", ConfigNode::quoted("../model/model.h5")).to_yaml());
  std::int64_t all = 0, failed = 0;
  for (const auto& part : record_.at("steps").at("examples")) {
    all += part.at("examples").get<std::int64_t>();
    failed += part.at("failed").get<std::int64_t>();
  }
  const auto curve = curve_of(text_of_file(out_ / "model" / "training.json"));
  auto shortfalls = ordered_json::array();
  for (const Shortfall& one : find_shortfalls({all, failed, curve, figures}))
    shortfalls.push_back({{"what", one.what}, {"remedy", one.remedy}});
  const auto settled = parse_json(prediction_evaluation_json(figures)).at("settled");
  return {{"settled", settled}, {"short", shortfalls}};
}

void Learning::write_task() const {
  const fs::path file = out_ / "task.yaml";
  if (fs::exists(file)) return;
  const ConfigNode config = keep_params(ConfigNode::load(config_file()), describe_params<SessionParams>(),
                                        [](const ParamInfo&) { return true; });
  const ConfigNode plugin = place(config, "predictor.plugin");
  const ConfigNode task = config.with(
      "predictor",
      ConfigNode::mapping({{"plugin", ConfigNode::quoted(plugin.as_string())},
                           {"params", ConfigNode::mapping({{"model", ConfigNode::quoted("model/model.h5")}})}}));
  write_text(file, "# Plans with the model that `weft learn` made in this folder. Every key: docs/configuration.md\n" +
                       task.to_yaml());
}

void Learning::say_end() const {
  if (context_.json) {
    context_.output() << record_.dump(2) << '\n';
    return;
  }
  const auto& evaluation = record_.at("steps").at("evaluation");
  const auto& settled = evaluation.at("settled").at("from_start");
  if (settled.at("median_mm").is_number()) {
    context_.say("held-out settled shapes: off by " + formatted("%.1f mm", settled["median_mm"].get<double>()) +
                 " in the median, " + formatted("%.1f mm", settled.at("mean_mm").get<double>()) + " in the mean");
  }
  for (const auto& one : evaluation.at("short"))
    context_.say("short: " + one.at("what").get<std::string>() + ". Remedy: " + one.at("remedy").get<std::string>());
  if (evaluation.at("short").empty())
    context_.say("nothing was short of what docs/model.md asks for");
  else
    context_.say("to go on in this folder with its examples: " +
                 (call_.hours > 0.0 ? "--hours " + ConfigNode::number(4.0 * call_.hours).as_string()
                                    : "--set learn.examples=" + std::to_string(4 * numbers_.examples.examples)) +
                 " --accept-changed");
  if (!has_evaluated_) context_.say("to look at it, open " + (out_ / "evaluation" / "report.html").string());
  context_.say("to fold with it: weft run " + (out_ / "task.yaml").string());
}

}  // namespace weft::app
