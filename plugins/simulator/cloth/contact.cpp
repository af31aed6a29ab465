#include "contact.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

#include "distances.hpp"

namespace weft::cloth {
namespace {

// Part of the explicit limit dt^2 lambda = 4 that contact takes besides the spring: 2 * 0.45 for the dashpot; the
// elements take 4 * 0.8^2 = 2.56 at the default step_safety.
constexpr float kDashpot = 0.45f;
// Least sum of |weight| with which a vertex counts (two layers give 2 to 4). Only touching pairs count, because pairs
// that come and go must not change the stiffness of the others. When pairs in fast approach counted too, springs were
// softer in compression than in release, and resting layers bounced for ever.
constexpr float kLeastLoad = 6.0f;
// A pair that yielded recovers at this speed, m/s, so that separating layers gain hardly any energy. (With 0.02 some folds did
// not settle below 5 mm/s.)
constexpr float kRecovery = 0.003f;
// Edge pairs act at a smaller distance than vertex-triangle pairs, which alone carry the load between flat layers.
constexpr float kEdgePart = 0.8f;

/// Measures eight candidates on the sides that they remember.
template <bool kEdges>
Measured measure(Candidate* const (&list)[8], Contact* const (&contact)[8], const Fixed4* x, float unit) {
  Memory memory;
  memory.normal = as_float(load8([&](int lane) { return contact[lane]->normal; }));
  memory.known = less(splat(0.5f), dot(memory.normal, memory.normal));
  const auto reach = [&](int lane) { return kEdges ? 0.5f * list[lane]->distance : list[lane]->distance; };
  memory.reach = _mm256_setr_ps(reach(0), reach(1), reach(2), reach(3), reach(4), reach(5), reach(6), reach(7));
  return measure<kEdges>([&](int k, int lane) { return list[lane]->v[k]; }, &memory, x, unit);
}

}  // namespace

SelfContact::SelfContact(const Topology& topology, const PatchTree& tree, const Fabric& fabric, float spring,
                         float yield, std::int32_t piecewise)
    : topology_(&topology),
      thickness_(static_cast<float>(fabric.thickness_m)),
      friction_(static_cast<float>(fabric.self_friction)),
      spring_(spring),
      yield_(yield),
      search_(topology, tree, thickness_, kEdgePart * thickness_, piecewise) {}

double SelfContact::longest_step(double g, double part) const {
  // k depth = m g with k = spring_ m / (2 kLeastLoad dt^2).
  return std::sqrt(part * thickness_ * spring_ / (2.0 * kLeastLoad * std::max(g, 1e-9)));
}

void SelfContact::clear(State& state) const {
  search_.clear(state);
  state.touching = 0;
  const std::size_t n = topology_->vertices;
  scratch_.active.reserve(16 * n);
  scratch_.soon_faces.reserve(16 * n);
  scratch_.soon_edges.reserve(32 * n);
  scratch_.fast.reserve(16 * n);
  scratch_.visited.reserve(16 * n);
  scratch_.changed.resize(n);
  scratch_.load.resize(n);
}

/// Whether a vertex's nearest point of a triangle lies on the triangle's border, with a nearer point beyond that
/// border. That point belongs to the next triangle, which is a pair of its own. So this pair must not act. Its
/// direction leans back while the vertex nears the border and forward after it. With the dashpot, that would brake
/// sliding layers (by 20 % of the acceleration at 1 m/s).
bool SelfContact::elsewhere(const Candidate& pair, const float (&weight)[4], const Fixed4* fixed) const {
  struct Vec {
    float x, y, z;
    float dot(const Vec& o) const { return x * o.x + y * o.y + z * o.z; }
  };
  const auto from = [&](std::int32_t a, std::int32_t b) {  // in fixed-point units
    const auto diff = [](std::int32_t s, std::int32_t t) {
      return static_cast<float>(
          static_cast<std::int32_t>(static_cast<std::uint32_t>(s) - static_cast<std::uint32_t>(t)));
    };
    const Fixed4 &p = fixed[a], &q = fixed[b];
    return Vec{diff(q.x, p.x), diff(q.y, p.y), diff(q.z, p.z)};
  };
  int zeros = 0, zero = 0, one = 0;
  for (int k = 0; k < 3; ++k) {
    if (weight[k + 1] > -1e-6f)
      ++zeros, zero = k;
    else
      one = k;
  }
  if (zeros == 1) {
    const std::int32_t across = topology_->opposite[pair.face][zero];
    if (across < 0 || across == pair.v[0]) return false;
    const std::int32_t a = pair.v[1 + (zero + 1) % 3], b = pair.v[1 + (zero + 2) % 3];
    const Vec e = from(a, b), p = from(a, pair.v[0]), o = from(a, across);
    const float along = o.dot(e) / e.dot(e);
    return p.dot({o.x - along * e.x, o.y - along * e.y, o.z - along * e.z}) > 0.0f;
  }
  if (zeros == 2) {
    const std::int32_t corner = pair.v[1 + one];
    const Vec p = from(corner, pair.v[0]);
    for (std::int32_t k = topology_->face_of_vertex_start[corner]; k < topology_->face_of_vertex_start[corner + 1];
         ++k) {
      const auto& face = topology_->faces[topology_->face_of_vertex[k]];
      if (face[0] == pair.v[0] || face[1] == pair.v[0] || face[2] == pair.v[0]) continue;
      for (const std::int32_t other : face)
        if (other != corner && p.dot(from(corner, other)) > 0.0f) return true;
    }
  }
  return false;
}

void SelfContact::select(State& state, const float* bound) const {
  const auto choose = [&](Pairs& list, std::vector<std::int32_t>& soon) {
    soon.clear();
    for (std::size_t k = 0; k < list.size(); ++k) {
      Candidate& c = list.candidate[k];
      const float bounds = (bound[c.v[0]] + bound[c.v[1]]) + (bound[c.v[2]] + bound[c.v[3]]);
      if (bounds >= c.due)
        soon.push_back(static_cast<std::int32_t>(k));
      else if (c.present >= 0.0f)
        let_go(c, list.contact[k]);
    }
  };
  choose(state.vertex_triangle, scratch_.soon_faces);
  choose(state.edge_edge, scratch_.soon_edges);
}

void SelfContact::let_go(Candidate& c, Contact& contact) {
  for (float& s : contact.slip) s = 0.0f;
  c.present = -1.0f;
  contact.mass = std::numeric_limits<float>::infinity();
}

template <bool kEdges>
void SelfContact::activate_pairs(State& state, const std::vector<std::int32_t>& soon, const Fixed4* fixed, double unit,
                                 const float* moved, float dt) const {
  Pairs& list = kEdges ? state.edge_edge : state.vertex_triangle;
  std::vector<Active>& active = scratch_.active;
  std::vector<std::int32_t>& fast = scratch_.fast;
  const float unit_f = static_cast<float>(unit);
  const float* path = state.path.data();
  Candidate* group[8];
  Contact* contacts[8];
  for (std::size_t first = 0; first < soon.size(); first += 8) {
    const int lanes = static_cast<int>(std::min<std::size_t>(8, soon.size() - first));
    for (int lane = 0; lane < 8; ++lane) {
      const std::size_t k = soon[first + (lane < lanes ? lane : 0)];
      group[lane] = &list.candidate[k], contacts[lane] = &list.contact[k];
    }
    const Stored m(measure<kEdges>(group, contacts, fixed, unit_f));
    // Most pairs are far apart and the branches below are unpredictable, hence masks.
    float closing[8];
    unsigned near = 0, held = 0;
    for (int lane = 0; lane < lanes; ++lane) {
      Candidate& c = *group[lane];
      const float gap = m.distance[lane];
      c.due = (path[c.v[0]] + path[c.v[1]]) + (path[c.v[2]] + path[c.v[3]]) + (gap - c.distance);
      for (int k = 0; k < 3; ++k) contacts[lane]->normal[k] = m.normal[k][lane];
      // How far the next step can close a gap: twice the last step's motion, and a little more for rest.
      closing[lane] = 2.0f * ((moved[c.v[0]] + moved[c.v[1]]) + (moved[c.v[2]] + moved[c.v[3]])) + 0.02f * c.distance;
      near |= static_cast<unsigned>(gap < c.distance + closing[lane]) << lane;
      held |= static_cast<unsigned>(c.present >= 0.0f) << lane;
    }
    const unsigned outside = near & ~m.inside;
    if constexpr (kEdges) {
      near &= ~outside;
    } else {
      each_lane(outside, [&](int lane) {
        const float weight[4] = {m.weight[0][lane], m.weight[1][lane], m.weight[2][lane], m.weight[3][lane]};
        if (elsewhere(*group[lane], weight, fixed)) near &= ~(1u << lane);
      });
    }
    each_lane(held & ~near, [&](int lane) { let_go(*group[lane], *contacts[lane]); });
    each_lane(near, [&](int lane) {
      Candidate& c = *group[lane];
      const float gap = m.distance[lane];
      // A pair can start closer than its distance: in a state set from outside, or when the vertex crossed over from
      // the next triangle. It starts without force. A push at once would create energy, and it kept creases vibrating.
      c.present = c.present < 0.0f ? std::max(gap, 0.0f) : c.present + kRecovery * dt;
      c.present = std::min(c.present, c.distance);
      c.present = std::min(c.present, std::max(gap, 0.0f) + yield_ * c.distance);
      Active a;
      a.gap = gap;
      a.least = 0.5f * c.distance;
      a.depth = c.present - gap;
      if (gap - a.least < closing[lane])
        fast.push_back(static_cast<std::int32_t>(active.size()));
      else if (a.depth <= 0.0f)
        return;
      a.contact = contacts[lane];
      for (int k = 0; k < 4; ++k) a.v[k] = c.v[k], a.weight[k] = m.weight[k][lane];
      active.push_back(a);
    });
  }
}

void SelfContact::activate(State& state, const Fixed4* fixed, double unit, const float* moved,
                           const float* inverse_mass, float dt, float longest) const {
  scratch_.active.clear();
  scratch_.fast.clear();
  activate_pairs<false>(state, scratch_.soon_faces, fixed, unit, moved, dt);
  activate_pairs<true>(state, scratch_.soon_edges, fixed, unit, moved, dt);
  set_stiffness(inverse_mass, longest);
}

/// Gershgorin over the pairs that share a vertex. With k_p = s min_i m_i / (2 W_i dt^2), W_i the sum of
/// |weight| of vertex i over its pairs, the rows of dt^2 M^-1 sum_p k_p g_p g_p^T sum to at most s.
void SelfContact::set_stiffness(const float* inverse_mass, float longest) const {
  std::vector<Active>& active = scratch_.active;
  std::vector<float>& load = scratch_.load;
  load.assign(topology_->vertices, 0.0f);
  for (const Active& a : active)
    if (a.depth > 0.0f)
      for (int k = 0; k < 4; ++k) load[a.v[k]] += std::abs(a.weight[k]);
  // A spring may become softer while it is compressed, never stiffer, and does not follow the varying step. Otherwise
  // it would pump energy into the cloth.
  const float per_dt = 1.0f / longest;
  for (Active& a : active) {
    float worst = 0.0f;
    for (int k = 0; k < 4; ++k)
      worst = std::max(worst, 2.0f * std::max(load[a.v[k]], kLeastLoad) * inverse_mass[a.v[k]]);
    const float mass = worst > 0.0f ? 1.0f / worst : 0.0f;
    Contact& c = *a.contact;
    c.mass = a.depth > 0.0f ? std::min(c.mass, mass) : mass;
    a.stiffness = spring_ * c.mass * per_dt * per_dt;
    a.damping = kDashpot * c.mass * per_dt;
  }
}

void SelfContact::add_forces(State& state, const Float4* v, float dt, Float4* forces) const {
  std::int64_t touching = 0;
  for (const Active& a : scratch_.active) {
    Contact& c = *a.contact;
    if (a.depth <= 0.0f) {
      for (float& s : c.slip) s = 0.0f;
      continue;
    }
    const auto velocity = [&](int k) { return _mm_load_ps(&v[a.v[k]].x); };
    __m128 u = _mm_mul_ps(_mm_set1_ps(a.weight[0]), velocity(0));
    for (int k = 1; k < 4; ++k) u = _mm_fmadd_ps(_mm_set1_ps(a.weight[k]), velocity(k), u);
    const __m128 n = _mm_setr_ps(c.normal[0], c.normal[1], c.normal[2], 0.0f);
    const float approach = _mm_cvtss_f32(_mm_dp_ps(u, n, 0x71));
    const float normal_force = std::max(0.0f, a.stiffness * a.depth - a.damping * approach);
    if (normal_force > 0.0f) ++touching;
    // Tangential spring with slider; its stretch is kept in the tangent plane as that turns.
    const __m128 tangential = _mm_sub_ps(u, _mm_mul_ps(_mm_set1_ps(approach), n));
    __m128 slip = _mm_setr_ps(c.slip[0], c.slip[1], c.slip[2], 0.0f);
    slip = _mm_sub_ps(slip, _mm_mul_ps(_mm_dp_ps(slip, n, 0x7f), n));
    slip = _mm_fmadd_ps(_mm_set1_ps(dt), tangential, slip);
    const float limit = friction_ * normal_force;
    const auto length = [](__m128 a4) { return std::sqrt(_mm_cvtss_f32(_mm_dp_ps(a4, a4, 0x71))); };
    const float stretch = length(slip);
    if (a.stiffness * stretch > limit) slip = _mm_mul_ps(slip, _mm_set1_ps(limit / (a.stiffness * stretch)));
    __m128 pull = _mm_fmadd_ps(_mm_set1_ps(a.stiffness), slip, _mm_mul_ps(_mm_set1_ps(a.damping), tangential));
    const float size = length(pull);
    if (size > limit) pull = _mm_mul_ps(pull, _mm_set1_ps(limit / size));
    alignas(16) float stored[4];
    _mm_store_ps(stored, slip);
    for (int k = 0; k < 3; ++k) c.slip[k] = stored[k];
    const __m128 force = _mm_sub_ps(_mm_mul_ps(_mm_set1_ps(normal_force), n), pull);
    for (int k = 0; k < 4; ++k) {
      float* to = &forces[a.v[k]].x;
      _mm_store_ps(to, _mm_fmadd_ps(_mm_set1_ps(a.weight[k]), force, _mm_load_ps(to)));
    }
  }
  state.touching = touching;
}

void SelfContact::stop(const Double4* x, double dt, double floor, double ground_friction, const float* inverse_mass,
                       Double4* v) const {
  // The ground's friction changes velocities, too, and more so when the impulses press on the ground. So the ground
  // comes next. Then the pairs are stopped once more, without pressing on the ground.
  stop_pairs(x, dt, floor, inverse_mass, v, false);
  for (const std::int32_t index : scratch_.fast)
    for (const std::int32_t i : scratch_.active[index].v)
      if (inverse_mass[i] != 0.0f && x[i].z + dt * v[i].z < floor)
        store(v[i], meet_ground(x[i].z, dt, floor, ground_friction, load(v[i])));
  stop_pairs(x, dt, floor, inverse_mass, v, true);
}

void SelfContact::stop_pairs(const Double4* x, double dt, double floor, const float* inverse_mass, Double4* v,
                             bool grounded) const {
  constexpr int kPasses = 30;
  const double per_dt = 1.0 / dt;
  std::vector<std::uint32_t>&changed_at = scratch_.changed, &visited = scratch_.visited;
  std::fill(changed_at.begin(), changed_at.end(), 1u);
  visited.assign(scratch_.fast.size(), 0u);
  std::uint32_t visits = 1;
  for (int pass = 0; pass < kPasses; ++pass) {
    bool changed = false;
    for (std::size_t k_fast = 0; k_fast < scratch_.fast.size(); ++k_fast) {
      const Active& a = scratch_.active[scratch_.fast[k_fast]];
      const std::uint32_t seen = visited[k_fast];
      if (changed_at[a.v[0]] <= seen && changed_at[a.v[1]] <= seen && changed_at[a.v[2]] <= seen &&
          changed_at[a.v[3]] <= seen)
        continue;
      visited[k_fast] = ++visits;
      const double nx = a.contact->normal[0], ny = a.contact->normal[1], nz = a.contact->normal[2];
      double approach = 0.0, inverse = 0.0;
      for (int k = 0; k < 4; ++k) {
        const std::int32_t i = a.v[k];
        const Double4& u = v[i];
        const double w = a.weight[k];
        // The ground comes after this and takes what is left of a downward velocity; here it counts as a wall.
        const double lowest = std::min(0.0, (floor - x[i].z) * per_dt);
        const bool blocked = u.z <= lowest && w * nz < 0.0;
        approach += w * (u.x * nx + u.y * ny + std::max(u.z, lowest) * nz);
        inverse += w * w * inverse_mass[i] * (nx * nx + ny * ny + (blocked ? 0.0 : nz * nz));
      }
      const double wanted = std::min(0.0, (static_cast<double>(a.least) - a.gap) * per_dt);
      if (approach >= wanted - 1e-9 || inverse <= 1e-12) continue;
      const double impulse = (wanted - approach) / inverse;
      ++visits;  // its own impulse comes after its visit
      for (int k = 0; k < 4; ++k) {
        changed_at[a.v[k]] = visits;
        const double s = impulse * a.weight[k] * inverse_mass[a.v[k]];
        v[a.v[k]].x += s * nx;
        v[a.v[k]].y += s * ny;
        v[a.v[k]].z += s * nz;
        if (grounded && inverse_mass[a.v[k]] != 0.0f)
          v[a.v[k]].z = std::max(v[a.v[k]].z, std::min(0.0, (floor - x[a.v[k]].z) * per_dt));
      }
      changed = true;
    }
    if (!changed) break;
  }
}

}  // namespace weft::cloth
