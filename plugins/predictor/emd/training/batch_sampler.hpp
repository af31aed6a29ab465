#pragma once
#include <cstdint>
#include <vector>

#include "../sampling.hpp"

namespace weft::emd {

class Passes;

/// Draws what one iteration trains on. Draws are functions of (seed, iteration): a resumed fit sees the same batches.
class BatchSampler {
 public:
  /// Keeps references to all but the seed. @param train positions in the dataset.
  BatchSampler(const Passes& passes, const std::vector<std::size_t>& train, const Training& training,
               std::uint64_t seed)
      : passes_(passes), train_(train), t_(training), seed_(seed) {}
  /// [Training::batch]
  std::vector<Sequence> sequences(std::int64_t iteration) const;
  /// Coordinates of the vertices that enter the loss, ascending; empty: all.
  std::vector<std::int64_t> columns(std::int64_t iteration) const;

 private:
  const Passes& passes_;
  const std::vector<std::size_t>& train_;
  const Training& t_;
  std::uint64_t seed_;
};

}  // namespace weft::emd
