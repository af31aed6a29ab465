#include "emd.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "model_file.hpp"
#include "training_library.hpp"

namespace weft::emd {
namespace {

constexpr Index kMostRows = 16;     // per block: these rows and one layer fit into the second-level cache
constexpr Index kMostWanted = 512;  // per block: bounds the memory of a decoded block

/// One block of cases, and what its derivatives need.
struct Part {
  std::vector<std::size_t> cases;  // row -> case
  Block block;
  std::vector<std::pair<std::size_t, std::size_t>> places;  // wanted -> case, entry of case.segments
  Network::Tape tape;
};

class EmdPrediction final : public PlainPrediction {
 public:
  EmdPrediction(std::shared_ptr<const EmdPredictor::Bound> bound, Host& host, const std::vector<PredictionCase>& cases,
                const PredictionRequest& request)
      : PlainPrediction(cases.size()), bound_(std::move(bound)), host_(host), request_(request) {
    for (const auto& one : cases) {
      segments_.push_back(one.segments);
      sizes_.emplace_back(one.controls.rows(), one.controls.cols());
      has_previous_.push_back(one.previous != nullptr);
      widths_.push_back(one.knowledge.width.mean());
    }
    make_inputs(cases);
    make_parts(cases);
    host_.parallel_for(static_cast<std::int64_t>(parts_.size()), [&](std::int64_t p) { run(cases, parts_[p]); });
  }

  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    if (!request_.gradients) throw Unsupported("emd: pullback needs a prediction made with gradients");
    check_sizes(cotangents);
    std::vector<CaseGradient> gradients(segments_.size());
    for (std::size_t i = 0; i < gradients.size(); ++i) {
      gradients[i].controls = Controls::Zero(sizes_[i].first, sizes_[i].second);
      gradients[i].state = Vector::Zero(dim().states);
      if (request_.shape_gradients) gradients[i].shape = Positions::Zero(dim().vertices, 3);
    }
    host_.parallel_for(static_cast<std::int64_t>(parts_.size()),
                       [&](std::int64_t p) { pullback(parts_[p], cotangents, gradients); });
    for (auto& gradient : gradients) {
      if (!request_.control_gradients) gradient.controls.setZero();
      if (!request_.knowledge_gradients) gradient.centre = gradient.width = PropertyVector::Zero();
      if (!request_.state_gradients) gradient.state.resize(0);
    }
    return gradients;
  }

  std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const override {
    if (!request_.gradients) throw Unsupported("emd: jvp needs a prediction made with gradients");
    require_shape("emd: direction cases", directions.size(), segments_.size());
    std::vector<std::vector<std::vector<ShapeCotangent>>> derivatives(directions.size());
    for (std::size_t i = 0; i < directions.size(); ++i) {
      for (const auto& d : directions[i]) {
        require_shape("emd: direction rows", d.controls.rows(), sizes_[i].first);
        require_shape("emd: direction columns", d.controls.cols(), sizes_[i].second);
      }
      derivatives[i].resize(directions[i].size());
    }
    host_.parallel_for(static_cast<std::int64_t>(parts_.size()),
                       [&](std::int64_t p) { jvp(parts_[p], directions, derivatives); });
    return derivatives;
  }

 private:
  const Model& model() const { return *bound_->model; }
  Model::SigmaCalibration calibration(std::size_t i, Index steps) const {
    return model().sigma_calibration(steps, !has_previous_[i], widths_[i]);
  }
  const Dimensions& dim() const { return bound_->model->dimensions; }
  const CaseInputs& input(const Part& part, Index row) const { return *inputs_[part.cases[row]]; }

  void check_sizes(const std::vector<std::vector<ShapeCotangent>>& cotangents) const {
    require_shape("emd: cotangent cases", cotangents.size(), segments_.size());
    for (std::size_t i = 0; i < cotangents.size(); ++i) {
      require_shape("emd: cotangents of a case", cotangents[i].size(), segments_[i].size());
      for (const auto& c : cotangents[i]) {
        if (c.mean.rows() > 0) require_shape("emd: cotangent rows", c.mean.rows(), dim().vertices);
        if (c.sigma.rows() > 0) {
          require_shape("emd: cotangent rows", c.sigma.rows(), dim().vertices);
          if (request_.moments == Moments::mean)
            throw Unsupported("emd: cotangents of sigma, but only the mean was asked for");
        }
      }
    }
  }

  /// States and grasp targets of every case. A case that the trajectory cannot follow fails and joins no block.
  void make_inputs(const std::vector<PredictionCase>& cases) {
    inputs_.resize(cases.size());
    for (std::size_t i = 0; i < cases.size(); ++i) {
      if (cases[i].segments.empty()) continue;
      try {
        inputs_[i] = std::make_unique<const CaseInputs>(bound_->task, dim(), cases[i], cases[i].segments.back());
      } catch (const Error& error) {
        failures_[i] = error.what();
      }
    }
  }

  /// Sorts the cases by descending length into blocks that share the threads evenly.
  void make_parts(const std::vector<PredictionCase>& cases) {
    std::vector<std::size_t> order;
    for (std::size_t i = 0; i < cases.size(); ++i) {
      if (inputs_[i]) order.push_back(i);
    }
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return cases[a].segments.back() > cases[b].segments.back(); });
    const Index count = order.size();
    if (count == 0) return;
    const Index threads = std::max(1, host_.threads());
    const Index blocks = std::max((count + kMostRows - 1) / kMostRows, std::min(threads, (count + 3) / 4));
    // Block b takes every blocks-th case: blocks of like length.
    std::vector<std::vector<std::size_t>> rows(blocks);
    for (std::size_t i = 0; i < order.size(); ++i) rows[i % blocks].push_back(order[i]);
    for (auto& part_rows : rows) {
      Index wanted = 0;
      parts_.emplace_back();
      for (const auto i : part_rows) {
        const Index more = cases[i].segments.size();
        if (wanted > 0 && wanted + more > kMostWanted) {
          parts_.emplace_back();
          wanted = 0;
        }
        parts_.back().cases.push_back(i);
        wanted += more;
      }
    }
  }

  void run(const std::vector<PredictionCase>& cases, Part& part) {
    const Index n = dim().coordinates(), u = dim().inputs();
    auto& block = part.block;
    block.rows = part.cases.size();
    block.shape.resize(block.rows * n);
    block.change.assign(block.rows * n, 0.0f);
    for (Index r = 0; r < block.rows; ++r) {
      const std::size_t i = part.cases[r];
      const auto& one = cases[i];
      block.steps.push_back(one.segments.back());
      float* y = block.shape.data() + r * n;
      for (Index c = 0; c < n; ++c) y[c] = static_cast<float>(one.shape->data()[c]) / kLength - model().mean[c];
      if (one.previous) {
        float* v = block.change.data() + r * n;
        for (Index c = 0; c < n; ++c)
          v[c] = static_cast<float>(one.shape->data()[c] - one.previous->data()[c]) / kLength;
      }
      for (std::size_t s = 0; s < one.segments.size(); ++s) {
        block.wanted.push_back({r, one.segments[s]});
        part.places.emplace_back(i, s);
      }
    }
    block.inputs.resize(block.total() * u);
    float* to = block.inputs.data();
    for (Index j = 0; j < block.steps.front(); ++j) {
      const Index running = block.running(j);
      for (Index r = 0; r < running; ++r, to += u) input(part, r).write(model(), j, to);
    }
    const bool has_sigma = request_.moments == Moments::mean_and_sigma;
    const std::size_t count = block.wanted.size() * n;
    std::vector<float> mean(count), sigma(has_sigma ? count : 0);
    bound_->network->forward(block, part.tape, mean.data(), has_sigma ? sigma.data() : nullptr);
    for (std::size_t w = 0; w < block.wanted.size(); ++w) {
      const auto [i, s] = part.places[w];
      shapes_[i].resize(segments_[i].size());
      auto& shape = shapes_[i][s];
      shape.mean.resize(dim().vertices, 3);
      shape.sigma.resize(has_sigma ? dim().vertices : 0, 3);
      const float* m = mean.data() + w * n;
      const Model::SigmaCalibration calibrated = calibration(i, block.wanted[w].step);
      for (Index c = 0; c < n; ++c) shape.mean.data()[c] = static_cast<double>((m[c] + model().mean[c]) * kLength);
      if (has_sigma) {
        const float* d = sigma.data() + w * n;
        for (Index c = 0; c < n; ++c) shape.sigma.data()[c] = calibrated(static_cast<double>(d[c] * kLength));
      }
      if (!shape.mean.allFinite() || !shape.sigma.allFinite()) {
        failures_[i] = "emd: the prediction after " + std::to_string(block.wanted[w].step) +
                       " segments is not finite; the inputs lie far outside the training data";
      }
    }
    for (const auto i : part.cases) {
      if (!failures_[i].empty()) shapes_[i].clear();
    }
    if (!request_.gradients) {
      part.tape = {};
      part.block = {};
    }
  }

  void pullback(const Part& part, const std::vector<std::vector<ShapeCotangent>>& cotangents,
                std::vector<CaseGradient>& gradients) const {
    const auto& block = part.block;
    const Index n = dim().coordinates(), u = dim().inputs();
    const std::size_t count = block.wanted.size() * n;
    std::vector<float> d_mean(count, 0.0f), d_sigma;
    for (std::size_t w = 0; w < block.wanted.size(); ++w) {
      const auto [i, s] = part.places[w];
      if (!failures_[i].empty()) continue;
      const auto& cotangent = cotangents[i][s];
      float* m = d_mean.data() + w * n;
      if (cotangent.mean.rows() > 0) {
        for (Index c = 0; c < n; ++c) m[c] = static_cast<float>(cotangent.mean.data()[c]) * kLength;
      }
      if (cotangent.sigma.rows() > 0) {
        if (d_sigma.empty()) d_sigma.assign(count, 0.0f);
        const Model::SigmaCalibration calibrated = calibration(i, block.wanted[w].step);
        const double* sigma = shapes_[i][s].sigma.data();
        float* d = d_sigma.data() + w * n;
        double d_width = 0.0;
        for (Index c = 0; c < n; ++c) {
          const double one = cotangent.sigma.data()[c];
          d_width += one * calibrated.by_width(sigma[c]);
          d[c] = static_cast<float>(one * calibrated.by_sigma(sigma[c])) * kLength;
        }
        gradients[i].width.array() += d_width / 4.0;  // through the mean width
      }
    }
    const bool with_shape = request_.shape_gradients;
    const std::size_t coordinates = with_shape ? block.shape.size() : 0;
    std::vector<float> d_inputs(block.inputs.size()), d_shape(coordinates), d_change(coordinates);
    bound_->network->pullback(block, part.tape, d_mean.data(), d_sigma.empty() ? nullptr : d_sigma.data(),
                              d_inputs.data(), with_shape ? d_shape.data() : nullptr,
                              with_shape ? d_change.data() : nullptr);
    for (Index r = 0; r < block.rows; ++r) {
      const std::size_t i = part.cases[r];
      if (!failures_[i].empty()) continue;
      std::vector<const float*> rows;
      for (Index j = 0; j < block.steps[r]; ++j) rows.push_back(d_inputs.data() + (part.tape.offset[j] + r) * u);
      input(part, r).pullback(model(), rows, gradients[i]);
      if (!with_shape) continue;
      for (Index c = 0; c < n; ++c) {
        const std::size_t at = r * n + c;
        const float sum = has_previous_[i] ? d_shape[at] + d_change[at] : d_shape[at];
        gradients[i].shape.data()[c] = static_cast<double>(sum / kLength);
      }
    }
  }

  void jvp(const Part& part, const std::vector<std::vector<CaseDirection>>& directions,
           std::vector<std::vector<std::vector<ShapeCotangent>>>& derivatives) const {
    const auto& block = part.block;
    const Index n = dim().coordinates(), u = dim().inputs();
    std::vector<Index> rows;
    std::vector<std::vector<std::vector<float>>> inputs;  // [direction][segment][input]
    for (Index r = 0; r < block.rows; ++r) {
      const std::size_t i = part.cases[r];
      for (const auto& direction : directions[i]) {
        rows.push_back(r);
        inputs.emplace_back();
        input(part, r).jvp(model(), direction, inputs.back());
      }
    }
    if (rows.empty()) return;
    std::vector<float> flat;
    for (std::size_t j = 0; j < part.tape.running.size(); ++j) {
      for (std::size_t t = 0; t < rows.size() && rows[t] < part.tape.running[j]; ++t)
        flat.insert(flat.end(), inputs[t][j].begin(), inputs[t][j].end());
    }
    flat.resize(std::max<std::size_t>(flat.size(), u));
    std::size_t shapes = 0;
    for (const Index r : rows) shapes += segments_[part.cases[r]].size();
    const bool has_sigma = request_.moments == Moments::mean_and_sigma;
    std::vector<float> d_mean(shapes * n), d_sigma(has_sigma ? d_mean.size() : 0);
    bound_->network->jvp(block, part.tape, rows, flat.data(), d_mean.data(), has_sigma ? d_sigma.data() : nullptr);
    std::size_t at = 0;
    std::vector<std::size_t> next(directions.size(), 0);
    for (const Index r : rows) {
      const std::size_t i = part.cases[r];
      const double d_width = directions[i][next[i]].width.mean();
      auto& result = derivatives[i][next[i]++];
      for (std::size_t s = 0; s < segments_[i].size(); ++s) {
        ShapeCotangent one;
        one.mean.resize(dim().vertices, 3);
        one.sigma.resize(has_sigma ? dim().vertices : 0, 3);
        const Model::SigmaCalibration calibrated = calibration(i, segments_[i][s]);
        const double* sigma = shapes_[i].empty() ? nullptr : shapes_[i][s].sigma.data();
        for (Index c = 0; c < n; ++c) one.mean.data()[c] = static_cast<double>(d_mean[at + c] * kLength);
        for (Index c = 0; c < one.sigma.size(); ++c) {
          one.sigma.data()[c] = sigma ? calibrated.by_sigma(sigma[c]) * static_cast<double>(d_sigma[at + c] * kLength) +
                                            calibrated.by_width(sigma[c]) * d_width
                                      : 0.0;  // the case has failed
        }
        at += n;
        result.push_back(std::move(one));
      }
    }
  }

  std::shared_ptr<const EmdPredictor::Bound> bound_;
  Host& host_;
  PredictionRequest request_;
  std::vector<std::vector<Index>> segments_;
  std::vector<std::pair<Index, Index>> sizes_;  // of the controls
  std::vector<bool> has_previous_;
  std::vector<double> widths_;                             // mean width of the knowledge
  std::vector<std::unique_ptr<const CaseInputs>> inputs_;  // per case; null: nothing to predict
  std::vector<Part> parts_;
};

}  // namespace

PredictorCapabilities EmdPredictor::capabilities() const {
  return {.gradients = true,
          .state_gradients = true,
          .shape_gradients = true,
          .jvp = true,
          .deterministic = true,
          .needs_binding = true,
          .opening_hands = true};
}

void EmdPredictor::bind(const Task& task) {
  if (!model_) {
    if (!params_.model.empty()) {
      load(params_.model);
    } else if (params_.untrained) {
      model_ = std::make_shared<const Model>(untrained_model(params_.architecture, task, host_.seed()));
    } else {
      throw ConfigError("emd: needs a model file: predictor.params.model; `weft train` makes one");
    }
  }
  const std::string warning = model_->require_task(task, params_.other_fabric == "warn");
  if (!warning.empty()) host_.log(LogLevel::warning, warning);
  auto bound = std::make_shared<Bound>();
  bound->task = task;
  bound->model = model_;
  bound->network = std::make_unique<const Network>(*model_, kernels(params_.kernels));
  bound_ = std::move(bound);
}

std::optional<Box> EmdPredictor::control_range() const {
  if (!bound_) throw Error("emd: control_range() before bind()");
  const auto vector = [](const std::vector<double>& v) { return Vector(Eigen::Map<const Vector>(v.data(), v.size())); };
  return Box{vector(bound_->model->control_low), vector(bound_->model->control_high)};
}

std::unique_ptr<Prediction> EmdPredictor::predict(const std::vector<PredictionCase>& cases,
                                                  const PredictionRequest& request) const {
  if (!bound_) throw Error("emd: predict() before bind()");
  check_cases("emd", bound_->task, cases);
  return std::make_unique<EmdPrediction>(bound_, host_, cases, request);
}

FitReport EmdPredictor::fit(const Dataset& dataset, const Task& task, const FitOptions& options,
                            const FitObserver& observer) {
  const auto run = reinterpret_cast<FitFunction>(training_function("weft_emd_fit", params_.kernels));
  FitJob job{dataset, task, params_.architecture, params_.training, options, observer, host_, params_.kernels, {}, {}};
  run(job);
  model_ = options.ranks.rank == 0 ? std::make_shared<const Model>(std::move(job.model)) : nullptr;
  bound_.reset();
  return job.report;
}

void EmdPredictor::save(const std::filesystem::path& file) const {
  if (!model_) throw Error("emd: has no model to save");
  save_model(file, *model_, params_.training.half_precision);
}

std::vector<DatasetOrigin> EmdPredictor::trained_on() const {
  return model_ ? model_->datasets : std::vector<DatasetOrigin>();
}

CalibrationReport EmdPredictor::calibrate(const Dataset& dataset, const std::vector<std::size_t>& examples,
                                          const Task& task, const CalibrationOptions& options) {
  if (!model_) bind(task);
  if (model_->dataset.empty()) throw ConfigError("emd: a network of random weights cannot be calibrated");
  model_->require_task(task, params_.other_fabric == "warn");
  dataset.require_task(task);
  if (examples.empty()) throw ConfigError("emd: no examples to calibrate with");
  for (const std::size_t i : examples) {
    if (i >= dataset.examples.size() || dataset.examples[i].failed())
      throw ShapeError("emd: the dataset has no good example at position " + std::to_string(i));
  }
  const auto run = reinterpret_cast<CalibrationFunction>(training_function("weft_emd_calibrate", params_.kernels));
  CalibrationJob job{dataset, examples, params_.training, options.seed, host_, *model_, {}};
  run(job);
  job.model.calibrated = dataset.origins();
  // A model that came in half precision is saved in half precision again.
  if (!options.model.empty()) save_model(options.model, job.model, fits_half(job.model));
  model_ = std::make_shared<const Model>(std::move(job.model));
  bound_.reset();
  return std::move(job.report);
}

std::vector<DatasetOrigin> EmdPredictor::calibrated_on() const {
  return model_ ? model_->calibrated : std::vector<DatasetOrigin>();
}

void EmdPredictor::load(const std::filesystem::path& file) { model_ = std::make_shared<const Model>(load_model(file)); }

}  // namespace weft::emd
