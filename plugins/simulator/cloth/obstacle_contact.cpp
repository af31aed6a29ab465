#include "obstacle_contact.hpp"

#include <algorithm>
#include <cmath>

namespace weft::cloth {
namespace {

// Parts of the explicit limit dt^2 lambda = 4 that springs and dashpots take where kLeastWeight is all of a vertex's
// load. Cloth::choose_step() shortens the substep for them.
// With scaled inertia they may take more: what they add to short waves, of which the elements need all, is scaled, too.
constexpr double kWallSpring = 0.3, kWallDashpot = 0.45, kWallSpringScaled = 0.6, kWallDashpotScaled = 0.9;
// Least sum of |weight| with which a vertex counts: its own contact and those of four edges that bend. Springs must not
// become stiffer while they are compressed.
constexpr double kLeastWeight = 3.0;
// m/s: slower points enter the spring, faster ones are stopped at the surface.
constexpr double kEntry = 0.01;
// Part of the thickness that a point may sink in; and kPressed times the cloth's weight must press it in by at most
// kRestDepth, because tight cloth around an edge weighs that much.
constexpr double kDeep = 0.2, kRestDepth = 0.1, kPressed = 20.0;
// m, added to what a vertex can move in a block: an edge of the cloth may be pushed, too.
constexpr double kBlockMargin = 5e-4;

// In the place of a flat side.
constexpr std::uint8_t kFarAway = 255;

Vec3 vec(const Double4& a) { return {a.x, a.y, a.z}; }

}  // namespace

ObstacleContact::ObstacleContact(const Topology& topology, const std::vector<Obstacle>& obstacles, const Fabric& fabric)
    : topology_(&topology),
      obstacles_(obstacles),
      thickness_(fabric.thickness_m),
      friction_(fabric.friction),
      primitives_(static_cast<std::int32_t>(topology.vertices + topology.edges.size() + topology.faces.size())) {
  const std::size_t n = topology.vertices;
  std::int32_t number = topology.vertices;
  for (const auto& edge : topology.edges) others_.push_back({{edge[0], edge[1], 0}, 2, number++});
  for (const auto& face : topology.faces) others_.push_back({{face[0], face[1], face[2]}, 3, number++});
  near_.resize(obstacles.size());
  for (Near& near : near_) {
    near.vertices.reserve(n);
    near.measured.reserve(n);
    near.others.reserve(topology.edges.size() + topology.faces.size());
  }
  points_.reserve(n * obstacles.size() + topology.edges.size() + topology.faces.size());
  at_.resize(n);
  flat_.resize(n);
  listed_.resize(n);
  load_.resize(n);
}

void ObstacleContact::set_scaled(bool scaled) {
  spring_ = scaled ? kWallSpringScaled : kWallSpring;
  dashpot_ = scaled ? kWallDashpotScaled : kWallDashpot;
}

void ObstacleContact::clear(State& state) {
  state.memory.assign(obstacles_.size() * primitives_, Memory{});
  state.substep = 1;
  points_.clear();
}

void ObstacleContact::prepare(const Double4* x, const float* reach) {
  const std::int32_t n = topology_->vertices;
  // An edge or face comes nearer than its corners by at most half of its longest edge, here of one stretched by a half.
  const double between = 0.75 * topology_->max_edge;
  for (std::size_t o = 0; o < obstacles_.size(); ++o) {
    const Obstacle& obstacle = obstacles_[o];
    Near& near = near_[o];
    near.vertices.clear(), near.measured.clear(), near.others.clear();
    int side = -1;
    bool bends = false;  // whether what is near it is above more than one flat side
    for (std::int32_t i = 0; i < n; ++i) {
      const Vec3 p = vec(x[i]);
      const double margin = 2.0 * static_cast<double>(reach[i]) + kBlockMargin;
      const double gap = obstacle_distance(obstacle, p).distance - thickness_ - margin;
      listed_[i] = gap < 0.0;
      if (listed_[i]) near.vertices.push_back(i);
      flat_[i] = kFarAway;
      if (gap > between) continue;
      flat_[i] = static_cast<std::uint8_t>(flat_side(obstacle, p, margin));
      bends = bends || flat_[i] == 0 || (side >= 0 && flat_[i] != side);
      side = flat_[i];
    }
    for (const Primitive& p : others_) {
      if (!bends) break;
      bool flat = true, far = true;
      for (int k = 0; k < p.corners; ++k) {
        flat = flat && flat_[p.v[k]] == flat_[p.v[0]];
        far = far && flat_[p.v[k]] == kFarAway;
      }
      if (far || (flat && flat_[p.v[0]] != 0)) continue;
      near.others.push_back(p);
      for (int k = 0; k < p.corners; ++k) listed_[p.v[k]] = 1;
    }
    for (std::int32_t i = 0; i < n; ++i)
      if (listed_[i]) near.measured.push_back(i);
  }
}

void ObstacleContact::activate(State& state, const Double4* x, const Double4* v, const float* inverse_mass, double dt,
                               double longest) {
  ++state.substep;
  points_.clear();
  for (std::size_t o = 0; o < obstacles_.size(); ++o) {
    const Obstacle& obstacle = obstacles_[o];
    const Near& near = near_[o];
    for (const std::int32_t i : near.measured) at_[i] = obstacle_distance(obstacle, vec(x[i]));
    for (const std::int32_t i : near.vertices) {
      constexpr double weight[3] = {1.0, 0.0, 0.0};
      add_point(o, {{i, 0, 0}, 1, i}, weight, at_[i], v, dt);
    }
    for (const Primitive& p : near.others) {
      const auto place = [&](int k) { return vec(x[p.v[k]]); };
      const auto contact = p.corners == 2 ? nearest_in_edge(obstacle, place(0), place(1), at_[p.v[0]], at_[p.v[1]])
                                          : nearest_in_face(obstacle, place(0), place(1), place(2));
      if (contact) add_point(o, p, contact->weight, contact->at, v, dt);
    }
  }
  set_stiffness(state, inverse_mass, dt, longest);
}

void ObstacleContact::add_point(std::size_t obstacle, const Primitive& p, const double (&weight)[3],
                                const ObstacleDistance& at, const Double4* v, double dt) {
  const double gap = at.distance - thickness_;
  // How far the step can close the gap: twice the last velocity's way, and a little more for rest.
  if (gap > 0.05 * thickness_) {
    double speed = 0.0;
    for (int k = 0; k < p.corners; ++k) speed += weight[k] * vec(v[p.v[k]]).norm();
    if (gap > 0.05 * thickness_ + 2.0 * dt * speed) return;
  }
  Point& point = points_.emplace_back();
  point.corners = p.corners;
  for (int k = 0; k < 3; ++k) point.v[k] = p.v[k], point.weight[k] = weight[k], point.normal[k] = at.normal[k];
  point.gap = gap;
  point.friction = obstacles_[obstacle].friction.value_or(friction_);
  point.memory = static_cast<std::int32_t>(obstacle) * primitives_ + p.number;
}

/// Gershgorin over the points that share a vertex, as in SelfContact::set_stiffness(); the obstacle does not move.
void ObstacleContact::set_stiffness(const State& state, const float* inverse_mass, double dt, double longest) {
  std::fill(load_.begin(), load_.end(), 0.0f);
  for (const Point& p : points_)
    if (p.gap < 0.0)
      for (int k = 0; k < p.corners; ++k) load_[p.v[k]] += static_cast<float>(p.weight[k]);
  for (Point& p : points_) {
    double worst = 0.0;
    for (int k = 0; k < p.corners; ++k)
      worst = std::max(worst, std::max(static_cast<double>(load_[p.v[k]]), kLeastWeight) *
                                  static_cast<double>(inverse_mass[p.v[k]]));
    // A spring may become softer while it is compressed, never stiffer: it would give back more than it took.
    const Memory& memory = state.memory[p.memory];
    p.mass = worst > 0.0 ? 1.0 / worst : 0.0;
    if (memory.last + 1 == state.substep) p.mass = std::min(p.mass, static_cast<double>(memory.mass));
    p.stiffness = spring_ * p.mass / (longest * longest);
    p.damping = dashpot_ * p.mass / dt;
  }
}

void ObstacleContact::add_forces(State& state, const Double4* v, double dt, Float4* forces) {
  for (const Point& p : points_) {
    if (p.gap >= 0.0) continue;
    Memory& memory = state.memory[p.memory];
    Eigen::Vector3d slip(memory.slip[0], memory.slip[1], memory.slip[2]);
    if (memory.last + 1 != state.substep) slip.setZero();
    memory.last = state.substep;
    memory.mass = static_cast<float>(p.mass);
    const Eigen::Vector3d n(p.normal[0], p.normal[1], p.normal[2]);
    Eigen::Vector3d u = Eigen::Vector3d::Zero();
    for (int k = 0; k < p.corners; ++k) u += p.weight[k] * vec(v[p.v[k]]);
    const double approach = n.dot(u);
    const double depth = std::min(-p.gap, kDeep * thickness_);  // what was pressed in deeper gives back no more
    const double normal_force = std::max(0.0, p.stiffness * depth - p.damping * approach);
    const Eigen::Vector3d tangential = u - approach * n;
    // Tangential spring with slider; its stretch is kept in the tangent plane as that turns.
    slip -= n.dot(slip) * n;
    slip += dt * tangential;
    const double limit = p.friction * normal_force, stretch = p.stiffness * p.stiffness * slip.squaredNorm();
    if (stretch > limit * limit) slip *= limit / std::sqrt(stretch);
    Eigen::Vector3d pull = p.stiffness * slip + p.damping * tangential;
    const double size = pull.squaredNorm();
    if (size > limit * limit) pull *= limit / std::sqrt(size);
    for (int k = 0; k < 3; ++k) memory.slip[k] = static_cast<float>(slip[k]);
    const Eigen::Vector3d force = normal_force * n - pull;
    for (int k = 0; k < p.corners; ++k) {
      Float4& f = forces[p.v[k]];
      f.x += static_cast<float>(p.weight[k] * force.x());
      f.y += static_cast<float>(p.weight[k] * force.y());
      f.z += static_cast<float>(p.weight[k] * force.z());
    }
  }
}

bool ObstacleContact::stop(double dt, const float* inverse_mass, bool entering, Double4* v) const {
  const double deep = -kDeep * thickness_;
  bool any = false;
  for (const Point& p : points_) {
    const Eigen::Vector3d n(p.normal[0], p.normal[1], p.normal[2]);
    Eigen::Vector3d u = Eigen::Vector3d::Zero();
    double inverse = 0.0;
    for (int k = 0; k < p.corners; ++k) {
      u += p.weight[k] * vec(v[p.v[k]]);
      inverse += p.weight[k] * p.weight[k] * static_cast<double>(inverse_mass[p.v[k]]);
    }
    const double approach = n.dot(u);
    double wanted = approach;
    if (p.gap + dt * approach < deep) wanted = std::max(wanted, std::min(0.0, (deep - p.gap) / dt));
    if (entering && p.gap > 0.0 && p.gap + dt * approach < 0.0) wanted = std::max(wanted, -kEntry);
    if (wanted <= approach || inverse <= 0.0) continue;
    any = true;
    const double impulse = (wanted - approach) / inverse;
    const Eigen::Vector3d tangential = u - approach * n;
    const double sliding = tangential.norm(), grip = p.friction * (wanted - approach);
    const double brake = sliding <= grip ? 1.0 : grip / sliding;
    const Eigen::Vector3d push = impulse * n - (brake / inverse) * tangential;
    for (int k = 0; k < p.corners; ++k) {
      const double s = p.weight[k] * static_cast<double>(inverse_mass[p.v[k]]);
      Double4& to = v[p.v[k]];
      to.x += s * push.x(), to.y += s * push.y(), to.z += s * push.z();
    }
  }
  return any;
}

double ObstacleContact::longest_step(double g) const {
  // k depth = m g with k = kWallSpring m / (kLeastWeight dt^2).
  return std::sqrt(kRestDepth * std::max(thickness_, 1e-4) * spring_ / (kLeastWeight * kPressed * std::max(g, 9.81)));
}

}  // namespace weft::cloth
