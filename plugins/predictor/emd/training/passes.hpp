#pragma once
// The network on libtorch, and the batches of examples that go through it. Training and calibration share both. Part of
// the training library.
#include <ATen/ATen.h>
#include <ATen/Parallel.h>

#include <algorithm>
#include <future>
#include <memory>
#include <unordered_map>
#include <utility>
#include <vector>

#include "../inputs.hpp"
#include "../network.hpp"
#include "../sampling.hpp"
#include "weft/host.hpp"

namespace weft::emd {

using at::Tensor;

inline Tensor view(const float* data, Index rows, Index columns) {
  return at::from_blob(const_cast<float*>(data), {rows, columns}, at::TensorOptions().dtype(at::kFloat));
}

/// The network as tensors: the same formulas as Network (network.cpp), left to autograd. It evaluates and calibrates, and
/// tests compare Network's derivatives with its own.
class Graph {
 public:
  Graph(const Model& model, const float* weights, float* gradients)
      : arch_(model.architecture), layout_(arch_, model.dimensions), z_(model.latent_size()) {
    for (const auto& w : layout_.weights) {
      Tensor t = view(weights + w.offset, w.rows, w.columns);
      if (gradients != nullptr) {
        t.set_requires_grad(true);
        t.mutable_grad() = view(gradients + w.offset, w.rows, w.columns);  // autograd adds in place
      }
      weights_.push_back(t);
    }
    if (model.needs_basis()) {
      const Tensor basis = view(model.basis.data(), model.dimensions.coordinates(), arch_.latent);
      const Tensor scale = view(model.scale.data(), 1, arch_.latent);
      project_ = basis / scale;
      expand_ = (basis * scale).t().contiguous();
    }
  }

  struct Output {
    Tensor mean;       ///< [wanted, coordinates]
    Tensor log_sigma;  ///< raw: before the upper limit and the floor
    Tensor hidden;     ///< [wanted, decoder_hidden]: g, what both layers see
  };
  /// @param shape, change, inputs as in Block, of which only the steps and the wanted shapes are used.
  Output forward(const Tensor& shape, const Tensor& change, const Tensor& inputs, const Block& block) const {
    Tensor e = at::addmm(w(layout_.encoder_bias), shape, w(layout_.encoder_shape));
    if (arch_.previous_shape) {
      e = e + at::mm(at::mm(change, project_) * kVelocityGain, w(layout_.encoder_velocity));
    }
    Tensor z = at::addmm(w(layout_.encoder_out_bias), f(e), w(layout_.encoder_out));
    if (arch_.pca_skip) z = z + at::constant_pad_nd(at::mm(shape, project_), {0, arch_.memory});
    z = normalise(z);
    const Tensor start = z;
    std::vector<Tensor> contributions;
    for (const auto& layer : layout_.layers) {
      contributions.push_back(layer.u < 0 ? Tensor() : at::addmm(w(layer.b), inputs, w(layer.u)));
    }
    const Tensor out_contribution =
        layout_.out.u < 0 ? Tensor() : at::addmm(w(layout_.out.b), inputs, w(layout_.out.u));
    std::vector<Tensor> boundaries{z};
    Index offset = 0;
    for (Index j = 0; j < block.steps.front(); ++j) {
      const Index m = block.running(j);
      const Tensor before = z.size(0) == m ? z : z.narrow(0, 0, m);
      Tensor h = before;
      std::vector<Tensor> outputs;
      for (std::size_t l = 0; l < layout_.layers.size(); ++l) {
        const auto& layer = layout_.layers[l];
        const Tensor added = layer.u < 0 ? w(layer.b) : contributions[l].narrow(0, offset, m);
        h = f(at::addmm(added, h, w(layer.h)));
        if (arch_.residual > 0 && l > 0) {
          h = h + outputs[std::max<std::int64_t>(static_cast<std::int64_t>(l) - arch_.residual, 0)];
        }
        outputs.push_back(h);
      }
      Tensor dz =
          at::addmm(layout_.out.u < 0 ? w(layout_.out.b) : out_contribution.narrow(0, offset, m), h, w(layout_.out.h));
      z = normalise(arch_.differential_latent ? before + dz : dz);
      boundaries.push_back(z);
      offset += m;
    }
    std::vector<Tensor> codes;
    std::vector<std::int64_t> of_row;
    // One index_select over all boundaries keeps the graph small.
    std::vector<std::int64_t> first(boundaries.size(), 0);
    for (std::size_t j = 1; j < boundaries.size(); ++j) first[j] = first[j - 1] + boundaries[j - 1].size(0);
    std::vector<std::int64_t> places;
    for (const auto& one : block.wanted) {
      places.push_back(first[one.step] + one.row);
      of_row.push_back(one.row);
    }
    const Tensor code = at::index_select(at::cat(boundaries), 0, at::tensor(places));
    const Tensor g = f(at::addmm(w(layout_.decoder_bias), code, w(layout_.decoder_in)));
    Output out;
    out.hidden = g;
    out.log_sigma = at::addmm(w(layout_.sigma_bias), g, w(layout_.sigma));
    Tensor latent = code.narrow(1, 0, arch_.latent);
    if (arch_.differential_decoding) {
      const Tensor rows = at::tensor(of_row);
      const Tensor g0 = f(at::addmm(w(layout_.decoder_bias), start, w(layout_.decoder_in)));
      out.mean = at::addmm(at::index_select(shape, 0, rows), g - at::index_select(g0, 0, rows), w(layout_.mean));
      latent = latent - at::index_select(start, 0, rows).narrow(1, 0, arch_.latent);
    } else {
      out.mean = at::addmm(w(layout_.mean_bias), g, w(layout_.mean));
    }
    if (arch_.pca_skip) out.mean = at::addmm(out.mean, latent, expand_);
    return out;
  }

 private:
  const Tensor& w(int i) const { return weights_[i]; }
  Tensor f(const Tensor& x) const { return arch_.activation == "tanh" ? at::tanh(x) : at::silu(x); }
  Tensor normalise(const Tensor& a) const {
    const auto unit = [](const Tensor& x) { return x * at::rsqrt(at::sum(x * x, {1}, true) + 1.0); };
    if (arch_.latent_normalisation == "all") return unit(a);
    if (arch_.latent_normalisation == "none" || arch_.memory == 0) return a;
    return at::cat({a.narrow(1, 0, arch_.latent), unit(a.narrow(1, arch_.latent, arch_.memory))}, 1);
  }

  Architecture arch_;
  Layout layout_;
  Index z_;
  std::vector<Tensor> weights_;
  Tensor project_, expand_;
};

/// sigma = exp(min(log_sigma, its limit)) + floor, in units of kLength. @param log_sigma as in Graph::Output.
struct Sigma {
  Tensor exp, value;  ///< the exponential; sigma
};
inline Sigma sigma_of(const Model& model, const Tensor& log_sigma) {
  const float floor = static_cast<float>(model.architecture.sigma_floor_m) / kLength;
  const Tensor exp = at::exp(at::clamp_max(log_sigma, kLargestLogSigma));
  return {exp, exp + floor};
}

/// Sub-sequences for one pass.
struct Batch : Block {
  std::vector<float> target;          ///< [wanted, coordinates]: the shapes that predictions are compared with
  std::vector<std::int64_t> columns;  ///< coordinates that enter the loss, ascending; empty: all
};

/// Sub-sequences of a dataset's examples on their way through a model's network.
class Passes {
 public:
  /// Keeps references to all of them.
  Passes(const Dataset& dataset, const Model& model, Host& host) : dataset_(dataset), model_(model), host_(host) {
    at::set_num_threads(1);  // parts of a batch run in parallel instead
    reads_files_ = std::any_of(dataset.examples.begin(), dataset.examples.end(),
                               [](const Example& e) { return e.stored.file != nullptr; });
  }
  Passes(const Passes&) = delete;
  Passes& operator=(const Passes&) = delete;
  const Dataset& dataset() const { return dataset_; }
  const Model& model() const { return model_; }
  bool cancelled() const { return host_.cancelled(); }
  /// But for its shapes, which may be in a file.
  const Example& example(std::size_t i) const { return dataset_.examples[i]; }

  using Shapes = std::shared_ptr<const std::vector<float>>;
  /// [k + 1, V, 3] m: from memory, from those that were read ahead, or from the file.
  Shapes shapes(std::size_t i) const {
    const Example& e = example(i);
    if (e.stored.file == nullptr) return {Shapes(), &e.shapes};
    const auto found = ahead_.find(i);
    return found != ahead_.end() ? found->second : read(i);
  }
  bool reads_files() const { return reads_files_; }
  /// Begins to read the shapes of examples on another thread, and keeps those of the call before.
  void read_ahead(std::vector<std::size_t> examples) {
    // With fresh memory for each example a fit on two threads makes 0.90 instead of 0.99 of the steps a second in memory.
    std::vector<Buffer> spare;
    for (auto& [example, buffer] : ahead_)
      if (buffer.use_count() == 1) spare.push_back(std::move(buffer));
    ahead_ = coming_.valid() ? coming_.get() : Read();
    coming_ = std::async(std::launch::async, [this, wanted = std::move(examples), spare = std::move(spare)]() mutable {
      Read all;
      for (const std::size_t i : wanted) {
        if (all.contains(i)) continue;
        const Buffer buffer = spare.empty() ? std::make_shared<std::vector<float>>() : std::move(spare.back());
        if (!spare.empty()) spare.pop_back();
        example(i).read_shapes(model_.dimensions.vertices, *buffer);
        all.emplace(i, buffer);
      }
      return all;
    });
  }

  void raw_inputs(const Example& e, Index j, const MaterialKnowledge& knowledge, double* to) const {
    const bool released = e.released && j + 1 == e.segments();
    write_inputs(model_.dimensions, e.controls.row(j).data(), e.states.row(j).data(), e.states.row(j + 1).data(),
                 e.targets.row(j).data(), e.targets.row(j + 1).data(), released, knowledge.centre, knowledge.width, to);
  }

  Batch make_batch(std::vector<Sequence> sequences) const {
    std::stable_sort(sequences.begin(), sequences.end(),
                     [](const Sequence& a, const Sequence& b) { return a.steps > b.steps; });
    Batch batch;
    const std::size_t n = model_.dimensions.coordinates(), u = model_.dimensions.inputs();
    batch.rows = std::ssize(sequences);
    for (const auto& s : sequences) batch.steps.push_back(s.steps);
    const auto normalised = [&](const float* from, std::vector<float>& to) {
      const std::size_t at = to.size();
      to.resize(at + n);
      for (std::size_t c = 0; c < n; ++c) to[at + c] = from[c] / kLength - model_.mean[c];
    };
    for (std::size_t r = 0; r < sequences.size(); ++r) {
      const auto& s = sequences[r];
      const Shapes of_example = shapes(s.example);
      const float* first = of_example->data() + s.start * n;
      normalised(first, batch.shape);
      for (std::size_t c = 0; c < n; ++c)
        batch.change.push_back(s.start == 0 ? 0.0f : (first[c] - (first - n)[c]) / kLength);
      for (const Index step : s.decoded) {
        batch.wanted.push_back({static_cast<Index>(r), step});
        normalised(first + step * n, batch.target);
      }
    }
    std::vector<double> raw(u);
    for (Index j = 0; j < sequences.front().steps; ++j) {
      for (Index m = 0; m < batch.running(j); ++m) {
        const auto& s = sequences[m];
        raw_inputs(example(s.example), s.start + j, s.knowledge, raw.data());
        for (std::size_t k = 0; k < u; ++k)
          batch.inputs.push_back(static_cast<float>((raw[k] - model_.input_mean[k]) / model_.input_sd[k]));
      }
    }
    return batch;
  }

  static constexpr std::size_t kBatch = 32;
  static std::size_t batches(const std::vector<Sequence>& all) { return (all.size() + kBatch - 1) / kBatch; }
  Batch batch(const std::vector<Sequence>& all, std::size_t number) const {
    const auto begin = all.begin() + kBatch * number;
    return make_batch({begin, begin + std::min<std::ptrdiff_t>(kBatch, all.end() - begin)});
  }

  /// Of all coordinates.
  Graph::Output forward(const Graph& graph, const Batch& batch) const {
    const auto& d = model_.dimensions;
    return graph.forward(view(batch.shape.data(), batch.rows, d.coordinates()),
                         view(batch.change.data(), batch.rows, d.coordinates()),
                         view(batch.inputs.data(), batch.total(), d.inputs()), batch);
  }
  /// Batch::target.
  Tensor target(const Batch& batch) const {
    return view(batch.target.data(), std::ssize(batch.wanted), model_.dimensions.coordinates());
  }

  /// body(p) for every part, on the host's threads. Each part's products use one thread.
  template <class Body>
  void side_by_side(std::size_t parts, const Body& body) {
    host_.parallel_for(parts, [&](std::int64_t p) {
      if (parts > 1) at::init_num_threads();  // libtorch counts threads per thread
      body(p);
    });
  }

 private:
  using Buffer = std::shared_ptr<std::vector<float>>;
  using Read = std::unordered_map<std::size_t, Buffer>;
  Shapes read(std::size_t i) const {
    return std::make_shared<const std::vector<float>>(example(i).read_shapes(model_.dimensions.vertices));
  }

  const Dataset& dataset_;
  const Model& model_;
  Host& host_;
  bool reads_files_ = false;
  Read ahead_;
  std::future<Read> coming_;  // the first to be destroyed: it uses the others
};

}  // namespace weft::emd
