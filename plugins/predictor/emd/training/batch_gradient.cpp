#include "batch_gradient.hpp"

#include <utility>

#include "loss.hpp"

namespace weft::emd {

BatchGradient::BatchGradient(Passes& passes, const Training& training, const Kernels& kernels, Host& host,
                             const Ranks& ranks, std::size_t parts)
    : passes_(passes),
      t_(training),
      host_(host),
      network_(passes.model(), kernels),
      all_parts_(parts),
      first_part_(ranks.rank() * (parts / ranks.size())),
      gradients_(parts / ranks.size()) {}

std::vector<double> BatchGradient::compute(const std::vector<float>& weights, const std::vector<Sequence>& sequences,
                                           const std::vector<std::int64_t>& columns) {
  double shapes = 0.0;
  for (const auto& s : sequences) shapes += static_cast<double>(s.decoded.size());
  network_.set_weights(weights.data(), columns, host_);
  std::vector<double> losses(gradients_.size());
  host_.parallel_for(std::ssize(gradients_), [&](std::int64_t p) {
    std::vector<Sequence> part;
    for (std::size_t i = first_part_ + p; i < sequences.size(); i += all_parts_) part.push_back(sequences[i]);
    Batch batch = passes_.make_batch(std::move(part));
    batch.columns = columns;
    std::vector<float> mean(batch.wanted.size() * network_.decoded()), sigma(mean.size());
    Network::Tape tape;
    network_.forward(batch, tape, mean.data(), sigma.data());
    const LossGradient loss =
        loss_gradient(mean, sigma, batch, passes_.model().dimensions.coordinates(), shapes, t_.beta);
    network_.weight_gradient(batch, tape, loss.d_mean.data(), loss.d_sigma.data(), gradients_[p]);
    losses[p] = loss.sum;
  });
  return losses;
}

std::vector<std::size_t> BatchGradient::examples(const std::vector<Sequence>& sequences) const {
  std::vector<std::size_t> found;
  for (std::size_t i = 0; i < sequences.size(); ++i) {
    const std::size_t part = i % all_parts_;
    if (part >= first_part_ && part < first_part_ + gradients_.size()) found.push_back(sequences[i].example);
  }
  return found;
}

}  // namespace weft::emd
