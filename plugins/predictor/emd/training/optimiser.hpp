#pragma once
#include <cstddef>
#include <vector>

#include "../params.hpp"
#include "checkpoint.hpp"
#include "weft/host.hpp"

namespace weft::emd {

/// Moves the weights along the direction of a batch: Adam(W), or SignSGD with a majority vote. The same bits on any
/// number of threads.
class Optimiser {
 public:
  /// Keeps references to both. @param weights Layout::size.
  Optimiser(const Training& training, Host& host, std::size_t weights) : t_(training), host_(host), size_(weights) {}
  /// One step, and the moving average of the weights with it.
  /// @param direction [weights], as GradientSum gives it.
  void step(const std::vector<float>& direction, FitState& state);

 private:
  void adam(const std::vector<float>& gradient, FitState& state);
  void signsgd(const std::vector<float>& vote, FitState& state);
  void average(FitState& state);

  const Training& t_;
  Host& host_;
  std::size_t size_;  ///< weights
};

}  // namespace weft::emd
