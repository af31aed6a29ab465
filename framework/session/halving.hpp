#pragma once
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// Successive halving of the instances of a search [Jamieson and Talwalkar 2016, "Non-stochastic best arm identification and
/// hyperparameter optimization"]: after 1/2^n, ..., 1/4 and 1/2 of its iterations the half of them with the larger costs is
/// no longer wanted.
class Halving {
 public:
  /// @param iterations of the whole search; @param times n.
  Halving(Index instances, Index iterations, Index times);
  /// Call it in an OptimiserObserver, with what that gets.
  void look(Index iteration, const Vector& best_costs);
  bool wants(Index instance) const { return wanted_[instance]; }

 private:
  std::vector<bool> wanted_;
  std::vector<Index> moments_;  // iterations after which half of the instances end, ascending
};

}  // namespace weft
