#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "session/observation.hpp"
#include "weft/simulator.hpp"

namespace weft {

/// Where a plan is carried out: a simulator, or a robot.
class Environment {
 public:
  virtual ~Environment() = default;
  virtual Observation observe() = 0;
  /// Moves the held vertices along the segment. @throws Diverged and the like.
  virtual void execute(const SegmentPath& path) = 0;
  /// Lets go and waits until the cloth lies still.
  virtual SettleResult release() = 0;
};

/// A shape as sessions record it: [V * 3], single precision.
std::vector<float> to_frame(const Positions& positions);

/// The first environment: a simulator with the true material. Records every frame it simulates.
class SimulatorEnvironment final : public Environment {
 public:
  /// @param seed as in observe_shape.
  SimulatorEnvironment(std::shared_ptr<Simulator> simulator, const Task& task, const MaterialProperties& material,
                       const ObservationParams& params = {}, std::uint64_t seed = 0);
  Observation observe() override;
  const Positions& positions() const { return simulator_->positions(); }  ///< the truth
  void execute(const SegmentPath& path) override;
  SettleResult release() override;
  /// [frames][V * 3], single precision: the start, 12 per executed segment, and every frame of the settling.
  const std::vector<std::vector<float>>& frames() const { return frames_; }
  double seconds() const { return seconds_; }
  double max_grasp_strain() const { return max_grasp_strain_; }
  std::string warning() const { return simulator_->diagnostics().warning; }

 private:
  void record();
  std::shared_ptr<Simulator> simulator_;
  SettleCriterion settle_;
  ObservationParams params_;
  std::uint64_t seed_ = 0, observations_ = 0;
  std::vector<std::vector<float>> frames_;
  double seconds_ = 0.0;
  double max_grasp_strain_ = 0.0;
};

}  // namespace weft
