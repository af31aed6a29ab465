#pragma once
#include <cstdint>
#include <vector>

#include "passes.hpp"

namespace weft::emd {

/// The loss on the validation split, on the same sequences at every evaluation.
class Validation {
 public:
  /// Keeps a reference to the passes, whose model has its normalisation.
  /// @param examples positions in the dataset.
  /// @param cases number of sequences, if the examples have so many.
  Validation(Passes& passes, const std::vector<std::size_t>& examples, std::int64_t cases, std::uint64_t seed);

  struct Result {
    double loss = 0.0;      ///< mean over shapes
    double error_mm = 0.0;  ///< mean vertex distance at the end of the sequences
  };
  /// @param weights [Layout::size]
  Result evaluate(const std::vector<float>& weights) const;

 private:
  Passes& passes_;
  std::vector<Batch> batches_;
};

}  // namespace weft::emd
