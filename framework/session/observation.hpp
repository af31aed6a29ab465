#pragma once
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// What is seen of the cloth at the end of a segment.
struct Observation {
  Positions positions;         ///< [V, 3] m
  std::vector<bool> observed;  ///< [V]; empty: all. The positions of other vertices mean nothing and may be NaN
  double sigma = 0.0;          ///< m, standard deviation of the measurement, independent per coordinate
  double height_sigma = 0.0;   ///< m, standard deviation of what all heights of a session have in common
  double time_s = 0.0;

  bool sees(Index vertex) const { return observed.empty() || observed[static_cast<std::size_t>(vertex)]; }
};

}  // namespace weft
