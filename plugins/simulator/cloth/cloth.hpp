#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "contact.hpp"
#include "elements.hpp"
#include "mass_scaling.hpp"
#include "params.hpp"
#include "stability.hpp"
#include "weft/simulator.hpp"

namespace weft::cloth {

/// Cloth as a continuum (elements.hpp), integrated by many small explicit steps per frame:
///     v += dt (f(x, v) / m + g),   v /= 1 + dt drag,   contact,   x += dt v.
/// What is at rest satisfies the static equations exactly, whatever the step: no iteration or step changes a stiffness
/// or a friction threshold. Forces are in float from exact fixed-point differences; state is in double.
class Cloth final : public Simulator {
 public:
  explicit Cloth(const Params& params) : params_(params) {}

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
  Index frame() const override { return state_.frame; }
  SimulatorDiagnostics diagnostics() const override;
  std::shared_ptr<const SimulatorSnapshot> save() const override;
  void restore(const SimulatorSnapshot& snapshot) override;

  /// Substeps of the last frame, for tests and benchmarks.
  Index last_substeps() const { return last_substeps_; }

 private:
  /// Everything that changes; a snapshot is a copy of it.
  struct State {
    std::vector<Double4> x, v;        ///< m, m/s
    std::vector<Float4> v_float;      ///< v, as the forces read it
    std::vector<Fixed4> x_fixed;      ///< x, as the forces read it
    std::vector<float> inverse_mass;  ///< 1/kg, zero for held and pinned vertices
    std::vector<float> moved;         ///< [padded] m, in the last substep
    std::vector<std::int32_t> held;   ///< in step()'s order
    SelfContact::State contact;
    float stiffening = 1.0f;  ///< largest squared stretch in the last substep
    double max_grasp_strain = 0.0;
    Index frame = 0;
    bool lost = false;  ///< diverged: nothing but reset() is allowed
  };
  struct Snapshot;

  void require_ready(const char* call) const;
  std::int32_t checked_vertex(Index vertex, const char* call) const;
  void hold(std::int32_t vertex);
  void advance(const Double4* targets, double extra_drag);
  double substep(double dt, double drag, const float* bound, const Double4* start, const Double4* targets, double part);
  struct Gain;
  __m256d accelerated(std::int32_t i, const Gain& gain) const;
  void accelerate_scaled(double dt, double drag);
  void rest_on_ground(const Double4& x, double dt, Double4& v, Double4& a, Float4& free) const;
  void refresh_derived();
  void publish();
  void update_grasp_strain();
  double max_speed() const;

  Params params_;
  std::shared_ptr<const Garment> garment_;
  Fabric fabric_;
  Scene scene_;
  std::unique_ptr<Topology> topology_;
  std::unique_ptr<Elements> elements_;
  std::unique_ptr<SelfContact> contact_;
  std::unique_ptr<MassScaling> scaling_;
  std::vector<double> masses_;  ///< kg, lumped: a third of the faces around
  std::vector<std::uint8_t> pinned_;
  Spectrum spectrum_;
  double damping_part_ = 1.0;  ///< of the fabric's stiffness-proportional damping that the step allows
  double longest_step_ = 0.0;  ///< s, at rest
  double floor_ = 0.0;         ///< m, lowest z of a mid-surface; -inf: no ground

  State state_;
  Positions positions_, velocities_;
  Index last_substeps_ = 0;
  // Scratch of the frame loop.
  std::vector<Float4> forces_, free_;
  std::vector<float> reach_, bound_;
  std::vector<Double4> start_, target_;
};

}  // namespace weft::cloth
