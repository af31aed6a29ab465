#include "session/halving.hpp"

#include <algorithm>

namespace weft {

Halving::Halving(Index instances, Index iterations, Index times) : wanted_(instances, true) {
  for (Index n = times; n > 0; --n) {
    const Index moment = n < 62 ? iterations >> n : 0;
    if (moment > 0) moments_.push_back(moment);
  }
}

void Halving::look(Index iteration, const Vector& best_costs) {
  while (!moments_.empty() && iteration >= moments_.front()) {
    moments_.erase(moments_.begin());
    std::vector<Index> running;
    for (Index i = 0; i < best_costs.size(); ++i)
      if (wants(i)) running.push_back(i);
    std::stable_sort(running.begin(), running.end(), [&](Index a, Index b) { return best_costs[a] < best_costs[b]; });
    for (std::size_t k = (running.size() + 1) / 2; k < running.size(); ++k) wanted_[running[k]] = false;
  }
}

}  // namespace weft
