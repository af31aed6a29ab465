#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "toy.hpp"
#include "weft/plugin.hpp"
#include "weft/trajectory.hpp"

namespace weft::toy {

/// Lift and carry: state (s, side m), g_i = g0_i + s d + side (z x d / |d|), lifted by |d|/2 sin(pi s) + h s;
/// s in [0, 1]. Mutations nan_* put one NaN into the result of the function of that name.
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
    return toy::spoilt(p_, "initial_state", Vector(Vector::Zero(2)));
  }
  Vector advance(const Manipulation& m, ConstVec state, ConstVec control) const override {
    misbehave(p_);
    return spoilt("nan_advance", toy::spoilt(p_, "advance", Trajectory::advance(m, state, control)));
  }
  void advance_pullback(const Manipulation& m, ConstVec state, ConstVec control, ConstVec d_next, Vector& d_state,
                        Vector& d_control) const override {
    Trajectory::advance_pullback(m, state, control, d_next, d_state, d_control);
    if (is("advance_pullback_is_exact")) d_control *= 1.01;
    d_state = spoilt("nan_d_state", toy::spoilt(p_, "d_state", d_state));
    d_control = spoilt("nan_d_control", toy::spoilt(p_, "d_control", d_control));
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
    return spoilt("nan_targets", toy::spoilt(p_, "targets", g));
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
    return spoilt("nan_targets_pullback", toy::spoilt(p_, "targets_pullback", out));
  }
  double progress(ConstVec state) const override {
    require_shape("toy: state", state.size(), 2);
    return is("nan_progress") ? kNaN : toy::spoilt(p_, "progress", state[0]);
  }

  Controls decode(ConstVec x, Index horizon, ConstVec state) const override {
    return spoilt("nan_decode", toy::spoilt(p_, "decode", Trajectory::decode(x, horizon, state)));
  }
  Vector decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const override {
    if (is("refuses_bad_shapes")) return Eigen::Map<const Vector>(d_controls.data(), d_controls.size());
    Vector d = Trajectory::decode_pullback(x, horizon, state, d_controls);
    if (is("decode_pullback_is_exact")) d *= -1.0;
    return spoilt("nan_decode_pullback", toy::spoilt(p_, "decode_pullback", d));
  }
  Vector encode(const Controls& controls, ConstVec state) const override {
    const Vector x = Trajectory::encode(controls, state);
    const double factor = is("decode_encode_round_trip") ? 0.999 : 1.0;
    return spoilt("nan_encode", toy::spoilt(p_, "encode", Vector(factor * x)));
  }
  Box decision_bounds(Index horizon) const override {
    Box box = Trajectory::decision_bounds(horizon);
    if (is("decision_box_is_sound")) box.upper.array() += 1.0;
    return {toy::spoilt(p_, "lower", box.lower), toy::spoilt(p_, "upper", box.upper)};
  }
  Vector decision_scale(Index horizon) const override {
    return toy::spoilt(p_, "decision_scale", Trajectory::decision_scale(horizon));
  }

 private:
  static constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  bool is(const char* mutation) const { return p_.mutation == mutation; }
  static void check(const Manipulation& m) {
    require_shape("toy: grasp points", m.grasp_points.rows(), 2);
    if (!(m.displacement.norm() > 0.0)) throw ConfigError("toy: |d| must be > 0");
  }
  /// `values` with a NaN as the last entry if that is the mutation.
  template <class Values>
  Values spoilt(const char* mutation, Values values) const {
    if (is(mutation) && values.size() > 0) values.data()[values.size() - 1] = kNaN;
    return values;
  }
  Params p_;
};

}  // namespace weft::toy

WEFT_PLUGIN(weft::Trajectory, weft::toy::ToyTrajectory, weft::toy::Params, "toy_trajectory", "1.0.0")
