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

/// A sequence of controls, simulated from start().
struct TwinSequence {
  std::vector<Positions> shapes;  ///< after every segment; the last one settled if it is released
  TwinState end;                  ///< after the last segment; not if it is released
  bool released = false;
  /// Whether more segments can follow without a simulation from the start.
  bool goes_on() const { return !released && end.snapshot != nullptr; }
};

/// A simulation of the session's cloth at the material that is believed. Thread-safe: calls run side by side.
class Twin {
 public:
  /// @param simulator slot; null: the task's. @throws ConfigError, PluginError.
  Twin(const Task& task, const ConfigNode& simulator, Host& host);
  ~Twin();

  /// The flat garment at rest, at the height of its thickness; or Task::start.
  TwinState start(const MaterialProperties& material) const;
  /// One segment later. @param control [C]. @throws Diverged.
  TwinState advance(const TwinState& from, ConstVec control) const;
  /// Executes controls until release, and settles. shapes: [k], after every segment. @throws Diverged.
  FoldResult fold(const TwinState& from, const Controls& controls) const;
  /// Simulates a whole sequence, until release, and settles. @throws Diverged.
  TwinSequence sequence(const MaterialProperties& material, const Controls& controls) const;
  /// Adds the controls from row shapes.size() on; the same shapes as those of sequence(). @param so_far goes_on().
  TwinSequence longer(TwinSequence so_far, const Controls& controls) const;
  const Task& task() const { return task_; }

 private:
  class Lease;
  void place(Lease& lease, const TwinState& from) const;
  FoldResult fold(Lease& lease, const TwinState& from, const Controls& controls) const;
  static void read_state(Lease& lease, TwinState& state);

  Task task_;
  ConfigNode simulator_;
  Host& host_;
  struct Idle;
  mutable std::mutex mutex_;
  mutable std::vector<Idle> idle_;
};

}  // namespace weft
