#pragma once
#include <cstddef>
#include <vector>

#include "../params.hpp"
#include "ranks.hpp"
#include "weft/host.hpp"

namespace weft::emd {

/// Parts that the gradient of a batch is computed in: `parts`, or the `votes` of SignSGD. @throws ConfigError when they
/// cannot be divided among the ranks, or cannot vote.
std::size_t parts_of_batch(const Training& training, std::size_t ranks);

/// Joins the parts of a gradient, whichever ranks computed them, into the step's direction: their sum, or their vote.
/// Over ranks each weight has an owner: rank r owns the r-th slice of the weights. Every rank sends the owners their
/// slices of its parts, the owners join them in the order of the parts, and all gather the results. So the bits do not
/// depend on the number of ranks.
class GradientSum {
 public:
  /// Keeps references to all. @param weights Layout::size. @param parts of the whole batch.
  GradientSum(const Training& training, Host& host, Ranks& ranks, std::size_t weights, std::size_t parts);
  /// The direction of a step.
  struct Direction {
    const std::vector<float>& values;  ///< [weights]: Adam: the sum. SignSGD: the vote, 1, -1 or 0
    double norm;
  };
  /// @param mine [parts / ranks][weights]: those of this rank; rank r has the r-th of `ranks` groups of parts.
  /// @return it stays valid until the next call.
  Direction join(const std::vector<std::vector<float>>& mine);

 private:
  enum class Kind { sum, sign, one_bit };
  void join_here(const std::vector<std::vector<float>>& mine, std::vector<double>& squares);
  /// @tparam Wire has the functions bytes(), put(), join() and get(), see gradient_sum.cpp.
  template <class Wire>
  void join_over_ranks(const std::vector<std::vector<float>>& mine);

  Kind kind_;
  Host& host_;
  Ranks& ranks_;
  std::size_t parts_, slice_;
  std::vector<float> joined_;
  std::vector<std::byte> to_, from_, own_, all_;
};

}  // namespace weft::emd
