#pragma once
#include <functional>
#include <vector>

#include "weft/task.hpp"

namespace weft {

/// Asked before every frame of a simulation: true ends it. Empty: it runs to its end.
using Cancelled = std::function<bool()>;
/// The user asked to stop a simulation, which has no result.
class WEFT_API Interrupted : public Error {
 public:
  using Error::Error;
  ~Interrupted() override;
};

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
/// @param state [S] of the hands. @throws Diverged, ConfigError, Interrupted.
void continue_fold(Simulator& simulator, const Task& task, Vector state, const Controls& controls, FoldResult& result,
                   const Cancelled& cancelled = {});
/// Runs the controls with a known material. @throws Diverged, ConfigError, Interrupted.
FoldResult simulate_fold(Simulator& simulator, const Task& task, const MaterialProperties& material,
                         const Controls& controls, const Cancelled& cancelled = {});

/// @throws Interrupted if the user asked to stop.
void require_not_cancelled(const Cancelled& cancelled);
/// Simulator::settle(), frame by frame. The states are those of a single call. @throws Diverged, Interrupted.
SettleResult settle(Simulator& simulator, const SettleCriterion& criterion, const Cancelled& cancelled);

}  // namespace weft
