#include "arc.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>

namespace weft::arc {
namespace {

constexpr Index kSize = 5;  // theta, r, phi, ax, ay
enum : Index { kTheta, kR, kPhi, kAx, kAy };
constexpr double kRadians = std::numbers::pi / 180.0;

/// cos and sin of an angle in degrees, exact at multiples of 90, so that paths end exactly where figures and tests
/// expect.
struct Turn {
  explicit Turn(double deg) : cos(std::cos(deg * kRadians)), sin(std::sin(deg * kRadians)) {
    if (std::remainder(deg, 90.0) == 0.0) {
      cos = std::round(cos);
      sin = std::round(sin);
    }
  }
  double cos, sin;
};

void check(const Manipulation& m, Index hands, double r_min) {
  require_shape("arc: manipulation.grasp_points rows", m.grasp_points.rows(), hands);
  const double length = m.displacement.norm();
  if (!(length >= 2.0 * r_min) || !std::isfinite(length)) {
    std::ostringstream text;
    text << "arc: |d| = " << length
         << " m (displacement of the grasp points), must be finite and at least 2 r_min = " << 2.0 * r_min << " m";
    throw ConfigError(text.str());
  }
  if (!m.grasp_points.allFinite()) throw ConfigError("arc: manipulation.grasp_points must be finite");
}

/// Offsets of the grasp points from their midpoint along d and along z x d.
struct Frame {
  explicit Frame(const Manipulation& m) {
    d = m.displacement / m.displacement.norm();
    const Index hands = m.grasp_points.rows();
    centre = (m.grasp_points.colwise().sum() / static_cast<double>(hands)).head<2>().transpose();
    for (Index i = 0; i < hands; ++i) {
      const Vec2 offset = m.grasp_points.row(i).head<2>().transpose() - centre;
      delta[i] = offset.dot(d);
      eps[i] = d.x() * offset.y() - d.y() * offset.x();
    }
  }
  Vec2 d;  // unit
  Vec2 centre;
  double delta[2] = {}, eps[2] = {};
};

Vec2 turned(const Vec2& v, const Turn& t) { return {t.cos * v.x() - t.sin * v.y(), t.sin * v.x() + t.cos * v.y()}; }
Vec2 quarter(const Vec2& v) { return {-v.y(), v.x()}; }  // z x v

}  // namespace

std::vector<Variable> Arc::controls() const {
  return {{"dtheta", "deg/frame", p_.dtheta_min_deg, p_.dtheta_max_deg, 2.0, p_.dtheta_scale_deg},
          {"dr", "m/frame", -p_.dr_max_m, p_.dr_max_m, 0.0, p_.dr_scale_m},
          {"dphi", "deg/frame", -p_.dphi_max_deg, p_.dphi_max_deg, 0.0, p_.dphi_scale_deg},
          {"dax", "m/frame", -p_.da_max_m, p_.da_max_m, 0.0, p_.da_scale_m},
          {"day", "m/frame", -p_.da_max_m, p_.da_max_m, 0.0, p_.da_scale_m}};
}

std::vector<Variable> Arc::state() const {
  // These bounds cover a workspace of 10 m and ten turns. The manipulation gives r and a at the start.
  return {{"theta", "deg", -3600.0, 3600.0, 0.0, 180.0},
          {"r", "m", p_.r_min_m, 10.0, p_.r_min_m, 0.1},
          {"phi", "deg", -3600.0, 3600.0, 0.0, 10.0},
          {"ax", "m", -10.0, 10.0, 0.0, 0.1},
          {"ay", "m", -10.0, 10.0, 0.0, 0.1}};
}

Vector Arc::initial_state(const Manipulation& m) const {
  check(m, p_.hands, p_.r_min_m);
  const Frame f(m);
  Vector s(kSize);
  s << 0.0, 0.5 * m.displacement.norm(), 0.0, f.centre + 0.5 * m.displacement;
  return s;
}

Vector Arc::advance(const Manipulation&, ConstVec state, ConstVec control) const {
  require_shape("arc: state", state.size(), kSize);
  require_shape("arc: control", control.size(), kSize);
  Vector next = state + control;
  next[kR] = std::max(next[kR], p_.r_min_m);
  return next;
}

void Arc::advance_pullback(const Manipulation&, ConstVec state, ConstVec control, ConstVec d_next, Vector& d_state,
                           Vector& d_control) const {
  require_shape("arc: state", state.size(), kSize);
  require_shape("arc: control", control.size(), kSize);
  require_shape("arc: d_next", d_next.size(), kSize);
  d_state = d_next;
  if (state[kR] + control[kR] < p_.r_min_m) d_state[kR] = 0.0;
  d_control = d_state;
}

Positions Arc::targets(const Manipulation& m, ConstVec state) const {
  require_shape("arc: state", state.size(), kSize);
  check(m, p_.hands, p_.r_min_m);
  const Frame f(m);
  const Vec2 d = turned(f.d, Turn(state[kPhi]));
  const Vec2 t_axis = quarter(d);
  const Turn t(std::clamp(state[kTheta], 0.0, 180.0));
  const double r = std::max(state[kR], p_.r_min_m);
  Positions g(p_.hands, 3);
  for (Index i = 0; i < p_.hands; ++i) {
    const double u = f.delta[i] - r;
    const double z = -t.sin * u + 0.5 * m.drop_height * (1.0 - t.cos);
    g.row(i).head<2>() = (state.segment<2>(kAx) + t.cos * u * d + f.eps[i] * t_axis).transpose();
    g(i, 2) = std::max(z, m.contact_height);
  }
  return g;
}

Vector Arc::targets_pullback(const Manipulation& m, ConstVec state, const Positions& d_targets) const {
  require_shape("arc: state", state.size(), kSize);
  require_shape("arc: d_targets rows", d_targets.rows(), p_.hands);
  check(m, p_.hands, p_.r_min_m);
  const Frame f(m);
  const Vec2 d = turned(f.d, Turn(state[kPhi]));
  const Vec2 t_axis = quarter(d);
  const Turn t(std::clamp(state[kTheta], 0.0, 180.0));
  const double r = std::max(state[kR], p_.r_min_m);
  const double theta_inside = state[kTheta] >= 0.0 && state[kTheta] <= 180.0 ? kRadians : 0.0;
  const double r_inside = state[kR] >= p_.r_min_m ? 1.0 : 0.0;

  Vector out = Vector::Zero(kSize);
  for (Index i = 0; i < p_.hands; ++i) {
    const double u = f.delta[i] - r;
    const double z = -t.sin * u + 0.5 * m.drop_height * (1.0 - t.cos);
    const Vec2 w = d_targets.row(i).head<2>().transpose();
    const double wz = z >= m.contact_height ? d_targets(i, 2) : 0.0;
    out[kTheta] += theta_inside * (-t.sin * u * d.dot(w) + (-t.cos * u + 0.5 * m.drop_height * t.sin) * wz);
    out[kR] += r_inside * (-t.cos * d.dot(w) + t.sin * wz);
    // A turn by phi takes d' to T and T to -d'.
    out[kPhi] += kRadians * (t.cos * u * t_axis.dot(w) - f.eps[i] * d.dot(w));
    out.segment<2>(kAx) += w;
  }
  return out;
}

double Arc::progress(ConstVec state) const {
  require_shape("arc: state", state.size(), kSize);
  return state[kTheta] / 180.0;
}

}  // namespace weft::arc
