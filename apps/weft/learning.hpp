#pragma once
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "context.hpp"
#include "learning/budget.hpp"
#include "prepared.hpp"
#include "processes/claims.hpp"
#include "progress_line.hpp"
#include "weft/trainable.hpp"
#include "work_options.hpp"

namespace weft::app {

struct LearnCall {
  std::string task;    ///< task or experiment file, or the folder of `weft garment import`
  double hours = 0.0;  ///< --hours; 0: the numbers are those of the config
  bool tune_displacement = false;
  WorkOptions work;
};

/// `weft learn`: from a task to a model that can ship.
///
/// 1. The task becomes one self-contained experiment, OUT/config.yaml. A short trial finds the rates of this machine, and
///    --hours becomes numbers in that file.
/// 2. The steps are the commands generate (three times), train, calibrate and evaluate prediction on that file. Each goes on
///    where it was killed, and gives the bytes of an undisturbed one.
/// 3. OUT/learn.json holds the numbers, and what each finished step found. What is in it is not done again.
/// 4. OUT/provenance.json refuses another task, and a claim a second process.
/// 5. OUT/task.yaml, which plans with the new model, is written last. What the model falls short of is in learn.json.
class Learning {
 public:
  /// Reads and checks all that is given. Changes nothing on the disk. @throws ConfigError.
  Learning(Context& context, const LearnCall& call);
  int run();

 private:
  using Clock = std::chrono::steady_clock;

  /// Options that make the task an experiment of a predictor that learns.
  std::vector<std::string> options_for_learning(const std::filesystem::path& file);
  void check_numbers(const std::filesystem::path& file) const;
  Identity make_identity_of_call() const;
  /// Reads learn.json of an earlier call. @return whether there is one.
  bool read_record();
  void say_plan() const;

  /// Waits until it is known that no other process learns in this folder. @throws ConfigError if one does.
  void take_folder();
  /// Writes config.yaml, tries rates, and writes the numbers.
  void plan();
  /// Tunes the displacement of the task in `saved`. @return what learn.json says of it; null unless it was asked for.
  nlohmann::ordered_json tune(ConfigNode& saved);
  void measure_rates();
  double measured_iterations_per_s();
  /// Examples that the trial needs: whole files, with some for the fit and some for its validation.
  std::int64_t trial_examples() const;
  /// The examples of the trial are the first ones of the fit.
  void keep_trial() const;

  // The steps. Each returns what learn.json says of it.
  nlohmann::ordered_json make_all_examples();
  nlohmann::ordered_json fit();
  nlohmann::ordered_json calibrate();
  nlohmann::ordered_json evaluate();
  /// Runs a step unless it is recorded.
  void step(const std::string& name, nlohmann::ordered_json (Learning::*work)());

  void write_task() const;
  void say_end() const;

  Context step_context(const std::filesystem::path& out) const;
  /// The value of --set that makes predictors use OUT/model/FILE.
  std::string set_model(const char* file) const;
  std::string config_file() const { return (out_ / "config.yaml").string(); }
  std::filesystem::path examples_of(const char* part) const { return out_ / "examples" / part; }
  /// @throws Interrupted if the user asked to stop.
  void require_not_stopped() const;
  void write_record() const;
  void write_times() const;
  /// "; 0:41:10 to go in all", or nothing while rates are not known.
  /// @param now seconds that this step still takes. @param examples, iterations of later steps.
  std::string left_in_all(double now, std::int64_t examples, std::int64_t iterations) const;
  void show(const char* name, const std::string& text);

  Context& context_;
  LearnCall call_;
  std::filesystem::path out_;
  Context task_context_;  ///< with the options that make the task an experiment
  std::unique_ptr<Prepared<ExperimentParams>> given_;
  std::string note_;  ///< what was changed of the task
  Identity identity_;
  LearnNumbers numbers_;
  bool is_accepted_change_ = false, has_evaluated_ = false;
  nlohmann::ordered_json record_;  ///< learn.json
  std::optional<Claims> claims_;
  LearnRates rates_;                                                   ///< 0: not known
  nlohmann::ordered_json seconds_ = nlohmann::ordered_json::object();  ///< by step
  Clock::time_point started_ = Clock::now();
  ProgressLine line_;
};

}  // namespace weft::app
