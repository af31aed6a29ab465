#pragma once
#include <vector>

#include "weft/task.hpp"

namespace weft {

/// The result of one fold, from where the task begins to release (or to the last segment) and settling.
struct FoldResult {
  std::vector<Positions> shapes;  ///< [segments + 1]: at the start and after every segment; the last one settled
  Controls states;                ///< [segments + 1, S]
  Index segments = 0;             ///< executed
  bool released = false;
  SettleResult settle;
  double max_grasp_strain = 0.0;
};
/// Executes the controls from where the simulator is, until release (then settles) or the last one. Appends to `result`:
/// a shape and a state after every segment.
/// @param state [S] of the hands. @throws Diverged, ConfigError.
void continue_fold(Simulator& simulator, const Task& task, Vector state, const Controls& controls, FoldResult& result);
/// Runs the controls with a known material. @throws Diverged, ConfigError.
FoldResult simulate_fold(Simulator& simulator, const Task& task, const MaterialProperties& material,
                         const Controls& controls);

}  // namespace weft
