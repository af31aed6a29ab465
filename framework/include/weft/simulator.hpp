#pragma once
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "weft/garment.hpp"
#include "weft/material.hpp"
#include "weft/types.hpp"

namespace weft {

/// The world around the cloth. The same for every plugin.
struct Scene {
  Vec3 gravity{0.0, 0.0, -9.81};              ///< m/s^2
  std::optional<double> ground_height = 0.0;  ///< m; nullopt: no ground
  std::vector<Index> pins;                    ///< vertices held where they are for the whole run
  Vec3 initial_velocity = Vec3::Zero();       ///< m/s, of every vertex that is not pinned
};

/// When the cloth counts as settled: the largest vertex speed stays below `speed` for `hold_frames` frames on end.
struct SettleCriterion {
  double speed = 0.005;  ///< m/s
  Index hold_frames = 6;
  Index max_frames = 300;
};
struct SettleResult {
  Index frames = 0;        ///< simulated
  double max_speed = 0.0;  ///< m/s, at the end
  bool settled = false;    ///< false: max_frames came first
};

/// Measurements on the current state, for results and tests.
struct SimulatorDiagnostics {
  double max_speed = 0.0;         ///< m/s
  double max_strain = 0.0;        ///< largest |principal in-plane strain| over all faces
  double max_grasp_strain = 0.0;  ///< largest over the faces at a grasped vertex since the last reset/restore
  Index contacts = 0;             ///< active self-contacts in the last step
  std::string warning;            ///< empty, or what the user should know (a grasp that overstretches the cloth)
};

/// Opaque copy of a simulator's whole state; only the plugin that made it reads it. Immutable, shareable.
class WEFT_API SimulatorSnapshot {
 public:
  virtual ~SimulatorSnapshot() = default;
};

struct SimulatorCapabilities {
  bool snapshots = false;        ///< save() / restore()
  bool self_contact = false;     ///< layers keep `thickness_m` apart
  bool ground_friction = false;  ///< Coulomb, threshold tan(alpha) = mu
  bool pins = false;             ///< honours Scene::pins
  bool orthotropic = false;      ///< honours warp != weft
  bool gravity_any_direction = true;
};

/// One piece of cloth, simulated. Call order: reset, then any of the others. One object is used by one thread at a
/// time; many objects run in parallel and do not affect one another: same calls, same bits. Non-finite state never
/// leaves: step() and settle() throw Diverged naming the frame, and the object must be reset.
class WEFT_API Simulator {
 public:
  static constexpr const char* kKind = "simulator";
  static constexpr int kVersion = 1;  // bump on any change to this class or the types above
  virtual ~Simulator() = default;

  virtual SimulatorCapabilities capabilities() const = 0;

  /// Puts the garment's initial positions into the scene, at scene.initial_velocity, nothing grasped, frame 0.
  /// Positions below contact height are lifted to it.
  /// @throws ConfigError for a fabric or scene that the plugin cannot honour.
  virtual void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) = 0;

  /// Replaces the state by an observed one; `grasped` replaces what is held. History (contact warm starts) is dropped.
  /// @param positions, velocities [V, 3] m, m/s. @throws ShapeError, Error if not finite.
  virtual void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) = 0;

  /// Takes hold of more vertices; they stay where they are until the next step(). A held vertex follows its target
  /// exactly.
  /// @throws ShapeError for an index out of range, pinned, or already held.
  virtual void grasp(std::span<const Index> vertices) = 0;
  /// Held vertices, in the order in which step() takes their targets.
  virtual std::vector<Index> grasped() const = 0;

  /// Advances one frame (kFrameSeconds). Held vertices move in a straight line from where they are to their targets.
  /// @param grasp_targets [grasped().size(), 3] m. @throws ShapeError, Error if not finite, Diverged.
  virtual void step(const Positions& grasp_targets) = 0;

  /// Lets go of the given vertices, or of all of them. Leaves no kick: a released vertex starts at rest.
  virtual void release(std::span<const Index> vertices) = 0;
  virtual void release() = 0;

  /// Steps, what is held kept still, until the criterion is met. Calls of one frame each give the bits of one call.
  virtual SettleResult settle(const SettleCriterion& criterion) = 0;

  virtual const Positions& positions() const = 0;   ///< [V, 3] m
  virtual const Positions& velocities() const = 0;  ///< [V, 3] m/s
  virtual Index frame() const = 0;                  ///< frames since reset
  virtual SimulatorDiagnostics diagnostics() const = 0;

  /// Capability `snapshots`: a run continued from a restored snapshot is equal bit for bit, also in another object that
  /// was reset with the same garment, fabric and scene.
  /// @throws Unsupported (the default), Error if the snapshot is another plugin's or garment's.
  WEFT_API virtual std::shared_ptr<const SimulatorSnapshot> save() const;
  WEFT_API virtual void restore(const SimulatorSnapshot& snapshot);
};

/// What every simulator of cloth refuses in reset(): a garment without faces, moduli, friction, thickness and damping
/// that are not finite or out of range, a scene that is not finite, pins that the garment has not.
/// @param plugin name that messages begin with. @param self_contact layers need a thickness above 0.
/// @throws ConfigError naming the value, what it is and what it must be.
WEFT_API void check_reset(const std::string& plugin, const Garment* garment, const Fabric& fabric, const Scene& scene,
                          bool self_contact);

/// Empty, or the warning that a grasp stretched the cloth more than the plugin's parameter grasp_strain_warning.
WEFT_API std::string grasp_strain_warning(double largest_strain, double limit);

}  // namespace weft
