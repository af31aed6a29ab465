#pragma once
#include <vector>

#include "weft/task.hpp"

namespace weft {

/// One fold under known material: runs the controls from the flat garment to release (or to the last segment) and
/// settles.
struct FoldResult {
  std::vector<Positions> shapes;  ///< [segments + 1]: at the start and after every segment; the last one settled
  Controls states;                ///< [segments + 1, S]
  Index segments = 0;             ///< executed
  bool released = false;
  SettleResult settle;
  double max_grasp_strain = 0.0;
};
/// @throws Diverged, ConfigError.
FoldResult simulate_fold(Simulator& simulator, const Task& task, const MaterialProperties& material,
                         const Controls& controls);

}  // namespace weft
