#include <algorithm>
#include <cmath>
#include <map>

#include "weft/plugin.hpp"
#include "weft/simulator.hpp"

using namespace weft;

struct Params {
  double damping = 0.05;
  double safety = 0.3;
  template <class Visitor>
  void visit(Visitor& v) {
    v("damping", damping, range(0.0, 0.5), "Of every spring, relative to critical.");
    v("safety", safety, range(0.01, 0.6), "Step, relative to where an undamped step becomes unstable.");
  }
};

/// Point masses and springs along the edges, semi-implicit Euler, ground contact with Coulomb friction; no self-contact
/// and one stiffness for all directions. Small and fast, not faithful.
class MassSpring final : public SimulatorBase {
 public:
  explicit MassSpring(const Params& params) : SimulatorBase("mass_spring"), p_(params) {}

  SimulatorCapabilities capabilities() const override {
    return {.snapshots = true, .ground_friction = true, .pins = true};
  }

 protected:
  /// Along every edge a spring of the membrane stiffness; across every edge, between the two vertices opposite to it,
  /// one of the bending stiffness over the length squared.
  void start() override {
    const Faces& faces = garment().faces;
    const RestPositions& rest = garment().rest;
    masses_ = Vector::Zero(rest.rows());
    std::map<std::pair<Index, Index>, double> stiffness;
    std::map<std::pair<Index, Index>, Index> opposite;
    for (Index f = 0; f < faces.rows(); ++f) {
      const Vec2 e = rest.row(faces(f, 1)) - rest.row(faces(f, 0)), g = rest.row(faces(f, 2)) - rest.row(faces(f, 0));
      const double area = 0.5 * std::abs(e.x() * g.y() - e.y() * g.x());
      for (int k = 0; k < 3; ++k) {
        const Index a = faces(f, k), b = faces(f, (k + 1) % 3), c = faces(f, (k + 2) % 3);
        masses_[a] += fabric().density_kg_per_m2 * area / 3.0;
        stiffness[std::minmax(a, b)] = fabric().stretch_warp_n_per_m;
        if (const auto [other, first] = opposite.try_emplace(std::minmax(a, b), c); !first) {
          const double length = (rest.row(c) - rest.row(other->second)).norm();
          stiffness[std::minmax(c, other->second)] += fabric().bend_bias_n_m / (length * length);
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
    substeps_ = std::max<Index>(20, std::ceil(kFrameSeconds * fastest / (2.0 * p_.safety)));
  }

  void advance_frame(const Positions& targets, double drag, Positions& x, Positions& v) override {
    for (Index i = 0; i < targets.rows(); ++i) v.row(held()[i]) = (targets.row(i) - x.row(held()[i])) / kFrameSeconds;
    for (Index k = 0; k < substeps_; ++k) substep(drag, x, v);
    for (Index i = 0; i < targets.rows(); ++i) x.row(held()[i]) = targets.row(i);
  }

 private:
  struct Spring {
    Index a, b;
    double rest, stiffness, damping;  // m, N/m, N s/m
  };

  void substep(double drag, Positions& x, Positions& v) const {
    const double h = kFrameSeconds / static_cast<double>(substeps_), keep = std::exp(-drag * h);
    Positions force = Positions::Zero(x.rows(), 3);
    for (const Spring& spring : springs_) {
      const Eigen::RowVector3d way = x.row(spring.b) - x.row(spring.a);
      const double length = way.norm();
      if (length == 0.0) continue;
      const Eigen::RowVector3d n = way / length;
      const double pull =
          spring.stiffness * (length - spring.rest) + spring.damping * (v.row(spring.b) - v.row(spring.a)).dot(n);
      force.row(spring.a) += pull * n;
      force.row(spring.b) -= pull * n;
    }
    for (Index i = 0; i < x.rows(); ++i) {
      if (!is_fixed(i)) {
        v.row(i) = keep * v.row(i) + h * (force.row(i) / masses_[i] + scene().gravity.transpose());
        if (const double lost = (floor() - x(i, 2)) / h - v(i, 2); lost > 0.0) {
          // The ground takes what would go below it, and Coulomb's share of what goes along it.
          const double along = v.row(i).head<2>().norm();
          v.row(i).head<2>() *= along > 0.0 ? std::max(0.0, 1.0 - fabric().friction * lost / along) : 0.0;
          v(i, 2) += lost;
        }
      }
      x.row(i) += h * v.row(i);  // a held vertex has the speed that takes it to its target
    }
  }

  Params p_;
  Vector masses_;  // [V] kg
  std::vector<Spring> springs_;
  Index substeps_ = 0;
};

WEFT_PLUGIN(weft::Simulator, MassSpring, Params, "mass_spring", "1.0.0")
