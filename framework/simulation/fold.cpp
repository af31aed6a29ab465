#include "simulation/fold.hpp"

#include <algorithm>

#include "simulation/start_shape.hpp"
#include "weft/hands.hpp"

namespace weft {

Interrupted::~Interrupted() = default;

void require_not_cancelled(const Cancelled& cancelled) {
  if (cancelled && cancelled()) throw Interrupted("interrupted: what was being simulated has no result");
}

SettleResult settle(Simulator& simulator, const SettleCriterion& criterion, const Cancelled& cancelled) {
  if (!cancelled) return simulator.settle(criterion);
  const SettleCriterion one_frame{criterion.speed, 1, 1};
  SettleResult result;
  for (Index calm = 0; result.frames < criterion.max_frames && !result.settled; ++result.frames) {
    require_not_cancelled(cancelled);
    const SettleResult now = simulator.settle(one_frame);
    calm = now.settled ? calm + 1 : 0;
    result.max_speed = now.max_speed;
    result.settled = calm >= criterion.hold_frames;
  }
  return result;
}

void continue_fold(Simulator& simulator, const Task& task, Vector state, const Controls& controls, FoldResult& result,
                   const Cancelled& cancelled) {
  const Index before = result.states.rows();
  result.states.conservativeResize(before + controls.rows(), state.size());
  Index executed = 0;
  for (; executed < controls.rows() && !result.released; ++executed) {
    const SegmentPath path = task.trajectory->segment(task.manipulation, state, controls.row(executed).transpose());
    for (const auto& targets : path.targets) {
      require_not_cancelled(cancelled);
      move_hands(simulator, task.manipulation, targets);
    }
    state = path.end_state;
    result.max_grasp_strain = std::max(result.max_grasp_strain, simulator.diagnostics().max_grasp_strain);
    result.released = task.trajectory->released(state);
    if (result.released) {
      simulator.release();
      result.settle = settle(simulator, task.settle, cancelled);
    } else {
      open_hands(simulator, task.manipulation, path.opening);
    }
    result.shapes.push_back(simulator.positions());
    result.states.row(before + executed) = state.transpose();
  }
  result.segments += executed;
  result.states.conservativeResize(before + executed, Eigen::NoChange);
}

FoldResult simulate_fold(Simulator& simulator, const Task& task, const MaterialProperties& material,
                         const Controls& controls, const Cancelled& cancelled) {
  FoldResult result;
  begin(simulator, task, task.material.at(material));
  const Vector state = task.trajectory->initial_state(task.manipulation);
  result.states = state.transpose();
  result.shapes.push_back(simulator.positions());
  continue_fold(simulator, task, state, controls, result, cancelled);
  return result;
}

}  // namespace weft
