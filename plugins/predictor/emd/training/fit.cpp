// Training, on libtorch: the network as a graph for autograd, the loss, the optimisers, checkpoints. A library of its
// own, so that prediction needs no libtorch.
#include "../model_file.hpp"
#include "../training_library.hpp"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>

#include "calibration.hpp"
#include "passes.hpp"
#include "weft/hdf5_file.hpp"
#include "weft/random.hpp"

namespace weft::emd {
namespace {

using nlohmann::ordered_json;

constexpr std::size_t kChunks = 64;  // of the weights, for what is done to each of them
constexpr const char* kCheckpointSchema = "weft emd checkpoint 1";

std::size_t size_of(Index rows, Index columns) { return static_cast<std::size_t>(rows * columns); }
class Fit {
 public:
  explicit Fit(FitJob& job)
      : job_(job),
        t_(job.training),
        model_(job.model),
        layout_(job.architecture, dimensions(job.task)),
        passes_(job.dataset, model_, job.host) {
    train_ = job.dataset.select(Split::train);
    validation_ = job.dataset.select(Split::validation);
    if (t_.max_examples > 0 && static_cast<std::size_t>(t_.max_examples) < train_.size())
      train_.resize(static_cast<std::size_t>(t_.max_examples));
    if (train_.empty()) throw ConfigError("weft train: the dataset has no example in its train split");
    if (validation_.empty())
      throw ConfigError("weft train: the dataset has no example in its validation split; make more examples");
    model_.architecture = job.architecture;
    model_.describe_task(job.task);
    model_.dataset = job.dataset.header.identity;
    model_.datasets = job.dataset.origins();
    model_.provenance = job.options.provenance;
    if (model_.dimensions.inputs() > 512) throw ConfigError("emd: the trajectory has too many variables");
    if (model_.needs_basis() && job.architecture.latent > model_.dimensions.coordinates()) {
      throw ConfigError("emd: architecture.latent = " + std::to_string(job.architecture.latent) +
                        ", must be at most 3 x vertices = " + std::to_string(model_.dimensions.coordinates()));
    }
    identity_ = make_identity();
  }

  void run() {
    started_ = std::chrono::steady_clock::now();
    if (!resume()) begin();
    planned_ = t_.iterations;
    gradients_.assign(layout_.size, 0.0f);
    const bool is_vote = t_.optimiser == "signsgd";
    for (std::int64_t p = 0; p < std::min(is_vote ? t_.votes : t_.parts, t_.batch); ++p) {
      workers_.push_back(std::make_unique<Worker>());
      workers_.back()->gradients.assign(layout_.size, 0.0f);
      workers_.back()->graph.emplace(model_, weights_.data(), workers_.back()->gradients.data());
    }
    make_validation();
    std::string stopped = "iterations";
    bool is_cancelled = false;
    auto last_report = std::chrono::steady_clock::now();
    while (iteration_ < planned_) {
      if (t_.time_limit_s > 0 && seconds() >= t_.time_limit_s) {
        stopped = "time_limit";
        break;
      }
      if (without_best_ >= t_.stop_after) {
        stopped = "early_stop";
        break;
      }
      step();
      ++iteration_;
      const bool is_last = iteration_ == planned_;
      bool is_wanted = true;
      if (iteration_ % t_.evaluate_every == 0 || is_last) {
        evaluate();
        is_wanted = report(true);
        last_report = std::chrono::steady_clock::now();
      } else if (std::chrono::duration<double>(std::chrono::steady_clock::now() - last_report).count() > 10.0) {
        is_wanted = report(false);
        last_report = std::chrono::steady_clock::now();
      }
      is_cancelled = !is_wanted || job_.host.cancelled();
      if (is_cancelled || iteration_ % t_.checkpoint_every == 0) save_checkpoint();
      if (is_cancelled) break;
    }
    if (best_weights_.empty() || (!is_cancelled && evaluated_at_ != iteration_)) evaluate();  // stopped in between
    finish(is_cancelled ? "cancelled" : stopped);
    job_.report.finished = !is_cancelled;
    if (!is_cancelled && !job_.options.checkpoint.empty()) {
      std::error_code ignored;
      std::filesystem::remove(job_.options.checkpoint, ignored);
    }
  }

 private:
  static Dimensions dimensions(const Task& task) {
    Model m;
    m.describe_task(task);
    return m.dimensions;
  }
  double seconds() const {
    return earlier_seconds_ + std::chrono::duration<double>(std::chrono::steady_clock::now() - started_).count();
  }
  /// Everything that the result depends on.
  std::string make_identity() const {
    std::string text = job_.dataset.header.identity + " " + std::to_string(train_.size()) + " " +
                       std::to_string(validation_.size()) + " " + std::to_string(job_.options.seed);
    struct Writer {
      std::string& out;
      void operator()(const char*, double& v, const Range&, const char*) {
        out += " " + ConfigNode::number(v).as_string();
      }
      void operator()(const char*, std::int64_t& v, const Range&, const char*) { out += " " + std::to_string(v); }
      void operator()(const char*, bool& v, const char*) { out += v ? " 1" : " 0"; }
      void operator()(const char*, std::string& v, const Choice&, const char*) { out += " " + v; }
    } writer{text};
    Architecture a = job_.architecture;
    Training t = t_;
    t.time_limit_s = 0;  // may be raised from one run to the next
    t.checkpoint_every = 1;
    a.visit(writer);
    t.visit(writer);
    return text;
  }

  // --- start
  // -------------------------------------------------------------------------------------------------------------

  void begin() {
    normalise_shapes();
    normalise_inputs();
    draw_weights(layout_, job_.options.seed, weights_);
    first_moment_.assign(layout_.size, 0.0f);
    second_moment_.assign(t_.optimiser == "adam" ? layout_.size : 0, 0.0f);
    average_ = weights_;
    rate_ = t_.rate;
  }

  void normalise_shapes() {
    const Index n = model_.dimensions.coordinates();
    const auto width = static_cast<std::size_t>(n);
    std::vector<double> sum(width, 0.0);
    std::size_t count = 0;
    for (const auto i : train_) {
      const auto& shapes = passes_.example(i).shapes;
      for (std::size_t s = 0; s < shapes.size(); ++s) sum[s % width] += static_cast<double>(shapes[s]);
      count += shapes.size() / width;
    }
    model_.mean.resize(width);
    for (std::size_t c = 0; c < width; ++c)
      model_.mean[c] = static_cast<float>(sum[c] / static_cast<double>(count)) / kLength;
    if (!model_.needs_basis()) return;

    // Principal components of at most 12000 shapes, evenly spread.
    const std::size_t stride = std::max<std::size_t>(1, count / 12000);
    std::vector<float> rows;
    std::size_t number = 0;
    for (const auto i : train_) {
      const auto& shapes = passes_.example(i).shapes;
      for (std::size_t s = 0; s + width <= shapes.size(); s += width, ++number) {
        if (number % stride != 0) continue;
        for (std::size_t c = 0; c < width; ++c) rows.push_back(shapes[s + c] / kLength - model_.mean[c]);
      }
    }
    const auto m = static_cast<Index>(rows.size() / width);
    const Tensor x = view(rows.data(), m, n);
    const auto [values, vectors] = at::linalg_eigh(at::mm(x.t(), x).to(at::kDouble) / static_cast<double>(m));
    const Index latent = job_.architecture.latent;
    model_.basis.resize(size_of(n, latent));
    model_.scale.resize(static_cast<std::size_t>(latent));
    const Tensor columns = vectors.contiguous();
    const auto* v = columns.data_ptr<double>();
    const auto* e = values.data_ptr<double>();
    const double largest = std::sqrt(std::max(e[n - 1], 1e-12));
    for (Index j = 0; j < latent; ++j) {
      const Index column = n - 1 - j;
      double peak = 0.0;
      for (Index c = 0; c < n; ++c) {
        if (std::abs(v[c * n + column]) > std::abs(peak)) peak = v[c * n + column];
      }
      const double sign = peak < 0 ? -1.0 : 1.0;
      for (Index c = 0; c < n; ++c)
        model_.basis[size_of(c, latent) + static_cast<std::size_t>(j)] = static_cast<float>(sign * v[c * n + column]);
      const double sd = std::max(std::sqrt(std::max(e[column], 0.0)), 1e-3 * largest);
      const double p = job_.architecture.whitening;
      model_.scale[static_cast<std::size_t>(j)] = static_cast<float>(std::pow(largest, 1.0 - p) * std::pow(sd, p));
    }
    if (t_.half_precision) {
      for (float& b : model_.basis) b = round_to_half(b);
    }
  }

  void normalise_inputs() {
    const auto& d = model_.dimensions;
    const auto u = static_cast<std::size_t>(d.inputs());
    std::vector<double> sum(u, 0.0), squares(u, 0.0), raw(u);
    model_.control_low.assign(static_cast<std::size_t>(d.controls), std::numeric_limits<double>::infinity());
    model_.control_high.assign(static_cast<std::size_t>(d.controls), -std::numeric_limits<double>::infinity());
    double count = 0;
    for (const auto i : train_) {
      const auto& e = passes_.example(i);
      for (Index j = 0; j < e.segments(); ++j, ++count) {
        passes_.raw_inputs(e, j, {}, raw.data());
        for (std::size_t k = 0; k < u; ++k) {
          sum[k] += raw[k];
          squares[k] += raw[k] * raw[k];
        }
        for (std::size_t k = 0; k < model_.control_low.size(); ++k) {
          model_.control_low[k] = std::min(model_.control_low[k], raw[k]);
          model_.control_high[k] = std::max(model_.control_high[k], raw[k]);
        }
      }
    }
    model_.input_mean.resize(u);
    model_.input_sd.resize(u);
    for (std::size_t k = 0; k < u; ++k) {
      const double mean = sum[k] / count;
      const double variance = squares[k] / count - mean * mean;
      model_.input_mean[k] = static_cast<float>(mean);
      // A variable that never changed is left out: whatever it does later moves the input little.
      model_.input_sd[k] = variance > 1e-12 * (1e-6 + mean * mean) ? static_cast<float>(std::sqrt(variance)) : 1e3f;
    }
    const auto fixed = [&](Index at, float mean, float sd) {
      model_.input_mean[static_cast<std::size_t>(at)] = mean;
      model_.input_sd[static_cast<std::size_t>(at)] = sd;
    };
    fixed(d.released_input(), 0.0f, 0.5f);
    for (Index p = 0; p < 4; ++p) {
      fixed(d.centre_input() + p, 0.5f, 0.29f);
      fixed(d.width_input() + p, 0.33f, 0.3f);
    }
  }

  // --- batches
  // -----------------------------------------------------------------------------------------------------------

  /// The sub-sequences of one iteration: a function of (seed, iteration), which is what makes resuming exact.
  std::vector<Sequence> draw(std::int64_t iteration) const {
    const RandomStream streams(job_.options.seed, 0x6261746368ull, static_cast<std::uint64_t>(iteration));
    std::vector<Sequence> sequences(static_cast<std::size_t>(t_.batch));
    for (std::size_t b = 0; b < sequences.size(); ++b) {
      RandomStream random = streams.child(b);
      const std::size_t i = train_[random.below(train_.size())];
      sequences[b] = sample_sequence(i, passes_.example(i), t_, random);
    }
    return sequences;
  }

  /// Coordinates of the vertices that enter the loss of one iteration.
  std::vector<std::int64_t> draw_columns(std::int64_t iteration) const {
    std::vector<std::int64_t> columns;
    if (t_.vertex_share >= 1.0) return columns;
    const Index vertices = model_.dimensions.vertices;
    const auto wanted = std::max<Index>(1, std::llround(t_.vertex_share * static_cast<double>(vertices)));
    RandomStream random(job_.options.seed, 0x636f6c756d6e73ull, static_cast<std::uint64_t>(iteration));
    Index left = wanted;  // selection sampling: ascending, each set of that size equally likely
    for (Index v = 0; v < vertices && left > 0; ++v) {
      if (random.below(static_cast<std::uint64_t>(vertices - v)) >= static_cast<std::uint64_t>(left)) continue;
      for (Index axis = 0; axis < 3; ++axis) columns.push_back(3 * v + axis);
      --left;
    }
    return columns;
  }

  struct Loss {
    double sum = 0.0;            ///< over shapes: mean over coordinates of the negative log-likelihood
    std::vector<double> error;   ///< per shape: mean vertex distance, mm
    Tensor d_mean, d_log_sigma;  ///< of the mean over `total` shapes
  };
  /// Negative log-likelihood per coordinate, (x - mu)^2 / (2 sigma^2) + log sigma, without the constant.
  /// @param total shapes that the gradient is the mean over; 0: no gradient wanted.
  Loss loss(const Graph::Output& out, const Batch& batch, double total = 0.0) const {
    const at::NoGradGuard guard;
    const auto shapes = static_cast<Index>(batch.wanted.size());
    const Index n = out.mean.size(1);
    const float floor = static_cast<float>(job_.architecture.sigma_floor_m) / kLength;
    const Tensor raw = out.log_sigma.detach();
    const Tensor e = at::exp(at::clamp_max(raw, kLargestLogSigma));
    const Tensor sigma = e + floor;
    const Tensor difference = out.mean.detach() - passes_.target(batch);
    const Tensor r = difference / sigma;
    const Tensor square = r * r;
    const Tensor terms = at::mean(square * 0.5 + at::log(sigma), 1).contiguous();
    Loss result;
    const auto* values = terms.data_ptr<float>();
    for (Index w = 0; w < shapes; ++w) result.sum += static_cast<double>(values[w]);
    if (total > 0) {
      const auto scale = static_cast<float>(1.0 / (total * static_cast<double>(n)));
      // beta-NLL (Seitzer et al. 2022): sigma^(2 beta), taken as a constant, times each term.
      const Tensor weight = t_.beta > 0 ? at::pow(sigma, 2.0 * t_.beta) * scale : Tensor();
      result.d_mean = r / sigma;
      result.d_log_sigma = (1.0 - square) / sigma * e * (raw < kLargestLogSigma);
      if (weight.defined()) {
        result.d_mean *= weight;
        result.d_log_sigma *= weight;
      } else {
        result.d_mean *= scale;
        result.d_log_sigma *= scale;
      }
    } else {
      const Tensor distance =
          at::mean(at::sqrt(at::sum(at::square(difference.reshape({shapes, n / 3, 3})), 2)), 1).contiguous();
      for (Index w = 0; w < shapes; ++w) {
        result.error.push_back(static_cast<double>(distance.data_ptr<float>()[w]) * kLength * 1e3);
      }
    }
    return result;
  }

  // --- one iteration
  // -----------------------------------------------------------------------------------------------------

  /// A part of the batch: its own leaves over the same weights, so that parts can be differentiated side by side.
  struct Worker {
    std::vector<float> gradients;
    std::optional<Graph> graph;
    Batch batch;
    double loss = 0.0;
  };

  void step() {
    auto sequences = draw(iteration_);
    const auto columns = draw_columns(iteration_);
    const std::size_t parts = workers_.size();
    double shapes = 0.0;
    for (const auto& s : sequences) shapes += static_cast<double>(s.decoded.size());
    passes_.side_by_side(parts, [&](std::size_t p) {
      auto& worker = *workers_[p];
      std::vector<Sequence> part;
      for (std::size_t i = p; i < sequences.size(); i += parts) part.push_back(sequences[i]);
      worker.batch = passes_.make_batch(std::move(part));
      worker.batch.columns = columns;
      std::fill(worker.gradients.begin(), worker.gradients.end(), 0.0f);
      const Graph::Output out = passes_.forward(*worker.graph, worker.batch);
      const Loss l = loss(out, worker.batch, shapes);
      torch::autograd::backward({out.mean, out.log_sigma}, {l.d_mean, l.d_log_sigma});
      worker.loss = l.sum;
    });
    double sum = 0.0;
    for (const auto& worker : workers_) sum += worker->loss;
    add_training_loss(sum / shapes);
    if (t_.optimiser == "signsgd") {
      // Majority vote (Bernstein et al. 2018): the sign of each part's gradient, summed, and the sign of that.
      const auto rate = static_cast<float>(rate_);
      in_chunks([&](std::size_t, std::size_t from, std::size_t to) {
        for (std::size_t i = from; i < to; ++i) {
          int votes = 0;
          for (const auto& worker : workers_) votes += (worker->gradients[i] > 0) - (worker->gradients[i] < 0);
          weights_[i] -= rate * static_cast<float>((votes > 0) - (votes < 0));
        }
      });
    } else {
      adam();
    }
    if (t_.average > 0) {
      const auto n = static_cast<double>(iteration_);
      const auto keep = static_cast<float>(std::min(t_.average, (1.0 + n) / (10.0 + n)));
      in_chunks([&](std::size_t, std::size_t from, std::size_t to) {
        for (std::size_t i = from; i < to; ++i) average_[i] = keep * average_[i] + (1.0f - keep) * weights_[i];
      });
    }
  }

  /// body(chunk, from, to) over the weights. Chunks do not depend on the threads.
  template <class Body>
  void in_chunks(const Body& body) {
    const std::size_t size = (layout_.size + kChunks - 1) / kChunks;
    job_.host.parallel_for(static_cast<std::int64_t>(kChunks), [&](std::int64_t c) {
      const std::size_t from = std::min(static_cast<std::size_t>(c) * size, layout_.size);
      body(static_cast<std::size_t>(c), from, std::min(from + size, layout_.size));
    });
  }

  void add_training_loss(double value) {
    if (!std::isfinite(value))
      throw Error("emd: the training loss is not finite after " + std::to_string(iteration_) +
                  " iterations; lower training.rate");
    loss_sum_ += value;
    ++loss_count_;
  }

  void adam() {
    std::array<double, kChunks> squares{};
    in_chunks([&](std::size_t chunk, std::size_t from, std::size_t to) {
      for (std::size_t i = from; i < to; ++i) {
        float g = 0.0f;
        for (const auto& worker : workers_) g += worker->gradients[i];
        gradients_[i] = g;
        squares[chunk] += static_cast<double>(g) * static_cast<double>(g);
      }
    });
    const double norm = std::sqrt(std::accumulate(squares.begin(), squares.end(), 0.0));
    const auto clip = static_cast<float>(t_.clip > 0 && norm > t_.clip ? t_.clip / norm : 1.0);
    const double n = static_cast<double>(iteration_) + 1.0;
    const double warm = t_.warmup > 0 ? std::min(1.0, n / static_cast<double>(t_.warmup)) : 1.0;
    double done = static_cast<double>(iteration_) / static_cast<double>(planned_);
    if (t_.time_limit_s > 0) done = std::max(done, schedule_);
    rate_ = warm * (t_.final_rate + 0.5 * (t_.rate - t_.final_rate) * (1.0 + std::cos(M_PI * std::min(1.0, done))));
    constexpr double kBeta1 = 0.9, kBeta2 = 0.99;
    const auto correct1 = static_cast<float>(1.0 / (1.0 - std::pow(kBeta1, n)));
    const auto correct2 = static_cast<float>(1.0 / (1.0 - std::pow(kBeta2, n)));
    const auto rate = static_cast<float>(rate_);
    const auto decay = static_cast<float>(rate_ * t_.weight_decay);
    in_chunks([&](std::size_t, std::size_t from, std::size_t to) {
      constexpr float b1 = kBeta1, b2 = kBeta2;
      for (std::size_t i = from; i < to; ++i) {
        const float g = gradients_[i] * clip;
        first_moment_[i] = b1 * first_moment_[i] + (1.0f - b1) * g;
        second_moment_[i] = b2 * second_moment_[i] + (1.0f - b2) * g * g;
        weights_[i] -= rate * first_moment_[i] * correct1 / (std::sqrt(second_moment_[i] * correct2) + 1e-8f) +
                       decay * weights_[i];
      }
    });
  }

  // --- validation
  // --------------------------------------------------------------------------------------------------------

  void make_validation() {
    // From the start and from every other start in turn, with knowledge of eq. 3: the same cases at every evaluation.
    const RandomStream streams(job_.options.seed, 0x76616c6964ull);
    std::vector<Sequence> all;
    for (std::size_t i = 0; static_cast<std::int64_t>(all.size()) < t_.evaluation_cases && i < 2 * validation_.size();
         ++i) {
      RandomStream random = streams.child(i);
      Sequence s;
      s.example = validation_[i / 2];
      const auto& e = passes_.example(s.example);
      s.start = i % 2 == 0 ? 0 : static_cast<Index>(random.below(static_cast<std::uint64_t>(e.segments())));
      s.steps = e.segments() - s.start;
      s.knowledge = sample_knowledge(e.q, 0.3, 0.3, random);
      for (Index j = 1; j <= s.steps; ++j) s.decoded.push_back(j);
      all.push_back(s);
    }
    validation_batches_ = passes_.in_batches(all);
  }
  const std::vector<float>& evaluated_weights() const { return t_.average > 0 ? average_ : weights_; }

  std::vector<Loss> validate(const Graph& graph) {
    std::vector<Loss> losses(validation_batches_.size());
    passes_.side_by_side(losses.size(), [&](std::size_t b) {
      const at::NoGradGuard guard;
      losses[b] = loss(passes_.forward(graph, validation_batches_[b]), validation_batches_[b]);
    });
    return losses;
  }

  void evaluate() {
    evaluated_at_ = iteration_;
    std::vector<float> weights = evaluated_weights();
    const Graph graph(model_, weights.data(), nullptr);
    double sum = 0.0, error = 0.0;
    std::size_t shapes = 0, ends = 0;
    const auto losses = validate(graph);
    for (std::size_t b = 0; b < losses.size(); ++b) {
      const auto& batch = validation_batches_[b];
      const auto& l = losses[b];
      sum += l.sum;
      shapes += batch.wanted.size();
      for (std::size_t w = 0; w < batch.wanted.size(); ++w) {
        if (w + 1 < batch.wanted.size() && batch.wanted[w + 1].row == batch.wanted[w].row) continue;
        error += l.error[w];
        ++ends;
      }
    }
    validation_loss_ = sum / static_cast<double>(shapes);
    validation_error_ = error / static_cast<double>(ends);
    training_loss_ = loss_count_ > 0 ? loss_sum_ / static_cast<double>(loss_count_) : 0.0;
    loss_sum_ = 0.0;
    loss_count_ = 0;
    if (best_weights_.empty() || validation_loss_ < best_loss_) {
      best_loss_ = validation_loss_;
      best_error_ = validation_error_;
      best_iteration_ = iteration_;
      best_weights_ = std::move(weights);
      without_best_ = 0;
      save_best(false);
    } else {
      ++without_best_;
      // Automatic adjustment of the rate: halved after `patience` evaluations without a new best.
      if (t_.optimiser == "signsgd" && without_best_ % t_.patience == 0) rate_ *= 0.5;
    }
    curve_.push_back({static_cast<double>(iteration_), training_loss_, validation_loss_, validation_error_, rate_});
    if (t_.time_limit_s > 0) schedule_ = std::min(1.0, seconds() / t_.time_limit_s);
  }

  bool report(bool is_evaluated) {
    FitProgress p;
    p.iteration = iteration_;
    p.iterations = planned_;
    p.seconds = seconds();
    const double done_here = static_cast<double>(iteration_ - first_iteration_);
    const double here = p.seconds - earlier_seconds_;
    p.seconds_left = done_here > 0 ? here / done_here * static_cast<double>(planned_ - iteration_) : 0.0;
    if (t_.time_limit_s > 0) p.seconds_left = std::min(p.seconds_left, t_.time_limit_s - p.seconds);
    p.rate = rate_;
    p.training_loss = is_evaluated || loss_count_ == 0 ? training_loss_ : loss_sum_ / static_cast<double>(loss_count_);
    p.validation_loss = validation_loss_;
    p.validation_error_mm = validation_error_;
    p.best_loss = best_loss_;
    return !job_.observer || job_.observer(p);
  }

  // --- files
  // -------------------------------------------------------------------------------------------------------------

  void save_best(bool is_final) {
    model_.weights = best_weights_;
    if (!is_final) {
      model_.calibration.assign(4, 1.0f);
      model_.calibration_added.clear();
    }
    // Nothing of the clock in here: the same fit gives the same file.
    ordered_json j{{"examples", train_.size()},
                   {"iterations", best_iteration_},
                   {"validation_loss", best_loss_},
                   {"validation_error_mm", best_error_}};
    model_.training = j.dump();
    if (!job_.options.model.empty()) save_model(job_.options.model, model_, t_.half_precision);
  }

  void finish(const std::string& stopped) {
    if (t_.half_precision) {
      for (float& w : best_weights_) w = round_to_half(w);
    }
    model_.calibration.assign(4, 1.0f);
    model_.calibration_added.clear();
    if (t_.calibrate) find_calibration(passes_, model_, {{validation_, best_weights_}}, job_.options.seed);
    save_best(true);
    auto& r = job_.report;
    r.iterations = iteration_;
    r.seconds = seconds();
    r.best_loss = best_loss_;
    r.resumed = first_iteration_ > 0;
    ordered_json json;
    json["iterations"] = iteration_;
    json["stopped_by"] = stopped;
    json["seconds"] = r.seconds;
    json["iterations_per_s"] =
        static_cast<double>(iteration_ - first_iteration_) / std::max(1e-9, r.seconds - earlier_seconds_);
    json["threads"] = job_.host.threads();
    json["examples"] = {{"train", train_.size()}, {"validation", validation_.size()}};
    json["parameters"] = layout_.size;
    json["dataset"] = job_.dataset.header.identity;
    json["seed"] = job_.options.seed;
    json["best"] = {
        {"iteration", best_iteration_}, {"validation_loss", best_loss_}, {"validation_error_mm", best_error_}};
    json["calibration"] = model_.calibration;
    json["calibration_added"] = model_.calibration_added;
    auto curve = ordered_json::array();
    for (const auto& c : curve_) {
      curve.push_back({{"iteration", static_cast<std::int64_t>(c[0])},
                       {"training_loss", c[1]},
                       {"validation_loss", c[2]},
                       {"validation_error_mm", c[3]},
                       {"rate", c[4]}});
    }
    json["curve"] = curve;
    r.json = json.dump(2) + "\n";
  }

  void save_checkpoint() {
    if (job_.options.checkpoint.empty()) return;
    auto file = Hdf5File::create(job_.options.checkpoint);
    file.write("/schema", std::string(kCheckpointSchema));
    file.write("/identity", identity_);
    const auto write = [&](const char* name, const std::vector<float>& v) {
      if (!v.empty()) file.write(name, {static_cast<Index>(v.size())}, v.data());
    };
    write("/weights", weights_);
    write("/first_moment", first_moment_);
    write("/second_moment", second_moment_);
    write("/average", average_);
    write("/best_weights", best_weights_);
    write("/mean", model_.mean);
    write("/basis", model_.basis);
    write("/scale", model_.scale);
    write("/input_mean", model_.input_mean);
    write("/input_sd", model_.input_sd);
    file.write("/control_low", {static_cast<Index>(model_.control_low.size())}, model_.control_low.data());
    file.write("/control_high", {static_cast<Index>(model_.control_high.size())}, model_.control_high.data());
    const double numbers[] = {rate_,          loss_sum_, best_loss_, best_error_, validation_loss_, validation_error_,
                              training_loss_, seconds(), schedule_};
    file.write("/numbers", {9}, numbers);
    const std::int64_t counts[] = {iteration_, loss_count_, best_iteration_, without_best_};
    file.write("/counts", {4}, counts);
    std::vector<double> curve;
    for (const auto& c : curve_) curve.insert(curve.end(), c.begin(), c.end());
    file.write("/curve", {static_cast<Index>(curve_.size()), 5}, curve.data());
    file.commit();
  }

  bool resume() {
    const auto& path = job_.options.checkpoint;
    if (path.empty() || !std::filesystem::exists(path)) return false;
    const auto file = Hdf5File::open(path);
    if (!file.has("/schema") || file.read_text("/schema") != kCheckpointSchema)
      throw ConfigError(path.string() + ": is no checkpoint of the predictor emd");
    if (file.read_text("/identity") != identity_) {
      throw ConfigError(path.string() + ": belongs to a fit with other settings or data; remove it to start anew");
    }
    const auto read = [&](const char* name, std::size_t size) {
      auto v = file.read_float(name, size + 1);
      if (v.size() != size) throw ConfigError(path.string() + ": " + name + " has the wrong size");
      return v;
    };
    weights_ = read("/weights", layout_.size);
    first_moment_ = read("/first_moment", layout_.size);
    if (t_.optimiser == "adam") second_moment_ = read("/second_moment", layout_.size);
    average_ = read("/average", layout_.size);
    if (file.has("/best_weights")) best_weights_ = read("/best_weights", layout_.size);
    const auto n = static_cast<std::size_t>(model_.dimensions.coordinates()),
               l = static_cast<std::size_t>(job_.architecture.latent);
    model_.mean = read("/mean", n);
    if (model_.needs_basis()) {
      model_.basis = read("/basis", n * l);
      model_.scale = read("/scale", l);
    }
    model_.input_mean = read("/input_mean", static_cast<std::size_t>(model_.dimensions.inputs()));
    model_.input_sd = read("/input_sd", static_cast<std::size_t>(model_.dimensions.inputs()));
    model_.control_low = file.read("/control_low", 64);
    model_.control_high = file.read("/control_high", 64);
    const auto numbers = file.read("/numbers", 9);
    const auto counts = file.read_int("/counts", 4);
    if (numbers.size() != 9 || counts.size() != 4) throw ConfigError(path.string() + ": is damaged");
    rate_ = numbers[0];
    loss_sum_ = numbers[1];
    best_loss_ = numbers[2];
    best_error_ = numbers[3];
    validation_loss_ = numbers[4];
    validation_error_ = numbers[5];
    training_loss_ = numbers[6];
    earlier_seconds_ = numbers[7];
    schedule_ = numbers[8];
    iteration_ = first_iteration_ = counts[0];
    loss_count_ = counts[1];
    best_iteration_ = counts[2];
    without_best_ = counts[3];
    const auto curve = file.read("/curve");
    for (std::size_t i = 0; i + 5 <= curve.size(); i += 5)
      curve_.push_back({curve[i], curve[i + 1], curve[i + 2], curve[i + 3], curve[i + 4]});
    return true;
  }

  FitJob& job_;
  const Training& t_;
  Model& model_;
  Layout layout_;
  Passes passes_;
  std::string identity_;
  std::vector<std::size_t> train_, validation_;
  std::vector<Batch> validation_batches_;
  std::vector<std::unique_ptr<Worker>> workers_;
  std::vector<float> weights_, gradients_, first_moment_, second_moment_, average_, best_weights_;
  std::int64_t iteration_ = 0, evaluated_at_ = -1, first_iteration_ = 0, planned_ = 0, loss_count_ = 0,
               best_iteration_ = 0, without_best_ = 0;
  double rate_ = 0.0, loss_sum_ = 0.0, best_loss_ = 0.0, best_error_ = 0.0, schedule_ = 0.0;
  double validation_loss_ = 0.0, validation_error_ = 0.0, training_loss_ = 0.0, earlier_seconds_ = 0.0;
  std::vector<std::array<double, 5>> curve_;
  std::chrono::steady_clock::time_point started_;
};

}  // namespace
}  // namespace weft::emd

extern "C" WEFT_API void weft_emd_fit(weft::emd::FitJob& job) {
  weft::emd::translated([&] { weft::emd::Fit(job).run(); });
}

extern "C" WEFT_API void weft_emd_autograd(weft::emd::AutogradJob& job) {
  using namespace weft::emd;
  translated([&] {
    const auto& block = job.block;
    const auto n = job.model.dimensions.coordinates();
    std::vector<float> weights = job.model.weights;
    const Graph graph(job.model, weights.data(), nullptr);
    at::Tensor shape = view(block.shape.data(), block.rows, n).clone().set_requires_grad(true);
    at::Tensor change = view(block.change.data(), block.rows, n).clone().set_requires_grad(true);
    at::Tensor inputs =
        view(block.inputs.data(), block.total(), job.model.dimensions.inputs()).clone().set_requires_grad(true);
    std::vector<weft::Index> running;
    for (weft::Index j = 0; j < block.steps.front(); ++j) running.push_back(block.running(j));
    const auto out = graph.forward(shape, change, inputs, running, block.wanted);
    const float floor = static_cast<float>(job.model.architecture.sigma_floor_m) / kLength;
    const at::Tensor sigma = at::exp(at::clamp_max(out.log_sigma, kLargestLogSigma)) + floor;
    const auto wanted = static_cast<weft::Index>(block.wanted.size());
    torch::autograd::backward({out.mean, sigma}, {view(job.d_mean, wanted, n), view(job.d_sigma, wanted, n)});
    const auto copy = [](const at::Tensor& t) {
      const at::Tensor c = t.detach().contiguous();
      return std::vector<float>(c.data_ptr<float>(), c.data_ptr<float>() + c.numel());
    };
    job.mean = copy(out.mean);
    job.sigma = copy(sigma);
    job.d_inputs = copy(inputs.grad());
    job.d_shape = copy(shape.grad());
    job.d_change = change.grad().defined() ? copy(change.grad()) : std::vector<float>(job.d_shape.size(), 0.0f);
  });
}
