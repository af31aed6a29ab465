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
/// A frame is one stepSimulation(). The world's soft-body solver (World::Solver) splits it into small substeps of
///     v = (v + dt g) / (1 + dt drag),  q = x,  x += dt v,  PSolve_Links once,  contact,  v = (x - q) / dt.
/// One pass with small substeps is XPBD [Macklin et al. 2019, Small steps in physics simulation]: a link of compliance
/// 1/k moves its ends by (L0 - L) / (1/(k dt^2) + w), w = 1/m_a + 1/m_b. So stiffness does not depend on the step.
/// Bullet divides by Link::m_c0. It is set here, because the meaning of Material::m_kLST changes with the masses. Its
/// value is 1/(k dt^2) + w/2: when the sweep reaches a link, on average half of what balances it at its ends has been
/// applied, and that is worth w/2 (README, "Calibration").
class Bullet final : public SimulatorBase {
 public:
  explicit Bullet(const Params& params);
  ~Bullet() override;

  SimulatorCapabilities capabilities() const override;

  Index substeps() const { return substeps_; }
  const SpringNetwork& network() const { return network_; }
  /// Pairs whose certificate (contact.hpp) could not be restored since reset().
  Index uncertified() const;

 protected:
  void start() override;
  void advance_frame(const Positions& targets, double drag, Positions& x, Positions& v) override;
  void hold_changed(Index vertex, bool held) override;
  void state_changed() override;
  void add_diagnostics(SimulatorDiagnostics& diagnostics) const override;

 private:
  class World;

  void choose_substeps();

  Params params_;
  SpringNetwork network_;
  std::vector<std::string> warnings_;
  Index substeps_ = 0;
  std::unique_ptr<World> world_;
};

}  // namespace weft::bullet
