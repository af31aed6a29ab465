#include <algorithm>
#include <cmath>
#include <map>

#include "weft/plugin.hpp"
#include "weft/simulator.hpp"

namespace mass_spring {

struct Params {
  double damping = 0.05;
  double safety = 0.3;
  template <class Visitor>
  void visit(Visitor& v) {
    v("damping", damping, weft::range(0.0, 0.5), "Of every spring, relative to critical.");
    v("safety", safety, weft::range(0.01, 0.6), "Step, relative to where an undamped step becomes unstable.");
  }
};

using namespace weft;

/// Point masses and springs along the edges, semi-implicit Euler, ground contact with Coulomb friction; no self-contact
/// and one stiffness for all directions. Small and fast, not faithful.
class MassSpring final : public Simulator {
 public:
  explicit MassSpring(const Params& params) : p_(params) {}

  SimulatorCapabilities capabilities() const override {
    return {.snapshots = true, .ground_friction = true, .pins = true};
  }

  void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) override {
    if (fabric.stretch_warp_n_per_m != fabric.stretch_weft_n_per_m || fabric.tables) {
      throw ConfigError("mass_spring: fabric " + fabric.name +
                        " stretches differently along warp and weft; must be the same");
    }
    State s;
    s.x = garment->positions;
    std::vector<bool> pinned(static_cast<std::size_t>(s.x.rows()), false);
    for (const Index pin : scene.pins) {
      if (pin < 0 || pin >= s.x.rows())
        throw ConfigError("mass_spring: scene.pins holds " + std::to_string(pin) + ", no vertex");
      pinned[static_cast<std::size_t>(pin)] = true;
    }
    contact_ = scene.ground_height ? *scene.ground_height + fabric.thickness_m : -1e300;
    s.x.col(2) = s.x.col(2).cwiseMax(contact_);
    s.v = scene.initial_velocity.transpose().replicate(s.x.rows(), 1);
    for (const Index pin : scene.pins) s.v.row(pin).setZero();
    garment_ = std::move(garment);
    fabric_ = fabric;
    scene_ = scene;
    pinned_ = std::move(pinned);
    make_springs();
    s_ = std::move(s);
  }

  void set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) override {
    require_shape("mass_spring: positions rows", positions.rows(), s_.x.rows());
    require_shape("mass_spring: velocities rows", velocities.rows(), s_.x.rows());
    if (!positions.allFinite() || !velocities.allFinite())
      throw Error("mass_spring: set_state() with numbers that are not finite");
    State next = s_;
    next.x = positions;
    next.v = velocities;
    next.held.clear();
    hold(next, grasped);
    s_ = std::move(next);
  }

  void grasp(std::span<const Index> vertices) override {
    State next = s_;
    hold(next, vertices);
    for (const Index v : vertices) next.v.row(v).setZero();
    s_ = std::move(next);
  }
  std::vector<Index> grasped() const override { return s_.held; }

  void step(const Positions& grasp_targets) override {
    require_shape("mass_spring: grasp_targets rows", grasp_targets.rows(), static_cast<std::ptrdiff_t>(s_.held.size()));
    if (!grasp_targets.allFinite()) throw Error("mass_spring: grasp_targets are not finite");
    State next = s_;  // what a step that diverges leaves behind is the state before it
    for (Index i = 0; i < grasp_targets.rows(); ++i) {
      const Index v = next.held[static_cast<std::size_t>(i)];
      next.v.row(v) = (grasp_targets.row(i) - next.x.row(v)) / kFrameSeconds;
    }
    for (Index k = 0; k < substeps_; ++k) substep(next);
    for (Index i = 0; i < grasp_targets.rows(); ++i)
      next.x.row(next.held[static_cast<std::size_t>(i)]) = grasp_targets.row(i);
    ++next.frame;
    if (!next.x.allFinite() || !next.v.allFinite()) {
      throw Diverged("mass_spring: diverged in frame " + std::to_string(next.frame));
    }
    s_ = std::move(next);
    for (const auto& spring : springs_) {
      if (is_held(spring.a) || is_held(spring.b)) s_.max_grasp_strain = std::max(s_.max_grasp_strain, strain(spring));
    }
  }

  void release(std::span<const Index> vertices) override {
    for (const Index v : vertices) {
      if (!is_held(v)) throw ShapeError("mass_spring: release of vertex " + std::to_string(v) + ", which is not held");
    }
    for (const Index v : vertices) {
      std::erase(s_.held, v);
      s_.v.row(v).setZero();
    }
  }
  void release() override { release(std::vector<Index>(s_.held)); }

  SettleResult settle(const SettleCriterion& criterion) override {
    Positions targets(static_cast<Index>(s_.held.size()), 3);
    for (Index i = 0; i < targets.rows(); ++i) targets.row(i) = s_.x.row(s_.held[static_cast<std::size_t>(i)]);
    SettleResult result;
    for (Index calm = 0; result.frames < criterion.max_frames && !result.settled; ++result.frames) {
      step(targets);
      result.max_speed = s_.v.rowwise().norm().maxCoeff();
      calm = result.max_speed < criterion.speed ? calm + 1 : 0;
      result.settled = calm >= criterion.hold_frames;
    }
    return result;
  }

  const Positions& positions() const override { return s_.x; }
  const Positions& velocities() const override { return s_.v; }
  Index frame() const override { return s_.frame; }
  SimulatorDiagnostics diagnostics() const override {
    SimulatorDiagnostics d;
    d.max_speed = s_.v.rowwise().norm().maxCoeff();
    for (const auto& spring : springs_) d.max_strain = std::max(d.max_strain, strain(spring));
    d.max_grasp_strain = s_.max_grasp_strain;
    return d;
  }

  std::shared_ptr<const SimulatorSnapshot> save() const override {
    auto snapshot = std::make_shared<Snapshot>();
    snapshot->garment = garment_->hash;
    snapshot->state = s_;
    return snapshot;
  }
  void restore(const SimulatorSnapshot& snapshot) override {
    const auto* ours = dynamic_cast<const Snapshot*>(&snapshot);
    if (ours == nullptr) throw Error("mass_spring: the snapshot is another simulator's");
    if (ours->garment != garment_->hash) throw Error("mass_spring: the snapshot is another garment's");
    s_ = ours->state;
    s_.max_grasp_strain = 0.0;
  }

 private:
  struct State {
    Positions x, v;
    std::vector<Index> held;
    Index frame = 0;
    double max_grasp_strain = 0.0;
  };
  struct Snapshot final : SimulatorSnapshot {
    std::uint64_t garment = 0;
    State state;
  };
  struct Spring {
    Index a, b;
    double rest, stiffness, damping;  // m, N/m, N s/m
  };

  bool is_held(Index v) const { return std::find(s_.held.begin(), s_.held.end(), v) != s_.held.end(); }
  double strain(const Spring& s) const { return std::abs((s_.x.row(s.a) - s_.x.row(s.b)).norm() / s.rest - 1.0); }

  void hold(State& s, std::span<const Index> vertices) const {
    for (const Index v : vertices) {
      const std::string what = "mass_spring: grasp of vertex " + std::to_string(v);
      if (v < 0 || v >= s.x.rows()) throw ShapeError(what + ", must be in [0, " + std::to_string(s.x.rows()) + ")");
      if (pinned_[static_cast<std::size_t>(v)]) throw ShapeError(what + ", which is pinned");
      if (std::find(s.held.begin(), s.held.end(), v) != s.held.end())
        throw ShapeError(what + ", which is held already");
      s.held.push_back(v);
    }
  }

  /// Along every edge the membrane stiffness; across every edge, between the two vertices opposite to it, the bending
  /// stiffness over the length squared.
  void make_springs() {
    const auto& faces = garment_->faces;
    const auto& rest = garment_->rest;
    masses_ = Vector::Zero(rest.rows());
    std::map<std::pair<Index, Index>, double> stiffness;
    std::map<std::pair<Index, Index>, Index> opposite;
    for (Index f = 0; f < faces.rows(); ++f) {
      const auto row = [&](int k) { return rest.row(faces(f, k % 3)); };
      const auto e = (row(1) - row(0)).eval(), g = (row(2) - row(0)).eval();
      const double area = 0.5 * std::abs(e.x() * g.y() - e.y() * g.x());
      for (int k = 0; k < 3; ++k) {
        masses_[faces(f, k)] += fabric_.density_kg_per_m2 * area / 3.0;
        const Index a = faces(f, k), b = faces(f, (k + 1) % 3), c = faces(f, (k + 2) % 3);
        const auto edge = std::minmax(a, b);
        stiffness[edge] = fabric_.stretch_warp_n_per_m;
        if (const auto other = opposite.find(edge); other != opposite.end()) {
          const double length = (rest.row(c) - rest.row(other->second)).norm();
          stiffness[std::minmax(c, other->second)] += fabric_.bend_bias_n_m / (length * length);
        } else {
          opposite[edge] = c;
        }
      }
    }
    springs_.clear();
    Vector sums = Vector::Zero(rest.rows());
    for (const auto& [ends, k] : stiffness) {
      const auto& [a, b] = ends;
      const double mass = 1.0 / (1.0 / masses_[a] + 1.0 / masses_[b]);
      springs_.push_back({a, b, (rest.row(a) - rest.row(b)).norm(), k, 2.0 * p_.damping * std::sqrt(k * mass)});
      sums[a] += k;
      sums[b] += k;
    }
    // No eigenvalue of M^-1 K exceeds 2 max(sum of a vertex's stiffness / its mass) [Gershgorin].
    const double fastest = std::sqrt(2.0 * sums.cwiseQuotient(masses_).maxCoeff());
    substeps_ = std::max<Index>(20, static_cast<Index>(std::ceil(kFrameSeconds * fastest / (2.0 * p_.safety))));
  }

  void substep(State& s) const {
    const double h = kFrameSeconds / static_cast<double>(substeps_);
    Positions force = Positions::Zero(s.x.rows(), 3);
    for (const auto& spring : springs_) {
      const Eigen::RowVector3d way = s.x.row(spring.b) - s.x.row(spring.a);
      const double length = way.norm();
      if (length == 0.0) continue;
      const Eigen::RowVector3d n = way / length;
      const double pull =
          spring.stiffness * (length - spring.rest) + spring.damping * (s.v.row(spring.b) - s.v.row(spring.a)).dot(n);
      force.row(spring.a) += pull * n;
      force.row(spring.b) -= pull * n;
    }
    const double drag = std::exp(-fabric_.damping_air_per_s * h);
    std::vector<bool> fixed = pinned_;
    for (const Index v : s.held) fixed[static_cast<std::size_t>(v)] = true;
    for (Index i = 0; i < s.x.rows(); ++i) {
      if (!fixed[static_cast<std::size_t>(i)]) {
        Eigen::RowVector3d v = drag * s.v.row(i) + h * (force.row(i) / masses_[i] + scene_.gravity.transpose());
        if (s.x(i, 2) + h * v.z() < contact_) {
          // The ground takes what would go below it, and Coulomb's share of what goes along it.
          const double lost = (contact_ - s.x(i, 2)) / h - v.z();
          const double along = v.head<2>().norm();
          v.head<2>() *= along > 0.0 ? std::max(0.0, 1.0 - fabric_.friction * lost / along) : 0.0;
          v.z() += lost;
        }
        s.v.row(i) = v;
      }
      if (!pinned_[static_cast<std::size_t>(i)]) s.x.row(i) += h * s.v.row(i);
    }
  }

  Params p_;
  std::shared_ptr<const Garment> garment_;
  Fabric fabric_;
  Scene scene_;
  double contact_ = 0.0;  // m, height of a vertex that lies on the ground
  std::vector<bool> pinned_;
  Vector masses_;
  std::vector<Spring> springs_;
  Index substeps_ = 0;
  State s_;
};

}  // namespace mass_spring

WEFT_PLUGIN(weft::Simulator, mass_spring::MassSpring, mass_spring::Params, "mass_spring", "1.0.0")
