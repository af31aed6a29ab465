#include <algorithm>

#include "weft/plugin.hpp"
#include "weft/trajectory.hpp"

using namespace weft;

struct Params {
  double lift = 0.5;
  void visit(auto& v) {
    v("lift", lift, range(0.0, 2.0), "Height of the path's middle, in lengths of the displacement.");
  }
};

/// Carries the hands along the displacement d with the least squared jerk [Flash & Hogan 1985], over a hump:
///     m(s) = s^3 (10 - 15 s + 6 s^2)
///     g_i = g0_i + m(s) d + (x, y) + [64 lift |d| (s (1 - s))^3 + h m(s)] z,   z >= contact height
/// State: phase s (1 releases), shift x and y (m). Controls: their changes per frame, which the base class adds up.
struct MinJerk final : Trajectory {
  explicit MinJerk(const Params& params) : p(params) {}
  std::vector<Variable> controls() const override {
    return {{"dphase", "1/frame", 1.0 / 240, 1.0 / 48, 1.0 / 96, 1.0 / 480},
            {"dx", "m/frame", -0.002, 0.002, 0.0, 0.0005},
            {"dy", "m/frame", -0.002, 0.002, 0.0, 0.0005}};
  }
  std::vector<Variable> state() const override {
    return {{"phase", "1", 0.0, 100.0, 0.0, 0.1}, {"x", "m", -10.0, 10.0, 0.0, 0.1}, {"y", "m", -10.0, 10.0, 0.0, 0.1}};
  }
  Index hands() const override { return 2; }
  Vector initial_state(const Manipulation& m) const override {
    check_manipulation("min_jerk", *this, m);
    return Vector::Zero(3);
  }
  double progress(ConstVec state) const override {
    check_state("min_jerk", *this, state);
    return state[0];
  }
  Positions targets(const Manipulation& m, ConstVec state) const override {
    const double s = std::clamp(progress(state), 0.0, 1.0), q = s * (1.0 - s);
    const double along = s * s * s * (10.0 + s * (6.0 * s - 15.0));
    const double height = 64.0 * p.lift * m.displacement.norm() * q * q * q + m.drop_height * along;
    check_manipulation("min_jerk", *this, m);
    Positions g = m.grasp_points;
    g.leftCols<2>().rowwise() += (along * m.displacement + state.tail<2>()).transpose();
    g.col(2) = (g.col(2).array() + height).max(m.contact_height);
    return g;
  }
  Vector targets_pullback(const Manipulation& m, ConstVec state, const Positions& d_targets) const override {
    require_shape("min_jerk: d_targets rows", d_targets.rows(), 2);
    const double s = std::clamp(progress(state), 0.0, 1.0), q = s * (1.0 - s), d_along = 30.0 * q * q;
    const double d_height = 192.0 * p.lift * m.displacement.norm() * q * q * (1.0 - 2.0 * s) + m.drop_height * d_along;
    const Vec2 d_shift = d_targets.leftCols<2>().colwise().sum().transpose();
    const double d_z = (targets(m, state).col(2).array() > m.contact_height).select(d_targets.col(2), 0.0).sum();
    return Vec3(d_along * m.displacement.dot(d_shift) + d_height * d_z, d_shift.x(), d_shift.y());
  }
  Params p;
};

WEFT_PLUGIN(weft::Trajectory, MinJerk, Params, "min_jerk", "1.0.0")
