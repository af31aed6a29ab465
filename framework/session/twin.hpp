#pragma once
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "simulation/fold.hpp"
#include "weft/host.hpp"
#include "weft/task.hpp"

namespace weft {

/// The simulated cloth at the start of a segment, held by the hands.
struct TwinState {
  MaterialProperties material = MaterialProperties::Constant(0.5);
  Positions positions, velocities;  ///< [V, 3] m, m/s
  Vector state;                     ///< [S] of the hands
  /// The whole state of a simulator with `material`, with contacts; null: positions and velocities are all there is.
  std::shared_ptr<const SimulatorSnapshot> snapshot;
};

/// A simulation of the session's cloth at the material that is believed. Thread-safe: calls run side by side.
class Twin {
 public:
  /// @param simulator slot; null: the task's. @throws ConfigError, PluginError.
  Twin(const Task& task, const ConfigNode& simulator, Host& host);
  ~Twin();

  /// The flat garment at rest, at the height of its thickness.
  TwinState start(const MaterialProperties& material) const;
  /// One segment later. @param control [C]. @throws Diverged.
  TwinState advance(const TwinState& from, ConstVec control) const;
  /// Executes controls until release, and settles. shapes: [k], after every segment. @throws Diverged.
  FoldResult fold(const TwinState& from, const Controls& controls) const;
  const Task& task() const { return task_; }

 private:
  class Lease;
  void place(Lease& lease, const TwinState& from) const;

  Task task_;
  ConfigNode simulator_;
  Host& host_;
  struct Idle;
  mutable std::mutex mutex_;
  mutable std::vector<Idle> idle_;
};

}  // namespace weft
