#include "torchscript.hpp"

#include <ATen/ATen.h>
#include <ATen/Parallel.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/jit/api/module.h>
#include <torch/csrc/jit/serialization/import.h>

#include <algorithm>
#include <map>

namespace weft::torchscript {

using at::Tensor;

/// (x - mean) / sd along the last axis; undefined: x as it is.
struct Normalisation {
  Tensor mean, sd;
  Tensor operator()(const Tensor& x) const { return sd.defined() ? (x - mean) / sd : x; }
};

struct TorchScriptPredictor::Bound {
  Task task;
  Metadata metadata;
  Normalisation control, state;
  mutable torch::jit::Module module;
  std::string name;
};

namespace {

std::string list(const std::vector<std::int64_t>& sizes) {
  std::string text;
  for (const auto n : sizes) text += (text.empty() ? "" : ", ") + std::to_string(n);
  return "[" + text + "]";
}
struct Output {
  Tensor mean, sigma;
};

/// forward() with the metadata's normalisation around it. The normalisation is part of the graph, so autograd
/// differentiates it, too.
/// @throws Error with the returned and the required result.
Output call(const TorchScriptPredictor::Bound& bound, const std::vector<Tensor>& inputs) {
  const double unit = bound.metadata.length_unit_m;
  const auto length = [&](const Tensor& x) { return unit == 1.0 ? x : x / unit; };
  std::vector<c10::IValue> values = {length(inputs[0]), bound.state(inputs[1]), bound.control(inputs[2]), inputs[3]};
  if (bound.metadata.previous) values.emplace_back(length(inputs[4]));
  c10::IValue result;
  try {
    result = bound.module.forward(values);
  } catch (const std::exception& error) {  // from libtorch, or from the module's code
    const std::string text = error.what();
    throw Error(bound.name + ": forward() failed: " + text.substr(0, 400));
  }
  const auto b = inputs[0].size(0), k = inputs[2].size(1), v = inputs[0].size(1);
  const std::vector<std::int64_t> wanted = {b, k, v, 3};
  const std::string must = ", must return (mean, sigma), float32 " + list(wanted);
  if (!result.isTuple() || result.toTuple()->elements().size() != 2 || !result.toTuple()->elements()[0].isTensor() ||
      !result.toTuple()->elements()[1].isTensor()) {
    throw Error(bound.name + ": forward() returned " + result.tagKind() + must);
  }
  Output out{result.toTuple()->elements()[0].toTensor(), result.toTuple()->elements()[1].toTensor()};
  for (const Tensor& t : {out.mean, out.sigma}) {
    if (t.sizes() != at::IntArrayRef(wanted) || t.scalar_type() != at::kFloat) {
      throw Error(bound.name + ": forward() returned " + std::string(at::toString(t.scalar_type())) + " " +
                  list(t.sizes().vec()) + must);
    }
  }
  if (unit != 1.0) out = {out.mean * unit, out.sigma * unit};
  return out;
}

/// Cases of one length in one pass. Every case of the batch has a row there, even if its length is another one or it is
/// not requested. So the bits of a case depend only on its row and the number of rows; products of other sizes would
/// use other kernels. A case that runs alone has row 0.
struct Group {
  std::vector<std::size_t> cases;  ///< of this group; all other rows repeat the first of them
  std::size_t rows = 1;
  std::size_t row(std::size_t i) const { return rows == 1 ? 0 : i; }
  std::vector<Tensor> inputs;
  Output output;
};

class TorchPrediction final : public PlainPrediction {
 public:
  TorchPrediction(std::shared_ptr<const TorchScriptPredictor::Bound> bound, const std::vector<PredictionCase>& cases,
                  const PredictionRequest& request, bool batch)
      : PlainPrediction(cases.size()), bound_(std::move(bound)), request_(request) {
    std::map<std::pair<Index, std::size_t>, Group> groups;
    for (std::size_t i = 0; i < cases.size(); ++i) {
      controls_.push_back(cases[i].controls);
      start_.push_back(cases[i].state);
      has_previous_.push_back(cases[i].previous != nullptr);
      segments_.push_back(cases[i].segments);
      if (cases[i].segments.empty()) continue;
      // All cases run to the end of their controls, so that the pass does not depend on the steps that others request.
      if (batch)
        groups[{cases[i].controls.rows(), 0}].cases.push_back(i);
      else
        groups[{cases[i].segments.back(), i}].cases.push_back(i);
    }
    for (auto& [key, group] : groups) {
      if (batch) group.rows = cases.size();
      run(cases, group, key.first);
      groups_.push_back(std::move(group));
    }
  }

  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    if (!request_.gradients) throw Unsupported("torchscript: pullback needs a prediction made with gradients");
    require_shape("torchscript: cotangent cases", cotangents.size(), shapes_.size());
    const Index v = bound_->task.garment->vertex_count();
    std::vector<CaseGradient> gradients(shapes_.size());
    for (std::size_t i = 0; i < gradients.size(); ++i) {
      gradients[i].controls = Controls::Zero(controls_[i].rows(), controls_[i].cols());
      gradients[i].state = Vector::Zero(start_[i].size());
      if (request_.shape_gradients) gradients[i].shape = Positions::Zero(v, 3);
      require_shape("torchscript: cotangents of a case", cotangents[i].size(), segments_[i].size());
      for (const auto& c : cotangents[i]) {
        for (const auto* p : {&c.mean, &c.sigma})
          if (p->rows() > 0) require_shape("torchscript: cotangent rows", p->rows(), v);
      }
    }
    for (const auto& group : groups_) pullback(group, cotangents, gradients);
    for (auto& g : gradients) {
      if (!request_.control_gradients) g.controls.setZero();
      if (!request_.knowledge_gradients) g.centre = g.width = PropertyVector::Zero();
      if (!request_.state_gradients) g.state.resize(0);
    }
    return gradients;
  }

 private:
  /// Places in Group::inputs of the start shape and of the shape before it.
  static bool is_shape(std::size_t input) { return input == 0 || input == 4; }

  void run(const std::vector<PredictionCase>& cases, Group& group, Index k) {
    const auto& task = bound_->task;
    const auto b = static_cast<std::int64_t>(group.rows);
    const Index v = task.garment->vertex_count(), s = start_[group.cases[0]].size(),
                c = controls_[group.cases[0]].cols();
    const at::NoGradGuard no_graph;
    const auto empty = [](std::vector<std::int64_t> sizes) {
      return at::empty(sizes, at::TensorOptions().dtype(at::kFloat));
    };
    Tensor shape = empty({b, v, 3}), previous = empty({b, v, 3}), states = empty({b, k + 1, s}),
           controls = empty({b, k, c}), knowledge = empty({b, 8});
    const auto fill = [](Tensor& to, std::int64_t row, const double* from, Index count) {
      float* at = to.data_ptr<float>() + row * to[0].numel();
      std::transform(from, from + count, at, [](double x) { return static_cast<float>(x); });
    };
    std::vector<std::size_t> held(group.rows, group.cases.front());
    for (const std::size_t i : group.cases) held[group.row(i)] = i;
    for (std::int64_t r = 0; r < b; ++r) {
      const auto& one = cases[held[r]];
      fill(shape, r, one.shape->data(), one.shape->size());
      fill(previous, r, (one.previous ? one.previous : one.shape)->data(), one.shape->size());
      const Controls used = one.controls.topRows(k);
      RowMatrix all(k + 1, s);
      all.row(0) = one.state.transpose();
      all.bottomRows(k) = task.trajectory->segment_states(task.manipulation, one.state, used);
      fill(states, r, all.data(), all.size());
      fill(controls, r, used.data(), used.size());
      Vector known(8);
      known << one.knowledge.centre, one.knowledge.width;
      fill(knowledge, r, known.data(), 8);
    }
    group.inputs = {shape, states, controls, knowledge};
    if (bound_->metadata.previous) group.inputs.push_back(previous);
    {
      const at::AutoGradMode graph(request_.gradients);
      for (std::size_t input = 0; input < group.inputs.size(); ++input) {
        if (request_.gradients && (!is_shape(input) || request_.shape_gradients))
          group.inputs[input].set_requires_grad(true);
      }
      group.output = call(*bound_, group.inputs);
    }
    const Tensor mean = group.output.mean.detach().contiguous(), sigma = group.output.sigma.detach().contiguous();
    for (const std::size_t i : group.cases) {
      const Index r = group.row(i);
      for (const Index segment : segments_[i]) {
        const auto read = [&](const Tensor& t) {
          Positions p(v, 3);
          const float* from = t.data_ptr<float>() + ((r * k) + segment - 1) * v * 3;
          std::copy_n(from, p.size(), p.data());
          return p;
        };
        ShapeDistribution one;
        one.mean = read(mean);
        one.sigma = request_.moments == Moments::mean_and_sigma ? read(sigma) : Positions(0, 3);
        if (!one.mean.allFinite() || !one.sigma.allFinite() || (one.sigma.array() <= 0.0).any()) {
          failures_[i] = bound_->name + ": the prediction after " + std::to_string(segment) +
                         " segments is not finite, or its sigma is not positive";
        }
        shapes_[i].push_back(std::move(one));
      }
      if (!failures_[i].empty()) shapes_[i].clear();
    }
    if (!request_.gradients) group = {};
  }

  void pullback(const Group& group, const std::vector<std::vector<ShapeCotangent>>& cotangents,
                std::vector<CaseGradient>& gradients) const {
    const auto& task = bound_->task;
    const auto& trajectory = *task.trajectory;
    Tensor d_mean = at::zeros_like(group.output.mean.detach()), d_sigma = at::zeros_like(d_mean);
    const auto k = group.output.mean.size(1), size = d_mean.size(2) * 3;
    for (const std::size_t i : group.cases) {
      if (!failures_[i].empty()) continue;
      for (std::size_t s = 0; s < segments_[i].size(); ++s) {
        const auto at = (static_cast<std::int64_t>(group.row(i)) * k + segments_[i][s] - 1) * size;
        const auto write = [&](const Positions& from, Tensor& to) {
          std::transform(from.data(), from.data() + from.size(), to.data_ptr<float>() + at,
                         [](double x) { return static_cast<float>(x); });
        };
        write(cotangents[i][s].mean, d_mean);
        write(cotangents[i][s].sigma, d_sigma);
      }
    }
    std::vector<Tensor> outputs, seeds;
    for (const auto& [out, seed] : {std::pair(group.output.mean, d_mean), std::pair(group.output.sigma, d_sigma)}) {
      if (!out.requires_grad()) continue;  // a constant sigma has no graph
      outputs.push_back(out);
      seeds.push_back(seed);
    }
    if (outputs.empty()) return;
    std::vector<Tensor> inputs;
    for (const auto& t : group.inputs)
      if (t.requires_grad()) inputs.push_back(t);
    const auto grads = torch::autograd::grad(outputs, inputs, seeds, /*retain_graph=*/true, /*create_graph=*/false,
                                             /*allow_unused=*/true);
    std::vector<Tensor> of_input(group.inputs.size());  // undefined: not requested, or without effect
    for (std::size_t input = 0, next = 0; input < of_input.size(); ++input)
      if (group.inputs[input].requires_grad()) of_input[input] = grads[next++];
    const auto row = [&](std::size_t input, std::size_t r) -> std::vector<double> {
      if (input >= of_input.size() || !group.inputs[input].requires_grad()) return {};
      if (!of_input[input].defined()) return std::vector<double>(group.inputs[input][0].numel(), 0.0);
      const Tensor t = of_input[input][static_cast<std::int64_t>(r)].to(at::kDouble).contiguous();
      return {t.data_ptr<double>(), t.data_ptr<double>() + t.numel()};
    };
    for (const std::size_t i : group.cases) {
      const std::size_t r = group.row(i);
      if (!failures_[i].empty()) continue;
      auto& g = gradients[i];
      const auto d_shape = row(0, r), d_states = row(1, r), d_controls = row(2, r), d_knowledge = row(3, r),
                 d_previous = row(4, r);
      for (Index x = 0; x < g.shape.size(); ++x) {
        g.shape.data()[x] = d_shape[x];
        // Without an earlier shape the module was given the start shape twice.
        if (!d_previous.empty() && !has_previous_[i]) g.shape.data()[x] += d_previous[x];
      }
      for (Index p = 0; p < 4; ++p) {
        g.centre(p) = d_knowledge[p];
        g.width(p) = d_knowledge[p + 4];
      }
      // Controls act directly and through the states after every segment.
      const Index s = g.state.size(), c = g.controls.cols();
      const auto add = [&](Index j, Vector& d_state) {
        d_state += Eigen::Map<const Vector>(d_states.data() + (j + 1) * s, s);
      };
      g.state = trajectory.pullback_states(task.manipulation, start_[i], controls_[i].topRows(k), add, g.controls) +
                Eigen::Map<const Vector>(d_states.data(), s);
      g.controls.topRows(k) += Eigen::Map<const Controls>(d_controls.data(), k, c);
    }
  }

  std::shared_ptr<const TorchScriptPredictor::Bound> bound_;
  PredictionRequest request_;
  std::vector<Controls> controls_;
  std::vector<Vector> start_;
  std::vector<bool> has_previous_;
  std::vector<std::vector<Index>> segments_;
  std::vector<Group> groups_;
};

/// Reads bound.name into bound.module, for inference.
/// @throws ConfigError when it is not a TorchScript file, or forward() has other arguments or results than required.
void load_module(TorchScriptPredictor::Bound& bound) {
  try {
    bound.module = torch::jit::load(bound.name, at::kCPU);
    bound.module.eval();
    for (const auto& parameter : bound.module.parameters()) parameter.set_requires_grad(false);
  } catch (const std::exception& error) {  // libtorch reports damaged files in many ways
    const std::string text = error.what();
    throw ConfigError(bound.name + ": is not a TorchScript file, or is damaged: " + text.substr(0, 300));
  }
  const auto& m = bound.metadata;
  const auto method = bound.module.find_method("forward");
  const std::size_t wanted = m.previous ? 5 : 4;
  if (!method) throw ConfigError(bound.name + ": has no forward()");
  if (const std::size_t given = method->function().getSchema().arguments().size() - 1; given != wanted) {
    throw ConfigError(bound.name + ": forward() takes " + std::to_string(given) + " arguments, must take " +
                      std::to_string(wanted) + ": shape, states, controls, knowledge" +
                      (m.previous ? ", previous" : ""));
  }
  // One call shows whether the shapes fit.
  const auto zeros = [](std::vector<std::int64_t> sizes) {
    return at::zeros(sizes, at::TensorOptions().dtype(at::kFloat));
  };
  const Index v = bound.task.garment->vertex_count(), s = m.states.size(), c = m.controls.size();
  const Index k = std::min<Index>(2, m.max_segments);
  std::vector<Tensor> inputs = {zeros({2, v, 3}), zeros({2, k + 1, s}), zeros({2, k, c}), zeros({2, 8})};
  if (m.previous) inputs.push_back(zeros({2, v, 3}));
  try {
    const at::NoGradGuard no_graph;
    call(bound, inputs);
  } catch (const Error& error) {
    throw ConfigError(error.what());
  }
}

}  // namespace

TorchScriptPredictor::TorchScriptPredictor(const Params& params, Host& host) : params_(params), host_(host) {}
TorchScriptPredictor::~TorchScriptPredictor() = default;

PredictorCapabilities TorchScriptPredictor::capabilities() const {
  return {.gradients = true,
          .state_gradients = true,
          .shape_gradients = true,
          .deterministic = !params_.batch,
          .needs_binding = true,
          .opening_hands = true};
}

void TorchScriptPredictor::bind(const Task& task) {
  if (params_.module.empty()) throw ConfigError("torchscript: needs predictor.params.module, a file of torch.jit.save");
  auto bound = std::make_shared<Bound>();
  bound->task = task;
  bound->name = params_.module.string();
  auto metadata_file = params_.metadata;
  if (metadata_file.empty()) metadata_file = std::filesystem::path(params_.module).replace_extension(".yaml");
  auto& m = bound->metadata;
  m = read_metadata(metadata_file);
  require_task(m, metadata_file.string(), task);
  check_material(m, metadata_file.string(), task);
  const auto normalisation = [](const std::vector<double>& mean, const std::vector<double>& sd) {
    return sd.empty() ? Normalisation{} : Normalisation{at::tensor(mean, at::kFloat), at::tensor(sd, at::kFloat)};
  };
  bound->control = normalisation(m.control_mean, m.control_sd);
  bound->state = normalisation(m.state_mean, m.state_sd);
  at::set_num_threads(params_.threads > 0 ? static_cast<int>(params_.threads) : std::max(1, host_.threads()));
  load_module(*bound);
  bound_ = std::move(bound);
}

void TorchScriptPredictor::check_material(const Metadata& m, const std::string& file, const Task& task) const {
  if (m.material.is_null()) {
    host_.log(LogLevel::warning,
              file + ": has no material: it is unknown which fabrics the module's properties in [0, 1] stand for");
    return;
  }
  if (write_material_space(read_material_space(m.material)).to_yaml() == write_material_space(task.material).to_yaml())
    return;
  const std::string text =
      file + ": material is another space than the task's: the same properties in [0, 1] mean other fabrics";
  if (params_.other_fabric != "warn")
    throw ConfigError(text + " (predictor.params.other_fabric: warn uses the module anyway)");
  host_.log(LogLevel::warning, text);
}

const TorchScriptPredictor::Bound& TorchScriptPredictor::require_bound(const char* call) const {
  if (!bound_) throw Error("torchscript: " + std::string(call) + "() before bind()");
  return *bound_;
}

std::optional<Box> TorchScriptPredictor::control_range() const {
  const auto& m = require_bound("control_range").metadata;
  if (m.control_low.empty()) return std::nullopt;
  const Index size = m.control_low.size();
  return Box{Eigen::Map<const Vector>(m.control_low.data(), size),
             Eigen::Map<const Vector>(m.control_high.data(), size)};
}

std::optional<Index> TorchScriptPredictor::max_segments() const {
  return require_bound("max_segments").metadata.max_segments;
}

std::unique_ptr<Prediction> TorchScriptPredictor::predict(const std::vector<PredictionCase>& cases,
                                                          const PredictionRequest& request) const {
  const auto& bound = require_bound("predict");
  check_cases("torchscript", bound.task, cases, bound.metadata.max_segments);
  return std::make_unique<TorchPrediction>(bound_, cases, request, params_.batch);
}

}  // namespace weft::torchscript
