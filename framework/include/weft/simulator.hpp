#pragma once
#include <any>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "weft/garment.hpp"
#include "weft/material.hpp"
#include "weft/obstacle.hpp"
#include "weft/types.hpp"

namespace weft {

/// The world around the cloth.
struct Scene {
  Vec3 gravity{0.0, 0.0, -9.81};              ///< m/s^2
  std::optional<double> ground_height = 0.0;  ///< m; nullopt: no ground
  std::vector<Index> pins;                    ///< vertices that stay fixed for the whole run
  Vec3 initial_velocity = Vec3::Zero();       ///< m/s, of every vertex that is not pinned
  std::vector<Obstacle> obstacles;            ///< capability `obstacles`
};

/// Where reset() puts the cloth, [V, 3] m: at positions_on_ground(). In a scene with obstacles a garment with layers
/// lies at height 0, or on the ground where that is higher, and every vertex that is closer to an obstacle than its
/// layer's number of thicknesses is moved out along the normal.
/// @throws ConfigError if a vertex starts deeper than one thickness in an obstacle.
WEFT_API Positions start_positions(const Garment& garment, const Scene& scene, double thickness);

/// The cloth is settled once the largest vertex speed has stayed below `speed` for `hold_frames` frames in a row.
struct SettleCriterion {
  double speed = 0.005;  ///< m/s
  Index hold_frames = 6;
  Index max_frames = 300;
};
struct SettleResult {
  Index frames = 0;        ///< simulated
  double max_speed = 0.0;  ///< m/s, at the end
  bool settled = false;    ///< false: max_frames was reached first
};

/// Measurements on the current state, for results and tests.
struct SimulatorDiagnostics {
  double max_speed = 0.0;   ///< m/s
  double max_strain = 0.0;  ///< largest |principal in-plane strain| over all faces
  /// The same, over the faces at a held vertex and over all frames since reset(). restore() restores it.
  double max_grasp_strain = 0.0;
  Index contacts = 0;   ///< active self-contacts in the last step
  std::string warning;  ///< for the user, such as: a grasp overstretches the cloth; empty: none
};

/// Opaque copy of a simulator's whole state. Only the plugin that made it can read it. Immutable, shareable.
class WEFT_API SimulatorSnapshot {
 public:
  virtual ~SimulatorSnapshot() = default;
};

/// What a simulator can do. check_reset() refuses a scene, fabric or garment that needs `pins`, `orthotropic`,
/// `gravity_any_direction`, `rest_frames` or `obstacles` if the simulator does not declare it. So every command reports
/// this in the same words.
struct SimulatorCapabilities {
  bool snapshots = false;        ///< save() / restore()
  bool self_contact = false;     ///< layers keep `thickness_m` apart
  bool ground_friction = false;  ///< Coulomb, threshold tan(alpha) = mu
  bool pins = false;             ///< honours Scene::pins
  bool orthotropic = false;      ///< honours warp != weft, in stretching and in bending, and Fabric::tables
  bool gravity_any_direction = true;
  /// Honours GarmentForm::frames and GarmentForm::seams. The form's layers concern all simulators: positions_on_ground().
  bool rest_frames = false;
  bool obstacles = false;  ///< honours Scene::obstacles: keeps the thickness, slides by Coulomb's law
};

/// Simulates one piece of cloth. Call order: reset, then any of the others. One thread at a time uses an object. Many
/// objects run in parallel and do not affect one another: the same calls give the same bits. Callers never see a
/// non-finite state: step() and settle() throw Diverged with the frame, and the object must be reset.
class WEFT_API Simulator {
 public:
  static constexpr const char* kKind = "simulator";
  static constexpr int kVersion = 4;  // bump on any change to this file or to obstacle.hpp
  static constexpr TypeSize kCrossing[] = {{"Garment", sizeof(Garment)},
                                           {"Fabric", sizeof(Fabric)},
                                           {"Scene", sizeof(Scene)},
                                           {"Obstacle", sizeof(Obstacle)},
                                           {"SettleCriterion", sizeof(SettleCriterion)},
                                           {"SettleResult", sizeof(SettleResult)},
                                           {"SimulatorDiagnostics", sizeof(SimulatorDiagnostics)},
                                           {"SimulatorCapabilities", sizeof(SimulatorCapabilities)},
                                           {"Positions", sizeof(Positions)}};
  virtual ~Simulator() = default;

  virtual SimulatorCapabilities capabilities() const = 0;

  /// Puts the garment's initial positions into the scene, at scene.initial_velocity, nothing grasped, frame 0.
  /// Vertices that are not pinned start at start_positions().
  /// @throws ConfigError for a fabric or scene that the plugin cannot honour.
  virtual void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) = 0;

  /// Replaces the state by an observed one, and the held vertices by `grasped`. Drops history (contact warm starts).
  /// @param positions, velocities [V, 3] m, m/s. @throws ShapeError, Error if not finite.
  virtual void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) = 0;

  /// Grasps more vertices. They stay in place until the next step(). A held vertex follows its target exactly.
  /// @throws ShapeError for an index out of range, pinned, or already held.
  virtual void grasp(std::span<const Index> vertices) = 0;
  /// Held vertices, in the order of step()'s targets.
  virtual std::vector<Index> grasped() const = 0;

  /// Advances one frame (kFrameSeconds). Held vertices move in a straight line to their targets.
  /// @param grasp_targets [grasped().size(), 3] m. @throws ShapeError, Error if not finite, Diverged.
  virtual void step(const Positions& grasp_targets) = 0;

  /// Releases the given vertices, or all. A released vertex starts at rest, so that it gets no kick.
  virtual void release(std::span<const Index> vertices) = 0;
  virtual void release() = 0;

  /// Steps until the criterion is met; held vertices stay still. Several calls of one frame each give the bits of one
  /// call.
  virtual SettleResult settle(const SettleCriterion& criterion) = 0;

  virtual const Positions& positions() const = 0;   ///< [V, 3] m
  virtual const Positions& velocities() const = 0;  ///< [V, 3] m/s
  virtual Index frame() const = 0;                  ///< frames since reset
  virtual SimulatorDiagnostics diagnostics() const = 0;

  /// Capability `snapshots`. A run that continues from a restored snapshot is equal bit for bit to the original run,
  /// also in another object that was reset with the same garment, fabric and scene.
  /// @throws Unsupported (the default), Error if the snapshot is another plugin's or garment's.
  WEFT_API virtual std::shared_ptr<const SimulatorSnapshot> save() const;
  WEFT_API virtual void restore(const SimulatorSnapshot& snapshot);
};

/// The checks that every simulator of cloth makes in reset(). It refuses a garment without faces; moduli, friction,
/// thickness and damping that are not finite or out of range; a scene that is not finite; pins that are not vertices of
/// the garment; a fabric or scene that needs an ability which `capabilities` does not declare. With self_contact the
/// thickness must be above 0.
/// @param plugin the plugin's name; messages start with it.
/// @throws ConfigError naming the key, its value and what it must be.
WEFT_API void check_reset(const std::string& plugin, const Garment* garment, const Fabric& fabric, const Scene& scene,
                          const SimulatorCapabilities& capabilities);

/// Bookkeeping that all simulators share: held and pinned vertices, the checks of every call, contact height at reset,
/// settling, the frame counter, strain at the grasps, divergence and snapshots. A simulator derives from it and writes
/// capabilities(), start() and advance_frame(). The other protected functions are for simulators that keep a copy of
/// the state elsewhere.
///
/// A pinned vertex has zero velocity. A held vertex has zero velocity until the next frame, and then its hand's.
class WEFT_API SimulatorBase : public Simulator {
 public:
  struct Options {
    double settle_drag_per_s = 0.0;  ///< 1/s; settle() adds it to the fabric's drag
    /// diagnostics() warns above this in-plane strain at a held vertex; infinity: never.
    double grasp_strain_warning = std::numeric_limits<double>::infinity();
  };

  void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) override;
  void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) override;
  void grasp(std::span<const Index> vertices) override;
  std::vector<Index> grasped() const override { return held_; }
  void step(const Positions& grasp_targets) override;
  void release(std::span<const Index> vertices) override;
  void release() override;
  SettleResult settle(const SettleCriterion& criterion) override;
  const Positions& positions() const override { return positions_; }
  const Positions& velocities() const override { return velocities_; }
  Index frame() const override { return frame_; }
  SimulatorDiagnostics diagnostics() const override;
  std::shared_ptr<const SimulatorSnapshot> save() const override;
  void restore(const SimulatorSnapshot& snapshot) override;

 protected:
  /// @param name the plugin's name; messages start with it.
  explicit SimulatorBase(std::string name) : SimulatorBase(std::move(name), Options()) {}
  SimulatorBase(std::string name, const Options& options);

  /// Called at the end of reset(): garment(), fabric(), scene(), positions() and velocities() are those of the new run.
  /// Sets up everything that depends on them.
  /// @throws ConfigError for what this simulator cannot honour; it must then be reset again.
  virtual void start() = 0;

  /// Advances one frame (kFrameSeconds). Held vertices move in a straight line to their targets and end there.
  /// @param targets [held().size(), 3] m, finite, in the order of held().
  /// @param drag 1/s: the air's (Fabric::damping_air_per_s), plus settle()'s.
  /// @param x, v [V, 3] m, m/s. In: the state before the frame. Out: after it. Non-finite numbers end the run as
  ///   diverged; positions() and velocities() then keep their values from before the frame.
  /// @throws Diverged with the reason. The base adds plugin and frame to the message.
  virtual void advance_frame(const Positions& targets, double drag, Positions& x, Positions& v) = 0;

  /// A vertex was grasped (`held`) or released. Its velocity is zero.
  virtual void hold_changed(Index /*vertex*/, bool /*held*/) {}
  /// set_state() or restore() replaced positions(), velocities() and held(). Drop all history here.
  virtual void state_changed() {}

  /// Largest |principal stretch - 1| of a face at positions(), against its rest shape.
  virtual double face_strain(Index face) const;
  /// Adds contacts and warnings, which the base cannot know, to the diagnostics.
  virtual void add_diagnostics(SimulatorDiagnostics& /*diagnostics*/) const {}

  /// What a snapshot must keep besides positions, velocities and held vertices, such as contact warm starts.
  virtual std::any save_history() const { return {}; }
  /// Restores the result of save_history(); positions(), velocities() and held() are already restored.
  virtual void restore_history(const std::any& /*history*/) { state_changed(); }

  const Garment& garment() const { return *garment_; }
  const Fabric& fabric() const { return fabric_; }
  const Scene& scene() const { return scene_; }
  /// Lowest z of a vertex, m: the ground and the cloth's thickness. Without ground -infinity.
  double floor() const { return floor_; }
  const std::vector<Index>& held() const { return held_; }  ///< in the order of step()'s targets
  bool is_fixed(Index vertex) const { return pinned_[vertex] || is_held_[vertex]; }

 private:
  enum class Phase { not_reset, running, diverged };
  struct Snapshot;

  void require_running(const char* call) const;
  void require_reset(const char* call) const;
  void require_free(Index vertex, const char* call) const;
  void set_held(std::span<const Index> vertices);
  void advance(const Positions& targets, double extra_drag);
  double max_speed() const;

  std::string name_;
  Options options_;
  Phase phase_ = Phase::not_reset;
  std::shared_ptr<const Garment> garment_;
  Fabric fabric_;
  Scene scene_;
  double floor_ = 0.0;
  std::vector<std::uint8_t> pinned_, is_held_;  // [V]
  std::vector<Index> held_;
  Positions positions_, velocities_;
  Positions next_positions_, next_velocities_;  // of the frame that is being computed
  Positions still_;                             // [held, 3] targets of settle()
  Index frame_ = 0;
  double max_grasp_strain_ = 0.0;
};

}  // namespace weft
