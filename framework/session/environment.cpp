#include "session/environment.hpp"

#include <algorithm>
#include <chrono>

namespace weft {

std::vector<float> to_frame(const Positions& positions) {
  const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> single = positions.cast<float>();
  return {single.data(), single.data() + single.size()};
}

SimulatorEnvironment::SimulatorEnvironment(std::shared_ptr<Simulator> simulator, const Task& task,
                                           const MaterialProperties& material, const ObservationParams& params,
                                           std::uint64_t seed)
    : simulator_(std::move(simulator)), settle_(task.settle), params_(params), seed_(seed) {
  simulator_->reset(task.garment, task.material.at(material), task.scene);
  simulator_->grasp(task.manipulation.grasp_vertices);
  record();
}

void SimulatorEnvironment::record() { frames_.push_back(to_frame(simulator_->positions())); }

Observation SimulatorEnvironment::observe() {
  return observe_shape(simulator_->positions(), params_, seed_, observations_++);
}

void SimulatorEnvironment::execute(const SegmentPath& path) {
  const auto started = std::chrono::steady_clock::now();
  for (const auto& targets : path.targets) {
    simulator_->step(targets);
    record();
  }
  max_grasp_strain_ = std::max(max_grasp_strain_, simulator_->diagnostics().max_grasp_strain);
  seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
}

SettleResult SimulatorEnvironment::release() {
  const auto started = std::chrono::steady_clock::now();
  simulator_->release();
  // A frame at a time, to record each: the same states as in one go (Simulator::settle).
  const SettleCriterion one_frame{settle_.speed, 1, 1};
  SettleResult result;
  for (Index calm = 0; result.frames < settle_.max_frames && calm < settle_.hold_frames; ++result.frames) {
    const SettleResult now = simulator_->settle(one_frame);
    calm = now.settled ? calm + 1 : 0;
    result.max_speed = now.max_speed;
    result.settled = calm >= settle_.hold_frames;
    record();
  }
  seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  return result;
}

}  // namespace weft
