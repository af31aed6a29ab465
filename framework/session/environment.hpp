#pragma once
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "session/observation.hpp"
#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/simulator.hpp"

namespace weft {

/// Executes a plan: a simulator, or a robot with a camera. It holds the task's grasp vertices from the start.
/// Call order: observe() once, then execute() and observe() for every segment. If the hands let go at the end of a
/// segment, release() comes between the two. One thread at a time.
class Environment {
 public:
  virtual ~Environment() = default;
  /// Observes the cloth now. Sees at least one vertex. @throws Error.
  virtual Observation observe() = 0;
  /// Moves the held vertices along the segment, opens SegmentPath::opening at its end and returns. @throws Error, Diverged.
  virtual void execute(const SegmentPath& path) = 0;
  /// Releases the cloth and waits until it lies still. @throws Error, Diverged.
  virtual SettleResult release() = 0;
  /// Warnings for the user so far.
  virtual std::vector<std::string> warnings() const { return {}; }

  // Known in a simulated world, but not to a camera.
  virtual std::optional<MaterialProperties> true_material() const { return std::nullopt; }
  virtual std::optional<Positions> true_shape() const { return std::nullopt; }  ///< [V, 3] m, now
  /// Largest strain at a held vertex so far.
  virtual std::optional<double> max_grasp_strain() const { return std::nullopt; }
  /// [1 + 12 segments + settling] of [V * 3], single precision: the start, and every frame of the executed segments and
  /// of settling. nullopt: the cloth is not seen between two observations.
  virtual std::optional<std::vector<std::vector<float>>> frames() const { return std::nullopt; }
};

/// A shape as sessions record it: [V * 3], single precision.
std::vector<float> to_frame(const Positions& positions);

/// A simulator with the true material. Records every frame it simulates.
class SimulatorEnvironment final : public Environment {
 public:
  /// @param seed as in observe_shape.
  SimulatorEnvironment(std::shared_ptr<Simulator> simulator, const Task& task, const MaterialProperties& material,
                       const ObservationParams& params = {}, std::uint64_t seed = 0);
  Observation observe() override;
  void execute(const SegmentPath& path) override;
  SettleResult release() override;
  std::vector<std::string> warnings() const override;
  std::optional<MaterialProperties> true_material() const override { return material_; }
  std::optional<Positions> true_shape() const override { return simulator_->positions(); }
  std::optional<double> max_grasp_strain() const override { return max_grasp_strain_; }
  std::optional<std::vector<std::vector<float>>> frames() const override { return frames_; }

 private:
  void record();
  std::shared_ptr<Simulator> simulator_;
  MaterialProperties material_;
  Fabric fabric_;
  Scene scene_;
  Manipulation manipulation_;
  SettleCriterion settle_;
  ObservationParams params_;
  std::uint64_t seed_ = 0, observations_ = 0;
  std::vector<std::vector<float>> frames_;
  double max_grasp_strain_ = 0.0;
};

/// The environment of a session.
struct EnvironmentParams {
  std::vector<std::string> command;
  std::filesystem::path folder;
  double timeout_s = 60.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v("command", command,
      "Program and arguments of a process that moves and observes the cloth (docs/environment-protocol.md); default: "
      "the simulator.");
    v("folder", folder, "Working folder of the command; default: the folder of the file that sets the command.",
      Decides::nothing);
    v("timeout_s", timeout_s, range(0.01, 1e6, "s"), "Longest wait for an answer of the process.");
  }
  bool simulated() const { return command.empty(); }
};

/// The environment that `params` describe: the task's simulator, or a process.
/// @param origin the node with `environment` and `observation`, for messages.
/// @param material q of the cloth; nullopt: unknown, for a process only.
/// @param observation for a process: the noise and height bias of observations that do not state their own.
/// @throws ConfigError for a command that cannot be run; Error if the process breaks the protocol.
std::unique_ptr<Environment> make_environment(const EnvironmentParams& params, const ConfigNode& origin,
                                              const Task& task, const std::optional<MaterialProperties>& material,
                                              const ObservationParams& observation, std::uint64_t seed, Host& host);

}  // namespace weft
