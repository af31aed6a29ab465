#include "experiments/physics/sheets.hpp"

#include <array>
#include <cmath>

#include "meshes/delaunay.hpp"
#include "weft/random.hpp"

namespace weft::physics {

const char* name_of(Pattern pattern) {
  return pattern == Pattern::regular ? "regular" : pattern == Pattern::rotated ? "rotated" : "irregular";
}

Sheet strip(double length, double width, double edge, Pattern pattern, double turn) {
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
      // Slivers along the straight border are not part of the strip.
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

void set_bend(Fabric& fabric, double bend) {
  fabric.bend_warp_n_m = fabric.bend_weft_n_m = fabric.bend_bias_n_m = bend;
}

Scene no_ground() {
  Scene scene;
  scene.ground_height.reset();
  return scene;
}

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

double hang(Simulator& simulator, const Sheet& sheet, Fabric fabric, double stiffness, double gravity) {
  fabric.damping_air_per_s = 1.5 * std::numbers::pi / sheet.length * std::sqrt(stiffness / fabric.density_kg_per_m2);
  Scene scene = no_ground();
  scene.gravity = {gravity, 0.0, 0.0};
  scene.pins = sheet.column(0.0);
  simulator.reset(sheet.garment("hanging strip"), fabric, scene);
  rest(simulator, 1e-6, 600);
  return mean_of(simulator.positions(), sheet.column(sheet.length)).x() - sheet.length;
}

}  // namespace weft::physics
