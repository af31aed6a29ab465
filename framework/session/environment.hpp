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

/// Where a plan is carried out: a simulator, or a robot with a camera. Holds the task's grasp vertices from the start.
/// Call order: observe() of the start; then execute() and observe() for every segment. When the hands let go at the end
/// of a segment, release() comes between the two. One thread at a time.
class Environment {
 public:
  virtual ~Environment() = default;
  /// What is seen of the cloth now. Sees at least one vertex. @throws Error.
  virtual Observation observe() = 0;
  /// Moves the held vertices along the segment and returns when they are there. @throws Error, Diverged.
  virtual void execute(const SegmentPath& path) = 0;
  /// Lets go and waits until the cloth lies still. @throws Error, Diverged.
  virtual SettleResult release() = 0;
  /// For the user: what went not quite right so far.
  virtual std::vector<std::string> warnings() const { return {}; }

  // What a simulated world knows, and a camera does not.
  virtual std::optional<MaterialProperties> true_material() const { return std::nullopt; }
  virtual std::optional<Positions> true_shape() const { return std::nullopt; }  ///< [V, 3] m, now
  /// Largest strain at a held vertex so far.
  virtual std::optional<double> max_grasp_strain() const { return std::nullopt; }
  /// [1 + 12 segments + settling] of [V * 3], single precision: the start, every frame of each executed segment and of
  /// the settling. nullopt: nothing is seen between two observations.
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
  SettleCriterion settle_;
  ObservationParams params_;
  std::uint64_t seed_ = 0, observations_ = 0;
  std::vector<std::vector<float>> frames_;
  double max_grasp_strain_ = 0.0;
};

/// Which environment carries a session out.
struct EnvironmentParams {
  std::vector<std::string> command;
  std::filesystem::path folder;
  double timeout_s = 60.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v("command", command,
      "Program and arguments of a process that moves the cloth and looks at it (docs/environment-protocol.md); "
      "default: the simulator.");
    v("folder", folder, "Folder that the command runs in; default: that of the file that names the command.");
    v("timeout_s", timeout_s, range(0.01, 1e6, "s"), "Longest time that an answer of the process may take.");
  }
  bool simulated() const { return command.empty(); }
};

/// The environment that `params` describe: the task's simulator, or a process.
/// @param origin what holds `environment` and `observation`, for messages.
/// @param material q of the cloth; nullopt only for a process: nobody knows it.
/// @param observation a process sees by itself: noise and height bias are what it has unless it says otherwise.
/// @throws ConfigError for a command that cannot be run; Error when the process does not speak the protocol.
std::unique_ptr<Environment> make_environment(const EnvironmentParams& params, const ConfigNode& origin,
                                              const Task& task, const std::optional<MaterialProperties>& material,
                                              const ObservationParams& observation, std::uint64_t seed, Host& host);

}  // namespace weft
