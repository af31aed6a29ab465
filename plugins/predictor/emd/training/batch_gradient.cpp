#include "batch_gradient.hpp"

#include <torch/csrc/autograd/autograd.h>

#include <algorithm>

#include "loss.hpp"

namespace weft::emd {

BatchGradient::BatchGradient(Passes& passes, const Training& training, const std::vector<float>& weights,
                             const Ranks& ranks, std::size_t parts)
    : passes_(passes), t_(training), all_parts_(parts), first_part_(ranks.rank() * (parts / ranks.size())) {
  gradients_.assign(parts / ranks.size(), std::vector<float>(weights.size(), 0.0f));
  for (auto& gradient : gradients_) graphs_.emplace_back(passes.model(), weights.data(), gradient.data());
}

std::vector<double> BatchGradient::compute(const std::vector<Sequence>& sequences,
                                           const std::vector<std::int64_t>& columns) {
  double shapes = 0.0;
  for (const auto& s : sequences) shapes += s.decoded.size();
  std::vector<double> losses(graphs_.size());
  passes_.side_by_side(graphs_.size(), [&](std::size_t p) {
    std::vector<Sequence> part;
    for (std::size_t i = first_part_ + p; i < sequences.size(); i += all_parts_) part.push_back(sequences[i]);
    Batch batch = passes_.make_batch(std::move(part));
    batch.columns = columns;
    std::fill(gradients_[p].begin(), gradients_[p].end(), 0.0f);
    const Graph::Output out = passes_.forward(graphs_[p], batch);
    const LossGradient loss = loss_gradient(passes_, out, batch, shapes, t_.beta);
    torch::autograd::backward({out.mean, out.log_sigma}, {loss.d_mean, loss.d_log_sigma});
    losses[p] = loss.sum;
  });
  return losses;
}

std::vector<std::size_t> BatchGradient::examples(const std::vector<Sequence>& sequences) const {
  std::vector<std::size_t> found;
  for (std::size_t i = 0; i < sequences.size(); ++i) {
    const std::size_t part = i % all_parts_;
    if (part >= first_part_ && part < first_part_ + graphs_.size()) found.push_back(sequences[i].example);
  }
  return found;
}

}  // namespace weft::emd
