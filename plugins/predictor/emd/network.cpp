#include "network.hpp"

#include <algorithm>
#include <cmath>

namespace weft::emd {
namespace {

void add(float* to, const float* from, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) to[i] += from[i];
}

}  // namespace

Network::Network(const Model& model, const Kernels& kernels)
    : kernels_(kernels),
      arch_(model.architecture),
      dim_(model.dimensions),
      layout_(arch_, dim_),
      z_(model.latent_size()),
      norm_all_(arch_.latent_normalisation == "all"),
      norm_(norm_all_ || (arch_.latent_normalisation == "memory" && arch_.memory > 0)),
      floor_(static_cast<float>(arch_.sigma_floor_m) / kLength) {
  if (model.needs_basis()) {
    const Index n = dim_.coordinates(), l = arch_.latent;
    std::vector<float> project(model.basis);
    expansion_.resize(model.basis.size());
    for (Index i = 0; i < n; ++i) {
      for (Index j = 0; j < l; ++j) {
        const float b = model.basis[size_of(i, l) + j];
        const float s = model.scale[j];
        project[size_of(i, l) + j] = b / s;
        expansion_[size_of(j, n) + i] = b * s;
      }
    }
    project_ = pack(project.data(), n, l, false);
  }
  if (!model.weights.empty()) pack_all(model.weights.data(), false, nullptr);
}

void Network::set_weights(const float* weights, const std::vector<std::int64_t>& columns, Host& host) {
  columns_ = columns;
  pack_all(weights, true, &host);
}

bool Network::is_decoded(int weight) const {
  return weight == layout_.mean || weight == layout_.mean_bias || weight == layout_.sigma ||
         weight == layout_.sigma_bias;
}

void Network::pack_all(const float* weights, bool for_training, Host* host) {
  const auto all = layout_.weights.size();
  layer_h_.resize(layout_.layers.size());
  layer_u_.resize(layout_.layers.size());
  biases_.resize(all);
  struct Work {
    int weight;  // -1: expansion_
    Packed* to;  // null: a bias
    bool products = false;
  };
  std::vector<Work> work;
  for (int i = 0; i < static_cast<int>(all); ++i)
    if (layout_.weights[i].rows == 1) work.push_back({i, nullptr});
  // The derivatives with respect to inputs and shapes are not wanted in training.
  work.push_back({layout_.encoder_shape, &encoder_shape_, for_training});
  if (arch_.previous_shape) work.push_back({layout_.encoder_velocity, &encoder_velocity_, for_training});
  work.push_back({layout_.encoder_out, &encoder_out_});
  for (std::size_t l = 0; l < layer_h_.size(); ++l) {
    work.push_back({layout_.layers[l].h, &layer_h_[l]});
    if (layout_.layers[l].u >= 0) work.push_back({layout_.layers[l].u, &layer_u_[l], for_training});
  }
  work.push_back({layout_.out.h, &out_h_});
  if (layout_.out.u >= 0) work.push_back({layout_.out.u, &out_u_, for_training});
  work.push_back({layout_.decoder_in, &decoder_in_});
  work.push_back({layout_.mean, &mean_});
  work.push_back({layout_.sigma, &sigma_});
  if (arch_.pca_skip) work.push_back({-1, &expand_});
  const auto run = [&](std::int64_t number) {
    const Work& one = work[number];
    const bool is_expansion = one.weight < 0;
    const float* from = is_expansion ? expansion_.data() : weights + layout_.weights[one.weight].offset;
    const Index rows = is_expansion ? arch_.latent : layout_.weights[one.weight].rows;
    Index columns = is_expansion ? dim_.coordinates() : layout_.weights[one.weight].columns;
    std::vector<float> some;
    if (!columns_.empty() && (is_expansion || is_decoded(one.weight))) {
      some.reserve(size_of(rows, decoded()));
      for (Index i = 0; i < rows; ++i)
        for (const std::int64_t c : columns_) some.push_back(from[size_of(i, columns) + c]);
      from = some.data();
      columns = decoded();
    }
    if (one.to == nullptr)
      biases_[one.weight].assign(from, from + columns);
    else
      *one.to = pack(from, rows, columns, one.products);
  };
  if (host != nullptr) {
    host->parallel_for(std::ssize(work), run);
  } else {
    for (std::int64_t i = 0; i < std::ssize(work); ++i) run(i);
  }
}

Network::Packed Network::pack(const float* data, Index k, Index n, bool products) const {
  Packed p{k, n, {}, {}};
  const std::size_t rows = k, columns = n;
  const auto packed = [&](std::size_t depth, std::size_t width, std::size_t row_stride, std::size_t column_stride) {
    std::vector<Packed::Line> lines((kernels_.packed_size(depth, width) + 15) / 16);
    kernels_.pack(depth, width, data, row_stride, column_stride, lines.front().values);
    return lines;
  };
  p.forward = packed(rows, columns, columns, 1);
  if (!products) p.backward = packed(columns, rows, 1, columns);
  return p;
}

void Network::times(const Packed& b, Index m, const float* a, Index lda, float* c, Index ldc, const float* start,
                    bool accumulate) const {
  kernels_.gemm(m, b.k, b.n, a, lda, b.forward.front().values, c, ldc, start, accumulate);
}
void Network::times_transposed(const Packed& b, Index m, const float* a, Index lda, float* c, Index ldc,
                               bool accumulate) const {
  kernels_.gemm(m, b.n, b.k, a, lda, b.backward.front().values, c, ldc, nullptr, accumulate);
}

void Network::normalise(Index rows, float* z, std::vector<float>& factor) const {
  factor.assign(rows, 1.0f);
  if (!norm_) return;
  for (Index r = 0; r < rows; ++r) {
    float* a = z + size_of(r, z_);
    float sum = 1.0f;
    for (Index i = norm_begin(); i < z_; ++i) sum += a[i] * a[i];
    const float s = 1.0f / std::sqrt(sum);
    for (Index i = norm_begin(); i < z_; ++i) a[i] *= s;
    factor[r] = s;
  }
}

void Network::normalise_derivative(float* g, const float* b, float factor) const {
  if (!norm_) return;
  float dot = 0.0f;
  for (Index i = norm_begin(); i < z_; ++i) dot += b[i] * g[i];
  for (Index i = norm_begin(); i < z_; ++i) g[i] = factor * (g[i] - b[i] * dot);
}

Index Network::skip_of(Index layer) const {
  // Skips of length 1 and 2; where several meet, only the longest is added (EM*D).
  if (arch_.residual == 0 || layer == 0) return -1;
  return std::max<Index>(layer - arch_.residual, 0);
}

void Network::forward(const Block& block, Tape& tape, float* mean, float* sigma) const {
  const Index most = block.rows == 0 ? 0 : block.steps.front();
  tape.running.clear();
  tape.offset.assign(1, 0);
  for (Index j = 0; j < most; ++j) {
    tape.running.push_back(block.running(j));
    tape.offset.push_back(tape.offset.back() + tape.running.back());
  }
  tape.z.resize(most + 1);
  tape.norm.resize(most + 1);
  encode(block, tape);
  advance(block, tape);
  decode(block, tape, mean, sigma);
}

std::vector<float> Network::velocities(const Block& block) const {
  std::vector<float> velocity(size_of(block.rows, arch_.latent));
  times(project_, block.rows, block.change.data(), dim_.coordinates(), velocity.data(), arch_.latent, nullptr, false);
  for (float& v : velocity) v *= kVelocityGain;
  return velocity;
}

void Network::encode(const Block& block, Tape& tape) const {
  const Index n = dim_.coordinates(), rows = block.rows;
  tape.encoder_pre.resize(size_of(rows, arch_.encoder_hidden));
  times(encoder_shape_, rows, block.shape.data(), n, tape.encoder_pre.data(), arch_.encoder_hidden,
        bias(layout_.encoder_bias), false);
  if (arch_.previous_shape) {
    const std::vector<float> velocity = velocities(block);
    times(encoder_velocity_, rows, velocity.data(), arch_.latent, tape.encoder_pre.data(), arch_.encoder_hidden,
          nullptr, true);
  }
  std::vector<float> work(tape.encoder_pre.size());
  kernels_.activate(work.size(), tape.encoder_pre.data(), work.data(), tanh());
  tape.z[0].resize(size_of(rows, z_));
  times(encoder_out_, rows, work.data(), arch_.encoder_hidden, tape.z[0].data(), z_, bias(layout_.encoder_out_bias),
        false);
  if (arch_.pca_skip) times(project_, rows, block.shape.data(), n, tape.z[0].data(), z_, nullptr, true);
  normalise(rows, tape.z[0].data(), tape.norm[0]);
}

void Network::advance(const Block& block, Tape& tape) const {
  const Index hidden = arch_.hidden, u = dim_.inputs(), total = block.total();
  // The inputs' contribution to each layer does not depend on the state, so one product serves all segments.
  const auto layers = layer_h_.size();
  tape.pre.resize(layers);
  tape.post.resize(layers);
  for (std::size_t l = 0; l < layers; ++l) {
    tape.pre[l].resize(size_of(total, hidden));
    tape.post[l].resize(size_of(total, hidden));
    const float* b = bias(layout_.layers[l].b);
    if (layout_.layers[l].u >= 0) {
      times(layer_u_[l], total, block.inputs.data(), u, tape.pre[l].data(), hidden, b, false);
    } else {
      for (Index i = 0; i < total; ++i) std::copy(b, b + hidden, tape.pre[l].data() + size_of(i, hidden));
    }
  }
  std::vector<float> update(size_of(total, z_));
  if (layout_.out.u >= 0) {
    times(out_u_, total, block.inputs.data(), u, update.data(), z_, bias(layout_.out.b), false);
  } else {
    for (Index i = 0; i < total; ++i) std::copy_n(bias(layout_.out.b), z_, update.data() + size_of(i, z_));
  }
  for (std::size_t at = 0; at < tape.running.size(); ++at) {
    const Index m = tape.running[at];
    const std::size_t first = size_of(tape.offset[at], hidden);
    const std::size_t count = size_of(m, hidden);
    const float* below = tape.z[at].data();
    Index below_size = z_;
    for (std::size_t l = 0; l < layers; ++l) {
      float* pre = tape.pre[l].data() + first;
      float* post = tape.post[l].data() + first;
      times(layer_h_[l], m, below, below_size, pre, hidden, nullptr, true);
      kernels_.activate(count, pre, post, tanh());
      if (const Index skip = skip_of(l); skip >= 0) add(post, tape.post[skip].data() + first, count);
      below = post;
      below_size = hidden;
    }
    float* dz = update.data() + size_of(tape.offset[at], z_);
    times(out_h_, m, below, hidden, dz, z_, nullptr, true);
    auto& next = tape.z[at + 1];
    next.assign(dz, dz + size_of(m, z_));
    if (arch_.differential_latent) add(next.data(), tape.z[at].data(), next.size());
    normalise(m, next.data(), tape.norm[at + 1]);
  }
}

std::vector<float> Network::wanted_states(const Block& block, const Tape& tape) const {
  std::vector<float> z(size_of(std::ssize(block.wanted), z_));
  for (Index w = 0; w < std::ssize(block.wanted); ++w) {
    const auto& one = block.wanted[w];
    std::copy_n(tape.z[one.step].data() + size_of(one.row, z_), z_, z.data() + size_of(w, z_));
  }
  return z;
}

void Network::decode(const Block& block, Tape& tape, float* mean, float* sigma) const {
  const Index n = decoded(), rows = block.rows;
  const Index wanted = block.wanted.size();
  const Index width = arch_.decoder_hidden;
  std::vector<float> z = wanted_states(block, tape);
  tape.decoder_pre.resize(size_of(wanted, width));
  times(decoder_in_, wanted, z.data(), z_, tape.decoder_pre.data(), width, bias(layout_.decoder_bias), false);
  std::vector<float> features(tape.decoder_pre.size());
  kernels_.activate(features.size(), tape.decoder_pre.data(), features.data(), tanh());
  if (sigma != nullptr) {
    times(sigma_, wanted, features.data(), width, sigma, n, bias(layout_.sigma_bias), false);
    const std::size_t count = size_of(wanted, n);
    tape.sigma_exp.resize(count);
    for (std::size_t i = 0; i < count; ++i) sigma[i] = std::min(sigma[i], kLargestLogSigma);
    kernels_.exponential(count, sigma, tape.sigma_exp.data());
    for (std::size_t i = 0; i < count; ++i) {
      const bool at_end = !(sigma[i] < kLargestLogSigma);
      sigma[i] = floor_ + tape.sigma_exp[i];
      if (at_end) tape.sigma_exp[i] = 0.0f;
    }
  } else {
    tape.sigma_exp.clear();
  }
  if (arch_.differential_decoding) {
    tape.start_pre.resize(size_of(rows, width));
    times(decoder_in_, rows, tape.z[0].data(), z_, tape.start_pre.data(), width, bias(layout_.decoder_bias), false);
    std::vector<float> start(tape.start_pre.size());
    kernels_.activate(start.size(), tape.start_pre.data(), start.data(), tanh());
    for (Index w = 0; w < wanted; ++w) {
      const Index row = block.wanted[w].row;
      for (Index i = 0; i < width; ++i) features[size_of(w, width) + i] -= start[size_of(row, width) + i];
      for (Index i = 0; i < z_; ++i) z[size_of(w, z_) + i] -= tape.z[0][size_of(row, z_) + i];
      const float* from = block.shape.data() + size_of(row, dim_.coordinates());
      float* to = mean + size_of(w, n);
      if (columns_.empty())
        std::copy_n(from, n, to);
      else
        std::transform(columns_.begin(), columns_.end(), to, [&](std::int64_t c) { return from[c]; });
    }
    times(mean_, wanted, features.data(), width, mean, n, nullptr, true);
  } else {
    times(mean_, wanted, features.data(), width, mean, n, bias(layout_.mean_bias), false);
  }
  if (arch_.pca_skip) times(expand_, wanted, z.data(), z_, mean, n, nullptr, true);
}

void Network::pullback(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma, float* d_inputs,
                       float* d_shape, float* d_change) const {
  const bool to_start = d_shape != nullptr;
  Cotangents d;
  if (to_start) std::fill_n(d_shape, size_of(block.rows, dim_.coordinates()), 0.0f);
  decode_pullback(block, tape, d_mean, d_sigma, d, to_start, d_shape);
  advance_pullback(block, tape, d, to_start, d_inputs);
  if (!to_start) return;
  encode_pullback(block, tape, d);
  shape_pullback(block, d, d_shape, d_change);
}

void Network::decode_pullback(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma,
                              Cotangents& d, bool to_start, float* d_shape) const {
  const Index n = decoded(), rows = block.rows;
  const Index wanted = block.wanted.size();
  const Index width = arch_.decoder_hidden;
  d.z.resize(tape.z.size());
  for (std::size_t j = 0; j < d.z.size(); ++j) d.z[j].assign(tape.z[j].size(), 0.0f);
  d.decoder.assign(size_of(wanted, width), 0.0f);
  std::vector<float> d_code(size_of(wanted, z_), 0.0f);
  if (d_mean != nullptr) {
    times_transposed(mean_, wanted, d_mean, n, d.decoder.data(), width, false);
    if (arch_.pca_skip) times_transposed(expand_, wanted, d_mean, n, d_code.data(), z_, false);
    if (arch_.differential_decoding && to_start) {
      d.start.assign(size_of(rows, width), 0.0f);
      for (Index w = 0; w < wanted; ++w) {
        const Index row = block.wanted[w].row;
        for (Index i = 0; i < width; ++i) d.start[size_of(row, width) + i] -= d.decoder[size_of(w, width) + i];
        for (Index i = 0; i < z_; ++i) d.z[0][size_of(row, z_) + i] -= d_code[size_of(w, z_) + i];
        if (d_shape != nullptr) add(d_shape + size_of(row, n), d_mean + size_of(w, n), n);
      }
      kernels_.activate_pullback(d.start.size(), tape.start_pre.data(), d.start.data(), tanh());
      times_transposed(decoder_in_, rows, d.start.data(), width, d.z[0].data(), z_, true);
    }
  }
  if (d_sigma != nullptr) {
    d.log_sigma.resize(size_of(wanted, n));
    for (std::size_t i = 0; i < d.log_sigma.size(); ++i) d.log_sigma[i] = d_sigma[i] * tape.sigma_exp[i];
    times_transposed(sigma_, wanted, d.log_sigma.data(), n, d.decoder.data(), width, true);
  }
  kernels_.activate_pullback(d.decoder.size(), tape.decoder_pre.data(), d.decoder.data(), tanh());
  times_transposed(decoder_in_, wanted, d.decoder.data(), width, d_code.data(), z_, true);
  for (Index w = 0; w < wanted; ++w) {
    const auto& one = block.wanted[w];
    add(d.z[one.step].data() + size_of(one.row, z_), d_code.data() + size_of(w, z_), z_);
  }
}

void Network::advance_pullback(const Block& block, const Tape& tape, Cotangents& d, bool to_start,
                               float* d_inputs) const {
  const Index hidden = arch_.hidden, u = dim_.inputs(), total = block.total();
  const auto layers = layer_h_.size();
  d.pre.assign(layers, std::vector<float>(size_of(total, hidden)));
  d.update.resize(size_of(total, z_));
  for (std::size_t at = tape.running.size(); at-- > 0;) {
    const Index m = tape.running[at];
    const std::size_t first = size_of(tape.offset[at], hidden), count = size_of(m, hidden);
    float* g = d.z[at + 1].data();
    for (Index r = 0; r < m; ++r)
      normalise_derivative(g + size_of(r, z_), tape.z[at + 1].data() + size_of(r, z_), tape.norm[at + 1][r]);
    std::copy_n(g, size_of(m, z_), d.update.data() + size_of(tape.offset[at], z_));
    const bool to_state = at > 0 || to_start;
    if (arch_.differential_latent && to_state) add(d.z[at].data(), g, size_of(m, z_));
    times_transposed(out_h_, m, g, z_, d.pre[layers - 1].data() + first, hidden, true);
    for (std::size_t l = layers; l-- > 0;) {
      float* here = d.pre[l].data() + first;  // so far: the cotangent of the layer's output
      if (const Index skip = skip_of(l); skip >= 0) add(d.pre[skip].data() + first, here, count);
      kernels_.activate_pullback(count, tape.pre[l].data() + first, here, tanh());
      if (l > 0) {
        times_transposed(layer_h_[l], m, here, hidden, d.pre[l - 1].data() + first, hidden, true);
      } else if (to_state) {
        times_transposed(layer_h_[0], m, here, hidden, d.z[at].data(), z_, true);
      }
    }
  }
  if (d_inputs == nullptr) return;
  std::fill_n(d_inputs, size_of(total, u), 0.0f);
  for (std::size_t l = 0; l < layers; ++l) {
    if (layout_.layers[l].u >= 0) times_transposed(layer_u_[l], total, d.pre[l].data(), hidden, d_inputs, u, true);
  }
  if (layout_.out.u >= 0) times_transposed(out_u_, total, d.update.data(), z_, d_inputs, u, true);
}

void Network::encode_pullback(const Block& block, const Tape& tape, Cotangents& d) const {
  const Index rows = block.rows;
  float* g = d.z[0].data();
  for (Index r = 0; r < rows; ++r)
    normalise_derivative(g + size_of(r, z_), tape.z[0].data() + size_of(r, z_), tape.norm[0][r]);
  d.encoder.resize(size_of(rows, arch_.encoder_hidden));
  times_transposed(encoder_out_, rows, g, z_, d.encoder.data(), arch_.encoder_hidden, false);
  kernels_.activate_pullback(d.encoder.size(), tape.encoder_pre.data(), d.encoder.data(), tanh());
}

void Network::shape_pullback(const Block& block, const Cotangents& d, float* d_shape, float* d_change) const {
  const Index n = dim_.coordinates(), rows = block.rows;
  if (arch_.pca_skip) times_transposed(project_, rows, d.z[0].data(), z_, d_shape, n, true);
  times_transposed(encoder_shape_, rows, d.encoder.data(), arch_.encoder_hidden, d_shape, n, true);
  if (!arch_.previous_shape) {
    std::fill_n(d_change, size_of(rows, n), 0.0f);
    return;
  }
  std::vector<float> d_velocity(size_of(rows, arch_.latent));
  times_transposed(encoder_velocity_, rows, d.encoder.data(), arch_.encoder_hidden, d_velocity.data(), arch_.latent,
                   false);
  for (float& v : d_velocity) v *= kVelocityGain;
  times_transposed(project_, rows, d_velocity.data(), arch_.latent, d_change, n, false);
}

void Network::jvp(const Block& block, const Tape& tape, const std::vector<Index>& base, const float* d_inputs,
                  float* d_mean, float* d_sigma) const {
  const Index n = dim_.coordinates(), hidden = arch_.hidden, u = dim_.inputs();
  const Index directions = base.size();
  const Index most = tape.running.size();
  const auto layers = layer_h_.size();
  // Rows are ordered by descending steps and base ascends, so directions of rows that still run come first.
  std::vector<float> z(size_of(directions, z_), 0.0f);
  std::vector<std::vector<float>> history{z};
  std::vector<float> slope(size_of(directions, hidden));
  std::vector<std::vector<float>> post(layers, slope);
  Index offset = 0;
  for (Index j = 0; j < most; ++j) {
    const std::size_t at = j;
    const Index m = std::lower_bound(base.begin(), base.end(), tape.running[at]) - base.begin();
    const float* inputs = d_inputs + size_of(offset, u);
    const float* below = z.data();
    Index below_size = z_;
    const std::size_t count = size_of(m, hidden);
    for (std::size_t l = 0; l < layers; ++l) {
      float* d = post[l].data();
      std::fill_n(d, count, 0.0f);
      if (layout_.layers[l].u >= 0) times(layer_u_[l], m, inputs, u, d, hidden, nullptr, false);
      times(layer_h_[l], m, below, below_size, d, hidden, nullptr, true);
      for (Index t = 0; t < m; ++t) {
        std::copy_n(tape.pre[l].data() + size_of(tape.offset[at] + base[t], hidden), hidden,
                    slope.data() + size_of(t, hidden));
      }
      kernels_.activate_pullback(count, slope.data(), d, tanh());
      if (const Index skip = skip_of(l); skip >= 0) add(d, post[skip].data(), count);
      below = d;
      below_size = hidden;
    }
    std::vector<float> next(size_of(directions, z_), 0.0f);
    if (layout_.out.u >= 0) times(out_u_, m, inputs, u, next.data(), z_, nullptr, false);
    times(out_h_, m, below, hidden, next.data(), z_, nullptr, true);
    if (arch_.differential_latent) add(next.data(), z.data(), size_of(m, z_));
    for (Index t = 0; t < m; ++t) {
      const Index row = base[t];
      normalise_derivative(next.data() + size_of(t, z_), tape.z[at + 1].data() + size_of(row, z_),
                           tape.norm[at + 1][row]);
    }
    z = std::move(next);
    history.push_back(z);
    offset += m;
  }

  std::vector<std::vector<Index>> of_row(block.rows);
  for (std::size_t w = 0; w < block.wanted.size(); ++w) of_row[block.wanted[w].row].push_back(w);
  std::vector<Index> source;
  std::vector<float> code;
  for (Index t = 0; t < directions; ++t) {
    for (const Index w : of_row[base[t]]) {
      source.push_back(w);
      const float* from = history[block.wanted[w].step].data() + size_of(t, z_);
      code.insert(code.end(), from, from + z_);
    }
  }
  const Index count = source.size();
  const Index width = arch_.decoder_hidden;
  std::vector<float> features(size_of(count, width)), pre(size_of(count, width));
  times(decoder_in_, count, code.data(), z_, features.data(), width, nullptr, false);
  for (Index i = 0; i < count; ++i) {
    std::copy_n(tape.decoder_pre.data() + size_of(source[i], width), width, pre.data() + size_of(i, width));
  }
  kernels_.activate_pullback(features.size(), pre.data(), features.data(), tanh());
  times(mean_, count, features.data(), width, d_mean, n, nullptr, false);
  if (arch_.pca_skip) times(expand_, count, code.data(), z_, d_mean, n, nullptr, true);
  if (d_sigma == nullptr) return;
  times(sigma_, count, features.data(), width, d_sigma, n, nullptr, false);
  for (Index i = 0; i < count; ++i) {
    const float* e = tape.sigma_exp.data() + size_of(source[i], n);
    for (Index c = 0; c < n; ++c) d_sigma[size_of(i, n) + c] *= e[c];
  }
}

}  // namespace weft::emd
