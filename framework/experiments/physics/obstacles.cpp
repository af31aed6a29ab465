#include "experiments/physics/obstacles.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "experiments/physics/closed_forms.hpp"
#include "experiments/physics/sheets.hpp"

namespace weft::physics {
namespace {

constexpr double kQuarter = 0.5 * std::numbers::pi;

Obstacle bar(double radius, double width) {
  Obstacle o;
  o.kind = Obstacle::Kind::cylinder;
  o.name = "cylinder";
  o.axes = Eigen::AngleAxisd(-kQuarter, Eigen::Vector3d::UnitX()).toRotationMatrix();  // along y
  o.half_size = {radius, radius, width};
  o.centre = {0.0, 0.5 * width, 0.0};
  o.rounding = 0.1 * radius;
  return o;
}

/// A box whose top goes through the origin, its half-edges `half`.
Obstacle box_below(const Eigen::Matrix3d& axes, const Vec3& half, double rounding) {
  Obstacle o;
  o.kind = Obstacle::Kind::box;
  o.name = "box";
  o.axes = axes;
  o.half_size = half;
  o.centre = -half.z() * axes.col(2);
  o.rounding = rounding;
  return o;
}

/// A sheet on a box that is tilted about y by tan(alpha) = slope. Gravity stays vertical.
Slide slide_on_box(Simulator& simulator, const Sheet& sheet, const Fabric& fabric, double slope, double seconds) {
  const Eigen::Matrix3d axes = Eigen::AngleAxisd(std::atan(slope), Eigen::Vector3d::UnitY()).toRotationMatrix();
  Scene scene = no_ground();
  scene.obstacles = {box_below(axes, {2.0, 2.0, 0.5}, 0.01)};
  Sheet tilted = sheet;
  tilted.positions.col(2).setConstant(fabric.thickness_m);
  tilted.positions = tilted.positions * axes.transpose();
  simulator.reset(tilted.garment("tilted box"), fabric, scene);
  const Positions start = simulator.positions();
  const Index frames = std::lround(seconds / kFrameSeconds);
  for (Index k = 0; k < frames; ++k) simulator.step(kNothing);
  const Positions moved = simulator.positions() - start;
  return {(moved * axes.col(0)).mean(), moved.rowwise().norm().maxCoeff()};
}

/// The tension (N/m) along a strip between two of its columns: St. Venant-Kirchhoff, K E dx/ds with Green's E.
double tension(const Sheet& sheet, const Positions& x, double from, double to, double stiffness) {
  const double stretch = (mean_of(x, sheet.column(to)) - mean_of(x, sheet.column(from))).norm() / (to - from);
  return 0.5 * stiffness * (stretch * stretch - 1.0) * stretch;
}

/// A weightless strip lies over a bar, wrapped around it by `phi`. One end is pinned, the other is pulled slowly, so that
/// it slips everywhere towards the hand. @return T2 / T1 on the two straight parts.
double capstan(Simulator& simulator, double edge, double radius, double phi, Fabric fabric) {
  const double straight = 6.0 * edge, around = (radius + fabric.thickness_m) * phi;
  const double length = edge * std::round((2.0 * straight + around) / edge);
  Sheet sheet = strip(length, 3.0 * edge, edge, Pattern::regular);
  const double r = radius + fabric.thickness_m, first = 0.5 * (length - around);
  for (Index i = 0; i < sheet.positions.rows(); ++i) {
    const double s = sheet.flat(i, 0) - first, y = sheet.flat(i, 1);
    // The angle from the top, and how far the point is beyond the arc along the tangent there.
    const double a = std::clamp(s / r, 0.0, phi) - 0.5 * phi, beyond = s - std::clamp(s, 0.0, around);
    sheet.positions.row(i) << r * std::sin(a) + beyond * std::cos(a), y, r * std::cos(a) - beyond * std::sin(a);
  }
  fabric.damping_air_per_s = 2.0;
  fabric.damping_stretch_s = 1e-3;
  set_bend(fabric, 1e-7);
  Scene scene = no_ground();
  scene.gravity.setZero();
  scene.obstacles = {bar(radius, 0.2)};
  scene.pins = sheet.column(0.0);
  simulator.reset(sheet.garment("capstan"), fabric, scene);
  const auto hand = sheet.column(length);
  simulator.grasp(hand);
  Positions targets(std::ssize(hand), 3);
  for (Index k = 0; k < targets.rows(); ++k) targets.row(k) = simulator.positions().row(hand[k]);
  const Vec3 way(std::cos(0.5 * phi), 0.0, -std::sin(0.5 * phi));
  constexpr Index frames = 120, last = 48;
  double sum = 0.0;
  for (Index k = 0; k < frames; ++k) {
    targets.rowwise() += (0.025 * length / frames * way).transpose();
    simulator.step(targets);
    if (k + last < frames) continue;
    const Positions& x = simulator.positions();
    const double stiffness = fabric.stretch_warp_n_per_m;
    sum += tension(sheet, x, length - 4.0 * edge, length, stiffness) / tension(sheet, x, 0.0, 4.0 * edge, stiffness);
  }
  return sum / last;
}

/// Whether a strip of which `overhang` is not on a table's top slips from it within a second.
bool slips_from_table(Simulator& simulator, double edge, double rounding, double overhang, double length,
                      const Fabric& fabric) {
  Sheet sheet = strip(length, 3.0 * edge, edge, Pattern::regular);
  const double r = rounding + fabric.thickness_m, around = r * kQuarter, first = length - overhang;
  for (Index i = 0; i < sheet.positions.rows(); ++i) {
    const double s = sheet.flat(i, 0) - first, y = sheet.flat(i, 1);
    const double a = std::clamp(s / r, 0.0, kQuarter), down = std::max(0.0, s - around);
    sheet.positions.row(i) << std::min(s, 0.0) + r * std::sin(a), y, r * (std::cos(a) - 1.0) - down;
  }
  sheet.positions.col(2).array() += fabric.thickness_m;
  Scene scene = no_ground();
  scene.obstacles = {box_below(Eigen::Matrix3d::Identity(), {1.0, 1.0, 0.5}, rounding)};
  scene.obstacles[0].centre.x() = rounding - 1.0;
  // The weight comes on in heavy drag, so that the strip does not swing beyond its extension at rest.
  Fabric dragged = fabric;
  dragged.damping_air_per_s = 300.0;
  const auto garment = sheet.garment("overhang");
  simulator.reset(garment, dragged, scene);
  for (int k = 0; k < 45; ++k) simulator.step(kNothing);
  const Positions loaded = simulator.positions();
  simulator.reset(garment, fabric, scene);
  simulator.set_state(loaded, Positions::Zero(loaded.rows(), 3), {});
  for (int k = 0; k < 60; ++k) simulator.step(kNothing);
  return (simulator.positions() - loaded).col(0).mean() > 2e-3;
}

}  // namespace

double overhang_at_slip(double length, double rho, double mu) {
  const double grow = std::exp(mu * kQuarter), arc = rho * kQuarter;
  const double round = rho * (2.0 * mu - grow * (1.0 - mu * mu)) / (1.0 + mu * mu);
  return arc + (grow * mu * (length - arc) + round) / (1.0 + grow * mu);
}

void add_obstacles(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  for (const double edge : {p.garment_edge_m, 0.5 * p.garment_edge_m})
    for (const double mu : {0.1, 0.5, 1.0}) {
      const std::string name = mm(edge) + text(" mu=%g", mu);
      cases.push_back({"tilted box", name, [=](const std::vector<SimulatorVariant>& variants) {
                         const Sheet sheet = strip(0.2, 0.2, edge, Pattern::irregular);
                         Fabric fabric = test_fabric(p);
                         fabric.friction = mu;
                         std::vector<PhysicsRow> rows;
                         for (const auto& variant : variants)
                           incline_rows(rows, "tilted box", variant, name, mu, 0.5, 0.02,
                                        [&](Simulator& simulator, double slope, double t) {
                                          return slide_on_box(simulator, sheet, fabric, slope, t);
                                        });
                         return rows;
                       }});
    }
  // The strip turns by a quarter of a radian at a vertex: the error of the exponent grows with the square of that angle.
  struct Wrap {
    double edge, phi;
  };
  for (const Wrap& wrap : {Wrap{p.garment_edge_m, kQuarter}, Wrap{p.garment_edge_m, 2.0 * kQuarter},
                           Wrap{0.5 * p.garment_edge_m, 2.0 * kQuarter}})
    for (const double mu : {0.1, 0.3, 0.6}) {
      const std::string name =
          mm(wrap.edge) + text(" over %.0f degrees", wrap.phi * 90.0 / kQuarter) + text(" mu=%g", mu);
      cases.push_back({"capstan", name, [=](const std::vector<SimulatorVariant>& variants) {
                         Fabric fabric = test_fabric(p);
                         fabric.friction = mu;
                         std::vector<PhysicsRow> rows;
                         for (const auto& variant : variants)
                           rows.push_back(
                               relative("capstan", variant, name, "T2/T1", std::exp(mu * wrap.phi),
                                        capstan(*variant.make(), wrap.edge, 4.0 * wrap.edge, wrap.phi, fabric), 0.03));
                         return rows;
                       }});
    }
  // The edge of a table is round over three edges of the mesh, and, as tables are, over half of one.
  struct Table {
    double edge, rounding, bound;
  };
  for (const Table& table : {Table{p.garment_edge_m, 3.0 * p.garment_edge_m, 0.03},
                             {0.5 * p.garment_edge_m, 1.5 * p.garment_edge_m, 0.03},
                             {p.garment_edge_m, 0.5 * p.garment_edge_m, 0.1}})
    for (const double mu : {0.2, 0.5}) {
      const std::string name = mm(table.edge) + text(" rounding=%g m", table.rounding) + text(" mu=%g", mu);
      cases.push_back(
          {"table edge", name, [=](const std::vector<SimulatorVariant>& variants) {
             constexpr double length = 0.6;
             Fabric fabric = test_fabric(p);
             fabric.friction = mu;
             fabric.damping_stretch_s = 1e-3;
             set_bend(fabric, 1e-7);
             const double wanted = overhang_at_slip(length, table.rounding + fabric.thickness_m, mu);
             const auto simulator = variants[0].make();
             double low = 0.9 * wanted, high = 1.1 * wanted;
             for (int k = 0; k < 6; ++k) {
               const double middle = 0.5 * (low + high);
               (slips_from_table(*simulator, table.edge, table.rounding, middle, length, fabric) ? high : low) = middle;
             }
             return std::vector<PhysicsRow>{relative("table edge", variants[0], name, "overhang at slip, m", wanted,
                                                     0.5 * (low + high), table.bound)};
           }});
    }
}

}  // namespace weft::physics
