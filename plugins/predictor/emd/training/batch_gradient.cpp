#include "batch_gradient.hpp"

#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <numeric>

#include "loss.hpp"

namespace weft::emd {

BatchGradient::BatchGradient(Passes& passes, const Training& training, const std::vector<float>& weights)
    : passes_(passes), t_(training) {
  const auto parts = std::min(t_.optimiser == "signsgd" ? t_.votes : t_.parts, t_.batch);
  gradients_.assign(parts, std::vector<float>(weights.size(), 0.0f));
  for (auto& gradient : gradients_) graphs_.emplace_back(passes.model(), weights.data(), gradient.data());
}

double BatchGradient::compute(const std::vector<Sequence>& sequences, const std::vector<std::int64_t>& columns) {
  const std::size_t parts = graphs_.size();
  double shapes = 0.0;
  for (const auto& s : sequences) shapes += s.decoded.size();
  std::vector<double> losses(parts);
  passes_.side_by_side(parts, [&](std::size_t p) {
    std::vector<Sequence> part;
    for (std::size_t i = p; i < sequences.size(); i += parts) part.push_back(sequences[i]);
    Batch batch = passes_.make_batch(std::move(part));
    batch.columns = columns;
    std::fill(gradients_[p].begin(), gradients_[p].end(), 0.0f);
    const Graph::Output out = passes_.forward(graphs_[p], batch);
    const LossGradient loss = loss_gradient(passes_, out, batch, shapes, t_.beta);
    torch::autograd::backward({out.mean, out.log_sigma}, {loss.d_mean, loss.d_log_sigma});
    losses[p] = loss.sum;
  });
  return std::accumulate(losses.begin(), losses.end(), 0.0) / shapes;
}

}  // namespace weft::emd
