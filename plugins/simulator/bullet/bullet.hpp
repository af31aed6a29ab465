#pragma once
#include <memory>
#include <string>
#include <vector>

#include "contact.hpp"
#include "links.hpp"
#include "params.hpp"
#include "weft/simulator.hpp"

namespace weft::bullet {

/// Cloth as a btSoftBody of links in a btSoftRigidDynamicsWorld of its own.
///
/// A frame is one stepSimulation(); the world's soft-body solver (World::Solver) makes small substeps of it, each
///     v = (v + dt g) / (1 + dt drag),  q = x,  x += dt v,  PSolve_Links once,  contact,  v = (x - q) / dt.
/// One pass with small substeps is XPBD [Macklin et al. 2019, Small steps in physics simulation]: a link of compliance
/// 1/k moves its ends by (L0 - L) / (1/(k dt^2) + w), w = 1/m_a + 1/m_b, so that stiffness does not depend on the step.
/// Bullet divides by Link::m_c0, which is set here instead of through Material::m_kLST, whose meaning changes with the
/// masses, and to 1/(k dt^2) + w/2: the sweep evaluates a link when, on average, half of what balances it at its ends
/// has been applied, which is worth w/2 (README, "Calibration").
class Bullet final : public Simulator {
 public:
  explicit Bullet(const Params& params);
  ~Bullet() override;

  SimulatorCapabilities capabilities() const override;
  void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) override;
  void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) override;
  void grasp(std::span<const Index> vertices) override;
  std::vector<Index> grasped() const override;
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

  Index substeps() const { return substeps_; }
  const SpringNetwork& network() const { return network_; }
  /// Pairs whose certificate (contact.hpp) could not be restored since reset().
  Index uncertified() const;

 private:
  class World;
  struct Snapshot;

  void require_ready(const char* call) const;
  std::int32_t checked_vertex(Index vertex, const char* call) const;
  void choose_substeps();
  void hold(std::int32_t vertex);
  void advance(const Positions& targets, double extra_drag);
  void publish();
  double principal_strain(Index face) const;
  double max_speed() const;

  Params params_;
  std::shared_ptr<const Garment> garment_;
  Fabric fabric_;
  Scene scene_;
  SpringNetwork network_;
  std::vector<std::uint8_t> pinned_;
  std::vector<std::string> warnings_;
  Index substeps_ = 0;
  std::unique_ptr<World> world_;

  // With the nodes' positions and velocities, the whole state at the end of a frame.
  std::vector<std::int32_t> held_;  ///< in step()'s order
  Index frame_ = 0;
  double max_grasp_strain_ = 0.0;
  bool lost_ = false;  ///< diverged: nothing but reset() and set_state() is allowed

  Positions positions_, velocities_;
};

}  // namespace weft::bullet
