#pragma once
#include <vector>

#include "../params.hpp"
#include "checkpoint.hpp"
#include "weft/host.hpp"

namespace weft::emd {

/// Moves the weights along the gradient of a batch: Adam(W), or SignSGD with a majority vote. The same bits on any
/// number of threads.
class Optimiser {
 public:
  /// Keeps references to both. @param weights Layout::size.
  Optimiser(const Training& training, Host& host, std::size_t weights) : t_(training), host_(host), sum_(weights) {}
  /// One step, and the moving average of the weights with it.
  /// @param gradients [parts][weights], whose sum is the gradient.
  void step(const std::vector<std::vector<float>>& gradients, FitState& state);

 private:
  void adam(const std::vector<std::vector<float>>& gradients, FitState& state);
  void signsgd(const std::vector<std::vector<float>>& gradients, FitState& state);
  void average(FitState& state);
  template <class Body>
  void in_chunks(const Body& body);

  const Training& t_;
  Host& host_;
  std::vector<float> sum_;  ///< [weights]: gradient of the step
};

}  // namespace weft::emd
