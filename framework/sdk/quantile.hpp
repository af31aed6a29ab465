#pragma once
#include <algorithm>
#include <cstddef>
#include <vector>

namespace weft {

/// Quantile of an ascending list that is not empty, linear between its values. @param at in [0, 1]; 0.5: the median.
inline double quantile(const std::vector<double>& sorted, double at) {
  const double place = at * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (place - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

}  // namespace weft
