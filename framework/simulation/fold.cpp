#include "simulation/fold.hpp"

#include <algorithm>

namespace weft {

FoldResult simulate_fold(Simulator& simulator, const Task& task, const MaterialProperties& material,
                         const Controls& controls) {
  FoldResult result;
  simulator.reset(task.garment, task.material.at(material), task.scene);
  simulator.grasp(task.manipulation.grasp_vertices);
  Vector state = task.trajectory->initial_state(task.manipulation);
  result.states.resize(controls.rows() + 1, state.size());
  result.states.row(0) = state.transpose();
  result.shapes.push_back(simulator.positions());
  for (Index j = 0; j < controls.rows() && !result.released; ++j) {
    const SegmentPath path = task.trajectory->segment(task.manipulation, state, controls.row(j).transpose());
    for (const auto& targets : path.targets) simulator.step(targets);
    state = path.end_state;
    result.max_grasp_strain = std::max(result.max_grasp_strain, simulator.diagnostics().max_grasp_strain);
    result.released = task.trajectory->released(state);
    if (result.released) {
      simulator.release();
      result.settle = simulator.settle(task.settle);
    }
    result.shapes.push_back(simulator.positions());
    result.states.row(j + 1) = state.transpose();
    ++result.segments;
  }
  result.states.conservativeResize(result.segments + 1, Eigen::NoChange);
  return result;
}

}  // namespace weft
