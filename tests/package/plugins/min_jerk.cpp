#include <algorithm>
#include <cmath>

#include "weft/plugin.hpp"
#include "weft/trajectory.hpp"

namespace min_jerk {

struct Params {
  double lift = 0.5;
  double shift_max_m = 0.002;
  template <class Visitor>
  void visit(Visitor& v) {
    v("lift", lift, weft::range(0.0, 2.0), "Height of the path's middle, in lengths of the displacement.");
    v("shift_max_m", shift_max_m, weft::range(1e-6, 0.01, "m/frame"), "Largest sideways shift per frame and axis.");
  }
};

using namespace weft;

/// Carries two hands along the displacement d with the least squared jerk [Flash & Hogan 1985], over a hump:
///     m(s) = 10 s^3 - 15 s^4 + 6 s^5
///     g_i = g0_i + m(s) d + shift + [lift |d| 64 (s (1 - s))^3 + h m(s)] z,   z >= contact height
/// State: phase s (progress; 1 releases), shift x and y (m). Controls: their changes per frame. At the end the hands
/// are at height h above where they began.
class MinJerk final : public Trajectory {
 public:
  explicit MinJerk(const Params& params) : p_(params) {}

  std::vector<Variable> controls() const override {
    return {{"dphase", "1/frame", 1.0 / 240, 1.0 / 48, 1.0 / 96, 1.0 / 480},
            {"dx", "m/frame", -p_.shift_max_m, p_.shift_max_m, 0.0, 0.25 * p_.shift_max_m},
            {"dy", "m/frame", -p_.shift_max_m, p_.shift_max_m, 0.0, 0.25 * p_.shift_max_m}};
  }
  std::vector<Variable> state() const override {
    return {{"phase", "1", 0.0, 100.0, 0.0, 0.1}, {"x", "m", -10.0, 10.0, 0.0, 0.1}, {"y", "m", -10.0, 10.0, 0.0, 0.1}};
  }
  Index hands() const override { return 2; }

  Vector initial_state(const Manipulation& m) const override {
    require_shape("min_jerk: manipulation.grasp_points rows", m.grasp_points.rows(), 2);
    if (!m.grasp_points.allFinite() || !m.displacement.allFinite()) {
      throw ConfigError("min_jerk: grasp points and displacement must be finite");
    }
    return Vector::Zero(3);
  }
  Vector advance(const Manipulation&, ConstVec state, ConstVec control) const override {
    require_shape("min_jerk: state", state.size(), 3);
    require_shape("min_jerk: control", control.size(), 3);
    return state + control;
  }
  void advance_pullback(const Manipulation&, ConstVec state, ConstVec control, ConstVec d_next, Vector& d_state,
                        Vector& d_control) const override {
    require_shape("min_jerk: state", state.size(), 3);
    require_shape("min_jerk: control", control.size(), 3);
    require_shape("min_jerk: d_next", d_next.size(), 3);
    d_state = d_next;
    d_control = d_next;
  }

  Positions targets(const Manipulation& m, ConstVec state) const override {
    const Point p(*this, m, state);
    Positions g = m.grasp_points;
    for (Index i = 0; i < g.rows(); ++i) {
      g(i, 0) += p.along * m.displacement.x() + state[1];
      g(i, 1) += p.along * m.displacement.y() + state[2];
      g(i, 2) = std::max(g(i, 2) + p.height, m.contact_height);
    }
    return g;
  }
  Vector targets_pullback(const Manipulation& m, ConstVec state, const Positions& d_targets) const override {
    const Point p(*this, m, state);
    require_shape("min_jerk: d_targets rows", d_targets.rows(), m.grasp_points.rows());
    Vector d_state = Vector::Zero(3);
    for (Index i = 0; i < d_targets.rows(); ++i) {
      const bool lifted = m.grasp_points(i, 2) + p.height >= m.contact_height;
      d_state[0] += p.d_along * (m.displacement.x() * d_targets(i, 0) + m.displacement.y() * d_targets(i, 1)) +
                    (lifted ? p.d_height * d_targets(i, 2) : 0.0);
      d_state[1] += d_targets(i, 0);
      d_state[2] += d_targets(i, 1);
    }
    return d_state;
  }
  double progress(ConstVec state) const override {
    require_shape("min_jerk: state", state.size(), 3);
    return state[0];
  }

  // The decision vector is the controls, row by row.
  Index decision_size(Index horizon) const override { return 3 * horizon; }
  Controls decode(ConstVec x, Index horizon, ConstVec) const override {
    require_shape("min_jerk: x", x.size(), decision_size(horizon));
    return Eigen::Map<const Controls>(x.data(), horizon, 3);
  }
  Vector decode_pullback(ConstVec, Index horizon, ConstVec, const Controls& d_controls) const override {
    require_shape("min_jerk: d_controls rows", d_controls.rows(), horizon);
    return encode(d_controls, Vector());
  }
  Vector encode(const Controls& controls, ConstVec) const override {
    require_shape("min_jerk: controls columns", controls.cols(), 3);
    return Eigen::Map<const Vector>(controls.data(), controls.size());
  }
  Box decision_bounds(Index horizon) const override {
    return {repeated(horizon, &Variable::lower), repeated(horizon, &Variable::upper)};
  }
  Vector decision_scale(Index horizon) const override { return repeated(horizon, &Variable::scale); }

 private:
  /// Where a phase is on the path, and the derivatives with respect to it.
  struct Point {
    Point(const MinJerk& self, const Manipulation& m, ConstVec state) {
      require_shape("min_jerk: state", state.size(), 3);
      require_shape("min_jerk: manipulation.grasp_points rows", m.grasp_points.rows(), 2);
      const double s = std::clamp(state[0], 0.0, 1.0), q = s * (1.0 - s);
      const double top = 64.0 * self.p_.lift * m.displacement.norm();
      along = s * s * s * (10.0 + s * (6.0 * s - 15.0));
      d_along = 30.0 * q * q;  // 0 at both ends, so the clamp leaves no corner
      height = top * q * q * q + m.drop_height * along;
      d_height = top * 3.0 * q * q * (1.0 - 2.0 * s) + m.drop_height * d_along;
    }
    double along, d_along, height, d_height;
  };
  Vector repeated(Index horizon, double Variable::*field) const {
    const auto variables = controls();
    Vector x(decision_size(horizon));
    for (Index i = 0; i < x.size(); ++i) x[i] = variables[static_cast<std::size_t>(i % 3)].*field;
    return x;
  }
  Params p_;
};

}  // namespace min_jerk

WEFT_PLUGIN(weft::Trajectory, min_jerk::MinJerk, min_jerk::Params, "min_jerk", "1.0.0")
