#include "experiments/physics/closed_forms.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "experiments/physics/sheets.hpp"
#include "weft/random.hpp"

namespace weft::physics {
namespace {

/// Heavy elastica: a cantilever of length L under its own weight, B theta'' = w (L - s) cos(theta), for G = w L^3 / B.
struct Elastica {
  double g, x, drop;  ///< G, tip x / L, tip drop / L
};
constexpr Elastica kElastica[] = {{0.5, 0.99778, 0.06231}, {1.0, 0.99125, 0.12347}, {2.0, 0.96689, 0.23851},
                                  {4.0, 0.89011, 0.42516}, {8.0, 0.72442, 0.64063}, {10.0, 0.65635, 0.70020},
                                  {20.0, 0.44523, 0.82988}};

}  // namespace

void add_elastica(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  struct Level {
    double edge, length, width, bound;
  };
  // Free length 20 fine edges, 8 garment edges (0.16 m).
  const Level levels[] = {{p.fine_edge_m, 21 * p.fine_edge_m, 6 * p.fine_edge_m, 0.03},
                          {p.garment_edge_m, 9 * p.garment_edge_m, 4 * p.garment_edge_m, 0.06}};
  for (const Level& level : levels)
    for (const Pattern pattern : {Pattern::regular, Pattern::rotated, Pattern::irregular})
      for (const Elastica& reference : kElastica) {
        const std::string name = mm(level.edge) + " " + name_of(pattern) + text(" G=%g", reference.g);
        cases.push_back({"elastica", name, [=](const std::vector<SimulatorVariant>& variants) {
                           const Sheet sheet = strip(level.length, level.width, level.edge, pattern);
                           const double length = level.length - 0.5 * level.edge;
                           Fabric fabric = test_fabric(p);
                           const double bend = p.density_kg_per_m2 * kGravity * std::pow(length, 3) / reference.g;
                           set_bend(fabric, bend);
                           const auto simulator = variants[0].make();
                           const Vec2 tip = cantilever(*simulator, sheet, fabric, bend);
                           return std::vector<PhysicsRow>{
                               row("elastica", variants[0], name, "drop/L", reference.drop, tip.y(),
                                   std::hypot(tip.x() - reference.x, tip.y() - reference.drop), level.bound,
                                   text("x/L %.4f", tip.x()) + text(" for %.4f", reference.x))};
                         }});
      }
  // The nominal bending stiffness gives the lengths of a garment's folds.
  for (const double edge : {p.fine_edge_m})
    for (const Elastica& reference : {kElastica[4], kElastica[6]})
      for (const Pattern pattern : {Pattern::regular, Pattern::irregular}) {
        const std::string name = mm(edge) + " " + name_of(pattern) + text(" G=%g nominal fabric", reference.g);
        cases.push_back({"elastica", name, [=](const std::vector<SimulatorVariant>& variants) {
                           const double length = std::cbrt(reference.g * p.bend_n_m / (p.density_kg_per_m2 * kGravity));
                           const double edges = std::round(length / edge + 0.5);
                           const double exact = length / (edges - 0.5);  // the edge that makes the free length fit
                           const Sheet sheet = strip(edges * exact, 6 * exact, exact, pattern);
                           const auto simulator = variants[0].make();
                           const Vec2 tip = cantilever(*simulator, sheet, test_fabric(p), p.bend_n_m);
                           return std::vector<PhysicsRow>{
                               row("elastica", variants[0], name, "drop/L", reference.drop, tip.y(),
                                   std::hypot(tip.x() - reference.x, tip.y() - reference.drop), 0.03,
                                   text("x/L %.4f", tip.x()) + text(" for %.4f", reference.x))};
                         }});
      }
  // Orthotropy: B(p) = Bw c^4 + Bf s^4 + (4 Bb - Bw - Bf) c^2 s^2. Each direction is scaled to G = 8 along itself.
  const Elastica reference = kElastica[4];
  for (const int degrees : {0, 45, 90}) {
    const std::string name = mm(p.fine_edge_m) + (degrees == 0    ? " along warp"
                                                  : degrees == 90 ? " along weft"
                                                                  : " along bias");
    cases.push_back(
        {"orthotropy", name, [=](const std::vector<SimulatorVariant>& variants) {
           const double turn = degrees * std::numbers::pi / 180.0;
           // 20 edges long and as wide: a narrow strip on the bias would also twist.
           const Sheet sheet = strip(21 * p.fine_edge_m, 20 * p.fine_edge_m, p.fine_edge_m, Pattern::regular, turn);
           const double length = sheet.length - 0.5 * sheet.edge;
           const double wanted = p.density_kg_per_m2 * kGravity * std::pow(length, 3) / reference.g;
           const double warp = 1.0, weft = 0.4, bias = 0.6;
           const double c = std::cos(turn), s = std::sin(turn);
           const double along =
               warp * std::pow(c, 4) + weft * std::pow(s, 4) + (4 * bias - warp - weft) * c * c * s * s;
           Fabric fabric = test_fabric(p);
           fabric.bend_warp_n_m = warp * wanted / along;
           fabric.bend_weft_n_m = weft * wanted / along;
           fabric.bend_bias_n_m = bias * wanted / along;
           const auto simulator = variants[0].make();
           const Vec2 tip = cantilever(*simulator, sheet, fabric, wanted);
           return std::vector<PhysicsRow>{row("orthotropy", variants[0], name, "drop/L", reference.drop, tip.y(),
                                              std::hypot(tip.x() - reference.x, tip.y() - reference.drop), 0.03)};
         }});
  }
}

void add_hanging(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  for (const double edge : {p.garment_edge_m, 0.5 * p.garment_edge_m})
    for (const Pattern pattern : {Pattern::regular, Pattern::irregular})
      for (const bool weft : {false, true}) {
        const std::string name = mm(edge) + " " + name_of(pattern) + (weft ? " along weft" : " along warp");
        cases.push_back({"hanging", name, [=](const std::vector<SimulatorVariant>& variants) {
                           const Sheet sheet = strip(0.5, 0.1, edge, pattern, weft ? std::numbers::pi / 2 : 0.0);
                           Fabric fabric = test_fabric(p);
                           fabric.stretch_weft_n_per_m = 2.0 * fabric.stretch_warp_n_per_m;
                           const double stiffness = weft ? fabric.stretch_weft_n_per_m : fabric.stretch_warp_n_per_m;
                           const double wanted = p.density_kg_per_m2 * kGravity * 0.25 / (2.0 * stiffness);
                           std::vector<PhysicsRow> rows;
                           double first = 0.0;
                           for (std::size_t k = 0; k < variants.size(); ++k) {
                             const auto simulator = variants[k].make();
                             const double got = hang(*simulator, sheet, fabric, stiffness);
                             if (k == 0) {
                               first = got;
                               rows.push_back(relative("hanging", variants[k], name, "extension m", wanted, got, 0.02));
                             } else {
                               rows.push_back(relative("hanging", variants[k], name + " against " + variants[0].name,
                                                       "extension m", first, got, 0.01));
                             }
                           }
                           return rows;
                         }});
      }
}

void add_catenary(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  struct Reference {
    double ratio, sag;
  };
  for (const Reference reference : {Reference{1.05, 0.13930}, {1.25, 0.33180}, {2.0, 0.79639}})
    for (const Pattern pattern : {Pattern::regular, Pattern::irregular}) {
      const std::string name = mm(p.garment_edge_m) + " " + name_of(pattern) + text(" L/d=%g", reference.ratio);
      cases.push_back(
          {"catenary", name, [=](const std::vector<SimulatorVariant>& variants) {
             const double length = 20 * p.garment_edge_m, d = length / reference.ratio;
             Sheet sheet = strip(length, 3 * p.garment_edge_m, p.garment_edge_m, pattern);
             // The strip starts as a circular arc of its length: half angle a with sin(a)/a = d/L.
             double low = 1e-6, high = std::numbers::pi;
             for (int k = 0; k < 80; ++k) {
               const double a = 0.5 * (low + high);
               (std::sin(a) / a > d / length ? low : high) = a;
             }
             const double radius = 0.5 * length / low;
             for (Index i = 0; i < sheet.positions.rows(); ++i) {
               const double a = (sheet.flat(i, 0) / length * 2.0 - 1.0) * low;
               sheet.positions.row(i) << radius * std::sin(a), sheet.flat(i, 1), radius * (std::cos(low) - std::cos(a));
             }
             // Nearly inextensible and without bending: 0.03 % strain, and (B / w)^(1/3) = 4 mm.
             Fabric fabric = test_fabric(p);
             fabric.stretch_warp_n_per_m = fabric.stretch_weft_n_per_m = 40.0 * p.stretch_n_per_m;
             set_bend(fabric, 1e-7);
             fabric.damping_air_per_s = 8.0;
             Scene scene = no_ground();
             scene.pins = sheet.column(0.0);
             for (const Index i : sheet.column(length)) scene.pins.push_back(i);
             const auto simulator = variants[0].make();
             simulator->reset(sheet.garment("catenary"), fabric, scene);
             rest(*simulator, 5e-4, 600);
             const double sag = -simulator->positions().col(2).minCoeff() / d;
             return std::vector<PhysicsRow>{relative("catenary", variants[0], name, "sag/d", reference.sag, sag, 0.02)};
           }});
    }
}

namespace {

/// A sheet on the ground after `seconds`, gravity turned to the slope tan(alpha) = slope.
Slide slide(Simulator& simulator, const Sheet& sheet, const Fabric& fabric, double slope, double seconds, Index from,
            Index count) {
  const double alpha = std::atan(slope);
  Scene scene;
  scene.gravity = {kGravity * std::sin(alpha), 0.0, -kGravity * std::cos(alpha)};
  simulator.reset(sheet.garment("incline"), fabric, scene);
  const Positions start = simulator.positions();
  const auto frames = static_cast<Index>(std::lround(seconds / kFrameSeconds));
  for (Index k = 0; k < frames; ++k) simulator.step(kNothing);
  const Positions moved = (simulator.positions() - start).middleRows(from, count);
  return {moved.col(0).mean(), moved.rowwise().norm().maxCoeff()};
}

}  // namespace

void incline_rows(std::vector<PhysicsRow>& rows, const std::string& test, const SimulatorVariant& variant,
                  const std::string& name, double mu, double seconds, double slack,
                  const std::function<Slide(Simulator&, double, double)>& run) {
  const auto simulator = variant.make();
  const Slide stuck = run(*simulator, (1.0 - slack) * mu, 1.0);
  rows.push_back(row(test, variant, name + text(" tan=%g mu", 1.0 - slack), "motion in 1 s, m", 0.0, stuck.largest,
                     stuck.largest, 1e-4));
  for (const double times : {1.0 + slack, 1.3, 2.0, 3.0}) {
    const double slope = times * mu, alpha = std::atan(slope);
    const double wanted = kGravity * (std::sin(alpha) - mu * std::cos(alpha));
    const double t = std::round(std::min(seconds, std::sqrt(2 * 0.25 / wanted)) / kFrameSeconds) * kFrameSeconds;
    const double got = 2.0 * run(*simulator, slope, t).mean / (t * t);
    const std::string label = name + text(" tan=%g mu", times);
    if (times < 2.0)
      rows.push_back(row(test, variant, label, "acceleration m/s^2", wanted, got,
                         std::abs(got - wanted) / (mu * kGravity * std::cos(alpha)), slack,
                         "error in mu g cos(alpha)"));
    else
      rows.push_back(relative(test, variant, label, "acceleration m/s^2", wanted, got, slack));
  }
}

void add_incline(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  for (const double edge : {p.garment_edge_m, 0.5 * p.garment_edge_m})
    for (const double mu : {0.1, 0.3, 0.5, 1.0}) {
      const std::string name = mm(edge) + text(" mu=%g", mu);
      cases.push_back({"incline", name, [=](const std::vector<SimulatorVariant>& variants) {
                         const Sheet sheet = strip(0.2, 0.2, edge, Pattern::irregular);
                         Fabric fabric = test_fabric(p);
                         fabric.friction = mu;
                         std::vector<PhysicsRow> rows;
                         for (const auto& variant : variants)
                           incline_rows(rows, "incline", variant, name, mu, 0.5, 0.02,
                                        [&](Simulator& simulator, double slope, double t) {
                                          return slide(simulator, sheet, fabric, slope, t, 0, sheet.positions.rows());
                                        });
                         return rows;
                       }});
    }
  for (const double mu : {0.1, 0.3, 0.6}) {
    const std::string name = mm(p.garment_edge_m) + text(" self mu=%g", mu);
    cases.push_back({"cloth on cloth", name, [=](const std::vector<SimulatorVariant>& variants) {
                       const double edge = p.garment_edge_m;
                       Fabric fabric = test_fabric(p);
                       fabric.friction = 20.0;  // the lower sheet stays
                       fabric.self_friction = mu;
                       const Sheet lower = strip(0.56, 0.28, edge, Pattern::irregular);
                       Sheet upper = strip(0.16, 0.16, edge, Pattern::rotated);
                       upper.positions.rowwise() += Eigen::RowVector3d(0.063, 0.057, 2.0 * fabric.thickness_m);
                       const Sheet sheet = both(lower, upper);
                       std::vector<PhysicsRow> rows;
                       incline_rows(rows, "cloth on cloth", variants[0], name, mu, 0.4, 0.05,
                                    [&](Simulator& simulator, double slope, double t) {
                                      return slide(simulator, sheet, fabric, slope, t, lower.positions.rows(),
                                                   upper.positions.rows());
                                    });
                       return rows;
                     }});
  }
  for (const double mu : {0.2, 0.5, 1.0}) {
    const std::string name = mm(p.garment_edge_m) + text(" mu=%g", mu);
    cases.push_back({"thrown sheet", name, [=](const std::vector<SimulatorVariant>& variants) {
                       const Sheet sheet = strip(0.2, 0.2, p.garment_edge_m, Pattern::irregular);
                       Fabric fabric = test_fabric(p);
                       fabric.friction = mu;
                       Scene scene;
                       scene.initial_velocity = {1.0, 0.0, 0.0};
                       std::vector<PhysicsRow> rows;
                       for (const auto& variant : variants) {
                         const auto simulator = variant.make();
                         simulator->reset(sheet.garment("thrown"), fabric, scene);
                         const Positions start = simulator->positions();
                         rest(*simulator, 1e-4, 200);
                         const double wanted = 1.0 / (2.0 * mu * kGravity);
                         rows.push_back(relative("thrown sheet", variant, name, "way to stop, m", wanted,
                                                 (simulator->positions() - start).col(0).mean(), 0.03));
                       }
                       return rows;
                     }});
  }
}

namespace {

double kinetic(const Vector& mass, const Positions& v) {
  return 0.5 * (mass.array() * v.rowwise().squaredNorm().array()).sum();
}

using Variants = std::vector<SimulatorVariant>;

std::vector<PhysicsRow> free_fall(const PhysicsParams& p, const Variants& variants) {
  const Sheet sheet = strip(0.2, 0.2, p.garment_edge_m, Pattern::irregular);
  Scene scene = no_ground();
  scene.initial_velocity = {0.3, -0.2, 0.5};
  const auto simulator = variants[0].make();
  simulator->reset(sheet.garment("falling"), test_fabric(p), scene);
  const Positions start = simulator->positions();
  for (int k = 0; k < 60; ++k) simulator->step(kNothing);
  const Vec3 way = scene.initial_velocity + Vec3(0.5 * scene.gravity);
  const double worst = (simulator->positions() - (start.rowwise() + way.transpose())).rowwise().norm().maxCoeff();
  return {row("free fall", variants[0], "1 s, irregular sheet", "error m", 0.0, worst, worst / (0.5 * kGravity), 2e-3,
              "error as a part of g t^2/2")};
}

std::vector<PhysicsRow> stay_at_rest(const PhysicsParams& p, const Variants& variants) {
  const Sheet sheet = strip(0.3, 0.3, p.garment_edge_m, Pattern::irregular);
  const auto simulator = variants[0].make();
  simulator->reset(sheet.garment("resting"), test_fabric(p), Scene());
  const Positions start = simulator->positions();
  for (int k = 0; k < 120; ++k) simulator->step(kNothing);
  const double moved = (simulator->positions() - start).rowwise().norm().maxCoeff();
  return {row("rest", variants[0], "2 s on the ground", "motion m", 0.0, moved, moved, 1e-6)};
}

std::vector<PhysicsRow> keep_momentum(const PhysicsParams& p, const Variants& variants) {
  const Sheet sheet = strip(0.3, 0.3, p.garment_edge_m, Pattern::irregular);
  const Vector mass = lumped_masses(sheet, p.density_kg_per_m2);
  const auto simulator = variants[0].make();
  simulator->reset(sheet.garment("flying"), test_fabric(p), no_ground());
  Positions x = simulator->positions(), v = x;
  RandomStream random(5, 1);
  for (Index i = 0; i < x.rows(); ++i) {
    x(i, 2) += 0.02 * std::sin(20.0 * x(i, 0)) * std::cos(15.0 * x(i, 1));
    v.row(i) << random.normal(), random.normal(), random.normal();
  }
  simulator->set_state(x, v, {});
  const auto momentum = [&](const Positions& velocity) { return Vec3(velocity.transpose() * mass); };
  const Vec3 start = momentum(v);
  for (int k = 0; k < 60; ++k) simulator->step(kNothing);
  const Vec3 wanted = start + Vec3(mass.sum() * Vec3(0.0, 0.0, -kGravity));
  const double error = (momentum(simulator->velocities()) - wanted).norm() / mass.sum();
  return {
      row("momentum", variants[0], "1 s of free flight, speeds 1 m/s at random", "drift m/s", 0.0, error, error, 1e-4)};
}

/// A strip is dropped upright: it falls, crumples, folds over itself and comes to rest. Kinetic plus potential energy
/// must never exceed the initial energy.
std::vector<PhysicsRow> drop_on_end(const PhysicsParams& p, const Variants& variants) {
  Sheet sheet = strip(0.3, 0.1, p.garment_edge_m, Pattern::irregular);
  for (Index i = 0; i < sheet.positions.rows(); ++i) {
    const double s = sheet.flat(i, 0);
    sheet.positions.row(i) << 0.05 * s, sheet.flat(i, 1), 0.05 + std::sqrt(1.0 - 0.0025) * s;
  }
  const Vector mass = lumped_masses(sheet, p.density_kg_per_m2);
  const auto simulator = variants[0].make();
  simulator->reset(sheet.garment("dropped"), test_fabric(p), Scene());
  const auto energy = [&] {
    return kinetic(mass, simulator->velocities()) + kGravity * mass.dot(Vector(simulator->positions().col(2)));
  };
  const double start = energy();
  double worst = 0.0;
  for (int k = 0; k < 180; ++k) {
    simulator->step(kNothing);
    worst = std::max(worst, energy());
  }
  return {
      row("energy", variants[0], "strip dropped on end", "largest energy J", start, worst, worst / start - 1.0, 1e-3)};
}

/// A sheet is stretched by 2 % along warp and released in free space: kinetic energy never exceeds area K E^2/2.
std::vector<PhysicsRow> let_go_stretched(const PhysicsParams& p, const Variants& variants) {
  const Sheet sheet = strip(0.3, 0.3, p.garment_edge_m, Pattern::irregular);
  const Vector mass = lumped_masses(sheet, p.density_kg_per_m2);
  Scene scene = no_ground();
  scene.gravity = Vec3::Zero();
  const auto simulator = variants[0].make();
  simulator->reset(sheet.garment("stretched"), test_fabric(p), scene);
  Positions x = simulator->positions();
  x.col(0) *= 1.02;
  simulator->set_state(x, Positions::Zero(x.rows(), 3), {});
  const double green = 0.5 * (1.02 * 1.02 - 1.0);
  const double start = 0.5 * p.stretch_n_per_m * green * green * 0.09;
  double worst = 0.0;
  for (int k = 0; k < 120; ++k) {
    simulator->step(kNothing);
    worst = std::max(worst, kinetic(mass, simulator->velocities()));
  }
  return {row("energy", variants[0], "stretched sheet let go", "largest kinetic energy J", start, worst,
              worst / start - 1.0, 0.02)};
}

/// The same cantilever (clamp at x = 0 for every mesh) on three meshes; G = 8.
std::vector<PhysicsRow> refine_cantilever(const PhysicsParams& p, const Variants& variants) {
  const Elastica reference = kElastica[4];
  std::vector<PhysicsRow> rows;
  std::vector<double> errors;
  for (const double edge : {0.02, 0.01, 0.005}) {
    const double length = 0.1;
    const Sheet sheet = strip(length + 0.5 * edge, 0.04, edge, Pattern::regular);
    Sheet exact = sheet;
    // The strip's cells are stretched a little, so that half an edge lies behind the clamp.
    const double cells = std::round(length / edge) + 0.5, scale = length / cells;
    for (Index i = 0; i < exact.flat.rows(); ++i) {
      const double s = std::round(sheet.flat(i, 0) / (sheet.length / std::round(sheet.length / edge))) * scale;
      exact.flat(i, 0) = exact.rest(i, 0) = exact.positions(i, 0) = s;
    }
    exact.edge = scale;
    exact.length = exact.flat.col(0).maxCoeff();
    const double free = exact.length - 0.5 * scale;
    const double bend = p.density_kg_per_m2 * kGravity * std::pow(free, 3) / reference.g;
    Fabric fabric = test_fabric(p);
    set_bend(fabric, bend);
    const auto simulator = variants[0].make();
    const Vec2 tip = cantilever(*simulator, exact, fabric, bend);
    errors.push_back(std::hypot(tip.x() - reference.x, tip.y() - reference.drop));
  }
  for (int k = 1; k < 3; ++k)
    rows.push_back(row("refinement", variants[0], k == 1 ? "20 to 10 mm" : "10 to 5 mm", "error of the tip / L",
                       errors[k - 1], errors[k], errors[k] / errors[k - 1], 0.6, "error: ratio of the two"));
  return rows;
}

}  // namespace

void add_dynamics(std::vector<PhysicsCase>& cases, const PhysicsParams& params) {
  struct Test {
    const char *test, *name;
    std::vector<PhysicsRow> (*run)(const PhysicsParams&, const Variants&);
  };
  for (const Test& one : {Test{"free fall", "irregular sheet", free_fall},
                          {"rest", "flat sheet", stay_at_rest},
                          {"momentum", "crumpled free flight", keep_momentum},
                          {"energy", "drop and crumple", drop_on_end},
                          {"energy", "stretched release", let_go_stretched},
                          {"refinement", "cantilever", refine_cantilever}})
    cases.push_back({one.test, one.name, [=](const Variants& variants) { return one.run(params, variants); }});
}

}  // namespace weft::physics
