#include "experiments/physics/physics.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>

#include "experiments/cpu_time.hpp"
#include "meshes/delaunay.hpp"
#include "meshes/intersections.hpp"
#include "simulation/fold.hpp"
#include "weft/config.hpp"
#include "weft/error.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr double kGravity = 9.81;
const Positions kNothing(0, 3);

// ---------------------------------------------------------------------------------------------------------------------
// Meshes

enum class Pattern { regular, rotated, irregular };
const char* name_of(Pattern pattern) {
  return pattern == Pattern::regular ? "regular" : pattern == Pattern::rotated ? "rotated" : "irregular";
}

struct Sheet {
  Positions positions;
  RestPositions rest;
  Faces faces;
  double edge = 0.0;
  double length = 0.0, width = 0.0;

  std::shared_ptr<const Garment> garment(const char* name = "sheet") const {
    Mesh mesh;
    mesh.positions = positions;
    mesh.rest = rest;
    mesh.faces = faces;
    mesh.source = name;
    return std::make_shared<const Garment>(make_garment(mesh, name));
  }
  /// Vertices whose first rest coordinate along the strip is x.
  std::vector<Index> column(double x) const {
    std::vector<Index> found;
    for (Index i = 0; i < flat.rows(); ++i)
      if (std::abs(flat(i, 0) - x) < 1e-9 * length) found.push_back(i);
    return found;
  }
  RestPositions flat;  ///< along and across the strip, m; rest may be turned against it
};

/// A strip [0, length] x [0, width] of triangles with edges near `edge`. Borders and the first two columns are regular
/// in every pattern, so that a clamp is the same; the inside is a grid, a grid turned by 27 degrees, or a shaken grid,
/// the last two triangulated by Delaunay. @param turn rad: the warp direction makes this angle with the strip.
Sheet strip(double length, double width, double edge, Pattern pattern, double turn = 0.0) {
  const auto nx = static_cast<Index>(std::lround(length / edge)), ny = static_cast<Index>(std::lround(width / edge));
  const double dx = length / static_cast<double>(nx), dy = width / static_cast<double>(ny);
  std::vector<Vec2> points;
  std::vector<std::array<int, 3>> triangles;
  if (pattern == Pattern::regular) {
    for (Index j = 0; j <= ny; ++j)
      for (Index i = 0; i <= nx; ++i) points.emplace_back(static_cast<double>(i) * dx, static_cast<double>(j) * dy);
    for (Index j = 0; j < ny; ++j)
      for (Index i = 0; i < nx; ++i) {
        const int a = static_cast<int>(j * (nx + 1) + i), b = a + 1, c = static_cast<int>(a + nx + 1), d = c + 1;
        triangles.push_back({a, b, d});
        triangles.push_back({a, d, c});
      }
  } else {
    for (Index j = 0; j <= ny; ++j)
      for (Index i = 0; i <= nx; ++i)
        if (i <= 1 || i == nx || j == 0 || j == ny)
          points.emplace_back(static_cast<double>(i) * dx, static_cast<double>(j) * dy);
    RandomStream random(7, static_cast<std::uint64_t>(nx * 1000 + ny));
    const double clear = 0.6;
    const auto inside = [&](const Vec2& p) {
      return p.x() > dx * (1.0 + clear) && p.x() < length - clear * dx && p.y() > clear * dy &&
             p.y() < width - clear * dy;
    };
    if (pattern == Pattern::rotated) {
      const double c = std::cos(0.47), s = std::sin(0.47);
      const Index reach = nx + ny + 2;
      for (Index j = -reach; j <= reach; ++j)
        for (Index i = -reach; i <= reach; ++i) {
          const double u = static_cast<double>(i) * dx, v = static_cast<double>(j) * dy;
          const Vec2 p(0.5 * length + c * u - s * v, 0.5 * width + s * u + c * v);
          if (inside(p)) points.push_back(p);
        }
    } else {
      for (Index j = 1; j < ny; ++j)
        for (Index i = 2; i < nx; ++i) {
          const Vec2 p((static_cast<double>(i) + 0.6 * (random.uniform() - 0.5)) * dx,
                       (static_cast<double>(j) + 0.6 * (random.uniform() - 0.5)) * dy);
          points.push_back(p);
        }
    }
    for (const auto& t : delaunay(points)) {
      // Slivers along the straight border are no part of the strip.
      const Vec2 &a = points[static_cast<std::size_t>(t[0])], &b = points[static_cast<std::size_t>(t[1])],
                 &c = points[static_cast<std::size_t>(t[2])];
      const double area = 0.5 * ((b - a).x() * (c - a).y() - (b - a).y() * (c - a).x());
      if (area > 1e-4 * edge * edge) triangles.push_back(t);
    }
  }
  Sheet sheet;
  sheet.edge = edge;
  sheet.length = length;
  sheet.width = width;
  const auto n = static_cast<Index>(points.size());
  sheet.flat.resize(n, 2);
  sheet.rest.resize(n, 2);
  sheet.positions.resize(n, 3);
  for (Index i = 0; i < n; ++i) {
    const Vec2& p = points[static_cast<std::size_t>(i)];
    sheet.flat.row(i) = p.transpose();
    sheet.rest.row(i) << std::cos(turn) * p.x() + std::sin(turn) * p.y(),
        -std::sin(turn) * p.x() + std::cos(turn) * p.y();
    sheet.positions.row(i) << p.x(), p.y(), 0.0;
  }
  sheet.faces.resize(static_cast<Index>(triangles.size()), 3);
  for (std::size_t f = 0; f < triangles.size(); ++f)
    sheet.faces.row(static_cast<Index>(f)) << triangles[f][0], triangles[f][1], triangles[f][2];
  return sheet;
}

/// Two sheets as one garment of two pieces.
Sheet both(const Sheet& a, const Sheet& b) {
  Sheet sum = a;
  const Index n = a.positions.rows();
  sum.positions.resize(n + b.positions.rows(), 3);
  sum.positions << a.positions, b.positions;
  sum.rest.resize(n + b.rest.rows(), 2);
  sum.rest << a.rest, b.rest;
  sum.flat.resize(n + b.flat.rows(), 2);
  sum.flat << a.flat, b.flat;
  sum.faces.resize(a.faces.rows() + b.faces.rows(), 3);
  sum.faces << a.faces, (b.faces.array() + static_cast<int>(n)).matrix();
  return sum;
}

Vector lumped_masses(const Sheet& sheet, double density) {
  Vector mass = Vector::Zero(sheet.positions.rows());
  for (Index f = 0; f < sheet.faces.rows(); ++f) {
    const auto at = [&](int k) { return sheet.rest.row(sheet.faces(f, k)); };
    const Eigen::RowVector2d u = at(1) - at(0), v = at(2) - at(0);
    const double third = density * std::abs(u.x() * v.y() - u.y() * v.x()) / 6.0;
    for (int k = 0; k < 3; ++k) mass[sheet.faces(f, k)] += third;
  }
  return mass;
}

// ---------------------------------------------------------------------------------------------------------------------
// Running

Fabric test_fabric(const PhysicsParams& p) {
  Fabric fabric;
  fabric.name = "physics";
  fabric.density_kg_per_m2 = p.density_kg_per_m2;
  fabric.stretch_warp_n_per_m = fabric.stretch_weft_n_per_m = p.stretch_n_per_m;
  fabric.stretch_shear_n_per_m = 0.5 * p.stretch_n_per_m;
  fabric.poisson = 0.0;
  fabric.bend_warp_n_m = fabric.bend_weft_n_m = fabric.bend_bias_n_m = p.bend_n_m;
  fabric.damping_stretch_s = fabric.damping_bend_s = fabric.damping_air_per_s = 0.0;
  return fabric;
}
void set_bend(Fabric& fabric, double b) { fabric.bend_warp_n_m = fabric.bend_weft_n_m = fabric.bend_bias_n_m = b; }

Scene no_ground() {
  Scene scene;
  scene.ground_height.reset();
  return scene;
}

/// Steps until the largest speed stays below `speed` for ten frames. @return frames; the limit if it never does.
Index rest(Simulator& simulator, double speed, Index limit) {
  Index calm = 0;
  for (Index k = 1; k <= limit; ++k) {
    simulator.step(kNothing);
    calm = simulator.velocities().rowwise().norm().maxCoeff() < speed ? calm + 1 : 0;
    if (calm >= 10) return k;
  }
  return limit;
}

Vec3 mean_of(const Positions& x, const std::vector<Index>& rows) {
  Vec3 sum = Vec3::Zero();
  for (const Index i : rows) sum += x.row(i).transpose();
  return sum / static_cast<double>(rows.size());
}

PhysicsRow row(std::string test, const SimulatorVariant& variant, std::string name, std::string quantity,
               double reference, double measured, double error, double bound, std::string note = "") {
  PhysicsRow r;
  r.test = std::move(test);
  r.variant = variant.name;
  r.name = std::move(name);
  r.quantity = std::move(quantity);
  r.reference = reference;
  r.measured = measured;
  r.error = error;
  r.bound = bound;
  r.passed = error <= bound;
  r.note = std::move(note);
  return r;
}
PhysicsRow relative(std::string test, const SimulatorVariant& variant, std::string name, std::string quantity,
                    double reference, double measured, double bound, std::string note = "") {
  return row(std::move(test), variant, std::move(name), std::move(quantity), reference, measured,
             std::abs(measured / reference - 1.0), bound, std::move(note));
}

std::string text(const char* format, double a) {
  char buffer[80];
  std::snprintf(buffer, sizeof buffer, format, a);
  return buffer;
}
std::string mm(double edge) { return text("%g mm", 1e3 * edge); }

// ---------------------------------------------------------------------------------------------------------------------
// Tests

/// Heavy elastica: a cantilever of length L under its own weight, B theta'' = w (L - s) cos(theta), for G = w L^3 / B.
struct Elastica {
  double g, x, drop;  ///< G, tip x / L, tip drop / L
};
constexpr Elastica kElastica[] = {{0.5, 0.99778, 0.06231}, {1.0, 0.99125, 0.12347}, {2.0, 0.96689, 0.23851},
                                  {4.0, 0.89011, 0.42516}, {8.0, 0.72442, 0.64063}, {10.0, 0.65635, 0.70020},
                                  {20.0, 0.44523, 0.82988}};

/// Tip of a cantilever at rest: (x / L, drop / L). `fabric` gives the stiffness; drag near the critical one is added.
Vec2 cantilever(Simulator& simulator, const Sheet& sheet, Fabric fabric, double bend) {
  const double length = sheet.length - 0.5 * sheet.edge, rho = fabric.density_kg_per_m2;
  const double frequency = std::sqrt(12.4 * bend / (rho * std::pow(length, 4)) + 1.5 * kGravity / length);
  fabric.damping_air_per_s = 1.4 * frequency;
  Scene scene = no_ground();
  for (const double x : {0.0, sheet.edge})
    for (const Index i : sheet.column(x)) scene.pins.push_back(i);
  simulator.reset(sheet.garment("cantilever"), fabric, scene);
  rest(simulator, 2e-4, 900);
  const Vec3 tip = mean_of(simulator.positions(), sheet.column(sheet.length));
  return {(tip.x() - 0.5 * sheet.edge) / length, -tip.z() / length};
}

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
  // The nominal bending stiffness: the lengths that a garment's folds have.
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

/// Tip extension of a strip that hangs by one column, m.
double hang(Simulator& simulator, const Sheet& sheet, Fabric fabric, double stiffness) {
  fabric.damping_air_per_s = 1.5 * std::numbers::pi / sheet.length * std::sqrt(stiffness / fabric.density_kg_per_m2);
  Scene scene = no_ground();
  scene.gravity = {kGravity, 0.0, 0.0};
  scene.pins = sheet.column(0.0);
  simulator.reset(sheet.garment("hanging strip"), fabric, scene);
  rest(simulator, 1e-6, 600);
  return mean_of(simulator.positions(), sheet.column(sheet.length)).x() - sheet.length;
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
             // Starts as a circular arc of that length: half angle a with sin(a)/a = d/L.
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

/// Mean slide (m) of a sheet down a slope tan(alpha) = slope after `seconds`; also the largest motion of any vertex.
struct Slide {
  double mean = 0.0, largest = 0.0;
};
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

/// Height of a heavy folded strip's loop over its lower layer's mid-surface. At both ends of the loop the layers touch
/// down without curvature; the loop pushes the layers apart, so they must stick (friction 1, layers long enough), and
/// it finds its length by rolling on and off them. The strip starts as two layers and a lower, tighter half circle.
double crease(Simulator& simulator, double edge, double bend, Pattern pattern, const PhysicsParams& p) {
  Fabric fabric = test_fabric(p);
  set_bend(fabric, bend);
  fabric.friction = fabric.self_friction = 1.0;
  fabric.thickness_m = 0.0005;
  const double l = std::cbrt(bend / (p.density_kg_per_m2 * kGravity));
  const double layer = std::max(6.0 * l, 6.0 * edge), radius = 0.35 * l, arc = std::numbers::pi * radius;
  const double cells = std::round((2.0 * layer + arc) / edge);
  Sheet sheet = strip(cells * edge, 4 * edge, edge, pattern);
  const double bottom = 0.5 * (sheet.length - arc);
  for (Index i = 0; i < sheet.positions.rows(); ++i) {
    const double s = sheet.flat(i, 0);
    double x = s, z = 0.0;
    if (s > bottom) {
      const double a = std::min((s - bottom) / radius, std::numbers::pi);
      x = bottom + radius * std::sin(a) - std::max(0.0, s - bottom - arc);
      z = radius * (1.0 - std::cos(a));
    }
    sheet.positions.row(i) << x, sheet.flat(i, 1), z + fabric.thickness_m;
  }
  fabric.damping_air_per_s = 6.0;
  simulator.reset(sheet.garment("crease"), fabric, Scene());
  rest(simulator, 1e-3, 600);
  return simulator.positions().col(2).maxCoeff() - fabric.thickness_m;
}

void add_crease(std::vector<PhysicsCase>& cases, const PhysicsParams& p, const std::shared_ptr<const Task>& task) {
  struct Level {
    double edge, edges_per_length;  // (B / w)^(1/3) in edges
  };
  for (const Level level : {Level{p.fine_edge_m, 3.0},
                            {p.fine_edge_m, 5.0},
                            {p.fine_edge_m, 10.0},
                            {2 * p.fine_edge_m, 3.0},
                            {2 * p.fine_edge_m, 5.0},
                            {p.garment_edge_m, 3.0}})
    for (const Pattern pattern : {Pattern::regular, Pattern::rotated, Pattern::irregular}) {
      const std::string name =
          mm(level.edge) + " " + name_of(pattern) + text(" (B/w)^1/3 = %g edges", level.edges_per_length);
      cases.push_back({"crease", name, [=](const std::vector<SimulatorVariant>& variants) {
                         const double l = level.edge * level.edges_per_length;
                         const double bend = std::pow(l, 3) * p.density_kg_per_m2 * kGravity;
                         const auto simulator = variants[0].make();
                         return std::vector<PhysicsRow>{relative("crease", variants[0], name, "height m", 0.907 * l,
                                                                 crease(*simulator, level.edge, bend, pattern, p),
                                                                 0.10)};
                       }});
    }
  if (task) {
    cases.push_back(
        {"garment crease", "default fold", [=](const std::vector<SimulatorVariant>& variants) {
           const Task& t = *task;
           const auto simulator = variants[0].make();
           const MaterialProperties q = MaterialProperties::Constant(0.5);
           const FoldResult fold = simulate_fold(*simulator, t, q, t.trajectory->default_controls(25));
           const Fabric fabric = t.material.at(q);
           // The fold line is normal to d; bending runs along d.
           const Vec2 d = t.manipulation.displacement / t.manipulation.displacement.norm();
           const double c2 = d.x() * d.x(), s2 = d.y() * d.y();
           const double bend = fabric.bend_warp_n_m * c2 * c2 + fabric.bend_weft_n_m * s2 * s2 +
                               (4 * fabric.bend_bias_n_m - fabric.bend_warp_n_m - fabric.bend_weft_n_m) * c2 * s2;
           const double wanted = 0.907 * std::cbrt(bend / (fabric.density_kg_per_m2 * kGravity));
           // In bands across the fold line: the highest point within 1.5 loops of the outermost one.
           const Positions& x = fold.shapes.back();
           const Vector along = x.leftCols<2>() * d, across = x.leftCols<2>() * Vec2(-d.y(), d.x());
           const double low = across.minCoeff(), high = across.maxCoeff();
           std::vector<double> heights;
           constexpr int kBands = 12;
           for (int band = 2; band < kBands - 3; ++band) {
             const double from = low + (high - low) * band / kBands, to = low + (high - low) * (band + 1) / kBands;
             double outermost = 1e300, highest = 0.0;
             for (Index i = 0; i < x.rows(); ++i)
               if (across[i] >= from && across[i] < to) outermost = std::min(outermost, along[i]);
             for (Index i = 0; i < x.rows(); ++i)
               if (across[i] >= from && across[i] < to && along[i] < outermost + 1.5 * wanted)
                 highest = std::max(highest, x(i, 2));
             heights.push_back(highest - fabric.thickness_m);
           }
           std::sort(heights.begin(), heights.end());
           return std::vector<PhysicsRow>{relative(
               "garment crease", variants[0], t.garment->name + text(", %.0f vertices", static_cast<double>(x.rows())),
               "median height m", wanted, heights[heights.size() / 2], 0.25,
               text("from %.4f", heights.front()) + text(" to %.4f", heights.back()))};
         }});
  }
}

double kinetic(const Vector& mass, const Positions& v) {
  return 0.5 * (mass.array() * v.rowwise().squaredNorm().array()).sum();
}

void add_dynamics(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  cases.push_back({"free fall", "irregular sheet", [=](const std::vector<SimulatorVariant>& variants) {
                     const Sheet sheet = strip(0.2, 0.2, p.garment_edge_m, Pattern::irregular);
                     Scene scene = no_ground();
                     scene.initial_velocity = {0.3, -0.2, 0.5};
                     const auto simulator = variants[0].make();
                     simulator->reset(sheet.garment("falling"), test_fabric(p), scene);
                     const Positions start = simulator->positions();
                     for (int k = 0; k < 60; ++k) simulator->step(kNothing);
                     const Vec3 way = scene.initial_velocity + Vec3(0.5 * scene.gravity);
                     const double worst =
                         (simulator->positions() - (start.rowwise() + way.transpose())).rowwise().norm().maxCoeff();
                     return std::vector<PhysicsRow>{row("free fall", variants[0], "1 s, irregular sheet", "error m",
                                                        0.0, worst, worst / (0.5 * kGravity), 2e-3,
                                                        "error as a part of g t^2/2")};
                   }});
  cases.push_back({"rest", "flat sheet", [=](const std::vector<SimulatorVariant>& variants) {
                     const Sheet sheet = strip(0.3, 0.3, p.garment_edge_m, Pattern::irregular);
                     const auto simulator = variants[0].make();
                     simulator->reset(sheet.garment("resting"), test_fabric(p), Scene());
                     const Positions start = simulator->positions();
                     for (int k = 0; k < 120; ++k) simulator->step(kNothing);
                     const double moved = (simulator->positions() - start).rowwise().norm().maxCoeff();
                     return std::vector<PhysicsRow>{
                         row("rest", variants[0], "2 s on the ground", "motion m", 0.0, moved, moved, 1e-6)};
                   }});
  cases.push_back({"momentum", "crumpled free flight", [=](const std::vector<SimulatorVariant>& variants) {
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
                     return std::vector<PhysicsRow>{row("momentum", variants[0],
                                                        "1 s of free flight, speeds 1 m/s at random", "drift m/s", 0.0,
                                                        error, error, 1e-4)};
                   }});
  cases.push_back({"energy", "drop and crumple", [=](const std::vector<SimulatorVariant>& variants) {
                     // A strip dropped on end: it falls, crumples, folds over itself and comes to rest. Kinetic plus
                     // potential energy may go into the cloth and never exceeds what was there.
                     Sheet sheet = strip(0.3, 0.1, p.garment_edge_m, Pattern::irregular);
                     for (Index i = 0; i < sheet.positions.rows(); ++i) {
                       const double s = sheet.flat(i, 0);
                       sheet.positions.row(i) << 0.05 * s, sheet.flat(i, 1), 0.05 + std::sqrt(1.0 - 0.0025) * s;
                     }
                     const Vector mass = lumped_masses(sheet, p.density_kg_per_m2);
                     const auto simulator = variants[0].make();
                     simulator->reset(sheet.garment("dropped"), test_fabric(p), Scene());
                     const auto energy = [&] {
                       return kinetic(mass, simulator->velocities()) +
                              kGravity * mass.dot(Vector(simulator->positions().col(2)));
                     };
                     const double start = energy();
                     double worst = 0.0;
                     for (int k = 0; k < 180; ++k) {
                       simulator->step(kNothing);
                       worst = std::max(worst, energy());
                     }
                     return std::vector<PhysicsRow>{row("energy", variants[0], "strip dropped on end",
                                                        "largest energy J", start, worst, worst / start - 1.0, 1e-3)};
                   }});
  cases.push_back({"energy", "stretched release", [=](const std::vector<SimulatorVariant>& variants) {
                     // Uniform stretch of 2 % along warp, let go in free space: kinetic energy never exceeds area K
                     // E^2/2.
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
                     return std::vector<PhysicsRow>{row("energy", variants[0], "stretched sheet let go",
                                                        "largest kinetic energy J", start, worst, worst / start - 1.0,
                                                        0.02)};
                   }});
  cases.push_back(
      {"refinement", "cantilever", [=](const std::vector<SimulatorVariant>& variants) {
         // The same cantilever (clamp at x = 0 for every mesh) on three meshes; G = 8.
         const Elastica reference = kElastica[4];
         std::vector<PhysicsRow> rows;
         std::vector<double> errors;
         for (const double edge : {0.02, 0.01, 0.005}) {
           const double length = 0.1;
           const Sheet sheet = strip(length + 0.5 * edge, 0.04, edge, Pattern::regular);
           Sheet exact = sheet;
           // Cells of the strip are stretched a little so that half an edge lies behind the clamp.
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
       }});
}

// ---------------------------------------------------------------------------------------------------------------------
// Folds of the task

/// Largest |principal stretch - 1| over the faces that are no closer than `radius` (m, at rest) to a grasped vertex.
class StrainAwayFromGrasps {
 public:
  StrainAwayFromGrasps(const Task& task, double radius) : garment_(*task.garment) {
    for (Index f = 0; f < garment_.face_count(); ++f) {
      bool near = false;
      for (int k = 0; k < 3; ++k)
        for (const Index grasp : task.manipulation.grasp_vertices)
          near |= (garment_.rest.row(garment_.faces(f, k)) - garment_.rest.row(grasp)).norm() <= radius;
      if (!near) faces_.push_back(f);
    }
  }
  double operator()(const Positions& x) const {
    double worst = 0.0;
    for (const Index f : faces_) {
      Eigen::Matrix2d rest;
      Eigen::Matrix<double, 3, 2> now;
      for (int k = 0; k < 2; ++k) {
        const int i = garment_.faces(f, 0), j = garment_.faces(f, k + 1);
        rest.col(k) = (garment_.rest.row(j) - garment_.rest.row(i)).transpose();
        now.col(k) = (x.row(j) - x.row(i)).transpose();
      }
      const Eigen::Matrix<double, 3, 2> deformation = now * rest.inverse();
      const Eigen::Matrix2d c = deformation.transpose() * deformation;
      const double mean = 0.5 * (c(0, 0) + c(1, 1)), apart = std::hypot(0.5 * (c(0, 0) - c(1, 1)), c(0, 1));
      for (const double square : {mean + apart, mean - apart})
        worst = std::max(worst, std::abs(std::sqrt(std::max(0.0, square)) - 1.0));
    }
    return worst;
  }

 private:
  const Garment& garment_;
  std::vector<Index> faces_;
};

struct RandomFold {
  MaterialProperties material;
  Controls controls;
};
RandomFold random_fold(const Task& task, const PhysicsParams::Folds& p, std::uint64_t seed) {
  RandomStream random(seed, 0x666f6c64);
  RandomFold fold;
  for (Index k = 0; k < fold.material.size(); ++k) fold.material[k] = random.uniform();
  fold.controls = random_controls(*task.trajectory, p.horizon, p.controls, random);
  return fold;
}

/// Worst of a group of folds, with the seeds that are out of bounds.
class Worst {
 public:
  Worst(std::string quantity, double bound) : quantity_(std::move(quantity)), bound_(bound) {}
  void add(std::uint64_t seed, double value) {
    if (by_seed_.empty() || by_seed_.back().first != seed) by_seed_.emplace_back(seed, value);
    by_seed_.back().second = std::max(by_seed_.back().second, value);
    if (value > worst_) worst_ = value, worst_seed_ = seed;
    if (!(value <= bound_) && last_failed_ != seed) {
      failed_ += " " + std::to_string(seed);
      last_failed_ = seed;
    }
  }
  PhysicsRow row_of(const SimulatorVariant& variant, const std::string& name) const {
    std::string note;
    if (!failed_.empty())
      note = "failing seeds:" + failed_;
    else if (worst_ > 0.0)
      note = "largest at seed " + std::to_string(worst_seed_);
    PhysicsRow result = row("folds", variant, name, quantity_, 0.0, worst_, worst_, bound_, note);
    result.by_seed = by_seed_;
    return result;
  }

 private:
  std::vector<std::pair<std::uint64_t, double>> by_seed_;
  std::string quantity_, failed_;
  double bound_ = 0.0, worst_ = 0.0;
  std::uint64_t worst_seed_ = 0, last_failed_ = std::numeric_limits<std::uint64_t>::max();
};

std::vector<PhysicsRow> random_folds(const SimulatorVariant& variant, const std::string& name, const Task& task,
                                     const PhysicsParams::Folds& p, std::uint64_t first, std::uint64_t end) {
  const StrainAwayFromGrasps strain(task, p.grasp_radius_m);
  const double ground = task.scene.ground_height.value_or(-1e300);
  Worst diverged("diverged", 0.0), crossings("edge/triangle crossings", 0.0), below("below ground m", 0.0);
  Worst speed("settled speed m/s", task.settle.speed), stretched("strain of the stiff half", 0.05);
  for (std::uint64_t seed = first; seed < end; ++seed) {
    const RandomFold fold = random_fold(task, p, seed);
    const auto simulator = variant.make();
    FoldResult result;
    try {
      result = simulate_fold(*simulator, task, fold.material, fold.controls);
    } catch (const Diverged&) {
      diverged.add(seed, 1.0);
      continue;
    }
    diverged.add(seed, 0.0);
    if (!result.released) {  // a path that the horizon cuts short: let go where it ends
      simulator->release();
      result.settle = simulator->settle(task.settle);
      result.shapes.back() = simulator->positions();
    }
    const Positions& x = result.shapes.back();
    crossings.add(seed, static_cast<double>(count_intersections(x, task.garment->faces)));
    below.add(seed, std::max(0.0, ground - x.col(2).minCoeff()));
    speed.add(seed, result.settle.max_speed);
    if (fold.material[2] < 0.5) continue;
    for (const Positions& shape : result.shapes) stretched.add(seed, strain(shape));
  }
  std::vector<PhysicsRow> rows;
  for (const Worst* one : {&diverged, &crossings, &below, &speed, &stretched})
    rows.push_back(one->row_of(variant, name));
  return rows;
}

/// The same fold, fabric and hands in each simulator, of which there are one or two: what each makes of it, and how far
/// apart the settled shapes are.
std::vector<PhysicsRow> paired_fold(const std::vector<SimulatorVariant>& variants, const std::string& name,
                                    const Task& task, const PhysicsParams::Folds& p, std::uint64_t seed) {
  const RandomFold fold = random_fold(task, p, seed);
  std::vector<Positions> shapes;
  std::vector<PhysicsRow> rows;
  const auto add = [&](const SimulatorVariant& variant, const char* quantity, double measured, double bound) {
    rows.push_back(row("paired folds", variant, name, quantity, 0.0, measured, measured, bound));
    rows.back().by_seed = {{seed, measured}};
  };
  for (const SimulatorVariant& variant : variants) {
    const auto simulator = variant.make();
    const double before = thread_cpu_seconds();
    FoldResult result = simulate_fold(*simulator, task, fold.material, fold.controls);
    if (!result.released) {
      simulator->release();
      result.settle = simulator->settle(task.settle);
    }
    const double ms = 1e3 * (thread_cpu_seconds() - before) / static_cast<double>(simulator->frame());
    shapes.push_back(simulator->positions());
    const double ground = task.scene.ground_height.value_or(-1e300);
    add(variant, "edge/triangle crossings",
        static_cast<double>(count_intersections(shapes.back(), task.garment->faces)), 0.0);
    add(variant, "below ground m", std::max(0.0, ground - shapes.back().col(2).minCoeff()), 0.0);
    add(variant, "settled speed m/s", result.settle.max_speed, task.settle.speed);
    rows.back().cpu_ms_per_frame = ms;
    rows.back().note = text("CPU %.1f ms/frame", ms);
  }
  // Two models of cloth: no bound follows from either. A fold gone another way would be off by decimetres.
  if (variants.size() > 1) {
    add(variants[0], "mean vertex distance mm", mean_distance_mm(shapes[0], shapes[1]), 100.0);
    rows.back().note = "from " + variants[1].name;
  }
  return rows;
}

void add_folds(std::vector<PhysicsCase>& cases, const PhysicsParams& p, const std::shared_ptr<const Task>& task) {
  if (!task) return;
  constexpr std::uint64_t kGroup = 10;
  const auto first = static_cast<std::uint64_t>(p.folds.first_seed);
  const auto end = first + static_cast<std::uint64_t>(p.folds.count);
  for (std::uint64_t from = first; from < end; from += kGroup) {
    const std::uint64_t to = std::min(end, from + kGroup);
    const std::string name = "seeds " + std::to_string(from) + " to " + std::to_string(to - 1);
    cases.push_back({"folds", name, [=](const std::vector<SimulatorVariant>& variants) {
                       return random_folds(variants[0], name, *task, p.folds, from, to);
                     }});
  }
  for (std::uint64_t seed = first; seed < first + static_cast<std::uint64_t>(p.folds.paired); ++seed) {
    const std::string name = "seed " + std::to_string(seed);
    cases.push_back({"paired folds", name, [=](const std::vector<SimulatorVariant>& variants) {
                       return paired_fold(variants, name, *task, p.folds, seed);
                     }});
  }
  // The settled shape of the default fold.
  const auto settled = [task, horizon = p.folds.horizon](const SimulatorVariant& variant, const MaterialProperties& q) {
    const auto simulator = variant.make();
    return simulate_fold(*simulator, *task, q, task->trajectory->default_controls(horizon)).shapes.back();
  };
  for (Index k = 0; k < static_cast<Index>(kPropertyNames.size()); ++k) {
    const std::string name = std::string(kPropertyNames[static_cast<std::size_t>(k)]) + " from 0 to 1";
    cases.push_back({"properties", name, [=](const std::vector<SimulatorVariant>& variants) {
                       MaterialProperties low = MaterialProperties::Constant(0.5), high = low;
                       low[k] = 0.0, high[k] = 1.0;
                       const double moved = mean_distance_mm(settled(variants[0], low), settled(variants[0], high));
                       return std::vector<PhysicsRow>{row("properties", variants[0], name, "settled shape moves mm",
                                                          1.0, moved, 1.0 / moved, 1.0, "at least the reference")};
                     }});
  }
  // A chaotic fold would move by millimetres.
  const std::string name = "friction + 0.001";
  cases.push_back({"properties", name, [=](const std::vector<SimulatorVariant>& variants) {
                     const PropertyRange& friction = task->material.ranges[0];
                     MaterialProperties a = MaterialProperties::Constant(0.5), b = a;
                     b[0] = friction.inverse(friction.at(0.5) + 0.001);
                     const double moved = mean_distance_mm(settled(variants[0], a), settled(variants[0], b));
                     return std::vector<PhysicsRow>{
                         row("properties", variants[0], name, "settled shape moves mm", 0.0, moved, moved, 0.2)};
                   }});
}

}  // namespace

std::vector<std::string> physics_test_names() {
  return {"elastica",     "orthotropy", "hanging",        "catenary", "incline",      "cloth on cloth",
          "thrown sheet", "crease",     "garment crease", "folds",    "paired folds", "properties",
          "free fall",    "rest",       "momentum",       "energy",   "refinement"};
}

std::vector<PhysicsCase> physics_cases(const PhysicsParams& params, std::shared_ptr<const Task> task,
                                       const ConfigNode& origin) {
  const auto known = physics_test_names();
  for (std::size_t i = 0; i < params.tests.size(); ++i) {
    const std::string& name = params.tests[i];
    if (std::find(known.begin(), known.end(), name) == known.end())
      place(origin, "physics.tests." + std::to_string(i))
          .fail("= " + name + ", must be " + one_of(known) + nearest_hint(name, known));
  }
  std::vector<PhysicsCase> all;
  add_elastica(all, params);
  add_hanging(all, params);
  add_catenary(all, params);
  add_incline(all, params);
  add_crease(all, params, task);
  add_folds(all, params, task);
  add_dynamics(all, params);
  if (params.tests.empty()) return all;
  std::vector<PhysicsCase> chosen;
  for (auto& one : all)
    if (std::find(params.tests.begin(), params.tests.end(), one.test) != params.tests.end())
      chosen.push_back(std::move(one));
  if (chosen.empty()) {
    const ConfigNode tests = place(origin, "physics.tests");
    tests.fail("= " + shown(tests) + " leaves no case to run: physics.folds.count = " +
               std::to_string(params.folds.count) + ", physics.folds.paired = " + std::to_string(params.folds.paired));
  }
  return chosen;
}

SimulatorVariant simulator_variant(std::string name, Host& host, const ConfigNode& slot) {
  return {std::move(name), [&host, slot] { return host.create<Simulator>(slot); }};
}

std::vector<PhysicsRow> run_physics_case(const PhysicsCase& physics_case,
                                         const std::vector<SimulatorVariant>& variants) {
  try {
    return physics_case.run(variants);
  } catch (const std::exception& error) {
    PhysicsRow failed = row(physics_case.test, variants.at(0), physics_case.name, "exception", 0.0, 0.0,
                            std::numeric_limits<double>::infinity(), 0.0, error.what());
    return {failed};
  }
}

std::string format_physics_row(const PhysicsRow& r) {
  char line[400];
  std::snprintf(line, sizeof line,
                "%-4s %-15s %-8s %-46s %-22s reference %-10.5g measured %-10.5g error %-9.3g bound %-7.3g %s",
                r.passed ? "ok" : "FAIL", r.test.c_str(), r.variant.c_str(), r.name.c_str(), r.quantity.c_str(),
                r.reference, r.measured, r.error, r.bound, r.note.c_str());
  return line;
}

}  // namespace weft
