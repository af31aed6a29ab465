#include "cloth.hpp"

#include <algorithm>
#include <cmath>

#include "stability.hpp"
#include "weft/error.hpp"

namespace weft::cloth {
namespace {

// A block is the time between two choices of step size and of contact pairs. It has at most this many substeps and is
// at most this long. (In longer blocks more pairs may meet, and every substep measures them all.)
constexpr Index kBlock = 8;
constexpr double kBlockSeconds = 1.2e-3;
// Allowed acceleration of a vertex within a block, m/s^2; a vertex with a larger one ends its block early.
constexpr float kGain = 3.0f;
// A layer may sink into another by this part of the thickness under its own weight. Only long steps come near this
// limit. Springs that are soft along the normal are soft along the layer, too: at 0.08 a layer of 1 mm moved 0.12 mm
// before it stuck.
constexpr double kSink = 0.08, kSinkScaled = 0.05;
// With scaled masses a layer may sink by this much, m, even if that is more than kSinkScaled of the thickness, up to
// kSinkMost of it. Else thin layers, which are light on fine meshes, would set the step.
constexpr double kSinkLength = 5e-5, kSinkMost = 0.1;
// Part of the explicit limit that the springs of contact take. With scaled masses the elements leave them more of it.
constexpr float kSpring = 0.4f, kSpringScaled = 0.5f;
// A garment of several layers presses with several times its own weight where it is folded, and a fold on coarse edges with more.
// There a layer may sink in by this part of the thickness. Springs take at least kSpringLayers of the limit, and all that the
// elements leave. With kSink and kSpring pairs yielded again and again, and nearly half of the folds vibrated for ever.
constexpr double kSinkLayers = 0.005, kSpringLayers = 1.5;
// A pair pressed deeper than this part of its distance yields. It is stopped at half of its distance.
constexpr float kYield = 0.25f, kYieldLayers = 0.45f;
// The springs of obstacles come on top of those of the cloth: so the substep is this part of what it is without them.
constexpr double kObstacleStep = 0.9;
// m; a mesh with a smaller mean edge counts as fine.
constexpr double kFineEdge = 0.012;
// Waves of the membrane, m/s. On fine meshes faster ones get more inertia, up to so many times fine_inertia_length_m.
constexpr double kFastWave = 60.0, kMostInertia = 2.0;
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

SimulatorCapabilities Cloth::capabilities() const {
  SimulatorCapabilities c;
  c.snapshots = true;
  c.self_contact = params_.self_contact;
  c.ground_friction = true;
  c.pins = true;
  c.orthotropic = true;
  c.rest_frames = true;
  c.obstacles = true;
  return c;
}

void Cloth::start() {
  const Fabric& fabric = this->fabric();
  const double nu = fabric.poisson;
  if (!fabric.tables &&
      !(std::isfinite(nu) && nu >= 0.0 && nu * nu * fabric.stretch_weft_n_per_m < 0.999 * fabric.stretch_warp_n_per_m))
    throw ConfigError("cloth: fabric.poisson = " + std::to_string(nu) +
                      ", must be at least 0 and below sqrt(K_warp / K_weft)");
  if (params_.max_substeps < params_.min_substeps)
    throw ConfigError("cloth: max_substeps = " + std::to_string(params_.max_substeps) +
                      ", must be at least min_substeps = " + std::to_string(params_.min_substeps));

  const Index n = garment().vertex_count();
  if (!topology_ || !topology_->is_of(garment())) {
    topology_ = std::make_unique<Topology>(garment());
    tree_ = std::make_unique<PatchTree>(*topology_);
  }
  masses_.resize(n);
  for (Index i = 0; i < n; ++i) masses_[i] = fabric.density_kg_per_m2 * topology_->vertex_area[i];
  obstacles_.reset();
  if (!scene().obstacles.empty()) obstacles_ = std::make_unique<ObstacleContact>(*topology_, scene().obstacles, fabric);
  choose_inertia(topology_->mean_edge < kFineEdge);
  // A few small faces in a coarse mesh may ask for more substeps than are allowed: so it counts as fine.
  if (kFrameSeconds / longest_step_ > static_cast<double>(params_.max_substeps)) choose_inertia(true);
  check_substeps();

  state_ = State{};
  state_.x.resize(n);
  state_.v.resize(n);
  state_.v_float.resize(n);
  state_.x_fixed.resize(n);
  state_.inverse_mass.resize(n);
  state_.moved.assign(padded(n), 0.0f);
  forces_.assign(n, Float4{});
  free_.assign(scaling_->stages() > 1 ? n : 0, Float4{});
  reach_.assign(n, 0.0f);
  bound_.assign(padded(n), 0.0f);
  start_.reserve(64);
  target_.reserve(64);
  load_state();
}

/// Sets up elements, scaled inertia and contact, and chooses the substep.
void Cloth::choose_inertia(bool fine) {
  const Fabric& fabric = this->fabric();
  elements_ = std::make_unique<Elements>(*topology_, fabric);
  double length = params_.inertia_length_m;
  if (fine) {
    const MembraneModuli& m = elements_->stiffest_membrane();
    const double wave = std::sqrt(std::max(m.c11, m.c22) / fabric.density_kg_per_m2);
    length = std::max(length, params_.fine_inertia_length_m * std::clamp(wave / kFastWave, 1.0, kMostInertia));
    elements_->damp_at_least(params_.fine_stretch_damping_s, params_.fine_bend_damping_s);
  } else if (fabric.tables) {
    elements_->damp_at_least(0.0, params_.table_bend_damping_s);
  }
  scaling_ = std::make_unique<MassScaling>(*topology_, elements_->stiffest_membrane(), fabric.density_kg_per_m2,
                                           masses_, length);
  if (elements_->nonlinear() && scaling_->stages() == 1) elements_->refer_to_rest();
  contact_ = std::make_unique<SelfContact>(*topology_, *tree_, fabric, scaling_->stages() > 1 ? kSpringScaled : kSpring,
                                           shares_limit() ? kYieldLayers : kYield);
  choose_step();
}

/// Chooses the longest substep. Stiffness-proportional damping that would shorten it too much is reduced.
void Cloth::choose_step() {
  const double stretch_s = elements_->stretch_damping_s(), bend_s = elements_->bend_damping_s();
  spectrum_ = largest_frequencies(*elements_, masses_, *scaling_);
  const double part = damping_part(spectrum_, stretch_s, bend_s, params_.step_safety, params_.damping_least_step);
  elements_->scale_damping(part);
  longest_step_ = stable_step(spectrum_, part * stretch_s, part * bend_s, params_.step_safety);
  if (params_.self_contact) {
    const double g = scene().gravity.norm();
    const double sink =
        scaling_->stages() > 1 ? std::clamp(kSinkLength / fabric().thickness_m, kSinkScaled, kSinkMost) : kSink;
    if (shares_limit())
      share_limit(g);
    else
      longest_step_ = std::min(longest_step_, contact_->longest_step(g, sink));
  }
  if (obstacles_) {
    obstacles_->set_scaled(scaling_->stages() > 1);
    longest_step_ = std::min(kObstacleStep * longest_step_, obstacles_->longest_step(scene().gravity.norm()));
  }
}

/// Shortens the substep until the springs hold the layers of a garment apart. The shorter it is, the more of the limit the elements
/// leave to the springs.
void Cloth::share_limit(double g) {
  const auto share = [&, all = kSpring + limit_taken(spectrum_, elements_->stretch_damping_s(),
                                                     elements_->bend_damping_s(), longest_step_)](double step) {
    return all - limit_taken(spectrum_, elements_->stretch_damping_s(), elements_->bend_damping_s(), step);
  };
  double low = 0.0, high = longest_step_;
  for (int k = 0; k < 40; ++k) {
    const double step = 0.5 * (low + high);
    contact_->set_spring(static_cast<float>(share(step)));
    const bool holds = share(step) >= kSpringLayers && contact_->longest_step(g, kSinkLayers) >= step;
    (holds ? low : high) = step;
  }
  longest_step_ = low;
  contact_->set_spring(static_cast<float>(share(low)));
}

void Cloth::check_substeps() const {
  const double frame_substeps = kFrameSeconds / longest_step_;
  if (frame_substeps > static_cast<double>(params_.max_substeps))
    throw ConfigError("cloth: this mesh and fabric need " +
                      std::to_string(static_cast<long>(std::ceil(frame_substeps))) +
                      " substeps per frame, must be at most max_substeps = " + std::to_string(params_.max_substeps) +
                      " (coarser mesh, softer fabric, or less stiffness-proportional damping)");
}

/// Takes over positions(), velocities() and the fixed vertices. Contact starts without memory.
void Cloth::load_state() {
  const Positions &x = positions(), &v = velocities();
  const __m256d per_unit = _mm256_set1_pd(1.0 / elements_->unit());
  for (Index i = 0; i < x.rows(); ++i) {
    const double vx = v(i, 0), vy = v(i, 1), vz = v(i, 2);
    state_.x[i] = {x(i, 0), x(i, 1), x(i, 2), 0.0};
    state_.v[i] = {vx, vy, vz, 0.0};
    state_.inverse_mass[i] = is_fixed(i) ? 0.0f : static_cast<float>(1.0 / masses_[i]);
    state_.x_fixed[i] = to_fixed(load(state_.x[i]), per_unit);
    state_.v_float[i] = {static_cast<float>(vx), static_cast<float>(vy), static_cast<float>(vz), 0.0f};
    state_.moved[i] = static_cast<float>(longest_step_ * std::sqrt(vx * vx + vy * vy + vz * vz));
  }
  contact_->clear(state_.contact);
  if (obstacles_) obstacles_->clear(state_.obstacles);
}

void Cloth::state_changed() {
  load_state();
  state_.stiffening = 1.0f;
  for (std::int32_t f = 0; f < elements_->face_count(); ++f) {
    const double s = 1.0 + elements_->principal_strain(state_.x.data(), f);
    state_.stiffening = std::max(state_.stiffening, static_cast<float>(s * s));
  }
}

void Cloth::hold_changed(Index vertex, bool held) {
  state_.inverse_mass[vertex] = held ? 0.0f : static_cast<float>(1.0 / masses_[vertex]);
  state_.v[vertex] = Double4{};
  state_.v_float[vertex] = Float4{};
}

void Cloth::advance_frame(const Positions& targets, double drag, Positions& x, Positions& v) {
  aim(targets);
  frame_step_ = longest_step_;
  if (elements_->nonlinear()) {
    const Elements::Growth growth = elements_->update_moduli(state_.x.data());
    const Spectrum now{growth.membrane * spectrum_.membrane, growth.bending * spectrum_.bending};
    frame_step_ = std::min(longest_step_, stable_step(now, elements_->stretch_damping_s(), elements_->bend_damping_s(),
                                                      params_.step_safety));
  }
  last_substeps_ = 0;
  for (double done = 0.0; done < kFrameSeconds;) {
    advance_block(done, drag);
    if (last_substeps_ > 4 * params_.max_substeps) throw Diverged("no progress");
  }
  for (std::size_t i = 0; i < state_.x.size(); ++i) {
    x.row(i) << state_.x[i].x, state_.x[i].y, state_.x[i].z;
    v.row(i) << state_.v[i].x, state_.v[i].y, state_.v[i].z;
  }
}

/// Computes where the held vertices start and end in this frame, and the speed that takes them there.
void Cloth::aim(const Positions& targets) {
  start_.resize(held().size());
  target_.resize(held().size());
  for (std::size_t k = 0; k < held().size(); ++k) {
    const Index i = held()[k];
    const Double4 s = state_.x[i], t{targets(k, 0), targets(k, 1), targets(k, 2), 0.0};
    start_[k] = s;
    target_[k] = t;
    Double4& v = state_.v[i];
    v = {(t.x - s.x) / kFrameSeconds, (t.y - s.y) / kFrameSeconds, (t.z - s.z) / kFrameSeconds, 0.0};
    state_.v_float[i] = {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z), 0.0f};
  }
}

/// Runs a few substeps of one length. @param done s, of this frame.
void Cloth::advance_block(double& done, double drag) {
  const auto n = static_cast<std::int32_t>(state_.x.size());
  // Tangent of St. Venant-Kirchhoff in tension: dP/dlambda = K (3 lambda^2 - 1)/2. step_safety covers the first tenth.
  const double stiffening = std::max(1.0, (1.5 * state_.stiffening - 0.5) / 1.15);
  const double rest = kFrameSeconds - done;
  const double limit =
      std::min(frame_step_ / std::sqrt(stiffening), kFrameSeconds / static_cast<double>(params_.min_substeps));
  const double wanted = std::ceil(rest / limit - 1e-6);
  if (!(wanted <= static_cast<double>(params_.max_substeps)))
    throw Diverged("the cloth needs more than max_substeps = " + std::to_string(params_.max_substeps) +
                   " substeps per frame");
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
  if (!std::isfinite(sum)) throw Diverged("speeds are not finite");
  if (params_.self_contact) {
    SelfContact::State& contact = state_.contact;
    contact_->prepare(contact, state_.x.data(), state_.v.data(), state_.x_fixed.data(), elements_->unit(),
                      block_seconds);
    for (std::int32_t i = 0; i < n; ++i) bound_[i] = contact.path[i] + reach_[i];
    contact_->select(contact, bound_.data());
  }
  if (obstacles_) obstacles_->prepare(state_.x.data(), reach_.data());
  for (Index k = 0; k < block; ++k) {
    const bool last = k + 1 == left;
    const double excess = substep(dt, drag, last ? 1.0 : (done + dt) / kFrameSeconds);
    done = last ? kFrameSeconds : done + dt;
    ++last_substeps_;
    if (excess > 0.0) break;
  }
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

/// One symplectic step. @param part of the frame that has passed at its end.
/// @return above zero when a vertex has moved beyond its bound: the block must end.
double Cloth::substep(double dt, double drag, double part) {
  const auto n = static_cast<std::int32_t>(state_.x.size());
  std::fill(forces_.begin(), forces_.end(), Float4{});
  state_.stiffening = elements_->add_forces(state_.x_fixed.data(), state_.v_float.data(), forces_.data());
  if (params_.self_contact) {
    contact_->activate(state_.contact, state_.x_fixed.data(), elements_->unit(), state_.moved.data(),
                       state_.inverse_mass.data(), static_cast<float>(dt), static_cast<float>(longest_step_));
    contact_->add_forces(state_.contact, state_.v_float.data(), static_cast<float>(dt), forces_.data());
  }
  if (obstacles_) {
    obstacles_->activate(state_.obstacles, state_.x.data(), state_.v.data(), state_.inverse_mass.data(), dt,
                         longest_step_);
    obstacles_->add_forces(state_.obstacles, state_.v.data(), dt, forces_.data());
  }

  const bool stop = params_.self_contact && contact_->has_fast();
  // If nothing comes between acceleration and move, one pass over the vertices does both.
  const bool together = scaling_->stages() == 1 && !stop && !obstacles_;
  const Gain gain(dt, drag, scene().gravity);
  if (scaling_->stages() > 1)
    accelerate_scaled(dt, drag);
  else if (!together)
    for (std::int32_t i = 0; i < n; ++i) store(state_.v[i], accelerated(i, gain));
  const double floor = this->floor(), mu = fabric().friction;
  const auto stop_at_obstacles = [&](bool entering) {
    return obstacles_->stop(dt, state_.inverse_mass.data(), entering, state_.v.data());
  };
  const auto stop_layers = [&] {
    contact_->stop(state_.x.data(), dt, floor, mu, state_.inverse_mass.data(), state_.v.data());
  };
  // Layers come last: they must not pass through one another, but may press a vertex into an obstacle for a while.
  if (obstacles_) stop_at_obstacles(true);
  if (stop) stop_layers();
  if (stop && obstacles_ && stop_at_obstacles(false)) stop_layers();

  // Ground, then move.
  const __m256d step = _mm256_set1_pd(dt), per_unit = _mm256_set1_pd(1.0 / elements_->unit());
  const __m128 step_float = _mm_set1_ps(static_cast<float>(dt));
  __m128 excess = _mm_setzero_ps(), strayed = _mm_setzero_ps();
  SelfContact::State& contact = state_.contact;
  contact.elapsed += dt;
  const __m256d elapsed = _mm256_set1_pd(contact.elapsed);
  const float *inverse_mass = state_.inverse_mass.data(), *bound = bound_.data();
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
    if (low + dt * sink < floor && inverse_mass[i] != 0.0f) {
      v = meet_ground(low, dt, floor, mu, v);
      const double z = low > floor ? floor : std::min(low + std::max(kRise, sink) * dt, floor);
      next = _mm256_blend_pd(_mm256_fmadd_pd(v, step, x), _mm256_set1_pd(z), 4);
    }
    store(vs[i], v);
    store(xs[i], next);  // held vertices are set exactly below
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
  place_held(part);
  if (!params_.self_contact) return 0.0;
  const double slack = contact_->slack();
  if (largest_of(strayed) > slack * slack) {
    contact.valid = false;
    return 1.0;
  }
  return largest_of(excess);
}

/// Moves the held vertices along their paths. @param part of the frame that has passed.
void Cloth::place_held(double part) {
  const __m256d per_unit = _mm256_set1_pd(1.0 / elements_->unit());
  for (std::size_t k = 0; k < held().size(); ++k) {
    const Index i = held()[k];
    const Double4 &s = start_[k], &t = target_[k];
    state_.x[i] =
        part >= 1.0 ? t : Double4{s.x + part * (t.x - s.x), s.y + part * (t.y - s.y), s.z + part * (t.z - s.z), 0.0};
    state_.x_fixed[i] = to_fixed(load(state_.x[i]), per_unit);
  }
}

/// The ground's reaction on a vertex that is on it, or reaches it in this step. Friction first brakes the motion; the
/// rest of it resists the force. Its direction must not come from v + dt a, because a is not yet scaled and short waves
/// dominate it.
void Cloth::rest_on_ground(const Double4& x, double dt, Double4& v, Double4& a, Float4& free) const {
  const double allowed = x.z > floor() ? (floor() - x.z) / dt : 0.0;  // <= 0
  const double normal = (allowed - v.z) / dt - a.z;                   // m/s^2
  if (normal <= 0.0) return;
  v.z = allowed, a.z = 0.0, free.z = 0.0f;
  const double grip = fabric().friction * normal, speed = std::sqrt(v.x * v.x + v.y * v.y),
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

/// The same step with p(W L) W (f + m g + ground). The ground's force is the one that the vertex needs by itself, as if
/// its mass were lumped. A component that the ground stops takes no part in p(W L) W. So reactions and sticking are
/// those of equilibrium.
void Cloth::accelerate_scaled(double dt, double drag) {
  const auto n = static_cast<std::int32_t>(state_.x.size());
  const __m256d gravity = _mm256_setr_pd(scene().gravity.x(), scene().gravity.y(), scene().gravity.z(), 0.0);
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
    if (state_.x[i].z + dt * state_.v[i].z <= floor()) rest_on_ground(state_.x[i], dt, state_.v[i], a, free_[i]);
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

double Cloth::face_strain(Index face) const {
  return elements_->principal_strain(state_.x.data(), static_cast<std::int32_t>(face));
}

void Cloth::add_diagnostics(SimulatorDiagnostics& diagnostics) const { diagnostics.contacts = state_.contact.touching; }

}  // namespace weft::cloth
