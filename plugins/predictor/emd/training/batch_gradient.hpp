#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "passes.hpp"
#include "ranks.hpp"

namespace weft::emd {

/// Loss and gradient of a batch by Network, in parts that are differentiated in parallel. The parts do not depend on the number of
/// threads or ranks; each rank has as many of them.
class BatchGradient {
 public:
  /// Keeps references to passes, training and host. @param parts of the whole batch.
  BatchGradient(Passes& passes, const Training& training, const Kernels& kernels, Host& host, const Ranks& ranks,
                std::size_t parts);
  BatchGradient(const BatchGradient&) = delete;
  BatchGradient& operator=(const BatchGradient&) = delete;

  /// @param weights [Layout::size]. @param sequences of the whole batch. @param columns coordinates that enter the loss;
  /// empty: all.
  /// @return [parts of this rank]: the loss, summed over their decoded shapes.
  std::vector<double> compute(const std::vector<float>& weights, const std::vector<Sequence>& sequences,
                              const std::vector<std::int64_t>& columns);
  /// The gradient of the mean loss of the whole batch is the sum of all ranks' parts. [parts of this rank][Layout::size]
  const std::vector<std::vector<float>>& parts() const { return gradients_; }
  /// The examples of this rank's parts.
  std::vector<std::size_t> examples(const std::vector<Sequence>& sequences) const;

 private:
  Passes& passes_;
  const Training& t_;
  Host& host_;
  Network network_;
  std::size_t all_parts_, first_part_;
  std::vector<std::vector<float>> gradients_;
};

}  // namespace weft::emd
