#include "cloth.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "weft/error.hpp"
#include "weft/simulator.hpp"

namespace weft::cloth {
namespace {

// A block, between two choices of step size and of contact pairs: this many substeps, and no longer than this (the
// pairs that may meet, which every substep measures, grow with its time).
constexpr Index kBlock = 8;
constexpr double kBlockSeconds = 1.2e-3;
// Allowance for what a vertex may gain in speed within a block, m/s^2; a faster one ends its block early.
constexpr float kGain = 3.0f;
// A layer under its own weight may sink into another by this part of the thickness. Only long steps come near it, and
// springs that give under weight give along it, too: at 0.08 a layer of 1 mm went 0.12 mm before it stuck.
constexpr double kSink = 0.08, kSinkScaled = 0.05;
// Part of the explicit limit that the springs of contact take. A mesh is scaled so that the elements leave them more.
constexpr float kSpring = 0.4f, kSpringScaled = 0.5f;
// A mesh with shorter edges than this in the mean, m, is a fine one.
constexpr double kFineEdge = 0.012;
// A vertex below the ground (from a state that was set so) rises at this speed, m/s, without getting it as a velocity.
constexpr double kRise = 0.05;

/// Rounds to fixed point modulo 2^32: adding 1.5 2^52 leaves the integer in the low bits of the double.
inline Fixed4 to_fixed(__m256d x, __m256d per_unit) {
  const __m256d magic = _mm256_set1_pd(6755399441055744.0);
  const __m256i bits = _mm256_castpd_si256(_mm256_fmadd_pd(x, per_unit, magic));
  const __m256i packed = _mm256_permutevar8x32_epi32(bits, _mm256_setr_epi32(0, 2, 4, 6, 0, 2, 4, 6));
  Fixed4 out;
  _mm_store_si128(reinterpret_cast<__m128i*>(&out), _mm256_castsi256_si128(packed));
  return out;
}

}  // namespace

struct Cloth::Snapshot final : SimulatorSnapshot {
  State state;
  std::uint64_t garment = 0;
  Index vertices = 0;
};

SimulatorCapabilities Cloth::capabilities() const {
  SimulatorCapabilities c;
  c.snapshots = true;
  c.self_contact = params_.self_contact;
  c.ground_friction = true;
  c.pins = true;
  c.orthotropic = true;
  return c;
}

void Cloth::reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) {
  check_reset("cloth", garment.get(), fabric, scene, params_.self_contact);
  const double nu = fabric.poisson;
  if (!fabric.tables &&
      !(std::isfinite(nu) && nu >= 0.0 && nu * nu * fabric.stretch_weft_n_per_m < 0.999 * fabric.stretch_warp_n_per_m))
    throw ConfigError("cloth: fabric.poisson = " + std::to_string(nu) +
                      ", must be at least 0 and below sqrt(K_warp / K_weft)");
  if (params_.max_substeps < params_.min_substeps)
    throw ConfigError("cloth: max_substeps = " + std::to_string(params_.max_substeps) +
                      ", must be at least min_substeps = " + std::to_string(params_.min_substeps));

  const Index n = garment->vertex_count();
  garment_ = std::move(garment);
  fabric_ = fabric;
  scene_ = scene;
  topology_ = std::make_unique<Topology>(*garment_);
  elements_ = std::make_unique<Elements>(*topology_, fabric_);
  masses_.resize(n);
  for (Index i = 0; i < n; ++i) masses_[i] = fabric_.density_kg_per_m2 * topology_->vertex_area[i];
  pinned_.assign(n, 0);
  for (const Index pin : scene_.pins) pinned_[pin] = 1;
  const double inertia_length = topology_->mean_edge < kFineEdge
                                    ? std::max(params_.inertia_length_m, params_.fine_inertia_length_m)
                                    : params_.inertia_length_m;
  scaling_ = std::make_unique<MassScaling>(*topology_, elements_->stiffest_membrane(), fabric_.density_kg_per_m2,
                                           masses_, inertia_length);
  spectrum_ = largest_frequencies(*elements_, masses_, *scaling_);
  damping_part_ = damping_part(spectrum_, fabric_.damping_stretch_s, fabric_.damping_bend_s, params_.step_safety,
                               params_.damping_least_step);
  elements_->scale_damping(damping_part_);
  longest_step_ = stable_step(spectrum_, damping_part_ * fabric_.damping_stretch_s,
                              damping_part_ * fabric_.damping_bend_s, params_.step_safety);
  const bool scaled = scaling_->stages() > 1;
  contact_ = std::make_unique<SelfContact>(*topology_, fabric_, scaled ? kSpringScaled : kSpring);
  if (params_.self_contact)
    longest_step_ =
        std::min(longest_step_, contact_->longest_step(scene_.gravity.norm(), scaled ? kSinkScaled : kSink));
  floor_ =
      scene_.ground_height ? *scene_.ground_height + fabric_.thickness_m : -std::numeric_limits<double>::infinity();
  const double frame_substeps = kFrameSeconds / longest_step_;
  if (frame_substeps > static_cast<double>(params_.max_substeps))
    throw ConfigError("cloth: this mesh and fabric need " +
                      std::to_string(static_cast<long>(std::ceil(frame_substeps))) +
                      " substeps per frame, must be at most max_substeps = " + std::to_string(params_.max_substeps) +
                      " (coarser mesh, softer fabric, or less stiffness-proportional damping)");

  state_ = State{};
  state_.x.resize(n);
  state_.v.resize(n);
  state_.v_float.resize(n);
  state_.x_fixed.resize(n);
  state_.inverse_mass.resize(n);
  state_.moved.assign(padded(n), 0.0f);
  state_.held.reserve(64);
  for (Index i = 0; i < n; ++i) {
    const bool pinned = pinned_[i] != 0;
    const double z = garment_->positions(i, 2);
    state_.x[i] = {garment_->positions(i, 0), garment_->positions(i, 1), pinned ? z : std::max(z, floor_), 0.0};
    state_.v[i] =
        pinned ? Double4{}
               : Double4{scene_.initial_velocity.x(), scene_.initial_velocity.y(), scene_.initial_velocity.z(), 0.0};
    state_.inverse_mass[i] = pinned ? 0.0f : static_cast<float>(1.0 / masses_[i]);
  }
  contact_->clear(state_.contact);
  forces_.assign(n, Float4{});
  free_.assign(scaling_->stages() > 1 ? n : 0, Float4{});
  reach_.assign(n, 0.0f);
  bound_.assign(padded(n), 0.0f);
  start_.reserve(64);
  target_.reserve(64);
  positions_.resize(n, 3);
  velocities_.resize(n, 3);
  if (elements_->nonlinear()) elements_->update_moduli(state_.x.data());
  refresh_derived();
  publish();
}

void Cloth::require_ready(const char* call) const {
  if (!garment_) throw Error(std::string("cloth: ") + call + "() before reset()");
  if (state_.lost)
    throw Error(std::string("cloth: ") + call + "() after divergence in frame " + std::to_string(state_.frame) +
                ", must be reset");
}

std::int32_t Cloth::checked_vertex(Index vertex, const char* call) const {
  const Index n = garment_->vertex_count();
  const auto refuse = [&](const std::string& why) {
    throw ShapeError(std::string("cloth: ") + call + ": vertex " + std::to_string(vertex) + " " + why);
  };
  if (vertex < 0 || vertex >= n) refuse("out of range, must be in [0, " + std::to_string(n - 1) + "]");
  if (pinned_[vertex]) refuse("is pinned, must be free");
  return static_cast<std::int32_t>(vertex);
}

void Cloth::hold(std::int32_t vertex) {
  state_.held.push_back(vertex);
  state_.inverse_mass[vertex] = 0.0f;
  state_.v[vertex] = Double4{};
  state_.v_float[vertex] = Float4{};
}

void Cloth::grasp(std::span<const Index> vertices) {
  require_ready("grasp");
  std::vector<std::int32_t> checked;
  for (const Index vertex : vertices) {
    const std::int32_t v = checked_vertex(vertex, "grasp");
    if (std::find(state_.held.begin(), state_.held.end(), v) != state_.held.end() ||
        std::find(checked.begin(), checked.end(), v) != checked.end())
      throw ShapeError("cloth: grasp: vertex " + std::to_string(v) + " is already held");
    checked.push_back(v);
  }
  for (const std::int32_t v : checked) hold(v);
  publish();
}

std::vector<Index> Cloth::grasped() const { return {state_.held.begin(), state_.held.end()}; }

void Cloth::release(std::span<const Index> vertices) {
  require_ready("release");
  for (const Index vertex : vertices)
    if (std::find(state_.held.begin(), state_.held.end(), vertex) == state_.held.end())
      throw ShapeError("cloth: release: vertex " + std::to_string(vertex) + " is not held");
  for (const Index vertex : vertices) {
    const auto v = static_cast<std::int32_t>(vertex);
    const auto at = std::find(state_.held.begin(), state_.held.end(), v);
    if (at == state_.held.end()) continue;  // named twice
    state_.held.erase(at);
    state_.inverse_mass[v] = static_cast<float>(1.0 / masses_[v]);
    state_.v[v] = Double4{};
    state_.v_float[v] = Float4{};
  }
  publish();
}

void Cloth::release() {
  const std::vector<Index> all(state_.held.begin(), state_.held.end());
  release(all);
}

void Cloth::set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) {
  if (!garment_) throw Error("cloth: set_state() before reset()");
  const Index n = garment_->vertex_count();
  require_shape("cloth: set_state: rows of positions", positions.rows(), n);
  require_shape("cloth: set_state: rows of velocities", velocities.rows(), n);
  if (!positions.allFinite() || !velocities.allFinite())
    throw Error("cloth: set_state: positions or velocities are not finite");
  for (std::size_t k = 0; k < grasped.size(); ++k) {
    checked_vertex(grasped[k], "set_state");
    if (std::find(grasped.begin(), grasped.begin() + k, grasped[k]) != grasped.begin() + k)
      throw ShapeError("cloth: set_state: vertex " + std::to_string(grasped[k]) + " is named twice");
  }
  state_.lost = false;
  state_.held.clear();
  state_.stiffening = 1.0f;
  for (Index i = 0; i < n; ++i) {
    state_.x[i] = {positions(i, 0), positions(i, 1), positions(i, 2), 0.0};
    state_.v[i] = pinned_[i] ? Double4{} : Double4{velocities(i, 0), velocities(i, 1), velocities(i, 2), 0.0};
    state_.inverse_mass[i] = pinned_[i] ? 0.0f : static_cast<float>(1.0 / masses_[i]);
  }
  for (const Index vertex : grasped) hold(static_cast<std::int32_t>(vertex));
  contact_->clear(state_.contact);
  for (std::int32_t f = 0; f < elements_->face_count(); ++f) {
    const double s = 1.0 + elements_->principal_strain(state_.x.data(), f);
    state_.stiffening = std::max(state_.stiffening, static_cast<float>(s * s));
  }
  refresh_derived();
  publish();
}

void Cloth::refresh_derived() {
  const __m256d per_unit = _mm256_set1_pd(1.0 / elements_->unit());
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    state_.x_fixed[i] = to_fixed(load(state_.x[i]), per_unit);
    const Double4& v = state_.v[i];
    state_.v_float[i] = {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z), 0.0f};
    state_.moved[i] = static_cast<float>(longest_step_ * std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z));
  }
}

void Cloth::publish() {
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    const auto row = static_cast<Index>(i);
    positions_.row(row) << state_.x[i].x, state_.x[i].y, state_.x[i].z;
    velocities_.row(row) << state_.v[i].x, state_.v[i].y, state_.v[i].z;
  }
}

void Cloth::step(const Positions& grasp_targets) {
  require_ready("step");
  if (grasp_targets.rows() != static_cast<Index>(state_.held.size()))  // else its message is allocated in every frame
    require_shape("cloth: step: rows of grasp_targets", grasp_targets.rows(),
                  static_cast<std::ptrdiff_t>(state_.held.size()));
  if (!grasp_targets.allFinite()) throw Error("cloth: step: grasp_targets are not finite");
  target_.resize(state_.held.size());
  for (std::size_t k = 0; k < state_.held.size(); ++k) {
    const auto row = static_cast<Index>(k);
    target_[k] = {grasp_targets(row, 0), grasp_targets(row, 1), grasp_targets(row, 2), 0.0};
  }
  advance(target_.data(), 0.0);
}

SettleResult Cloth::settle(const SettleCriterion& criterion) {
  require_ready("settle");
  target_.resize(state_.held.size());
  for (std::size_t k = 0; k < state_.held.size(); ++k) target_[k] = state_.x[state_.held[k]];
  SettleResult result;
  Index calm = 0;
  while (result.frames < criterion.max_frames) {
    advance(target_.data(), params_.settle_damping_per_s);
    ++result.frames;
    calm = max_speed() < criterion.speed ? calm + 1 : 0;
    if (calm >= criterion.hold_frames) {
      result.settled = true;
      break;
    }
  }
  result.max_speed = max_speed();
  return result;
}

void Cloth::advance(const Double4* targets, double extra_drag) {
  const auto n = static_cast<std::int32_t>(state_.x.size());
  const std::size_t held = state_.held.size();
  start_.resize(held);
  for (std::size_t k = 0; k < held; ++k) {
    start_[k] = state_.x[state_.held[k]];
    const Double4 &s = start_[k], &t = targets[k];
    Double4& v = state_.v[state_.held[k]];
    v = {(t.x - s.x) / kFrameSeconds, (t.y - s.y) / kFrameSeconds, (t.z - s.z) / kFrameSeconds, 0.0};
    state_.v_float[state_.held[k]] = {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z), 0.0f};
  }
  if (elements_->nonlinear()) elements_->update_moduli(state_.x.data());

  const double drag = fabric_.damping_air_per_s + extra_drag;
  const auto diverged = [&](const std::string& why) {
    state_.lost = true;
    throw Diverged("cloth: diverged in frame " + std::to_string(state_.frame + 1) + ": " + why);
  };
  double done = 0.0;
  last_substeps_ = 0;
  while (done < kFrameSeconds) {
    // Tangent of St. Venant-Kirchhoff in tension: dP/dlambda = K (3 lambda^2 - 1)/2; step_safety covers the first
    // tenth.
    const double stiffening = std::max(1.0, (1.5 * state_.stiffening - 0.5) / 1.15);
    const double rest = kFrameSeconds - done;
    const double limit =
        std::min(longest_step_ / std::sqrt(stiffening), kFrameSeconds / static_cast<double>(params_.min_substeps));
    const double wanted = std::ceil(rest / limit - 1e-6);
    if (!(wanted <= static_cast<double>(params_.max_substeps)))
      diverged("it needs more than max_substeps = " + std::to_string(params_.max_substeps) + " substeps per frame");
    const Index left = std::max<Index>(1, static_cast<Index>(wanted));
    const double dt = rest / static_cast<double>(left);
    const Index block = std::min(left, std::clamp<Index>(static_cast<Index>(kBlockSeconds / dt), 1, kBlock));
    const auto block_seconds = static_cast<float>(dt * static_cast<double>(block));

    double sum = 0.0;
    for (std::int32_t i = 0; i < n; ++i) {
      const Float4& v = state_.v_float[i];
      const float square = v.x * v.x + v.y * v.y + v.z * v.z;
      sum += square;
      reach_[i] = block_seconds * (1.25f * std::sqrt(square) + kGain * block_seconds) + 1e-6f;
    }
    if (!std::isfinite(sum)) diverged("speeds are not finite");
    if (params_.self_contact) {
      SelfContact::State& contact = state_.contact;
      contact_->prepare(contact, state_.x.data(), state_.v.data(), state_.x_fixed.data(), elements_->unit(),
                        block_seconds);
      for (std::int32_t i = 0; i < n; ++i) bound_[i] = contact.path[i] + reach_[i];
      contact_->select(contact, bound_.data());
    }
    for (Index k = 0; k < block; ++k) {
      const bool last = last_substeps_ >= 0 && k + 1 == left;
      const double part = last ? 1.0 : (done + dt) / kFrameSeconds;
      const double excess = substep(dt, drag, bound_.data(), start_.data(), targets, part);
      done = last ? kFrameSeconds : done + dt;
      ++last_substeps_;
      if (excess > 0.0) break;
    }
    if (last_substeps_ > 4 * params_.max_substeps) diverged("no progress");
  }
  double sum = 0.0;
  for (std::int32_t i = 0; i < n; ++i) {
    const Double4 &x = state_.x[i], &v = state_.v[i];
    sum += std::abs(x.x) + std::abs(x.y) + std::abs(x.z) + std::abs(v.x) + std::abs(v.y) + std::abs(v.z);
  }
  if (!std::isfinite(sum)) diverged("positions or speeds are not finite");
  ++state_.frame;
  update_grasp_strain();
  publish();
}

struct Cloth::Gain {
  double dt;
  __m256d gravity, keep;
  Gain(double step, double drag, const Vec3& g)
      : dt(step),
        gravity(_mm256_setr_pd(step * g.x(), step * g.y(), step * g.z(), 0.0)),
        keep(_mm256_set1_pd(1.0 / (1.0 + step * drag))) {}
};

/// (v + dt (f / m + g)) / (1 + dt drag).
inline __m256d Cloth::accelerated(std::int32_t i, const Gain& gain) const {
  const __m256d v = load(state_.v[i]);
  const float w = state_.inverse_mass[i];
  if (w == 0.0f) return v;
  const __m256d f = _mm256_cvtps_pd(_mm_load_ps(&forces_[i].x));
  const __m256d change = _mm256_fmadd_pd(f, _mm256_set1_pd(gain.dt * static_cast<double>(w)), gain.gravity);
  return _mm256_mul_pd(_mm256_add_pd(v, change), gain.keep);
}

/// One symplectic step. @return above zero when a vertex has moved beyond its bound: the block must end.
double Cloth::substep(double dt, double drag, const float* bound, const Double4* start, const Double4* targets,
                      double part) {
  const auto n = static_cast<std::int32_t>(state_.x.size());
  std::fill(forces_.begin(), forces_.end(), Float4{});
  state_.stiffening = elements_->add_forces(state_.x_fixed.data(), state_.v_float.data(), forces_.data());
  if (params_.self_contact) {
    contact_->activate(state_.contact, state_.x_fixed.data(), elements_->unit(), state_.moved.data(),
                       state_.inverse_mass.data(), static_cast<float>(dt), static_cast<float>(longest_step_));
    contact_->add_forces(state_.contact, state_.v_float.data(), static_cast<float>(dt), forces_.data());
  }

  const bool stop = params_.self_contact && contact_->has_fast();
  // Where nothing comes between the two, a vertex is accelerated when it moves, which saves a pass over the vertices.
  const bool together = scaling_->stages() == 1 && !stop;
  const Gain gain(dt, drag, scene_.gravity);
  if (scaling_->stages() > 1)
    accelerate_scaled(dt, drag);
  else if (!together)
    for (std::int32_t i = 0; i < n; ++i) store(state_.v[i], accelerated(i, gain));
  if (stop) contact_->stop(state_.x.data(), dt, floor_, fabric_.friction, state_.inverse_mass.data(), state_.v.data());

  // Ground, then move.
  const double mu = fabric_.friction;
  const __m256d step = _mm256_set1_pd(dt), per_unit = _mm256_set1_pd(1.0 / elements_->unit());
  const __m128 step_float = _mm_set1_ps(static_cast<float>(dt));
  __m128 excess = _mm_setzero_ps(), strayed = _mm_setzero_ps();
  SelfContact::State& contact = state_.contact;
  contact.elapsed += dt;
  const __m256d elapsed = _mm256_set1_pd(contact.elapsed);
  const float* inverse_mass = state_.inverse_mass.data();
  Double4 *xs = state_.x.data(), *vs = state_.v.data();
  const Double4 *drift = contact.drift.data(), *from = contact.start.data();
  Float4* v_float = state_.v_float.data();
  Fixed4* x_fixed = state_.x_fixed.data();
  float *moved = state_.moved.data(), *path = contact.path.data();
  // @return the vertex's new velocity and its distance from the path that its candidates were found for.
  const auto move = [&](std::int32_t i, __m128& velocity, __m128& off) {
    const __m256d x = load(xs[i]);
    __m256d v = together ? accelerated(i, gain) : load(vs[i]);
    const double low = xs[i].z, sink = _mm_cvtsd_f64(_mm256_extractf128_pd(v, 1));
    __m256d next = _mm256_fmadd_pd(v, step, x);
    if (low + dt * sink < floor_ && inverse_mass[i] != 0.0f) {
      v = meet_ground(low, dt, floor_, mu, v);
      const double z = low > floor_ ? floor_ : std::min(low + std::max(kRise, sink) * dt, floor_);
      next = _mm256_blend_pd(_mm256_fmadd_pd(v, step, x), _mm256_set1_pd(z), 4);
    }
    store(vs[i], v);
    store(xs[i], next);  // what is held is made exact below
    velocity = _mm256_cvtpd_ps(v);
    _mm_store_ps(&v_float[i].x, velocity);
    x_fixed[i] = to_fixed(next, per_unit);
    const __m256d straight = _mm256_fmadd_pd(load(drift[i]), elapsed, load(from[i]));
    off = _mm256_cvtpd_ps(_mm256_sub_pd(next, straight));
  };
  for (std::int32_t i = 0; i < n; i += 4) {
    __m128 velocity[4], off[4];
    if (i + 4 <= n) {
      for (int k = 0; k < 4; ++k) move(i + k, velocity[k], off[k]);
    } else {
      for (int k = 0; k < 4; ++k) velocity[k] = off[k] = _mm_setzero_ps();
      for (int k = 0; i + k < n; ++k) move(i + k, velocity[k], off[k]);
    }
    const __m128 way =
        _mm_mul_ps(step_float, _mm_sqrt_ps(squares4(velocity[0], velocity[1], velocity[2], velocity[3])));
    _mm_storeu_ps(moved + i, way);
    const __m128 ways = _mm_add_ps(_mm_loadu_ps(path + i), way);
    _mm_storeu_ps(path + i, ways);
    excess = _mm_max_ps(_mm_sub_ps(ways, _mm_loadu_ps(bound + i)), excess);
    strayed = _mm_max_ps(squares4(off[0], off[1], off[2], off[3]), strayed);
  }
  for (std::size_t k = 0; k < state_.held.size(); ++k) {
    const std::int32_t i = state_.held[k];
    const Double4 &s = start[k], &t = targets[k];
    state_.x[i] =
        part >= 1.0 ? t : Double4{s.x + part * (t.x - s.x), s.y + part * (t.y - s.y), s.z + part * (t.z - s.z), 0.0};
    state_.x_fixed[i] = to_fixed(load(state_.x[i]), per_unit);
  }
  if (!params_.self_contact) return 0.0;
  const double slack = contact_->slack();
  if (largest_of(strayed) > slack * slack) {
    contact.valid = false;
    return 1.0;
  }
  return largest_of(excess);
}

/// The ground's reaction on a vertex that is on it, or comes to it in this step. Friction brakes what moves and, with
/// what it has left, holds against the force: its direction must not come from v + dt a, since a, which short waves
/// dominate, is not yet scaled.
void Cloth::rest_on_ground(const Double4& x, double dt, Double4& v, Double4& a, Float4& free) const {
  const double allowed = x.z > floor_ ? (floor_ - x.z) / dt : 0.0;  // <= 0
  const double normal = (allowed - v.z) / dt - a.z;                 // m/s^2
  if (normal <= 0.0) return;
  v.z = allowed, a.z = 0.0, free.z = 0.0f;
  const double grip = fabric_.friction * normal, speed = std::sqrt(v.x * v.x + v.y * v.y),
               pull = std::sqrt(a.x * a.x + a.y * a.y);
  const double brake = std::min(grip, speed / dt), hold = grip - brake;
  if (pull <= hold) {
    v.x = v.y = a.x = a.y = 0.0, free.x = free.y = 0.0f;
    return;
  }
  const double part = 1.0 - hold / pull, braking = speed > 0.0 ? brake / speed : 0.0;
  a.x = part * a.x - braking * v.x;
  a.y = part * a.y - braking * v.y;
}

/// The same with p(W L) W (f + m g + ground). The ground's force is what a vertex needs by itself, as if its mass were
/// lumped; a component that it stops takes no part in p(W L) W. So reactions, and what sticks, are those of
/// equilibrium.
void Cloth::accelerate_scaled(double dt, double drag) {
  const auto n = static_cast<std::int32_t>(state_.x.size());
  const __m256d gravity = _mm256_setr_pd(scene_.gravity.x(), scene_.gravity.y(), scene_.gravity.z(), 0.0);
  for (std::int32_t i = 0; i < n; ++i) {
    const float w = state_.inverse_mass[i];
    free_[i] = {w, w, w, 0.0f};
    if (w == 0.0f) {
      forces_[i] = Float4{};
      continue;
    }
    const __m256d f = _mm256_cvtps_pd(_mm_load_ps(&forces_[i].x));
    Double4 a;
    store(a, _mm256_fmadd_pd(f, _mm256_set1_pd(static_cast<double>(w)), gravity));
    if (state_.x[i].z + dt * state_.v[i].z <= floor_) rest_on_ground(state_.x[i], dt, state_.v[i], a, free_[i]);
    _mm_store_ps(&forces_[i].x, _mm256_cvtpd_ps(load(a)));
  }
  const Float4* scaled = scaling_->apply(forces_.data(), free_.data());
  const __m256d step = _mm256_set1_pd(dt), keep = _mm256_set1_pd(1.0 / (1.0 + dt * drag));
  for (std::int32_t i = 0; i < n; ++i) {
    if (state_.inverse_mass[i] == 0.0f) continue;
    const __m256d a = _mm256_cvtps_pd(_mm_load_ps(&scaled[i].x));
    store(state_.v[i], _mm256_mul_pd(_mm256_fmadd_pd(a, step, load(state_.v[i])), keep));
  }
}

void Cloth::update_grasp_strain() {
  for (const std::int32_t vertex : state_.held)
    for (std::int32_t k = topology_->face_of_vertex_start[vertex]; k < topology_->face_of_vertex_start[vertex + 1]; ++k)
      state_.max_grasp_strain =
          std::max(state_.max_grasp_strain, elements_->principal_strain(state_.x.data(), topology_->face_of_vertex[k]));
}

double Cloth::max_speed() const {
  double square = 0.0;
  for (const Double4& v : state_.v) square = std::max(square, v.x * v.x + v.y * v.y + v.z * v.z);
  return std::sqrt(square);
}

SimulatorDiagnostics Cloth::diagnostics() const {
  require_ready("diagnostics");
  SimulatorDiagnostics d;
  d.max_speed = max_speed();
  for (std::int32_t f = 0; f < elements_->face_count(); ++f)
    d.max_strain = std::max(d.max_strain, elements_->principal_strain(state_.x.data(), f));
  d.max_grasp_strain = state_.max_grasp_strain;
  d.contacts = static_cast<Index>(state_.contact.touching);
  d.warning = grasp_strain_warning(d.max_grasp_strain, params_.grasp_strain_warning);
  return d;
}

std::shared_ptr<const SimulatorSnapshot> Cloth::save() const {
  require_ready("save");
  auto snapshot = std::make_shared<Snapshot>();
  snapshot->state = state_;
  snapshot->garment = garment_->hash;
  snapshot->vertices = garment_->vertex_count();
  return snapshot;
}

void Cloth::restore(const SimulatorSnapshot& snapshot) {
  if (!garment_) throw Error("cloth: restore() before reset()");
  const auto* mine = dynamic_cast<const Snapshot*>(&snapshot);
  if (!mine) throw Error("cloth: restore: the snapshot was made by another simulator, must be made by cloth");
  if (mine->garment != garment_->hash || mine->vertices != garment_->vertex_count())
    throw Error("cloth: restore: the snapshot is of another garment");
  state_ = mine->state;
  publish();
}

}  // namespace weft::cloth
