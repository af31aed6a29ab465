#include "bullet.hpp"

#include <BulletSoftBody/btDefaultSoftBodySolver.h>
#include <BulletSoftBody/btSoftBody.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>
#include <btBulletDynamicsCommon.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "weft/error.hpp"
#include "weft/simulator.hpp"

static_assert(sizeof(btScalar) == sizeof(double), "build with BT_USE_DOUBLE_PRECISION");

namespace weft::bullet {
namespace {

// Rest length of a strut over its length in the flat sheet. Bullet's link pushes with x (R^2 - x^2) / (R^2 + x^2), x
// being its length over flat: with this R it stays within 12 % of the push that a hinge linear in its angle wants, up
// to 120 degrees.
constexpr double kStrutRatio = 1.5;
// A strut's k dt^2 w is at most this part of link_step: nothing balances a strut within its own pass over the links, as
// edges are (update_compliance). A strip whose struts had 0.24 trembled at 90 mm/s, with 0.15 it came to rest.
constexpr double kStrutStep = 0.3;
// Largest share of the edges that may be stiffened to carry bending. With 26 %, the softest and thickest T-shirt, cloth
// comes to rest; strips with 69 % and more buzzed at metres per second, and stretched like another fabric.
constexpr double kMostRaised = 0.5;
// Speeds above this are a run that has left physics, m/s.
constexpr double kAbsurdSpeed = 1e6;

/// Force of a strut over k L in the flat sheet, k being its stiffness there: Bullet's link pulls with
/// k L (L^2 - L0^2) / (L^2 + L0^2).
constexpr double kStrutForce = (1.0 - kStrutRatio * kStrutRatio) / (1.0 + kStrutRatio * kStrutRatio);
bool is_strut(const Spring& spring) { return spring.stiffness <= 0.0; }
/// N/m, in the flat sheet.
double stiffness_of(const Spring& spring) {
  return is_strut(spring) ? spring.pre_stress / kStrutForce : spring.stiffness;
}

btVector3 vector(const Positions& x, Index row) { return {x(row, 0), x(row, 1), x(row, 2)}; }
Eigen::Vector3d vector(const btVector3& a) { return {a.x(), a.y(), a.z()}; }
btVector3 vector(const Eigen::Vector3d& a) { return {a.x(), a.y(), a.z()}; }

/// A fixed order without order. A sweep along the mesh would meet every link with the load on one side of it solved and
/// on the other side not, and bias all of them alike.
std::vector<std::size_t> shuffled(std::size_t count) {
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto key = [](std::size_t e) { return static_cast<std::uint32_t>(e) * 2654435769u; };  // Fibonacci hashing
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
  return order;
}

std::string percent(double part) { return std::to_string(std::lround(100.0 * part)) + " %"; }

/// Small pools: the world holds one soft body and no rigid one.
btDefaultCollisionConstructionInfo small_pools() {
  btDefaultCollisionConstructionInfo info;
  info.m_defaultMaxPersistentManifoldPoolSize = 1;
  info.m_defaultMaxCollisionAlgorithmPoolSize = 1;
  return info;
}

}  // namespace

/// A Bullet world with one soft body, and the solver that steps it.
class Bullet::World {
 public:
  World(const Garment& garment, const SpringNetwork& network, const Fabric& fabric, const Scene& scene, Index substeps,
        const Params& params)
      : configuration_(small_pools()),
        dispatcher_(&configuration_),
        world_(&dispatcher_, &broadphase_, &rigid_solver_, &configuration_, &solver_),
        solver_(*this),
        contact_(garment, fabric.thickness_m, fabric.self_friction, params.self_contact),
        scene_(scene),
        drag_(fabric.damping_air_per_s),
        damping_(fabric.damping_stretch_s),
        substeps_(substeps),
        passes_(static_cast<int>(params.contact_passes)) {
    const Index n = garment.vertex_count();
    auto body = std::make_unique<btSoftBody>(&world_.getWorldInfo(), static_cast<int>(n), nullptr,
                                             network.vertex_masses.data());
    body_ = body.get();
    for (const std::size_t e : shuffled(network.springs.size())) append(network.springs[e]);
    for (Index f = 0; f < garment.face_count(); ++f)
      body_->appendFace(garment.faces(f, 0), garment.faces(f, 1), garment.faces(f, 2));
    // All contact is that of contact.hpp; none of Bullet's own passes runs.
    body_->m_cfg.collisions = 0;
    body_->setActivationState(DISABLE_DEACTIVATION);
    // Bullet would take the present shape as the rest shape at the next step.
    body_->m_bUpdateRtCst = false;
    world_.addSoftBody(body.release());

    substep_.seconds = kFrameSeconds / static_cast<double>(substeps);
    substep_.floor =
        scene.ground_height ? *scene.ground_height + fabric.thickness_m : -std::numeric_limits<double>::infinity();
    substep_.friction = fabric.friction;
    substep_.start.resize(n);
    substep_.end.resize(n);
    inverse_mass_.resize(n);
    for (Index i = 0; i < n; ++i) inverse_mass_[i] = body_->m_nodes[static_cast<int>(i)].m_im;
    substep_.inverse_mass = &inverse_mass_;
  }
  ~World() {
    world_.removeSoftBody(body_);
    delete body_;
  }
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  btSoftBody::Node& node(Index i) { return body_->m_nodes[static_cast<int>(i)]; }
  SelfContact& contact() { return contact_; }
  double floor() const { return substep_.floor; }

  /// Makes a vertex immovable (0) or gives it back its mass.
  void set_inverse_mass(Index i, double value) {
    inverse_mass_[i] = value;
    node(i).m_im = value;
    compliance_is_current_ = false;
  }

  /// One frame; the held vertices go in straight lines to their targets.
  void step(const std::vector<std::int32_t>& held, const Positions& targets, double extra_drag) {
    held_ = &held;
    targets_ = &targets;
    extra_drag_ = extra_drag;
    world_.stepSimulation(kFrameSeconds, 0, kFrameSeconds);
  }

 private:
  /// The place that Bullet gives to a soft body's integration: called by the world once a step.
  class Solver final : public btDefaultSoftBodySolver {
   public:
    explicit Solver(World& world) : owner_(world) {}
    void predictMotion(btScalar) override {}  // a part of every substep
    void solveConstraints(btScalar) override { owner_.substeps(); }
    void updateSoftBodies() override {}  // normals, for drawing

   private:
    World& owner_;
  };

  struct LinkLaw {
    double stiffness;  ///< N/m, tangent at the length in the flat sheet
    bool strut;
  };

  void append(const Spring& spring) {
    const bool strut = is_strut(spring);
    const double k = stiffness_of(spring), u = strut ? kStrutForce : spring.pre_stress / k;
    if (strut && k <= 0.0) return;  // the two hinges across one strut cancelled, or there is no bending
    body_->appendLink(spring.a, spring.b, nullptr);
    btSoftBody::Link& link = body_->m_links[body_->m_links.size() - 1];
    link.m_rl = spring.length * std::sqrt((1.0 - u) / (1.0 + u));
    link.m_c1 = link.m_rl * link.m_rl;
    link.m_bbending = strut ? 1 : 0;
    laws_.push_back({k, strut});
  }

  /// m_c0 from compliance and the present masses.
  void update_compliance() {
    const double dt = substep_.seconds;
    for (int e = 0; e < body_->m_links.size(); ++e) {
      btSoftBody::Link& link = body_->m_links[e];
      const double w = link.m_n[0]->m_im + link.m_n[1]->m_im;
      const double compliance = 1.0 / (laws_[static_cast<std::size_t>(e)].stiffness * dt * dt);
      // Not below w: half a link too stiff for the step would overshoot.
      link.m_c0 = laws_[static_cast<std::size_t>(e)].strut ? compliance : std::max(compliance + 0.5 * w, w);
    }
    compliance_is_current_ = true;
  }

  /// Stiffness-proportional damping along the links: VSolve_Links takes c3 (c3 . dv) c2 out of the velocities.
  void damp() {
    const double dt = substep_.seconds;
    for (int e = 0; e < body_->m_links.size(); ++e) {
      btSoftBody::Link& link = body_->m_links[e];
      const LinkLaw& law = laws_[static_cast<std::size_t>(e)];
      link.m_c3 = link.m_n[1]->m_x - link.m_n[0]->m_x;
      const double rate = law.strut ? 0.0 : damping_ * law.stiffness * dt, w = link.m_n[0]->m_im + link.m_n[1]->m_im;
      link.m_c2 = rate / ((1.0 + rate * w) * std::max(link.m_c3.length2(), 1e-30));
    }
    btSoftBody::VSolve_Links(body_, 1.0);
  }

  void substeps() {
    if (!compliance_is_current_) update_compliance();
    const auto n = static_cast<std::size_t>(body_->m_nodes.size());
    const double dt = substep_.seconds;
    const btVector3 gain = dt * btVector3(scene_.gravity.x(), scene_.gravity.y(), scene_.gravity.z());
    const double keep = 1.0 / (1.0 + dt * (drag_ + extra_drag_));
    begin_.resize(held_->size());
    for (std::size_t k = 0; k < held_->size(); ++k) begin_[k] = node((*held_)[k]).m_x;

    for (Index s = 1; s <= substeps_; ++s) {
      if (damping_ > 0.0) damp();
      for (std::size_t i = 0; i < n; ++i) {
        auto& node_i = node(static_cast<Index>(i));
        node_i.m_q = node_i.m_x;
        if (node_i.m_im == 0.0) continue;
        node_i.m_v = keep * (node_i.m_v + gain);
        node_i.m_x += dt * node_i.m_v;
      }
      const double part = static_cast<double>(s) / static_cast<double>(substeps_);
      for (std::size_t k = 0; k < held_->size(); ++k) {
        const btVector3 target = vector(*targets_, static_cast<Index>(k));
        node((*held_)[k]).m_x = s == substeps_ ? target : begin_[k] + part * (target - begin_[k]);
      }
      btSoftBody::PSolve_Links(body_, 1.0, 0.0);
      for (std::size_t i = 0; i < n; ++i) {
        substep_.start[i] = vector(node(static_cast<Index>(i)).m_q);
        substep_.end[i] = vector(node(static_cast<Index>(i)).m_x);
      }
      contact_.resolve(substep_, passes_);
      double sum = 0.0;
      for (std::size_t i = 0; i < n; ++i) {
        auto& node_i = node(static_cast<Index>(i));
        if (node_i.m_im != 0.0) {
          node_i.m_x = vector(substep_.end[i]);
          node_i.m_v = (node_i.m_x - node_i.m_q) / dt;
        }
        sum += node_i.m_v.length2();
      }
      if (!(sum < kAbsurdSpeed * kAbsurdSpeed)) return;  // advance() finds it
    }
    for (std::size_t k = 0; k < held_->size(); ++k)
      node((*held_)[k]).m_v = (vector(*targets_, static_cast<Index>(k)) - begin_[k]) / kFrameSeconds;
  }

  btSoftBodyRigidBodyCollisionConfiguration configuration_;
  btCollisionDispatcher dispatcher_;
  btDbvtBroadphase broadphase_;
  btSequentialImpulseConstraintSolver rigid_solver_;
  btSoftRigidDynamicsWorld world_;
  Solver solver_;
  btSoftBody* body_ = nullptr;
  SelfContact contact_;
  Substep substep_;
  std::vector<double> inverse_mass_;
  std::vector<LinkLaw> laws_;
  std::vector<btVector3> begin_;
  Scene scene_;
  double drag_, damping_, extra_drag_ = 0.0;
  Index substeps_;
  int passes_;
  bool compliance_is_current_ = false;
  const std::vector<std::int32_t>* held_ = nullptr;
  const Positions* targets_ = nullptr;
};

/// Contacts follow from the positions alone (SelfContact::make_contacts), so this is all.
struct Bullet::Snapshot final : SimulatorSnapshot {
  Positions positions, velocities;
  std::vector<std::int32_t> held;
  Index frame = 0;
  double max_grasp_strain = 0.0;
  std::uint64_t garment = 0;
};

Bullet::Bullet(const Params& params) : params_(params) {}
Bullet::~Bullet() = default;

SimulatorCapabilities Bullet::capabilities() const {
  SimulatorCapabilities c;
  c.snapshots = true;
  c.self_contact = params_.self_contact;
  c.ground_friction = true;
  c.pins = true;
  c.orthotropic = true;
  return c;
}

void Bullet::reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) {
  check_reset("bullet", garment.get(), fabric, scene, params_.self_contact);
  if (!fabric.tables && !(fabric.stretch_shear_n_per_m > 0.0))  // springs along all edges cannot do without
    throw ConfigError("bullet: fabric.stretch_n_per_m.shear = " + std::to_string(fabric.stretch_shear_n_per_m) +
                      ", must be above 0");
  if (params_.max_substeps < params_.min_substeps)
    throw ConfigError("bullet: max_substeps = " + std::to_string(params_.max_substeps) +
                      ", must be at least min_substeps = " + std::to_string(params_.min_substeps));

  SpringNetwork network = spring_network(*garment, fabric);
  if (network.raised_share > kMostRaised)
    throw ConfigError(
        "bullet: fabric.bend_n_m is too stiff beside stretch_n_per_m on this mesh: " + percent(network.raised_share) +
        " of the edges would have to be stiffened to carry it, must be at most " + percent(kMostRaised));

  const Index n = garment->vertex_count();
  garment_ = std::move(garment);
  fabric_ = fabric;
  scene_ = scene;
  network_ = std::move(network);
  warnings_.clear();
  choose_substeps();
  pinned_.assign(n, 0);
  for (const Index pin : scene_.pins) pinned_[pin] = 1;
  world_ = std::make_unique<World>(*garment_, network_, fabric_, scene_, substeps_, params_);
  held_.clear();
  frame_ = 0;
  max_grasp_strain_ = 0.0;
  lost_ = false;
  for (Index i = 0; i < n; ++i) {
    auto& node = world_->node(i);
    node.m_x = vector(garment_->positions, i);
    node.m_v.setValue(0.0, 0.0, 0.0);
    if (pinned_[i]) {
      world_->set_inverse_mass(i, 0.0);
      continue;
    }
    node.m_x.setZ(std::max(node.m_x.z(), world_->floor()));
    node.m_v.setValue(scene_.initial_velocity.x(), scene_.initial_velocity.y(), scene_.initial_velocity.z());
  }
  positions_.resize(n, 3);
  velocities_.resize(n, 3);
  publish();
}

/// Substeps from the stiffest edge or strut; what this mesh and fabric cannot have here goes to the warnings.
void Bullet::choose_substeps() {
  double fastest = 0.0;
  for (const Spring& spring : network_.springs) {
    const double w = 1.0 / network_.vertex_masses[spring.a] + 1.0 / network_.vertex_masses[spring.b];
    fastest = std::max(fastest, stiffness_of(spring) * w / (is_strut(spring) ? kStrutStep : 1.0));
  }
  const double wanted = std::ceil(kFrameSeconds * std::sqrt(fastest / params_.link_step));
  substeps_ = static_cast<Index>(
      std::clamp(wanted, static_cast<double>(params_.min_substeps), static_cast<double>(params_.max_substeps)));
  if (wanted > static_cast<double>(params_.max_substeps))
    warnings_.push_back("the stiffest link needs " + std::to_string(static_cast<long>(wanted)) +
                        " substeps per frame, more than max_substeps = " + std::to_string(params_.max_substeps) +
                        ": the cloth stretches more than its stiffness says");
  if (network_.raised_share > 0.0)
    warnings_.push_back("bending is so stiff that " + percent(network_.raised_share) +
                        " of the edges were stiffened to carry it: the cloth stretches less than its stiffness says; "
                        "if it trembles, halve link_step");
  if (network_.stretch_misfit > 0.15)
    warnings_.push_back("this mesh has the membrane stiffness to " + percent(network_.stretch_misfit) + " only");
  if (network_.bend_misfit > 0.15)
    warnings_.push_back("this mesh has the bending stiffness to " + percent(network_.bend_misfit) + " only");
  if (fabric_.tables)
    warnings_.push_back("stiffness is taken from the tables at zero strain and curvature and stays constant");
  else if (network_.shear_n_per_m < 0.999 * fabric_.stretch_shear_n_per_m)
    warnings_.push_back("stretch_n_per_m.shear = " + std::to_string(fabric_.stretch_shear_n_per_m) +
                        " cannot be had beside this warp and weft, here " + std::to_string(network_.shear_n_per_m));
  if (!fabric_.tables && std::abs(network_.poisson - fabric_.poisson) > 0.01)
    warnings_.push_back("poisson = " + std::to_string(fabric_.poisson) +
                        " cannot be had: links give it with the shear stiffness, here " +
                        std::to_string(network_.poisson));
  if (fabric_.damping_bend_s > 0.0)
    warnings_.push_back("damping.bend_s = " + std::to_string(fabric_.damping_bend_s) +
                        " has no effect: links damp stretching only");
}

void Bullet::require_ready(const char* call) const {
  if (!garment_) throw Error(std::string("bullet: ") + call + "() before reset()");
  if (lost_)
    throw Error(std::string("bullet: ") + call + "() after divergence in frame " + std::to_string(frame_ + 1) +
                ", must be reset");
}

std::int32_t Bullet::checked_vertex(Index vertex, const char* call) const {
  const Index n = garment_->vertex_count();
  const auto refuse = [&](const std::string& why) {
    throw ShapeError(std::string("bullet: ") + call + ": vertex " + std::to_string(vertex) + " " + why);
  };
  if (vertex < 0 || vertex >= n) refuse("out of range, must be in [0, " + std::to_string(n - 1) + "]");
  if (pinned_[vertex]) refuse("is pinned, must be free");
  return static_cast<std::int32_t>(vertex);
}

void Bullet::hold(std::int32_t vertex) {
  held_.push_back(vertex);
  world_->set_inverse_mass(vertex, 0.0);
  world_->node(vertex).m_v.setValue(0.0, 0.0, 0.0);
}

void Bullet::grasp(std::span<const Index> vertices) {
  require_ready("grasp");
  std::vector<std::int32_t> checked;
  for (const Index vertex : vertices) {
    const std::int32_t v = checked_vertex(vertex, "grasp");
    if (std::find(held_.begin(), held_.end(), v) != held_.end() ||
        std::find(checked.begin(), checked.end(), v) != checked.end())
      throw ShapeError("bullet: grasp: vertex " + std::to_string(v) + " is already held");
    checked.push_back(v);
  }
  for (const std::int32_t v : checked) hold(v);
  publish();
}

std::vector<Index> Bullet::grasped() const { return {held_.begin(), held_.end()}; }

void Bullet::release(std::span<const Index> vertices) {
  require_ready("release");
  for (const Index vertex : vertices)
    if (std::find(held_.begin(), held_.end(), vertex) == held_.end())
      throw ShapeError("bullet: release: vertex " + std::to_string(vertex) + " is not held");
  for (const Index vertex : vertices) {
    const auto at = std::find(held_.begin(), held_.end(), vertex);
    if (at == held_.end()) continue;  // named twice
    held_.erase(at);
    world_->set_inverse_mass(vertex, 1.0 / network_.vertex_masses[vertex]);
    world_->node(vertex).m_v.setValue(0.0, 0.0, 0.0);
  }
  publish();
}

void Bullet::release() {
  const std::vector<Index> all(held_.begin(), held_.end());
  release(all);
}

void Bullet::set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) {
  if (!garment_) throw Error("bullet: set_state() before reset()");
  const Index n = garment_->vertex_count();
  require_shape("bullet: set_state: rows of positions", positions.rows(), n);
  require_shape("bullet: set_state: rows of velocities", velocities.rows(), n);
  if (!positions.allFinite() || !velocities.allFinite())
    throw Error("bullet: set_state: positions or velocities are not finite");
  for (std::size_t k = 0; k < grasped.size(); ++k) {
    checked_vertex(grasped[k], "set_state");
    if (std::find(grasped.begin(), grasped.begin() + static_cast<std::ptrdiff_t>(k), grasped[k]) !=
        grasped.begin() + static_cast<std::ptrdiff_t>(k))
      throw ShapeError("bullet: set_state: vertex " + std::to_string(grasped[k]) + " is named twice");
  }
  lost_ = false;
  held_.clear();
  world_->contact().forget();
  for (Index i = 0; i < n; ++i) {
    world_->node(i).m_x = vector(positions, i);
    world_->node(i).m_v = pinned_[i] ? btVector3(0.0, 0.0, 0.0) : vector(velocities, i);
    world_->set_inverse_mass(i, pinned_[i] ? 0.0 : 1.0 / network_.vertex_masses[i]);
  }
  for (const Index vertex : grasped) hold(static_cast<std::int32_t>(vertex));
  publish();
}

void Bullet::publish() {
  for (Index i = 0; i < positions_.rows(); ++i) {
    const auto& node = world_->node(i);
    positions_.row(i) << node.m_x.x(), node.m_x.y(), node.m_x.z();
    velocities_.row(i) << node.m_v.x(), node.m_v.y(), node.m_v.z();
  }
}

void Bullet::step(const Positions& grasp_targets) {
  require_ready("step");
  require_shape("bullet: step: rows of grasp_targets", grasp_targets.rows(), static_cast<Index>(held_.size()));
  if (!grasp_targets.allFinite()) throw Error("bullet: step: grasp_targets are not finite");
  advance(grasp_targets, 0.0);
}

SettleResult Bullet::settle(const SettleCriterion& criterion) {
  require_ready("settle");
  Positions targets(static_cast<Index>(held_.size()), 3);
  for (std::size_t k = 0; k < held_.size(); ++k) targets.row(static_cast<Index>(k)) = positions_.row(held_[k]);
  SettleResult result;
  Index calm = 0;
  while (result.frames < criterion.max_frames) {
    advance(targets, params_.settle_damping_per_s);
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

void Bullet::advance(const Positions& targets, double extra_drag) {
  world_->step(held_, targets, extra_drag);
  double worst = 0.0;
  bool finite = true;
  for (Index i = 0; i < positions_.rows(); ++i) {
    const auto& node = world_->node(i);
    const double size = node.m_v.length2();
    finite = finite && std::isfinite(size) && std::isfinite(node.m_x.length2());
    worst = std::max(worst, size);
  }
  if (!finite || worst > kAbsurdSpeed * kAbsurdSpeed) {
    lost_ = true;
    throw Diverged("bullet: diverged in frame " + std::to_string(frame_ + 1) +
                   (finite ? ": a vertex is faster than 1e6 m/s" : ": positions or speeds are not finite"));
  }
  ++frame_;
  publish();
  for (Index f = 0; f < garment_->face_count() && !held_.empty(); ++f)
    for (int k = 0; k < 3; ++k)
      if (std::find(held_.begin(), held_.end(), garment_->faces(f, k)) != held_.end()) {
        max_grasp_strain_ = std::max(max_grasp_strain_, principal_strain(f));
        break;
      }
}

/// Largest |principal stretch - 1| of a face.
double Bullet::principal_strain(Index face) const {
  const auto x = [&](int k) { return positions_.row(garment_->faces(face, k)); };
  const auto r = [&](int k) { return garment_->rest.row(garment_->faces(face, k)); };
  const Eigen::RowVector2d u = r(1) - r(0), v = r(2) - r(0);
  const double det = u.x() * v.y() - u.y() * v.x();
  const Eigen::RowVector3d a = x(1) - x(0), b = x(2) - x(0);
  const Eigen::RowVector3d du = (v.y() * a - u.y() * b) / det, dv = (u.x() * b - v.x() * a) / det;
  const double e = du.squaredNorm(), g = dv.squaredNorm(), f = du.dot(dv);
  const double mean = 0.5 * (e + g), part = std::sqrt(0.25 * (e - g) * (e - g) + f * f);
  return std::max(std::abs(std::sqrt(mean + part) - 1.0), std::abs(std::sqrt(std::max(0.0, mean - part)) - 1.0));
}

double Bullet::max_speed() const { return std::sqrt(velocities_.rowwise().squaredNorm().maxCoeff()); }

Index Bullet::uncertified() const { return world_ ? world_->contact().uncertified() : 0; }

SimulatorDiagnostics Bullet::diagnostics() const {
  require_ready("diagnostics");
  SimulatorDiagnostics d;
  d.max_speed = max_speed();
  for (Index f = 0; f < garment_->face_count(); ++f) d.max_strain = std::max(d.max_strain, principal_strain(f));
  d.max_grasp_strain = max_grasp_strain_;
  d.contacts = world_->contact().touching();
  for (const std::string& warning : warnings_) d.warning += (d.warning.empty() ? "bullet: " : "; ") + warning;
  if (const auto grasp = grasp_strain_warning(d.max_grasp_strain, params_.grasp_strain_warning); !grasp.empty())
    d.warning += (d.warning.empty() ? "" : "; ") + grasp;
  return d;
}

std::shared_ptr<const SimulatorSnapshot> Bullet::save() const {
  require_ready("save");
  auto snapshot = std::make_shared<Snapshot>();
  snapshot->positions = positions_;
  snapshot->velocities = velocities_;
  snapshot->held = held_;
  snapshot->frame = frame_;
  snapshot->max_grasp_strain = max_grasp_strain_;
  snapshot->garment = garment_->hash;
  return snapshot;
}

void Bullet::restore(const SimulatorSnapshot& snapshot) {
  if (!garment_) throw Error("bullet: restore() before reset()");
  const auto* mine = dynamic_cast<const Snapshot*>(&snapshot);
  if (!mine) throw Error("bullet: restore: the snapshot was made by another simulator, must be made by bullet");
  if (mine->garment != garment_->hash || mine->positions.rows() != garment_->vertex_count())
    throw Error("bullet: restore: the snapshot is of another garment");
  const std::vector<Index> hands(mine->held.begin(), mine->held.end());
  set_state(mine->positions, mine->velocities, hands);
  // A vertex held in motion has its hand's speed.
  for (Index i = 0; i < positions_.rows(); ++i) world_->node(i).m_v = vector(mine->velocities, i);
  frame_ = mine->frame;
  max_grasp_strain_ = mine->max_grasp_strain;
  publish();
}

}  // namespace weft::bullet
