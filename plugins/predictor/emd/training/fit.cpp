// The loop of a fit: iterations, evaluations, checkpoints, the best model so far and the report.
#include "fit.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "../model_file.hpp"
#include "../training_library.hpp"
#include "batch_gradient.hpp"
#include "batch_sampler.hpp"
#include "calibration.hpp"
#include "checkpoint.hpp"
#include "gradient_sum.hpp"
#include "learning_rate.hpp"
#include "normalisation.hpp"
#include "optimiser.hpp"
#include "passes.hpp"
#include "ranks.hpp"
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

/// What rank 0 tells the others before each iteration.
struct Order {
  enum Kind : std::int64_t { go_on, stopped, finished };
  Kind kind = go_on;
  double rate = 0.0, time_used = 0.0;  ///< as in FitState
};

class Fit {
 public:
  /// Keeps references to all but the state. The model has its normalisation.
  Fit(FitJob& job, Passes& passes, const Examples& examples, const Checkpoint& checkpoint, Ranks& ranks, FitState state,
      Clock::time_point started)
      : job_(job),
        t_(job.training),
        model_(job.model),
        passes_(passes),
        examples_(examples),
        checkpoint_(checkpoint),
        ranks_(ranks),
        state_(std::move(state)),
        sampler_(passes, examples.train, t_, job.options.seed),
        gradient_(passes, t_, kernels(job.kernels), job.host, ranks, parts_of_batch(t_, ranks.size())),
        sum_(t_, job.host, ranks, state_.weights.size(), parts_of_batch(t_, ranks.size())),
        optimiser_(t_, kernels(job.kernels), job.host, state_.weights.size()),
        first_iteration_(state_.iteration),
        earlier_seconds_(state_.seconds),
        started_(started) {
    if (ranks.is_first()) validation_.emplace(passes, examples.validation, t_.evaluation_cases, job.options.seed);
  }

  /// Rank 0.
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
      try {
        order(Order::go_on);
        step();
      } catch (const RanksLost&) {
        save_checkpoint();  // of the last whole iteration
        throw;
      }
      is_cancelled = !evaluate_and_report() || is_stop_wanted_ || job_.host.cancelled();
      if (is_cancelled || state_.iteration % t_.checkpoint_every == 0) save_checkpoint();
    }
    try {
      order(is_cancelled ? Order::stopped : Order::finished);
    } catch (const RanksLost&) {
      // They are not needed any more.
    }
    // The state may come from a checkpoint that was written after the last evaluation.
    const bool is_evaluated = !state_.curve.empty() && state_.curve.back().iteration == state_.iteration;
    if (state_.best_weights.empty() || (!is_cancelled && !is_evaluated)) evaluate();  // stopped in between
    finish(is_cancelled ? "cancelled" : stopped_by);
    job_.report.finished = !is_cancelled;
    if (!is_cancelled) checkpoint_.remove();
  }

  /// The other ranks.
  void follow() {
    Order from_first;
    for (ranks_.broadcast(&from_first, 1); from_first.kind == Order::go_on; ranks_.broadcast(&from_first, 1)) {
      state_.rate = from_first.rate;
      state_.time_used = from_first.time_used;
      step();
    }
    job_.report.iterations = state_.iteration;
    job_.report.seconds = seconds();
    job_.report.resumed = first_iteration_ > 0;
    job_.report.finished = from_first.kind == Order::finished;
  }

  /// Of an exchange of the gradient with the other ranks, in the median; 0 without any.
  double exchange_seconds() {
    if (exchange_s_.empty()) return 0.0;
    const auto middle = exchange_s_.begin() + static_cast<std::ptrdiff_t>(exchange_s_.size() / 2);
    std::nth_element(exchange_s_.begin(), middle, exchange_s_.end());
    return *middle;
  }

 private:
  void order(Order::Kind kind) {
    Order told{kind, state_.rate, state_.time_used};
    ranks_.broadcast(&told, 1);
  }

  double seconds() const { return earlier_seconds_ + seconds_since(started_); }

  void step() {
    const auto sequences = sampler_.sequences(state_.iteration);
    if (passes_.reads_files()) {
      if (state_.iteration == first_iteration_) passes_.read_ahead(gradient_.examples(sequences));
      passes_.read_ahead(gradient_.examples(sampler_.sequences(state_.iteration + 1)));
    }
    const double loss =
        mean_loss(sequences, gradient_.compute(state_.weights, sequences, sampler_.columns(state_.iteration)));
    if (!std::isfinite(loss)) {
      throw Error("emd: the training loss is not finite after " + std::to_string(state_.iteration) +
                  " iterations; lower training.rate");
    }
    const auto begun = Clock::now();  // mean_loss() has waited for all ranks
    const auto direction = sum_.join(gradient_.parts());
    if (ranks_.size() > 1) exchange_s_.push_back(static_cast<float>(seconds_since(begun)));
    state_.loss_sum += loss;
    ++state_.loss_count;
    optimiser_.step(direction, state_);
    ++state_.iteration;
  }

  /// Of the whole batch; asks all ranks for it, and whether one is to stop.
  /// @param losses [parts of this rank], as from BatchGradient.
  double mean_loss(const std::vector<Sequence>& sequences, std::vector<double> losses) {
    double sum = 0.0, shapes = 0.0;
    losses.push_back(job_.host.cancelled() ? 1.0 : 0.0);
    const std::size_t each = losses.size();
    std::vector<double> all(ranks_.size() * each);
    ranks_.gather(reinterpret_cast<const std::byte*>(losses.data()), reinterpret_cast<std::byte*>(all.data()),
                  each * sizeof(double));
    for (std::size_t k = 0; k < all.size(); ++k) {
      if (k % each + 1 < each)
        sum += all[k];
      else if (all[k] > 0.0)
        is_stop_wanted_ = true;
    }
    for (const auto& s : sequences) shapes += s.decoded.size();
    return sum / shapes;
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
    const auto [loss, error_mm] = validation_->evaluate(weights);
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
  Ranks& ranks_;
  FitState state_;
  BatchSampler sampler_;
  BatchGradient gradient_;
  GradientSum sum_;
  Optimiser optimiser_;
  std::optional<Validation> validation_;  // of rank 0
  bool is_stop_wanted_ = false;           // by any rank
  std::vector<float> exchange_s_;         // of each iteration
  std::int64_t first_iteration_;
  double earlier_seconds_;  ///< of the processes before this one
  Clock::time_point started_, last_report_ = Clock::now();
};

/// Gives all ranks what iterations need of rank 0's state and model.
void share(Ranks& ranks, FitState& state, Model& model) {
  for (auto* values : {&state.weights, &state.first_moment, &state.second_moment, &model.mean, &model.basis,
                       &model.scale, &model.input_mean, &model.input_sd})
    ranks.broadcast(*values);
  ranks.broadcast(&state.iteration, 1);
  if (!ranks.is_first()) state.average = state.weights;
}

}  // namespace

void fit(FitJob& job) {
  const Clock::time_point started = Clock::now();
  parts_of_batch(job.training, static_cast<std::size_t>(job.options.ranks.size));  // says what is wrong with them
  const Examples examples(job);
  describe_model(job);
  Passes passes(job.dataset, job.model, job.host);
  const Checkpoint checkpoint(job, examples.train.size(), examples.validation.size());
  Ranks ranks(job.options.ranks);
  const char* variant = std::getenv("ATEN_CPU_CAPABILITY");  // see training_library.cpp
  ranks.require_same(checkpoint.identity() + " " + (variant != nullptr ? variant : ""));
  std::optional<FitState> state;
  if (ranks.is_first()) {
    state = checkpoint.load(job.model);
    if (!state) {
      find_normalisation(passes, examples.train, job.training.half_precision, job.model);
      state = first_state(job);
    }
  } else {
    state.emplace();
  }
  ranks.wait_for_first();
  share(ranks, *state, job.model);
  Fit fit(job, passes, examples, checkpoint, ranks, std::move(*state), started);
  if (ranks.is_first())
    fit.run();
  else
    fit.follow();
  if (const auto done = job.report.iterations; ranks.size() > 1 && done > 0) {
    char line[160];
    std::snprintf(line, sizeof(line),
                  "emd: rank %zu of %zu sent %.3f MB in all; an exchange of the gradient took %.2f ms", ranks.rank(),
                  ranks.size(), static_cast<double>(ranks.bytes_sent()) / 1e6, 1e3 * fit.exchange_seconds());
    job.host.log(LogLevel::info, line);
  }
}

}  // namespace weft::emd
