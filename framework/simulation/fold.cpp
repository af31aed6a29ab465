#include "simulation/fold.hpp"

#include <algorithm>

#include "simulation/start_shape.hpp"

namespace weft {

void continue_fold(Simulator& simulator, const Task& task, Vector state, const Controls& controls, FoldResult& result) {
  const Index before = result.states.rows();
  result.states.conservativeResize(before + controls.rows(), state.size());
  Index executed = 0;
  for (; executed < controls.rows() && !result.released; ++executed) {
    const SegmentPath path = task.trajectory->segment(task.manipulation, state, controls.row(executed).transpose());
    for (const auto& targets : path.targets) simulator.step(targets);
    state = path.end_state;
    result.max_grasp_strain = std::max(result.max_grasp_strain, simulator.diagnostics().max_grasp_strain);
    result.released = task.trajectory->released(state);
    if (result.released) {
      simulator.release();
      result.settle = simulator.settle(task.settle);
    }
    result.shapes.push_back(simulator.positions());
    result.states.row(before + executed) = state.transpose();
  }
  result.segments += executed;
  result.states.conservativeResize(before + executed, Eigen::NoChange);
}

FoldResult simulate_fold(Simulator& simulator, const Task& task, const MaterialProperties& material,
                         const Controls& controls) {
  FoldResult result;
  begin(simulator, task, task.material.at(material));
  const Vector state = task.trajectory->initial_state(task.manipulation);
  result.states = state.transpose();
  result.shapes.push_back(simulator.positions());
  continue_fold(simulator, task, state, controls, result);
  return result;
}

}  // namespace weft
