#pragma once
#include <memory>
#include <vector>

#include "contact.hpp"
#include "elements.hpp"
#include "mass_scaling.hpp"
#include "obstacle_contact.hpp"
#include "params.hpp"
#include "stability.hpp"
#include "weft/simulator.hpp"

namespace weft::cloth {

/// Cloth as a continuum (elements.hpp), integrated by many small explicit steps per frame:
///     v += dt (f(x, v) / m + g),   v /= 1 + dt drag,   contact,   x += dt v.
/// Cloth at rest satisfies the static equations exactly, for any step: no iteration or step changes a stiffness or a
/// friction threshold. Forces are in float from exact fixed-point differences; state is in double.
class Cloth final : public SimulatorBase {
 public:
  explicit Cloth(const Params& params)
      : SimulatorBase("cloth", {params.settle_damping_per_s, params.grasp_strain_warning}), params_(params) {}

  SimulatorCapabilities capabilities() const override;

  /// Substeps of the last frame, for tests and benchmarks.
  Index last_substeps() const { return last_substeps_; }

 protected:
  void start() override;
  void advance_frame(const Positions& targets, double drag, Positions& x, Positions& v) override;
  void hold_changed(Index vertex, bool held) override;
  void state_changed() override;
  double face_strain(Index face) const override;
  void add_diagnostics(SimulatorDiagnostics& diagnostics) const override;
  std::any save_history() const override { return state_; }
  void restore_history(const std::any& history) override { state_ = std::any_cast<const State&>(history); }

 private:
  /// Everything that changes, in the layout of the frame loop.
  struct State {
    std::vector<Double4> x, v;        ///< m, m/s
    std::vector<Float4> v_float;      ///< v, as the forces read it
    std::vector<Fixed4> x_fixed;      ///< x, as the forces read it
    std::vector<float> inverse_mass;  ///< 1/kg, zero for held and pinned vertices
    std::vector<float> moved;         ///< [padded] m, in the last substep
    SelfContact::State contact;
    ObstacleContact::State obstacles;
    float stiffening = 1.0f;  ///< largest squared stretch in the last substep
  };

  void choose_inertia(bool fine);
  void choose_step();
  void share_limit(double g);
  /// The springs of contact take what the elements leave of the limit: in garments of several layers. Not where inertia is
  /// scaled, which was not measured.
  bool shares_limit() const { return !garment().form.layers.empty() && scaling_->stages() == 1; }
  void check_substeps() const;
  void load_state();
  void aim(const Positions& targets);
  void advance_block(double& done, double drag);
  double substep(double dt, double drag, double part);
  void place_held(double part);
  struct Gain;
  __m256d accelerated(std::int32_t i, const Gain& gain) const;
  void accelerate_scaled(double dt, double drag);
  void rest_on_ground(const Double4& x, double dt, Double4& v, Double4& a, Float4& free) const;

  Params params_;
  /// The parts of the setup that depend on the mesh alone. A simulator that is reset for the next fold keeps them.
  std::unique_ptr<Topology> topology_;
  std::unique_ptr<PatchTree> tree_;
  std::unique_ptr<Elements> elements_;
  std::unique_ptr<SelfContact> contact_;
  std::unique_ptr<MassScaling> scaling_;
  std::unique_ptr<ObstacleContact> obstacles_;  ///< null: the scene has none
  std::vector<double> masses_;                  ///< kg, lumped: a third of the faces around
  Spectrum spectrum_;                           ///< at rest
  double longest_step_ = 0.0;                   ///< s, at rest
  double frame_step_ = 0.0;                     ///< s, the same with the frame's moduli

  State state_;
  Index last_substeps_ = 0;
  // Scratch of the frame loop.
  std::vector<Float4> forces_, free_;
  std::vector<float> reach_, bound_;
  std::vector<Double4> start_, target_;  ///< [held] m, of the frame
};

}  // namespace weft::cloth
