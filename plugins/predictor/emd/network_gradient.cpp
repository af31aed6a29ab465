// The gradient of the weights, for training. A weight enters by a product X W or a sum, so its gradient is X^T D or the sum of
// D's rows, where D is the cotangent of the result (Network::Cotangents).
#include <algorithm>

#include "network.hpp"

namespace weft::emd {

void Network::weight_gradient(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma,
                              std::vector<float>& gradient) const {
  Cotangents d;
  decode_pullback(block, tape, d_mean, d_sigma, d, true, nullptr);
  advance_pullback(block, tape, d, true, nullptr);
  encode_pullback(block, tape, d);
  gradient.resize(layout_.size);
  decoder_gradient(block, tape, d_mean, d, gradient.data());
  module_gradient(block, tape, d, gradient.data());
  encoder_gradient(block, tape, d, gradient.data());
}

void Network::put_product(int weight, Index m, const float* a, const float* d, float* gradient, bool adds) const {
  const auto& w = layout_.weights[weight];
  const bool some = !columns_.empty() && is_decoded(weight);
  const std::size_t k = w.rows, n = some ? decoded() : w.columns, rows = m;
  std::vector<float> transposed(k * rows);
  for (std::size_t r = 0; r < rows; ++r)
    for (std::size_t i = 0; i < k; ++i) transposed[i * rows + r] = a[r * k + i];
  std::vector<Packed::Line> packed((kernels_.packed_size(rows, n) + 15) / 16);
  kernels_.pack(rows, n, d, n, 1, packed.front().values);
  float* to = gradient + w.offset;
  if (!some) {
    kernels_.gemm(k, rows, n, transposed.data(), rows, packed.front().values, to, n, nullptr, adds);
    return;
  }
  std::vector<float> of_columns(k * n);
  kernels_.gemm(k, rows, n, transposed.data(), rows, packed.front().values, of_columns.data(), n, nullptr, false);
  std::fill_n(to, w.size(), 0.0f);
  for (std::size_t i = 0; i < k; ++i)
    for (std::size_t j = 0; j < n; ++j) to[size_of(i, w.columns) + columns_[j]] = of_columns[i * n + j];
}

void Network::put_rows(int weight, Index m, const float* d, float* gradient, bool adds) const {
  const auto& w = layout_.weights[weight];
  const bool some = !columns_.empty() && is_decoded(weight);
  const Index n = some ? decoded() : w.columns;
  std::vector<float> sum(n, 0.0f);
  for (Index r = 0; r < m; ++r)
    for (Index j = 0; j < n; ++j) sum[j] += d[size_of(r, n) + j];
  float* to = gradient + w.offset;
  if (!adds) std::fill_n(to, w.size(), 0.0f);
  for (Index j = 0; j < n; ++j) to[some ? columns_[j] : j] += sum[j];
}

void Network::decoder_gradient(const Block& block, const Tape& tape, const float* d_mean, const Cotangents& d,
                               float* gradient) const {
  const Index wanted = block.wanted.size(), rows = block.rows, width = arch_.decoder_hidden;
  std::vector<float> features(tape.decoder_pre.size());
  kernels_.activate(features.size(), tape.decoder_pre.data(), features.data(), tanh());
  put_product(layout_.sigma, wanted, features.data(), d.log_sigma.data(), gradient);
  put_rows(layout_.sigma_bias, wanted, d.log_sigma.data(), gradient);
  put_product(layout_.decoder_in, wanted, wanted_states(block, tape).data(), d.decoder.data(), gradient);
  put_rows(layout_.decoder_bias, wanted, d.decoder.data(), gradient);
  if (arch_.differential_decoding) {
    std::vector<float> start(tape.start_pre.size());
    kernels_.activate(start.size(), tape.start_pre.data(), start.data(), tanh());
    for (Index w = 0; w < wanted; ++w) {
      const Index row = block.wanted[w].row;
      for (Index i = 0; i < width; ++i) features[size_of(w, width) + i] -= start[size_of(row, width) + i];
    }
    put_product(layout_.decoder_in, rows, tape.z[0].data(), d.start.data(), gradient, true);
    put_rows(layout_.decoder_bias, rows, d.start.data(), gradient, true);
  } else {
    put_rows(layout_.mean_bias, wanted, d_mean, gradient);
  }
  put_product(layout_.mean, wanted, features.data(), d_mean, gradient);
}

void Network::module_gradient(const Block& block, const Tape& tape, const Cotangents& d, float* gradient) const {
  const Index total = block.total();
  // The states before every segment, those that run it.
  std::vector<float> states(size_of(total, z_));
  for (std::size_t at = 0; at < tape.running.size(); ++at)
    std::copy_n(tape.z[at].data(), size_of(tape.running[at], z_), states.data() + size_of(tape.offset[at], z_));
  const float* below = states.data();
  const auto add_layer = [&](const Layout::Layer& layer, const float* cotangent) {
    put_product(layer.h, total, below, cotangent, gradient);
    if (layer.u >= 0) put_product(layer.u, total, block.inputs.data(), cotangent, gradient);
    put_rows(layer.b, total, cotangent, gradient);
  };
  for (std::size_t l = 0; l < layout_.layers.size(); ++l) {
    add_layer(layout_.layers[l], d.pre[l].data());
    below = tape.post[l].data();
  }
  add_layer(layout_.out, d.update.data());
}

void Network::encoder_gradient(const Block& block, const Tape& tape, const Cotangents& d, float* gradient) const {
  const Index rows = block.rows;
  std::vector<float> hidden(tape.encoder_pre.size());
  kernels_.activate(hidden.size(), tape.encoder_pre.data(), hidden.data(), tanh());
  put_product(layout_.encoder_out, rows, hidden.data(), d.z[0].data(), gradient);
  put_rows(layout_.encoder_out_bias, rows, d.z[0].data(), gradient);
  put_product(layout_.encoder_shape, rows, block.shape.data(), d.encoder.data(), gradient);
  put_rows(layout_.encoder_bias, rows, d.encoder.data(), gradient);
  if (!arch_.previous_shape) return;
  const std::vector<float> velocity = velocities(block);
  put_product(layout_.encoder_velocity, rows, velocity.data(), d.encoder.data(), gradient);
}

}  // namespace weft::emd
