#pragma once
#include <cstddef>
#include <vector>

#include "../params.hpp"
#include "checkpoint.hpp"
#include "gradient_sum.hpp"
#include "weft/host.hpp"

namespace weft::emd {

/// Moves the weights along the direction of a batch: Adam(W), or SignSGD with a majority vote. The same bits on any
/// number of threads.
class Optimiser {
 public:
  /// Keeps references to all. @param weights Layout::size.
  Optimiser(const Training& training, const Kernels& kernels, Host& host, std::size_t weights)
      : t_(training), kernels_(kernels), host_(host), size_(weights) {}
  /// One step, and the moving average of the weights with it.
  void step(const GradientSum::Direction& direction, FitState& state);

 private:
  void adam(const GradientSum::Direction& gradient, FitState& state);
  void signsgd(const std::vector<float>& vote, FitState& state);

  float keep_average(const FitState& state) const;

  const Training& t_;
  const Kernels& kernels_;
  Host& host_;
  std::size_t size_;  ///< weights
};

}  // namespace weft::emd
