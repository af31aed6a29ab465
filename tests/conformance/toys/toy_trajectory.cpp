#include <algorithm>
#include <cmath>
#include <numbers>

#include "toy.hpp"
#include "weft/plugin.hpp"
#include "weft/trajectory.hpp"

namespace weft::toy {

/// Lift and carry: state (s, side m), g_i = g0_i + s d + side (z x d / |d|), lifted by |d|/2 sin(pi s) + h s; s in [0,
/// 1].
class ToyTrajectory final : public Trajectory {
 public:
  explicit ToyTrajectory(const Params& params) : p_(params) {}

  std::vector<Variable> controls() const override {
    return {{"ds", "1/frame", 0.002, 0.03, is("default_controls_release") ? 0.002 : 0.0111, 0.003},
            {"dside", "m/frame", -0.002, 0.002, is("variables_are_well_formed") ? 0.003 : 0.0, 0.0005}};
  }
  std::vector<Variable> state() const override {
    return {{"s", "", -100.0, 100.0, 0.0, 0.13}, {"side", "m", -10.0, 10.0, 0.0, 0.02}};
  }
  Index hands() const override { return 2; }

  Vector initial_state(const Manipulation& m) const override {
    check(m);
    return Vector::Zero(2);
  }
  Vector advance(const Manipulation&, ConstVec state, ConstVec control) const override {
    check(state, control);
    return state + control;
  }
  void advance_pullback(const Manipulation&, ConstVec state, ConstVec control, ConstVec d_next, Vector& d_state,
                        Vector& d_control) const override {
    check(state, control);
    require_shape("toy: d_next", d_next.size(), 2);
    d_state = d_next;
    d_control = is("advance_pullback_is_exact") ? 1.01 * d_next : Vector(d_next);
  }

  Positions targets(const Manipulation& m, ConstVec state) const override {
    check(m);
    require_shape("toy: state", state.size(), 2);
    const double s = std::clamp(state[0], 0.0, 1.0), length = m.displacement.norm();
    const Vec2 d = m.displacement / length;
    Positions g = m.grasp_points;
    for (Index i = 0; i < 2; ++i) {
      g(i, 0) += s * length * d.x() - state[1] * d.y();
      g(i, 1) += s * length * d.y() + state[1] * d.x();
      g(i, 2) += 0.5 * length * std::sin(std::numbers::pi * s) + m.drop_height * s;
      g(i, 2) = std::max(g(i, 2), m.contact_height);
    }
    if (is("starts_at_the_grasp_points")) g(0, 0) += 1e-6;
    if (is("path_is_continuous") && s > 0.5) g(1, 2) += 0.1;
    if (is("never_below_contact_height") && s > 0.9) g(1, 2) = 0.5 * m.contact_height;
    if (is("same_bits_on_two_threads")) g.array() += 1e-13 * thread_ordinal();
    return g;
  }
  Vector targets_pullback(const Manipulation& m, ConstVec state, const Positions& d_targets) const override {
    check(m);
    require_shape("toy: state", state.size(), 2);
    require_shape("toy: d_targets", d_targets.rows(), 2);
    const double s = std::clamp(state[0], 0.0, 1.0), length = m.displacement.norm();
    const Vec2 d = m.displacement / length;
    Vector out = Vector::Zero(2);
    for (Index i = 0; i < 2; ++i) {
      const double rise = 0.5 * length * std::numbers::pi * std::cos(std::numbers::pi * s) + m.drop_height;
      if (s == state[0])
        out[0] += length * (d.x() * d_targets(i, 0) + d.y() * d_targets(i, 1)) +
                  (is("targets_pullback_is_exact") ? 0.0 : rise) * d_targets(i, 2);
      out[1] += d.x() * d_targets(i, 1) - d.y() * d_targets(i, 0);
    }
    return out;
  }
  double progress(ConstVec state) const override {
    require_shape("toy: state", state.size(), 2);
    return state[0];
  }

  Index decision_size(Index horizon) const override { return 2 * horizon; }
  Controls decode(ConstVec x, Index horizon, ConstVec) const override {
    require_shape("toy: x", x.size(), 2 * horizon);
    return Eigen::Map<const Controls>(x.data(), horizon, 2);
  }
  Vector decode_pullback(ConstVec x, Index horizon, ConstVec, const Controls& d_controls) const override {
    if (!is("refuses_bad_shapes")) require_shape("toy: d_controls", d_controls.size(), 2 * horizon);
    Vector d = Eigen::Map<const Vector>(d_controls.data(), d_controls.size());
    if (is("decode_pullback_is_exact")) d *= x.size() > 0 ? -1.0 : 1.0;
    return d;
  }
  Vector encode(const Controls& controls, ConstVec) const override {
    require_shape("toy: columns of controls", controls.cols(), 2);
    return (is("decode_encode_round_trip") ? 0.999 : 1.0) * Eigen::Map<const Vector>(controls.data(), controls.size());
  }
  Box decision_bounds(Index horizon) const override {
    Box box{Vector(2 * horizon), Vector(2 * horizon)};
    for (Index i = 0; i < 2 * horizon; ++i) {
      const auto v = controls()[static_cast<std::size_t>(i % 2)];
      box.lower[i] = v.lower;
      box.upper[i] = v.upper + (is("decision_box_is_sound") ? 1.0 : 0.0);
    }
    return box;
  }
  Vector decision_scale(Index horizon) const override {
    Vector scale(2 * horizon);
    for (Index i = 0; i < 2 * horizon; ++i) scale[i] = controls()[static_cast<std::size_t>(i % 2)].scale;
    return scale;
  }

 private:
  bool is(const char* mutation) const { return p_.mutation == mutation; }
  static void check(const Manipulation& m) {
    require_shape("toy: grasp points", m.grasp_points.rows(), 2);
    if (!(m.displacement.norm() > 0.0)) throw ConfigError("toy: |d| must be > 0");
  }
  static void check(ConstVec state, ConstVec control) {
    require_shape("toy: state", state.size(), 2);
    require_shape("toy: control", control.size(), 2);
  }
  Params p_;
};

}  // namespace weft::toy

WEFT_PLUGIN(weft::Trajectory, weft::toy::ToyTrajectory, weft::toy::Params, "toy_trajectory", "1.0.0")
