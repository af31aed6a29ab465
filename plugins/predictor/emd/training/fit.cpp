// The loop of a fit: iterations, evaluations, checkpoints, the best model so far and the report.
#include "fit.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "../model_file.hpp"
#include "../training_library.hpp"
#include "batch_gradient.hpp"
#include "batch_sampler.hpp"
#include "calibration.hpp"
#include "checkpoint.hpp"
#include "learning_rate.hpp"
#include "normalisation.hpp"
#include "optimiser.hpp"
#include "passes.hpp"
#include "validation.hpp"

namespace weft::emd {
namespace {

using nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// Positions in the dataset.
struct Examples {
  std::vector<std::size_t> train, validation;

  explicit Examples(const FitJob& job)
      : train(job.dataset.select(Split::train)), validation(job.dataset.select(Split::validation)) {
    const std::size_t most = job.training.max_examples;
    if (most > 0 && most < train.size()) train.resize(most);
    if (train.empty()) throw ConfigError("weft train: the dataset has no example in its train split");
    if (validation.empty())
      throw ConfigError("weft train: the dataset has no example in its validation split; make more examples");
  }
};

/// The untrained model that the job describes.
void describe_model(FitJob& job) {
  Model& model = job.model;
  model.architecture = job.architecture;
  model.describe_task(job.task);
  model.dataset = job.dataset.header.identity;
  model.datasets = job.dataset.origins();
  model.provenance = job.options.provenance;
  if (model.dimensions.inputs() > 512) throw ConfigError("emd: the trajectory has too many variables");
  if (model.needs_basis() && job.architecture.latent > model.dimensions.coordinates()) {
    throw ConfigError("emd: architecture.latent = " + std::to_string(job.architecture.latent) +
                      ", must be at most 3 x vertices = " + std::to_string(model.dimensions.coordinates()));
  }
}

FitState first_state(const FitJob& job) {
  FitState state;
  const Layout layout(job.model.architecture, job.model.dimensions);
  draw_weights(layout, job.options.seed, state.weights);
  state.average = state.weights;
  state.first_moment.assign(layout.size, 0.0f);
  state.second_moment.assign(job.training.optimiser == "adam" ? layout.size : 0, 0.0f);
  state.rate = job.training.rate;
  return state;
}

class Fit {
 public:
  /// Keeps references to all but the state. The model has its normalisation.
  Fit(FitJob& job, Passes& passes, const Examples& examples, const Checkpoint& checkpoint, FitState state,
      Clock::time_point started)
      : job_(job),
        t_(job.training),
        model_(job.model),
        passes_(passes),
        examples_(examples),
        checkpoint_(checkpoint),
        state_(std::move(state)),
        sampler_(passes, examples.train, t_, job.options.seed),
        gradient_(passes, t_, state_.weights),
        optimiser_(t_, job.host, state_.weights.size()),
        validation_(passes, examples.validation, t_.evaluation_cases, job.options.seed),
        first_iteration_(state_.iteration),
        earlier_seconds_(state_.seconds),
        started_(started) {}

  void run() {
    std::string stopped_by = "iterations";
    bool is_cancelled = false;
    while (state_.iteration < t_.iterations && !is_cancelled) {
      if (t_.time_limit_s > 0 && seconds() >= t_.time_limit_s) {
        stopped_by = "time_limit";
        break;
      }
      if (state_.without_best >= t_.stop_after) {
        stopped_by = "early_stop";
        break;
      }
      step();
      is_cancelled = !evaluate_and_report() || job_.host.cancelled();
      if (is_cancelled || state_.iteration % t_.checkpoint_every == 0) save_checkpoint();
    }
    // The state may come from a checkpoint that was written after the last evaluation.
    const bool is_evaluated = !state_.curve.empty() && state_.curve.back().iteration == state_.iteration;
    if (state_.best_weights.empty() || (!is_cancelled && !is_evaluated)) evaluate();  // stopped in between
    finish(is_cancelled ? "cancelled" : stopped_by);
    job_.report.finished = !is_cancelled;
    if (!is_cancelled) checkpoint_.remove();
  }

 private:
  double seconds() const { return earlier_seconds_ + seconds_since(started_); }

  void step() {
    const double loss = gradient_.compute(sampler_.sequences(state_.iteration), sampler_.columns(state_.iteration));
    if (!std::isfinite(loss)) {
      throw Error("emd: the training loss is not finite after " + std::to_string(state_.iteration) +
                  " iterations; lower training.rate");
    }
    state_.loss_sum += loss;
    ++state_.loss_count;
    optimiser_.step(gradient_.parts(), state_);
    ++state_.iteration;
  }

  /// Evaluates when an evaluation is due. Reports after it, and every 10 s. @return false when the observer stops the
  /// fit.
  bool evaluate_and_report() {
    const bool is_due = state_.iteration % t_.evaluate_every == 0 || state_.iteration == t_.iterations;
    if (is_due) evaluate();
    if (!is_due && seconds_since(last_report_) <= 10.0) return true;
    const bool is_wanted = report(is_due);
    last_report_ = Clock::now();
    return is_wanted;
  }

  void evaluate() {
    const auto& weights = t_.average > 0 ? state_.average : state_.weights;
    const auto [loss, error_mm] = validation_.evaluate(weights);
    state_.validation_loss = loss;
    state_.validation_error_mm = error_mm;
    state_.training_loss = state_.mean_training_loss();
    state_.loss_sum = 0.0;
    state_.loss_count = 0;
    if (state_.best_weights.empty() || loss < state_.best_loss) {
      state_.best_loss = loss;
      state_.best_error_mm = error_mm;
      state_.best_iteration = state_.iteration;
      state_.best_weights = weights;
      state_.without_best = 0;
      reset_calibration();
      save_best();
    } else {
      ++state_.without_best;
      if (t_.optimiser == "signsgd") state_.rate = rate_without_best(t_, state_.rate, state_.without_best);
    }
    state_.curve.push_back({state_.iteration, state_.training_loss, loss, error_mm, state_.rate});
    if (t_.time_limit_s > 0) state_.time_used = std::min(1.0, seconds() / t_.time_limit_s);
  }

  bool report(bool is_evaluated) const {
    if (!job_.observer) return true;
    FitProgress p;
    p.iteration = state_.iteration;
    p.iterations = t_.iterations;
    p.seconds = seconds();
    const double done_here = state_.iteration - first_iteration_, here = p.seconds - earlier_seconds_;
    p.seconds_left = done_here > 0 ? here / done_here * (t_.iterations - state_.iteration) : 0.0;
    if (t_.time_limit_s > 0) p.seconds_left = std::min(p.seconds_left, t_.time_limit_s - p.seconds);
    p.rate = state_.rate;
    const bool has_newer = !is_evaluated && state_.loss_count > 0;
    p.training_loss = has_newer ? state_.mean_training_loss() : state_.training_loss;
    p.validation_loss = state_.validation_loss;
    p.validation_error_mm = state_.validation_error_mm;
    p.best_loss = state_.best_loss;
    return job_.observer(p);
  }

  void save_checkpoint() {
    state_.seconds = seconds();
    checkpoint_.save(state_, model_);
  }

  void reset_calibration() {
    model_.calibration.assign(4, 1.0f);
    model_.calibration_added.clear();
  }

  void save_best() {
    model_.weights = state_.best_weights;
    // No times in here: the same fit gives the same file.
    const ordered_json json{{"examples", examples_.train.size()},
                            {"iterations", state_.best_iteration},
                            {"validation_loss", state_.best_loss},
                            {"validation_error_mm", state_.best_error_mm}};
    model_.training = json.dump();
    if (!job_.options.model.empty()) save_model(job_.options.model, model_, t_.half_precision);
  }

  void finish(const std::string& stopped_by) {
    if (t_.half_precision) {
      for (float& w : state_.best_weights) w = round_to_half(w);
    }
    reset_calibration();
    if (t_.calibrate) {
      find_calibration(passes_, model_, {{examples_.validation, state_.best_weights}}, job_.options.seed);
    }
    save_best();
    auto& r = job_.report;
    r.iterations = state_.iteration;
    r.seconds = seconds();
    r.best_loss = state_.best_loss;
    r.resumed = first_iteration_ > 0;
    r.json = training_json(stopped_by).dump(2) + "\n";
  }

  /// Without times: the same fit gives the same file.
  ordered_json training_json(const std::string& stopped_by) const {
    ordered_json json;
    json["iterations"] = state_.iteration;
    json["stopped_by"] = stopped_by;
    json["examples"] = {{"train", examples_.train.size()}, {"validation", examples_.validation.size()}};
    json["parameters"] = state_.weights.size();
    json["dataset"] = job_.dataset.header.identity;
    json["seed"] = job_.options.seed;
    json["best"] = {{"iteration", state_.best_iteration},
                    {"validation_loss", state_.best_loss},
                    {"validation_error_mm", state_.best_error_mm}};
    json["calibration"] = model_.calibration;
    json["calibration_added"] = model_.calibration_added;
    auto curve = ordered_json::array();
    for (const auto& c : state_.curve) {
      curve.push_back({{"iteration", c.iteration},
                       {"training_loss", c.training_loss},
                       {"validation_loss", c.validation_loss},
                       {"validation_error_mm", c.validation_error_mm},
                       {"rate", c.rate}});
    }
    json["curve"] = curve;
    return json;
  }

  FitJob& job_;
  const Training& t_;
  Model& model_;
  Passes& passes_;
  const Examples& examples_;
  const Checkpoint& checkpoint_;
  FitState state_;
  BatchSampler sampler_;
  BatchGradient gradient_;
  Optimiser optimiser_;
  Validation validation_;
  std::int64_t first_iteration_;
  double earlier_seconds_;  ///< of the processes before this one
  Clock::time_point started_, last_report_ = Clock::now();
};

}  // namespace

void fit(FitJob& job) {
  const Clock::time_point started = Clock::now();
  const Examples examples(job);
  describe_model(job);
  Passes passes(job.dataset, job.model, job.host);
  const Checkpoint checkpoint(job, examples.train.size(), examples.validation.size());
  std::optional<FitState> state = checkpoint.load(job.model);
  if (!state) {
    find_normalisation(passes, examples.train, job.training.half_precision, job.model);
    state = first_state(job);
  }
  Fit(job, passes, examples, checkpoint, std::move(*state), started).run();
}

}  // namespace weft::emd
