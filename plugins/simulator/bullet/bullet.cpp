#include "bullet.hpp"

#include <BulletSoftBody/btDefaultSoftBodySolver.h>
#include <BulletSoftBody/btSoftBody.h>
#include <BulletSoftBody/btSoftBodyRigidBodyCollisionConfiguration.h>
#include <BulletSoftBody/btSoftRigidDynamicsWorld.h>
#include <btBulletDynamicsCommon.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "weft/error.hpp"

static_assert(sizeof(btScalar) == sizeof(double), "build with BT_USE_DOUBLE_PRECISION");

namespace weft::bullet {
namespace {

// Rest length of a strut over its length in the flat sheet, R. At x times its flat length Bullet's link pushes with
// x (R^2 - x^2) / (R^2 + x^2). With this R the push stays within 12 % of that of a hinge linear in its angle, up to
// 120 degrees.
constexpr double kStrutRatio = 1.5;
// A strut's k dt^2 w is at most this part of link_step. Edges balance one another within a pass over the links
// (update_compliance), but nothing balances a strut. A strip trembled at 90 mm/s with 0.24 and came to rest with 0.15.
constexpr double kStrutStep = 0.3;
// Largest share of the edges that may be stiffened to carry bending. With 26 % (the softest and thickest T-shirt) cloth
// comes to rest. Strips with 69 % and more vibrated at metres per second and stretched like another fabric.
constexpr double kMostRaised = 0.5;
// m/s; a vertex above this speed means that the simulation has diverged.
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

/// A fixed order without a pattern. A sweep along the mesh would meet every link with the load on one side already
/// solved, which would bias all links in the same way.
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
  World(const Garment& garment, const SpringNetwork& network, const Fabric& fabric, const Scene& scene, double floor,
        Index substeps, const Params& params)
      : configuration_(small_pools()),
        dispatcher_(&configuration_),
        world_(&dispatcher_, &broadphase_, &rigid_solver_, &configuration_, &solver_),
        solver_(*this),
        contact_(garment, fabric.thickness_m, fabric.self_friction, params.self_contact,
                 ObstacleContact(garment, scene.obstacles, fabric.thickness_m, fabric.friction)),
        scene_(scene),
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
    // Otherwise Bullet would take the current shape as the rest shape at the next step.
    body_->m_bUpdateRtCst = false;
    world_.addSoftBody(body.release());

    substep_.seconds = kFrameSeconds / static_cast<double>(substeps);
    substep_.floor = floor;
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

  /// Makes a vertex immovable (0) or gives it back its mass.
  void set_inverse_mass(Index i, double value) {
    inverse_mass_[i] = value;
    node(i).m_im = value;
    compliance_is_current_ = false;
  }

  /// Advances by one frame. The held vertices move in straight lines to their targets.
  void step(const std::vector<Index>& held, const Positions& targets, double drag) {
    held_ = &held;
    targets_ = &targets;
    drag_ = drag;
    world_.stepSimulation(kFrameSeconds, 0, kFrameSeconds);
  }

 private:
  /// Bullet's hook for integrating soft bodies, which the world calls once a step.
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

  /// m_c0 from compliance and the current masses.
  void update_compliance() {
    const double dt = substep_.seconds;
    for (int e = 0; e < body_->m_links.size(); ++e) {
      btSoftBody::Link& link = body_->m_links[e];
      const double w = link.m_n[0]->m_im + link.m_n[1]->m_im;
      const double compliance = 1.0 / (laws_[e].stiffness * dt * dt);
      // Not below w: half a link too stiff for the step would overshoot.
      link.m_c0 = laws_[e].strut ? compliance : std::max(compliance + 0.5 * w, w);
    }
    compliance_is_current_ = true;
  }

  /// Stiffness-proportional damping along the links: VSolve_Links subtracts c3 (c3 . dv) c2 from the velocities.
  void damp() {
    const double dt = substep_.seconds;
    for (int e = 0; e < body_->m_links.size(); ++e) {
      btSoftBody::Link& link = body_->m_links[e];
      const LinkLaw& law = laws_[e];
      link.m_c3 = link.m_n[1]->m_x - link.m_n[0]->m_x;
      const double rate = law.strut ? 0.0 : damping_ * law.stiffness * dt, w = link.m_n[0]->m_im + link.m_n[1]->m_im;
      link.m_c2 = rate / ((1.0 + rate * w) * std::max(link.m_c3.length2(), 1e-30));
    }
    btSoftBody::VSolve_Links(body_, 1.0);
  }

  void substeps() {
    if (!compliance_is_current_) update_compliance();
    const std::size_t n = body_->m_nodes.size();
    const double dt = substep_.seconds;
    const btVector3 gain = dt * btVector3(scene_.gravity.x(), scene_.gravity.y(), scene_.gravity.z());
    const double keep = 1.0 / (1.0 + dt * drag_);
    begin_.resize(held_->size());
    for (std::size_t k = 0; k < held_->size(); ++k) begin_[k] = node((*held_)[k]).m_x;

    for (Index s = 1; s <= substeps_; ++s) {
      if (damping_ > 0.0) damp();
      for (std::size_t i = 0; i < n; ++i) {
        auto& node_i = node(i);
        node_i.m_q = node_i.m_x;
        if (node_i.m_im == 0.0) continue;
        node_i.m_v = keep * (node_i.m_v + gain);
        node_i.m_x += dt * node_i.m_v;
      }
      const double part = static_cast<double>(s) / static_cast<double>(substeps_);
      for (std::size_t k = 0; k < held_->size(); ++k) {
        const btVector3 target = vector(*targets_, k);
        node((*held_)[k]).m_x = s == substeps_ ? target : begin_[k] + part * (target - begin_[k]);
      }
      btSoftBody::PSolve_Links(body_, 1.0, 0.0);
      for (std::size_t i = 0; i < n; ++i) {
        substep_.start[i] = vector(node(i).m_q);
        substep_.end[i] = vector(node(i).m_x);
      }
      contact_.resolve(substep_, passes_);
      double sum = 0.0;
      for (std::size_t i = 0; i < n; ++i) {
        auto& node_i = node(i);
        if (node_i.m_im != 0.0) {
          node_i.m_x = vector(substep_.end[i]);
          node_i.m_v = (node_i.m_x - node_i.m_q) / dt;
        }
        sum += node_i.m_v.length2();
      }
      if (!(sum < kAbsurdSpeed * kAbsurdSpeed)) return;  // advance_frame() reports it
    }
    for (std::size_t k = 0; k < held_->size(); ++k)
      node((*held_)[k]).m_v = (vector(*targets_, k) - begin_[k]) / kFrameSeconds;
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
  double drag_ = 0.0, damping_;
  Index substeps_;
  int passes_;
  bool compliance_is_current_ = false;
  const std::vector<Index>* held_ = nullptr;
  const Positions* targets_ = nullptr;
};

Bullet::Bullet(const Params& params)
    : SimulatorBase("bullet", {params.settle_damping_per_s, params.grasp_strain_warning}), params_(params) {}
Bullet::~Bullet() = default;

SimulatorCapabilities Bullet::capabilities() const {
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

void Bullet::start() {
  const Fabric& fabric = this->fabric();
  if (!fabric.tables && !(fabric.stretch_shear_n_per_m > 0.0))  // the springs along the edges need a shear stiffness
    throw ConfigError("bullet: fabric.stretch_n_per_m.shear = " + std::to_string(fabric.stretch_shear_n_per_m) +
                      ", must be above 0");
  if (params_.max_substeps < params_.min_substeps)
    throw ConfigError("bullet: max_substeps = " + std::to_string(params_.max_substeps) +
                      ", must be at least min_substeps = " + std::to_string(params_.min_substeps));
  network_ = spring_network(garment(), fabric);
  if (network_.raised_share > kMostRaised)
    throw ConfigError(
        "bullet: fabric.bend_n_m is too large for stretch_n_per_m on this mesh: " + percent(network_.raised_share) +
        " of the edges would have to be stiffened to carry it, must be at most " + percent(kMostRaised));
  choose_substeps();
  world_ = std::make_unique<World>(garment(), network_, fabric, scene(), floor(), substeps_, params_);
  state_changed();
}

/// Takes over positions(), velocities() and the fixed vertices. Contacts follow from the positions alone
/// (SelfContact::make_contacts), so a snapshot of these is complete.
void Bullet::state_changed() {
  world_->contact().forget();
  for (Index i = 0; i < positions().rows(); ++i) {
    world_->node(i).m_x = vector(positions(), i);
    world_->node(i).m_v = vector(velocities(), i);
    world_->set_inverse_mass(i, is_fixed(i) ? 0.0 : 1.0 / network_.vertex_masses[i]);
  }
}

/// Chooses the substeps from the stiffest edge or strut. Warns of every property of mesh and fabric that links lack.
void Bullet::choose_substeps() {
  const Fabric& fabric = this->fabric();
  warnings_.clear();
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
    warnings_.push_back("on this mesh the membrane stiffness is met to within " + percent(network_.stretch_misfit) +
                        " only");
  if (network_.bend_misfit > 0.15)
    warnings_.push_back("on this mesh the bending stiffness is met to within " + percent(network_.bend_misfit) +
                        " only");
  if (fabric.tables)
    warnings_.push_back("stiffness is taken from the tables at zero strain and curvature and stays constant");
  else if (network_.shear_n_per_m < 0.999 * fabric.stretch_shear_n_per_m)
    warnings_.push_back("stretch_n_per_m.shear = " + std::to_string(fabric.stretch_shear_n_per_m) +
                        " is too large for this warp and weft; the links have " +
                        std::to_string(network_.shear_n_per_m));
  if (!fabric.tables && std::abs(network_.poisson - fabric.poisson) > 0.01)
    warnings_.push_back("poisson = " + std::to_string(fabric.poisson) +
                        " cannot be chosen: the links' shear stiffness makes it " + std::to_string(network_.poisson));
  if (fabric.damping_bend_s > 0.0)
    warnings_.push_back("damping.bend_s = " + std::to_string(fabric.damping_bend_s) +
                        " has no effect: links damp stretching only");
}

void Bullet::hold_changed(Index vertex, bool held) {
  world_->set_inverse_mass(vertex, held ? 0.0 : 1.0 / network_.vertex_masses[vertex]);
  world_->node(vertex).m_v.setValue(0.0, 0.0, 0.0);
}

void Bullet::advance_frame(const Positions& targets, double drag, Positions& x, Positions& v) {
  world_->step(held(), targets, drag);
  for (Index i = 0; i < x.rows(); ++i) {
    const auto& node = world_->node(i);
    if (node.m_v.length2() > kAbsurdSpeed * kAbsurdSpeed) throw Diverged("a vertex is faster than 1e6 m/s");
    x.row(i) << node.m_x.x(), node.m_x.y(), node.m_x.z();
    v.row(i) << node.m_v.x(), node.m_v.y(), node.m_v.z();
  }
}

Index Bullet::uncertified() const { return world_ ? world_->contact().uncertified() : 0; }

void Bullet::add_diagnostics(SimulatorDiagnostics& diagnostics) const {
  diagnostics.contacts = world_->contact().touching();
  for (const std::string& warning : warnings_)
    diagnostics.warning += (diagnostics.warning.empty() ? "bullet: " : "; ") + warning;
}

}  // namespace weft::bullet
