#include "batch_sampler.hpp"

#include <algorithm>
#include <cmath>

#include "passes.hpp"
#include "weft/random.hpp"

namespace weft::emd {
namespace {

constexpr std::uint64_t kBatchStream = 0x6261746368ull;        // "batch"
constexpr std::uint64_t kColumnsStream = 0x636f6c756d6e73ull;  // "columns"

}  // namespace

std::vector<Sequence> BatchSampler::sequences(std::int64_t iteration) const {
  const RandomStream streams(seed_, kBatchStream, iteration);
  std::vector<Sequence> drawn;
  for (std::int64_t b = 0; b < t_.batch; ++b) {
    RandomStream random = streams.child(b);
    const std::size_t i = train_[random.below(train_.size())];
    drawn.push_back(sample_sequence(i, passes_.example(i), t_, random));
  }
  return drawn;
}

std::vector<std::int64_t> BatchSampler::columns(std::int64_t iteration) const {
  std::vector<std::int64_t> drawn;
  if (t_.vertex_share >= 1.0) return drawn;
  const Index vertices = passes_.model().dimensions.vertices;
  RandomStream random(seed_, kColumnsStream, iteration);
  // Selection sampling: ascending, each set of that size equally likely.
  Index left = std::max<Index>(1, std::llround(t_.vertex_share * vertices));
  for (Index v = 0; v < vertices && left > 0; ++v) {
    if (static_cast<Index>(random.below(vertices - v)) >= left) continue;
    for (Index axis = 0; axis < 3; ++axis) drawn.push_back(3 * v + axis);
    --left;
  }
  return drawn;
}

}  // namespace weft::emd
