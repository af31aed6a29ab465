#include "session/environment.hpp"

#include <algorithm>

#include "session/process_environment.hpp"
#include "simulation/simulator_warnings.hpp"
#include "simulation/start_shape.hpp"
#include "weft/config.hpp"
#include "weft/hands.hpp"

namespace weft {

std::vector<float> to_frame(const Positions& positions) {
  const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> single = positions.cast<float>();
  return {single.data(), single.data() + single.size()};
}

SimulatorEnvironment::SimulatorEnvironment(std::shared_ptr<Simulator> simulator, const Task& task,
                                           const MaterialProperties& material, const ObservationParams& params,
                                           std::uint64_t seed)
    : simulator_(std::move(simulator)),
      material_(material),
      fabric_(task.material.at(material)),
      scene_(task.scene),
      manipulation_(task.manipulation),
      settle_(task.settle),
      params_(params),
      seed_(seed) {
  begin(*simulator_, task, fabric_);
  record();
}

void SimulatorEnvironment::record() { frames_.push_back(to_frame(simulator_->positions())); }

Observation SimulatorEnvironment::observe() {
  return observe_shape(simulator_->positions(), params_, seed_, observations_++);
}

void SimulatorEnvironment::execute(const SegmentPath& path) {
  for (const auto& targets : path.targets) {
    move_hands(*simulator_, manipulation_, targets);
    record();
  }
  open_hands(*simulator_, manipulation_, path.opening);
  max_grasp_strain_ = std::max(max_grasp_strain_, simulator_->diagnostics().max_grasp_strain);
}

SettleResult SimulatorEnvironment::release() {
  simulator_->release();
  // Settle one frame at a time, to record each. The states are those of a single call (Simulator::settle).
  const SettleCriterion one_frame{settle_.speed, 1, 1};
  SettleResult result;
  for (Index calm = 0; result.frames < settle_.max_frames && calm < settle_.hold_frames; ++result.frames) {
    const SettleResult now = simulator_->settle(one_frame);
    calm = now.settled ? calm + 1 : 0;
    result.max_speed = now.max_speed;
    result.settled = calm >= settle_.hold_frames;
    record();
  }
  return result;
}

std::vector<std::string> SimulatorEnvironment::warnings() const {
  return simulator_warnings(*simulator_, fabric_, scene_);
}

std::unique_ptr<Environment> make_environment(const EnvironmentParams& params, const ConfigNode& origin,
                                              const Task& task, const std::optional<MaterialProperties>& material,
                                              const ObservationParams& observation, std::uint64_t seed, Host& host) {
  if (params.simulated()) {
    return std::make_unique<SimulatorEnvironment>(host.create<Simulator>(task.simulator), task, material.value(),
                                                  observation, seed);
  }
  const std::pair<const char*, double> shares[] = {{"observation.hidden_share", observation.hidden_share},
                                                   {"observation.lost_share", observation.lost_share}};
  for (const auto& [key, share] : shares) {
    if (share > 0.0)
      must_be(place(origin, key), "0 with environment.command: the process reports the vertices that it sees");
  }
  const ConfigNode command = place(origin, "environment.command");
  ProcessOptions options;
  options.command = params.command;
  options.folder = params.folder.empty() ? command.folder() : params.folder;
  options.timeout_s = params.timeout_s;
  options.sigma = observation.noise_m;
  options.height_sigma = observation.height_bias_m;
  options.material = material;
  return blaming(command, [&] { return std::make_unique<ProcessEnvironment>(options, task); });
}

}  // namespace weft
