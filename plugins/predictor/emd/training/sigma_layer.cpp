// The decoder's sigma layer, fitted alone. Part of the training library; libtorch runs the network.
#include "sigma_layer.hpp"

#include <cmath>
#include <numbers>

#include "passes.hpp"
#include "weft/random.hpp"

namespace weft::emd {
namespace {

constexpr std::int64_t kBatch = 32;
constexpr std::uint64_t kFitStream = 0x7369676d61ull;     // "sigma"
constexpr std::uint64_t kLossStream = 0x6865646f7574ull;  // "hedout"

/// How sequences are drawn: half of them from the start; a third each with exact knowledge, with none and between.
/// These are the cases that are calibrated.
Training shares() {
  Training t;
  t.start_share = 0.5;
  t.certain_share = t.unknown_share = 1.0 / 3.0;
  return t;
}

struct Terms {
  Tensor loss;         ///< [wanted]: mean over coordinates
  Tensor d_log_sigma;  ///< [wanted, coordinates]: of the sum of `loss` over shapes, times coordinates
};
Terms terms_of(const Passes& passes, const Graph::Output& out, const Batch& batch, double tails) {
  const auto [e, sigma] = sigma_of(passes.model(), out.log_sigma);
  const Tensor r2 = at::square((out.mean - passes.target(batch)) / sigma);
  const Tensor near = at::clamp_max(r2, kTailEnd);
  // r^4 / 2 up to the end, its tangent beyond: near (r^2 - near / 2).
  const Tensor loss = at::log(sigma) + r2 * (0.5 * (1.0 - 3.0 * tails)) + near * (r2 - near * 0.5) * (0.5 * tails);
  const Tensor by_log_sigma = 1.0 - r2 * (1.0 - 3.0 * tails) - near * r2 * tails;
  return {at::mean(loss, 1).contiguous(), by_log_sigma * (e / sigma) * (out.log_sigma < kLargestLogSigma)};
}

}  // namespace

std::vector<float> fit_sigma_layer(const Passes& passes, const std::vector<std::size_t>& examples,
                                   std::int64_t passes_over, double tails, std::uint64_t seed) {
  const at::NoGradGuard guard;
  const Model& model = passes.model();
  const Layout layout(model.architecture, model.dimensions);
  std::vector<float> weights = model.weights;
  const Graph graph(model, weights.data(), nullptr);  // its tensors are views of `weights`
  const auto& matrix = layout.weights[layout.sigma];
  const auto& bias = layout.weights[layout.sigma_bias];
  Tensor layer[] = {view(weights.data() + matrix.offset, matrix.rows, matrix.columns),
                    view(weights.data() + bias.offset, bias.rows, bias.columns)};
  Tensor first[] = {at::zeros_like(layer[0]), at::zeros_like(layer[1])},
         second[] = {first[0].clone(), first[1].clone()};
  const RandomStream streams(seed, kFitStream);
  const Training drawn = shares();
  const std::int64_t count = examples.size(), iterations = (passes_over * count + kBatch - 1) / kBatch;
  constexpr double kRate = 1e-3, kBeta1 = 0.9, kBeta2 = 0.99;
  for (std::int64_t k = 0; k < iterations && !passes.cancelled(); ++k) {
    const RandomStream of_iteration = streams.child(k);
    std::vector<Sequence> sequences;
    for (std::int64_t b = 0; b < kBatch; ++b) {
      RandomStream random = of_iteration.child(b);
      const std::size_t i = examples[random.below(examples.size())];
      sequences.push_back(sample_sequence(i, passes.example(i), drawn, random));
    }
    const Batch batch = passes.make_batch(std::move(sequences));
    const Graph::Output out = passes.forward(graph, batch);
    const Terms terms = terms_of(passes, out, batch, tails);
    const Tensor d = terms.d_log_sigma / static_cast<double>(terms.d_log_sigma.size(0));
    const Tensor gradients[] = {at::mm(out.hidden.t(), d), at::sum(d, {0}, true)};
    // Adam, with a rate that falls to 0 as half a cosine wave. Coordinates are independent in this layer, so their
    // number does not enter the gradient.
    const double n = static_cast<double>(k) + 1.0;
    const double rate =
        0.5 * kRate * (1.0 + std::cos(std::numbers::pi * static_cast<double>(k) / static_cast<double>(iterations)));
    for (int w = 0; w < 2; ++w) {
      first[w].mul_(kBeta1).add_(gradients[w], 1.0 - kBeta1);
      second[w].mul_(kBeta2).addcmul_(gradients[w], gradients[w], 1.0 - kBeta2);
      const Tensor scale = at::sqrt(second[w] / (1.0 - std::pow(kBeta2, n))) + 1e-8;
      layer[w].addcdiv_(first[w], scale, -rate / (1.0 - std::pow(kBeta1, n)));
    }
  }
  return weights;
}

double sigma_layer_loss(const Passes& passes, const std::vector<float>& weights,
                        const std::vector<std::size_t>& examples, double tails, std::uint64_t seed) {
  const at::NoGradGuard guard;
  constexpr int kDraws = 4;
  const Graph graph(passes.model(), weights.data(), nullptr);
  const RandomStream streams(seed, kLossStream);
  const Training drawn = shares();
  std::vector<Sequence> all;
  for (const std::size_t i : examples) {
    RandomStream random = streams.child(i);
    for (int draw = 0; draw < kDraws; ++draw) all.push_back(sample_sequence(i, passes.example(i), drawn, random));
  }
  double sum = 0.0, count = 0.0;
  for (std::size_t b = 0; b < Passes::batches(all); ++b) {
    const Batch batch = passes.batch(all, b);
    const Tensor loss = terms_of(passes, passes.forward(graph, batch), batch, tails).loss;
    sum += at::sum(loss).item<double>();
    count += static_cast<double>(loss.size(0));
  }
  return sum / count;
}

}  // namespace weft::emd
