#include "validation.hpp"

#include "loss.hpp"
#include "weft/random.hpp"

namespace weft::emd {
namespace {

constexpr std::uint64_t kValidationStream = 0x76616c6964ull;  // "valid"

}  // namespace

Validation::Validation(Passes& passes, const std::vector<std::size_t>& examples, std::int64_t cases, std::uint64_t seed)
    : passes_(passes) {
  // Of each example one sequence from its start and one from any segment, with knowledge of eq. 3.
  const RandomStream streams(seed, kValidationStream);
  std::vector<Sequence> all;
  for (std::size_t i = 0; static_cast<std::int64_t>(all.size()) < cases && i < 2 * examples.size(); ++i) {
    RandomStream random = streams.child(i);
    Sequence s;
    s.example = examples[i / 2];
    const auto& e = passes.example(s.example);
    s.start = i % 2 == 0 ? 0 : random.below(e.segments());
    s.steps = e.segments() - s.start;
    s.knowledge = sample_knowledge(e.q, 0.3, 0.3, random);
    for (Index j = 1; j <= s.steps; ++j) s.decoded.push_back(j);
    all.push_back(s);
  }
  for (std::size_t b = 0; b < Passes::batches(all); ++b) batches_.push_back(passes.batch(all, b));
}

Validation::Result Validation::evaluate(const std::vector<float>& weights) const {
  const Graph graph(passes_.model(), weights.data(), nullptr);
  std::vector<ShapeErrors> errors(batches_.size());
  passes_.side_by_side(batches_.size(), [&](std::size_t b) {
    const at::NoGradGuard guard;
    errors[b] = shape_errors(passes_, passes_.forward(graph, batches_[b]), batches_[b]);
  });
  double loss = 0.0, distance = 0.0, shapes = 0.0, ends = 0.0;
  for (std::size_t b = 0; b < batches_.size(); ++b) {
    const auto& wanted = batches_[b].wanted;
    loss += errors[b].loss_sum;
    shapes += wanted.size();
    for (std::size_t w = 0; w < wanted.size(); ++w) {
      if (w + 1 < wanted.size() && wanted[w + 1].row == wanted[w].row) continue;  // not the sequence's last shape
      distance += errors[b].distance_mm[w];
      ++ends;
    }
  }
  return {loss / shapes, distance / ends};
}

}  // namespace weft::emd
