#pragma once
#include <cstdint>
#include <vector>

#include "passes.hpp"

namespace weft::emd {

/// Loss and gradient of a batch, in parts that are differentiated in parallel. The parts do not depend on the number of
/// threads.
class BatchGradient {
 public:
  /// Keeps references to passes, training and weights. @param weights [Layout::size], which stay where they are.
  BatchGradient(Passes& passes, const Training& training, const std::vector<float>& weights);
  BatchGradient(const BatchGradient&) = delete;
  BatchGradient& operator=(const BatchGradient&) = delete;

  /// @param columns coordinates that enter the loss; empty: all.
  /// @return mean loss over the decoded shapes.
  double compute(const std::vector<Sequence>& sequences, const std::vector<std::int64_t>& columns);
  /// The gradient of that loss is the sum of these, [parts][Layout::size].
  const std::vector<std::vector<float>>& parts() const { return gradients_; }

 private:
  Passes& passes_;
  const Training& t_;
  std::vector<std::vector<float>> gradients_;
  std::vector<Graph> graphs_;  ///< [parts]: each has leaves of its own over the same weights
};

}  // namespace weft::emd
