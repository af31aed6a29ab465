#include "loader/checked.hpp"
#include "loader/guard.hpp"
#include "weft/simulator.hpp"

namespace weft {
namespace {

class CheckedSimulator final : public Simulator {
 public:
  CheckedSimulator(const std::string& name, std::shared_ptr<Simulator> plugin, PluginChecks checks)
      : guard_(kKind, name, checks == PluginChecks::all), plugin_(std::move(plugin)) {}

  SimulatorCapabilities capabilities() const override {
    return guard_.call("capabilities()", [&] { return plugin_->capabilities(); });
  }

  void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) override {
    guard_.set_up("reset()", [&] {
      const Index vertices = garment ? garment->vertex_count() : 0;
      plugin_->reset(std::move(garment), fabric, scene);
      vertices_ = vertices;
      check_state("reset()");
      check_held("reset()", 0);
    });
  }

  void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) override {
    guard_.call("set_state()", [&] {
      plugin_->set_state(positions, velocities, grasped);
      check_state("set_state()");
      check_held("set_state()", std::ssize(grasped));
    });
  }

  void grasp(std::span<const Index> vertices) override {
    guard_.call("grasp()", [&] {
      plugin_->grasp(vertices);
      check_held("grasp()", held_ + std::ssize(vertices));
    });
  }

  std::vector<Index> grasped() const override {
    return guard_.call("grasped()", [&] {
      std::vector<Index> held = plugin_->grasped();
      check_vertices(held);
      return held;
    });
  }

  void step(const Positions& grasp_targets) override {
    guard_.want_from_caller("targets, counted in rows,", grasp_targets.rows(), held_);
    if (guard_.callers_too() && !all_finite(grasp_targets)) guard_.blame_caller("targets that are not finite");
    guard_.call("step()", [&] {
      plugin_->step(grasp_targets);
      check_state("step()");
    });
  }

  void release(std::span<const Index> vertices) override {
    guard_.call("release()", [&] {
      plugin_->release(vertices);
      read_held();
    });
  }
  void release() override {
    guard_.call("release()", [&] {
      plugin_->release();
      check_held("release()", 0);
    });
  }

  SettleResult settle(const SettleCriterion& criterion) override {
    return guard_.call("settle()", [&] {
      const SettleResult result = plugin_->settle(criterion);
      check_state("settle()");
      if (result.frames < 0 || result.frames > criterion.max_frames) {
        guard_.fail("settle() took " + std::to_string(result.frames) + " frames, must be in [0, " +
                    std::to_string(criterion.max_frames) + "]");
      }
      if (!all_finite(&result.max_speed, 1)) guard_.fail_not_finite("max_speed from settle()");
      return result;
    });
  }

  const Positions& positions() const override {
    return guard_.call("positions()", [&]() -> const Positions& { return plugin_->positions(); });
  }
  const Positions& velocities() const override {
    return guard_.call("velocities()", [&]() -> const Positions& { return plugin_->velocities(); });
  }
  Index frame() const override {
    return guard_.call("frame()", [&] { return plugin_->frame(); });
  }
  SimulatorDiagnostics diagnostics() const override {
    return guard_.call("diagnostics()", [&] {
      SimulatorDiagnostics result = plugin_->diagnostics();
      const double numbers[] = {result.max_speed, result.max_strain, result.max_grasp_strain};
      if (!all_finite(numbers, 3)) guard_.fail_not_finite("a speed or strain from diagnostics()");
      return result;
    });
  }

  std::shared_ptr<const SimulatorSnapshot> save() const override {
    return guard_.call("save()", [&] {
      auto snapshot = plugin_->save();
      if (!snapshot) guard_.fail("save() returned no snapshot");
      return snapshot;
    });
  }
  void restore(const SimulatorSnapshot& snapshot) override {
    guard_.call("restore()", [&] {
      plugin_->restore(snapshot);
      check_state("restore()");
      read_held();
    });
  }

 private:
  /// Positions and velocities after a call that may have changed them.
  void check_state(const std::string& after) const {
    const Positions& x = plugin_->positions();
    const Positions& v = plugin_->velocities();
    if (x.rows() != vertices_)
      guard_.fail_size(("positions(), counted in rows, after " + after).c_str(), x.rows(), vertices_);
    if (v.rows() != vertices_)
      guard_.fail_size(("velocities(), counted in rows, after " + after).c_str(), v.rows(), vertices_);
    if (!all_finite(x)) guard_.fail_not_finite("a position after " + after);
    if (!all_finite(v)) guard_.fail_not_finite("a velocity after " + after);
  }
  void check_held(const std::string& after, Index wanted) {
    const std::vector<Index> held = plugin_->grasped();
    if (std::ssize(held) != wanted) guard_.fail_size(("grasped() after " + after).c_str(), std::ssize(held), wanted);
    check_vertices(held);
    held_ = wanted;
  }
  void read_held() {
    const std::vector<Index> held = plugin_->grasped();
    check_vertices(held);
    held_ = std::ssize(held);
  }
  void check_vertices(const std::vector<Index>& held) const {
    for (const Index v : held) {
      if (v < 0 || v >= vertices_) {
        guard_.fail("grasped() holds vertex " + std::to_string(v) + ", must be in [0, " +
                    std::to_string(vertices_ - 1) + "]");
      }
    }
  }

  Guard guard_;
  std::shared_ptr<Simulator> plugin_;
  Index vertices_ = 0, held_ = 0;
};

}  // namespace

std::shared_ptr<Simulator> checked(const std::string& name, std::shared_ptr<Simulator> plugin, PluginChecks checks) {
  return std::make_shared<CheckedSimulator>(name, std::move(plugin), checks);
}

}  // namespace weft
