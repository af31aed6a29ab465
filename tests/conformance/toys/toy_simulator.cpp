#include <algorithm>
#include <cmath>

#include "toy.hpp"
#include "weft/plugin.hpp"
#include "weft/simulator.hpp"

namespace weft::toy {

/// Cloth without threads: every vertex is a particle of its own that falls, lands, slides and is carried. Its only
/// notion of layers: a released vertex comes to rest a little above the others.
class ToySimulator final : public Simulator {
 public:
  explicit ToySimulator(const Params& params) : p_(params) {}

  SimulatorCapabilities capabilities() const override {
    SimulatorCapabilities c;
    c.snapshots = c.self_contact = c.ground_friction = c.pins = c.gravity_any_direction = c.rest_frames = c.obstacles =
        p_.declare;
    c.orthotropic = is("orthotropic_in_words");
    return c;
  }

  void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) override {
    const bool tilted = scene.gravity.x() != 0.0 || scene.gravity.y() != 0.0;
    SimulatorCapabilities can = capabilities();
    if (p_.accept) can.pins = can.gravity_any_direction = can.rest_frames = can.obstacles = true;
    if (is("stretches_by_direction")) can.orthotropic = true;
    Fabric checked = fabric;
    if (is("two_bends")) checked.bend_warp_n_m = checked.bend_weft_n_m;
    if (is("tables")) checked.tables = nullptr;
    check_reset("toy", garment.get(), checked, scene, can);
    garment_ = std::move(garment);
    fabric_ = fabric;
    scene_ = scene;
    if (is("falls_freely") && !tilted && !scene.ground_height) scene_.gravity *= 0.9;
    if (is("gravity_any_direction") && tilted && !scene.ground_height) scene_.gravity.x() = 0.0;
    s_ = {};
    s_.x = garment_->positions;
    if (scene.ground_height && !is("reset_lifts_to_contact_height"))
      s_.x = positions_on_ground(*garment_, *scene.ground_height, fabric.thickness_m);
    if (!scene.obstacles.empty() && !is("starts_clear_of_obstacles"))
      s_.x = start_positions(*garment_, scene, fabric.thickness_m);
    if (is("reset_lays_layers_above_each_other") && scene.ground_height)
      s_.x.col(2) = garment_->positions.col(2).cwiseMax(*scene.ground_height + fabric.thickness_m);
    if (is("reset_forgets")) s_.x.array() += 1e-9 * resets_++;
    if (is("same_calls_same_bits")) s_.x.array() += 1e-12 * ordinal_;
    if (is("same_bits_on_two_threads")) s_.x.array() += 1e-12 * thread_ordinal();
    s_.v = scene.initial_velocity.transpose().replicate(s_.x.rows(), 1);
    for (Index pin : scene.pins) s_.v.row(pin).setZero();
    s_.loft.assign(static_cast<std::size_t>(s_.x.rows()), false);
  }

  void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) override {
    require_shape("toy: positions", positions.rows(), s_.x.rows());
    require_shape("toy: velocities", velocities.rows(), s_.x.rows());
    if (!positions.allFinite() || !velocities.allFinite()) throw Error("toy: state is not finite");
    s_.x = positions;
    if (!is("set_state_is_taken")) s_.v = velocities;
    s_.held.clear();
    s_.loft.assign(s_.loft.size(), false);
    grasp(grasped);
  }

  void grasp(std::span<const Index> vertices) override {
    for (Index v : vertices) {
      if (v < 0 || v >= s_.x.rows()) throw ShapeError("toy: vertex " + std::to_string(v) + " is out of range");
      if (std::count(scene_.pins.begin(), scene_.pins.end(), v)) throw ShapeError("toy: vertex is pinned");
      if (holds(v)) {
        if (is("refuses_bad_shapes")) continue;
        throw ShapeError("toy: vertex is held already");
      }
      s_.held.push_back(v);
      if (is("grasp_moves_nothing")) s_.x(v, 2) += 1e-3;
    }
  }
  std::vector<Index> grasped() const override {
    std::vector<Index> held = s_.held;
    if (spoils(p_, "empty", "grasped")) held.clear();
    if (spoils(p_, "long", "grasped")) held.push_back(0);
    return held;
  }

  void step(const Positions& targets) override {
    misbehave(p_);
    require_shape("toy: targets", targets.rows(), static_cast<Index>(s_.held.size()));
    if (!targets.allFinite()) {
      if (is("refuses_nan")) return;
      throw Error("toy: target is not finite");
    }
    for (std::size_t i = 0; i < s_.held.size(); ++i) {
      const Index v = s_.held[i];
      const Vec3 move = targets.row(static_cast<Index>(i)).transpose() - s_.x.row(v).transpose();
      s_.x.row(v) = targets.row(static_cast<Index>(i));
      if (is("held_vertex_follows_its_target")) s_.x.row(v) -= 1e-3 * move.transpose();
      s_.v.row(v) = move.transpose() / kFrameSeconds;
      if (is("non_finite_state_never_leaves")) s_.v.row(v) *= move.squaredNorm() / move.squaredNorm();
      if (s_.x(v, 2) > 5.0 * fabric_.thickness_m) s_.loft[static_cast<std::size_t>(v)] = true;
    }
    constexpr int substeps = 8;
    for (Index v = 0; v < s_.x.rows(); ++v) {
      if (holds(v)) continue;
      if (std::count(scene_.pins.begin(), scene_.pins.end(), v)) {
        if (is("pinned_stays_pinned")) s_.x(v, 2) -= 1e-6;
        continue;
      }
      for (int k = 0; k < substeps; ++k) fly(v, kFrameSeconds / substeps);
      if (is("rest_stays_at_rest") && s_.held.empty()) s_.x(v, 0) += 1e-5;
      if (is("translation_changes_nothing") && !s_.held.empty()) s_.x(v, 0) += 1e-5 * s_.x(v, 0);
      if (is("turn_about_z_changes_nothing") && !s_.held.empty()) s_.x(v, 0) += 1e-5;
    }
    // Threads that want the size of the picture; a seam that straightens; a back that rises through the front.
    if (is("frames_are_the_rest_shape") && garment_->has_frames()) s_.x.col(0) *= 0.999;
    if (is("seams_carry_no_moment") && garment_->form.seams.rows() > 0) s_.x.col(2) *= 0.999;
    if (is("sewn_layers_do_not_cross") && garment_->has_frames() && !s_.held.empty())
      s_.x(garment_->vertex_count() - 1, 2) = 0.01;
    // A vertex beside the carried corner rises through the face that the corner spans.
    if (is("layers_do_not_cross") && s_.loft[0]) s_.x(2, 2) = 0.05;
    ++s_.frame;
    if (!is("non_finite_state_never_leaves") && !(s_.x.allFinite() && s_.v.allFinite())) {
      s_.x.setZero();
      s_.v.setZero();
      throw Diverged("toy: frame " + std::to_string(s_.frame) + ": state is not finite");
    }
  }

  void release(std::span<const Index> vertices) override {
    if (is("one_hand_lets_go") && vertices.size() < s_.held.size() && vertices.front() == 0) return release();
    for (Index v : vertices) {
      const auto at = std::find(s_.held.begin(), s_.held.end(), v);
      if (at == s_.held.end()) throw ShapeError("toy: vertex is not held");
      s_.held.erase(at);
      if (!is("release_leaves_no_kick")) s_.v.row(v).setZero();
    }
  }
  void release() override { release(std::vector<Index>(s_.held)); }

  SettleResult settle(const SettleCriterion& criterion) override {
    SettleResult result;
    if (is("settles")) {
      result.settled = true;
      return result;
    }
    if (is("settle_can_be_split")) s_.v.row(0) *= 0.99;
    const Index before = s_.frame;
    Positions keep(static_cast<Index>(s_.held.size()), 3);
    for (std::size_t i = 0; i < s_.held.size(); ++i) keep.row(static_cast<Index>(i)) = s_.x.row(s_.held[i]);
    if (is("settle_keeps_held_vertices")) keep.array() += 1e-6;
    for (Index calm = 0; result.frames < criterion.max_frames && calm < criterion.hold_frames; ++result.frames) {
      step(keep);
      result.max_speed = s_.v.rowwise().norm().maxCoeff();
      calm = result.max_speed < criterion.speed ? calm + 1 : 0;
      result.settled = calm >= criterion.hold_frames;
    }
    result.max_speed = spoilt(p_, "max_speed", result.max_speed);
    if (is("frames_are_counted")) s_.frame = before;
    return result;
  }

  const Positions& positions() const override { return shown("positions", s_.x, shown_x_); }
  const Positions& velocities() const override { return shown("velocities", s_.v, shown_v_); }
  Index frame() const override { return s_.frame; }
  SimulatorDiagnostics diagnostics() const override {
    SimulatorDiagnostics result;
    result.max_grasp_strain = spoilt(p_, "strain", 0.0);
    return result;
  }

  std::shared_ptr<const SimulatorSnapshot> save() const override {
    if (!p_.declare && !p_.accept) return Simulator::save();
    auto snapshot = std::make_shared<Snapshot>();
    snapshot->state = s_;
    snapshot->owner = this;
    return snapshot;
  }
  void restore(const SimulatorSnapshot& given) override {
    if (!p_.declare && !p_.accept) return Simulator::restore(given);
    const auto* snapshot = dynamic_cast<const Snapshot*>(&given);
    if (snapshot == nullptr || snapshot->state.x.rows() != s_.x.rows()) {
      if (is("foreign_snapshots_are_refused")) return;
      throw Error("toy: the snapshot is another plugin's or another garment's");
    }
    s_ = snapshot->state;
    if (is("restored_among_obstacles_is_bit_exact") && !scene_.obstacles.empty()) s_.v *= 0.5;
    if (is("restored_run_is_bit_exact")) s_.loft.assign(s_.loft.size(), false), s_.frame = 0;
    if (is("restores_in_another_object") && snapshot->owner != this) s_.held.clear();
  }

 private:
  struct State {
    Positions x, v;
    std::vector<Index> held;
    std::vector<bool> loft;  // has been carried: rests above the others
    Index frame = 0;
  };
  struct Snapshot final : SimulatorSnapshot {
    State state;
    const ToySimulator* owner = nullptr;
  };

  bool is(const char* mutation) const { return p_.mutation == mutation; }
  const Positions& shown(const char* result, const Positions& values, Positions& copy) const {
    return p_.spoil == "none" ? values : copy = spoilt(p_, result, values);
  }
  bool holds(Index v) const { return std::count(s_.held.begin(), s_.held.end(), v) > 0; }

  void fly(Index v, double dt) {
    s_.v.row(v) += dt * scene_.gravity.transpose();
    s_.v.row(v) *= std::exp(-fabric_.damping_air_per_s * dt);
    if (scene_.ground_height) land(v, dt);
    for (const Obstacle& obstacle : scene_.obstacles) touch(obstacle, v, dt);
    s_.x.row(v) += dt * s_.v.row(v);
  }
  /// Changes the velocity such that the vertex ends no lower than contact; the impulse of that bounds friction
  /// (Coulomb).
  void land(Index v, double dt) {
    const bool lofty = s_.loft[static_cast<std::size_t>(v)];
    const double layers = !lofty ? (is("nothing_sinks") ? 0.9 : 1.0) : is("layers_keep_their_distance") ? 1.1 : 5.0;
    const double contact = *scene_.ground_height + layers * fabric_.thickness_m;
    const double upwards = (contact - s_.x(v, 2)) / dt;
    if (s_.v(v, 2) >= upwards) return;
    const double impulse = upwards - s_.v(v, 2);
    s_.v(v, 2) = upwards;
    double mu = fabric_.friction;
    if (is("sticks_below_the_friction_threshold")) mu *= 0.5;
    if (is("slides_above_the_friction_threshold")) mu *= 2.0;
    const double slide = s_.v.row(v).head<2>().norm();
    if (slide > 0.0) s_.v.row(v).head<2>() *= std::max(0.0, 1.0 - mu * impulse / slide);
  }

  /// The same against an obstacle.
  void touch(const Obstacle& obstacle, Index v, double dt) {
    const ObstacleDistance at = obstacle_distance(obstacle, s_.x.row(v).transpose());
    const double contact = is("nothing_sinks_into_obstacles") ? 0.5 * fabric_.thickness_m : fabric_.thickness_m;
    Vec3 velocity = s_.v.row(v).transpose();
    const double outwards = (contact - at.distance) / dt, approach = at.normal.dot(velocity);
    if (approach >= outwards) return;
    const double impulse = outwards - approach;
    double mu = obstacle.friction.value_or(fabric_.friction);
    if (is("sticks_to_a_tilted_obstacle")) mu *= 0.5;
    if (is("slides_on_a_tilted_obstacle")) mu *= 2.0;
    const Vec3 along = velocity - approach * at.normal;
    const double slide = along.norm();
    velocity = outwards * at.normal;
    if (slide > 0.0) velocity += std::max(0.0, 1.0 - mu * impulse / slide) * along;
    s_.v.row(v) = velocity.transpose();
  }

  Params p_;
  int ordinal_ = object_ordinal();
  int resets_ = 0;
  std::shared_ptr<const Garment> garment_;
  Fabric fabric_;
  Scene scene_;
  State s_;
  mutable Positions shown_x_, shown_v_;  // spoilt copies
};

}  // namespace weft::toy

WEFT_PLUGIN(weft::Simulator, weft::toy::ToySimulator, weft::toy::Params, "toy_simulator", "1.0.0")
