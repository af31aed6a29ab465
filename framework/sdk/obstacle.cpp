#include "weft/obstacle.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace weft {
namespace {

// The root of the slope along an edge is found to this part of the edge's length. Beside it the distance changes by the
// square of that.
constexpr double kLevel = 1e-4;
// A face whose normal has less than this part across a cylinder's axis is touched along a line: its edges touch, too.
constexpr double kAcross = 1e-3;
// Part of each corner's weight below which the edges of a face take over.
constexpr double kInside = 1e-3;

/// How far a point is beyond the core (half_size - rounding) along up to three directions, m, and on which side.
struct Beyond {
  int count = 0;
  double q[3] = {};
  bool positive[3] = {};
};

Beyond beyond_core(const Obstacle& o, const Vec3& point) {
  const Vec3 p = o.axes.transpose() * (point - o.centre);
  if (o.kind == Obstacle::Kind::cylinder)
    return {2,
            {std::sqrt(p.x() * p.x() + p.y() * p.y()) - (o.half_size.x() - o.rounding),
             std::abs(p.z()) - (o.half_size.z() - o.rounding)},
            {true, p.z() >= 0.0}};
  Beyond out;
  out.count = 3;
  for (int k = 0; k < 3; ++k) out.q[k] = std::abs(p[k]) - (o.half_size[k] - o.rounding), out.positive[k] = p[k] >= 0.0;
  return out;
}

}  // namespace

ObstacleDistance obstacle_distance(const Obstacle& o, const Vec3& point) {
  if (o.kind == Obstacle::Kind::half_space) return {o.axes.col(2).dot(point - o.centre), o.axes.col(2)};
  // Simulators call this for every vertex in every substep, hence no lists.
  const double dx = point.x() - o.centre.x(), dy = point.y() - o.centre.y(), dz = point.z() - o.centre.z();
  const auto along = [&](int k) { return o.axes(0, k) * dx + o.axes(1, k) * dy + o.axes(2, k) * dz; };
  const double px = along(0), py = along(1), pz = along(2);
  const double core_x = o.half_size.x() - o.rounding, core_y = o.half_size.y() - o.rounding,
               core_z = o.half_size.z() - o.rounding;
  double qx = std::abs(px) - core_x, qy = std::abs(py) - core_y, sx = std::copysign(1.0, px),
         sy = std::copysign(1.0, py);
  const double qz = std::abs(pz) - core_z, sz = std::copysign(1.0, pz);
  const bool round = o.kind == Obstacle::Kind::cylinder;
  double across_x = 1.0, across_y = 0.0;  // the direction of q_x: of a cylinder the radial one
  if (round) {
    const double radial = std::sqrt(px * px + py * py);
    if (radial > 0.0) across_x = px / radial, across_y = py / radial;
    qx = radial - core_x, qy = -std::numeric_limits<double>::infinity();
    sx = 1.0, sy = 0.0;
  }
  const double ux = std::max(qx, 0.0), uy = std::max(qy, 0.0), uz = std::max(qz, 0.0);
  double nx, ny, nz, distance;
  if ((ux > 0.0) + (uy > 0.0) + (uz > 0.0) > 1) {
    distance = std::sqrt(ux * ux + uy * uy + uz * uz);
    nx = ux / distance, ny = uy / distance, nz = uz / distance;
  } else {
    distance = std::max({qx, qy, qz});
    nx = distance == qx, ny = nx == 0.0 && distance == qy, nz = nx == 0.0 && ny == 0.0;
  }
  nz *= sz;
  const double wx = round ? nx * across_x : nx * sx, wy = round ? nx * across_y : ny * sy;
  return {distance - o.rounding,
          {o.axes(0, 0) * wx + o.axes(0, 1) * wy + o.axes(0, 2) * nz,
           o.axes(1, 0) * wx + o.axes(1, 1) * wy + o.axes(1, 2) * nz,
           o.axes(2, 0) * wx + o.axes(2, 1) * wy + o.axes(2, 2) * nz}};
}

int flat_side(const Obstacle& o, const Vec3& point, double margin) {
  if (o.kind == Obstacle::Kind::half_space) return 1;
  const Beyond b = beyond_core(o, point);
  int side = 0;
  for (int k = 0; k < b.count; ++k) {
    if (b.q[k] <= -margin) continue;
    if (side != 0 || b.q[k] <= margin) return 0;
    if (o.kind == Obstacle::Kind::cylinder && k == 0) return 0;  // round
    side = 2 * k + (b.positive[k] ? 2 : 1);
  }
  return side;
}

std::optional<ObstacleContact> nearest_in_edge(const Obstacle& o, const Vec3& a, const Vec3& b,
                                               const ObstacleDistance& at_a, const ObstacleDistance& at_b) {
  const Vec3 e = b - a;
  double low = 0.0, high = 1.0, slope_low = at_a.normal.dot(e), slope_high = at_b.normal.dot(e);
  const double small = kLevel * e.norm();
  if (!(slope_low < -small && slope_high > small)) return std::nullopt;
  ObstacleContact contact;
  double part = 0.5;
  int last = 0;  // which end moved: regula falsi halves the slope of an end that stays [Illinois: Dowell and Jarratt]
  for (int k = 0; k < 30; ++k) {
    part = (low * slope_high - high * slope_low) / (slope_high - slope_low);
    contact.at = obstacle_distance(o, a + part * e);
    const double slope = contact.at.normal.dot(e);
    if (std::abs(slope) <= small || high - low < 1e-7) break;
    if (slope < 0.0) {
      low = part, slope_low = slope;
      if (last == -1) slope_high *= 0.5;
      last = -1;
    } else {
      high = part, slope_high = slope;
      if (last == 1) slope_low *= 0.5;
      last = 1;
    }
  }
  contact.weight[0] = 1.0 - part;
  contact.weight[1] = part;
  return contact;
}

std::optional<ObstacleContact> nearest_in_face(const Obstacle& o, const Vec3& a, const Vec3& b, const Vec3& c) {
  if (o.kind == Obstacle::Kind::half_space) return std::nullopt;
  const Vec3 u = b - a, v = c - a;
  Vec3 normal(u.y() * v.z() - u.z() * v.y(), u.z() * v.x() - u.x() * v.z(), u.x() * v.y() - u.y() * v.x());
  const double twice = normal.norm();
  if (!(twice > 0.0)) return std::nullopt;
  normal /= twice;
  if (normal.dot(a - o.centre) < 0.0) normal = -normal;
  // The point of the core that is furthest along the normal.
  const Vec3 n = o.axes.transpose() * normal;
  const Vec3 core = o.half_size.array() - o.rounding;
  Vec3 tip;
  if (o.kind == Obstacle::Kind::box) {
    for (int k = 0; k < 3; ++k) tip[k] = n[k] < 0.0 ? -core[k] : core[k];
  } else {
    const double across = std::hypot(n.x(), n.y());
    if (std::abs(n.z()) < kAcross) return std::nullopt;
    const double radius = across < kAcross ? 0.0 : core.x() / across;
    tip = {radius * n.x(), radius * n.y(), n.z() < 0.0 ? -core.z() : core.z()};
  }
  const Vec3 w = Vec3(o.centre + o.axes * tip) - a;
  const double uu = u.squaredNorm(), uv = u.dot(v), vv = v.squaredNorm(), wu = w.dot(u), wv = w.dot(v);
  const double second = (vv * wu - uv * wv) / (twice * twice), third = (uu * wv - uv * wu) / (twice * twice);
  const double first = 1.0 - second - third;
  if (std::min({first, second, third}) < kInside) return std::nullopt;
  return ObstacleContact{{first, second, third}, {-w.dot(normal) - o.rounding, normal}};
}

}  // namespace weft
