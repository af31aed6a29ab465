// The parts of the cloth simulator against plain versions, and its promises as a simulator. Closed forms are in
// test_cloth_physics.cpp.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>

#include <cmath>
#include <cstring>
#include <set>

// Compiled in, so that the parts can be reached (with -march as the plugin).
#include "meshes/intersections.hpp"
#include "meshes/mesher.hpp"
#include "meshes/sewing.hpp"
#include "plugins/counted_allocations.hpp"
#include "simulator/cloth/bending_patch.cpp"
#include "simulator/cloth/cloth.cpp"
#include "simulator/cloth/contact.cpp"
#include "simulator/cloth/contact_search.cpp"
#include "simulator/cloth/elements.cpp"
#include "simulator/cloth/mass_scaling.cpp"
#include "simulator/cloth/obstacle_contact.cpp"
#include "simulator/cloth/patches.cpp"
#include "simulator/cloth/stability.cpp"
#include "simulator/cloth/tables.cpp"
#include "simulator/cloth/topology.cpp"
#include "unit/test_support.hpp"
#include "weft/random.hpp"

namespace weft::cloth {
namespace {

using testing::HasSubstr;

/// nx x ny vertices h apart, inner ones shaken by `shake` of h.
Garment sheet(Index nx, Index ny, double h, double shake = 0.0) {
  Garment g;
  g.name = "sheet";
  g.positions.resize(nx * ny, 3);
  g.rest.resize(nx * ny, 2);
  RandomStream random(3, 1);
  for (Index j = 0; j < ny; ++j)
    for (Index i = 0; i < nx; ++i) {
      const bool inner = i > 0 && j > 0 && i + 1 < nx && j + 1 < ny;
      const double x = (static_cast<double>(i) + (inner ? shake * (random.uniform() - 0.5) : 0.0)) * h;
      const double y = (static_cast<double>(j) + (inner ? shake * (random.uniform() - 0.5) : 0.0)) * h;
      g.rest.row(j * nx + i) << x, y;
      g.positions.row(j * nx + i) << x, y, 0.0;
    }
  g.faces.resize(2 * (nx - 1) * (ny - 1), 3);
  Index f = 0;
  for (Index j = 0; j + 1 < ny; ++j)
    for (Index i = 0; i + 1 < nx; ++i) {
      const int a = static_cast<int>(j * nx + i), b = a + 1, c = static_cast<int>(a + nx), d = c + 1;
      g.faces.row(f++) << a, b, d;
      g.faces.row(f++) << a, d, c;
    }
  g.hash = static_cast<std::uint64_t>(nx * 1000 + ny);
  return g;
}

Fabric fabric() {
  Fabric f;
  f.stretch_warp_n_per_m = 80.0;
  f.stretch_weft_n_per_m = 120.0;
  f.stretch_shear_n_per_m = 40.0;
  f.poisson = 0.2;
  f.bend_warp_n_m = 1.6e-5;
  f.bend_weft_n_m = 2.4e-5;
  f.bend_bias_n_m = 1.8e-5;
  f.damping_air_per_s = 2.0;
  return f;
}

const Positions kNothing(0, 3);
constexpr double kUnit = 0x1.0p-30;

struct Shape {
  std::vector<Fixed4> x;
  std::vector<Float4> v;
  explicit Shape(const Positions& p) : x(p.rows()), v(p.rows(), Float4{}) {
    for (Index i = 0; i < p.rows(); ++i)
      x[i] = {static_cast<std::int32_t>(std::llround(p(i, 0) / kUnit)),
              static_cast<std::int32_t>(std::llround(p(i, 1) / kUnit)),
              static_cast<std::int32_t>(std::llround(p(i, 2) / kUnit)), 0};
  }
};
Positions forces_on(const Elements& elements, const Positions& p) {
  const Shape shape(p);
  std::vector<Float4> f(p.rows(), Float4{});
  elements.add_forces(shape.x.data(), shape.v.data(), f.data());
  Positions out(p.rows(), 3);
  for (Index i = 0; i < p.rows(); ++i) out.row(i) << f[i].x, f[i].y, f[i].z;
  return out;
}

/// St. Venant-Kirchhoff energy of linear triangles, J.
double membrane_energy(const Garment& g, const Positions& x, const MembraneModuli& m) {
  double sum = 0.0;
  for (Index f = 0; f < g.face_count(); ++f) {
    Eigen::Matrix2d rest;
    Eigen::Matrix<double, 3, 2> now;
    for (int k = 0; k < 2; ++k) {
      rest.col(k) = (g.rest.row(g.faces(f, k + 1)) - g.rest.row(g.faces(f, 0))).transpose();
      now.col(k) = (x.row(g.faces(f, k + 1)) - x.row(g.faces(f, 0))).transpose();
    }
    const Eigen::Matrix<double, 3, 2> gradient = now * rest.inverse();
    const Eigen::Matrix2d e = 0.5 * (gradient.transpose() * gradient - Eigen::Matrix2d::Identity());
    sum += 0.5 * std::abs(rest.determinant()) *
           (0.5 * m.c11 * e(0, 0) * e(0, 0) + m.c12 * e(0, 0) * e(1, 1) + 0.5 * m.c22 * e(1, 1) * e(1, 1) +
            2.0 * m.g * e(0, 1) * e(0, 1));
  }
  return sum;
}

TEST(ClothElements, SixteenLanesGiveTheBitsOfEight) {
  if (!has_wide_lanes()) GTEST_SKIP() << "this processor has no AVX-512";
  const Garment g = sheet(9, 7, 0.02, 0.3);
  const Topology topology(g);
  RandomStream random(5, 1);
  Positions x = g.positions;
  for (Index i = 0; i < x.size(); ++i) x.data()[i] += 0.003 * random.normal();
  Shape shape(x);
  const auto speed = [&] { return static_cast<float>(random.normal()); };
  for (Float4& v : shape.v) v = {speed(), speed(), speed(), 0.0f};
  for (const double stretch_s : {0.0, 1e-3})
    for (const double bend_s : {0.0, 2e-3}) {
      Fabric f = fabric();
      f.damping_stretch_s = stretch_s;
      f.damping_bend_s = bend_s;
      const Elements elements(topology, f);
      std::vector<Float4> eight(x.rows(), Float4{}), sixteen = eight;
      const float stretch = elements.add_forces(shape.x.data(), shape.v.data(), eight.data(), false);
      EXPECT_EQ(elements.add_forces(shape.x.data(), shape.v.data(), sixteen.data(), true), stretch);
      EXPECT_GT(stretch, 1.1f);
      EXPECT_EQ(std::memcmp(eight.data(), sixteen.data(), eight.size() * sizeof(Float4)), 0);
    }
}

/// Tables that hold one figure for every strain, angle and curvature.
std::shared_ptr<MaterialTables> constant_tables() {
  auto tables = std::make_shared<MaterialTables>();
  for (auto& row : tables->stretching) row = {40.0, 8.0, 60.0, 40.0};
  for (int row = 0; row < 3; ++row) tables->bending[row].fill(row == 0 ? 9.6e-5 : row == 1 ? 7.2e-5 : 6.4e-5);
  return tables;
}

TEST(ClothElements, ConstantTablesGiveTheForcesOfConstants) {
  const Garment g = sheet(9, 7, 0.02, 0.3);
  const Topology topology(g);
  Fabric f = fabric();
  f.bend_warp_n_m = 1.6e-5, f.bend_bias_n_m = 1.8e-5, f.bend_weft_n_m = 2.4e-5;
  f.stretch_warp_n_per_m = 80.0 - 16.0 * 16.0 / 120.0, f.stretch_weft_n_per_m = 120.0 - 16.0 * 16.0 / 80.0;
  f.poisson = 16.0 / 120.0, f.stretch_shear_n_per_m = 40.0;
  const Elements constants(topology, f);
  f.tables = constant_tables();
  Elements tables(topology, f);
  tables.refer_to_rest();
  Positions x = g.positions;
  RandomStream random(5, 2);
  for (Index i = 0; i < x.size(); ++i) x.data()[i] += 0.003 * random.normal();
  std::vector<Double4> at(x.rows());
  for (Index i = 0; i < x.rows(); ++i) at[i] = {x(i, 0), x(i, 1), x(i, 2), 0.0};
  const Elements::Growth growth = tables.update_moduli(at.data());
  EXPECT_NEAR(growth.membrane, 1.0, 1e-12);
  EXPECT_NEAR(growth.bending, 1.0, 1e-12);
  const Positions wanted = forces_on(constants, x), got = forces_on(tables, x);
  EXPECT_LT((got - wanted).cwiseAbs().maxCoeff(), 1e-6 * wanted.cwiseAbs().maxCoeff());
}

TEST(ClothElements, GrowthBoundsWhatStrainAddsToTheStiffnessOfTables) {
  const Garment g = sheet(9, 7, 0.02, 0.3);
  const Topology topology(g);
  Fabric f = fabric();
  auto made = constant_tables();
  made->stretching[1] = {100.0, 4.0, 90.0, 30.0};  // 1/6 along warp: 2.5 times as stiff there
  f.tables = made;
  Elements elements(topology, f);
  elements.refer_to_rest();
  std::vector<Double4> at(g.vertex_count());
  const auto stretched = [&](double part) {
    for (Index i = 0; i < g.vertex_count(); ++i) at[i] = {(1.0 + part) * g.rest(i, 0), g.rest(i, 1), 0.0, 0.0};
    return elements.update_moduli(at.data()).membrane;
  };
  EXPECT_NEAR(stretched(0.0), 1.0, 1e-9);
  // Largest eigenvalue of [100 4; 4 90] against [40 8; 8 60].
  const Eigen::Matrix2d now{{100.0, 4.0}, {4.0, 90.0}}, rest{{40.0, 8.0}, {8.0, 60.0}};
  const double wanted = (rest.inverse() * now).eigenvalues().real().maxCoeff();
  EXPECT_NEAR(stretched(1.0 / 6.0), wanted, 1e-6);
  EXPECT_GT(wanted, 2.5);
  EXPECT_NEAR(stretched(0.0), 1.0, 1e-9);
}

TEST(ClothElements, MembraneForceIsMinusTheEnergysGradient) {
  const Garment g = sheet(6, 5, 0.02, 0.6);
  Fabric f = fabric();
  f.bend_warp_n_m = f.bend_weft_n_m = f.bend_bias_n_m = 0.0;
  const Topology topology(g);
  const Elements elements(topology, f);
  ASSERT_EQ(elements.unit(), kUnit);
  const MembraneModuli m = membrane_moduli(f);
  Positions x = g.positions;
  RandomStream random(8, 2);
  for (Index i = 0; i < x.size(); ++i) x.data()[i] += 0.003 * random.normal();
  const Positions got = forces_on(elements, x);
  const double scale = got.cwiseAbs().maxCoeff();
  for (Index i = 0; i < x.rows(); i += 3)
    for (int k = 0; k < 3; ++k) {
      Positions y = x;
      constexpr double h = 1e-6;
      y(i, k) = x(i, k) + h;
      const double up = membrane_energy(g, y, m);
      y(i, k) = x(i, k) - h;
      EXPECT_NEAR(got(i, k), -(up - membrane_energy(g, y, m)) / (2 * h), 2e-5 * scale);
    }
}

TEST(ClothElements, RotatedAndShiftedRestShapeFeelsNothing) {
  const Garment g = sheet(6, 5, 0.02, 0.6);
  const Topology topology(g);
  const Elements elements(topology, fabric());
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(1.1, Eigen::Vector3d(0.3, -0.5, 0.8).normalized()).toRotationMatrix();
  Positions x = g.positions * turn.transpose();
  x.rowwise() += Eigen::RowVector3d(37.25, -11.5, 3.0);  // beyond what fixed point holds: it wraps
  Shape shape(g.positions);
  for (Index i = 0; i < x.rows(); ++i) {
    const auto wrap = [](double a) {
      return static_cast<std::int32_t>(static_cast<std::uint32_t>(std::llround(a / kUnit)));
    };
    shape.x[i] = {wrap(x(i, 0)), wrap(x(i, 1)), wrap(x(i, 2)), 0};
  }
  std::vector<Float4> f(x.rows(), Float4{});
  elements.add_forces(shape.x.data(), shape.v.data(), f.data());
  for (const Float4& a : f) EXPECT_LT(std::abs(a.x) + std::abs(a.y) + std::abs(a.z), 1e-5);  // N; stiffness * 1e-7
}

TEST(ClothElements, BendingForceOfACylinderVanishesInsideARegularSheet) {
  // Constant curvature carries constant moment: no net force but at the border. Nearly inextensible small deflection.
  const Garment g = sheet(11, 11, 0.02);
  Fabric f = fabric();
  const Topology topology(g);
  const Elements elements(topology, f);
  std::vector<double> w(g.vertex_count()), k(g.vertex_count());
  for (Index i = 0; i < g.vertex_count(); ++i) w[i] = 0.5 * 3.0 * g.rest(i, 0) * g.rest(i, 0);
  elements.bending_stiffness(w, k);
  const double border = *std::max_element(k.begin(), k.end());
  for (Index j = 3; j < 8; ++j)
    for (Index i = 3; i < 8; ++i) EXPECT_NEAR(k[j * 11 + i], 0.0, 1e-9 * border);
}

TEST(ClothElements, EnergyOfACylinderIsHalfABKappaSquared) {
  // Along u; the ends u = 0 and 0.2 are free, where a bent sheet has no natural shape: only their column differs.
  const double kappa = 3.0;
  for (const double shake : {0.0, 0.6}) {
    const Garment g = sheet(41, 11, 0.005, shake);
    const Topology topology(g);
    const Elements elements(topology, fabric());
    std::vector<double> w(g.vertex_count()), k(g.vertex_count());
    for (Index i = 0; i < g.vertex_count(); ++i) w[i] = 0.5 * kappa * g.rest(i, 0) * g.rest(i, 0);
    elements.bending_stiffness(w, k);
    double energy = 0.0;
    for (Index i = 0; i < g.vertex_count(); ++i) energy += 0.5 * w[i] * k[i];
    EXPECT_NEAR(energy / (0.5 * 0.2 * 0.05 * 1.6e-5 * kappa * kappa), 1.0, 0.03) << shake;
  }
}

TEST(ClothModuli, EngineeringConstantsGiveTheUniaxialStiffness) {
  const MembraneModuli m = membrane_moduli(fabric());
  // Pull along warp with free weft: stress / strain = K_warp.
  EXPECT_NEAR(m.c11 - m.c12 * m.c12 / m.c22, 80.0, 1e-9);
  EXPECT_NEAR(m.c22 - m.c12 * m.c12 / m.c11, 120.0, 1e-9);
  EXPECT_NEAR(m.c12 / m.c22, 0.2, 1e-12);  // warp strain from weft pull is nu21, weft strain from warp pull is nu12
}

TEST(ClothModuli, BendingFollowsTheDirection) {
  for (const double bias : {1.8e-5, 0.7e-5}) {
    const BendingModuli m = bending_moduli(1.6e-5, 2.4e-5, bias);
    EXPECT_GT(m.d33, 0.0);
    for (const double angle : {0.0, 0.4, std::numbers::pi / 4, 1.2, std::numbers::pi / 2}) {
      const double c = std::cos(angle), s = std::sin(angle);
      EXPECT_NEAR(m.d11 * std::pow(c, 4) + m.d22 * std::pow(s, 4) + (2 * m.d12 + m.d33) * c * c * s * s,
                  1.6e-5 * std::pow(c, 4) + 2.4e-5 * std::pow(s, 4) + (4 * bias - 4.0e-5) * c * c * s * s, 1e-12);
    }
  }
}

TEST(ClothModuli, TablesAreReadAsTheirFormatSays) {
  MaterialTables t;
  for (int row = 0; row < 6; ++row) t.stretching[row] = {10.0 + row, 2.0, 20.0 + row, 5.0 + row};
  t.stretching[3][1] = -4.0;
  const MembraneModuli rest = membrane_moduli(t, 2.0, 0.0, 0.0, 0.0);
  EXPECT_DOUBLE_EQ(rest.c11, 2.0 * 2.0 * 10.0);
  EXPECT_DOUBLE_EQ(rest.g, 2.0 * 5.0);  // c33 is the shear modulus itself
  const auto green = [](double stretch) { return 0.5 * ((1 + stretch) * (1 + stretch) - 1); };
  EXPECT_NEAR(membrane_moduli(t, 1.0, green(1.0 / 6.0), 0.0, 0.0).c11, 2.0 * 11.0, 1e-9);  // row 1: 0 deg
  EXPECT_NEAR(membrane_moduli(t, 1.0, 0.0, green(0.5), 0.0).c22, 2.0 * 25.0, 1e-9);  // row 5: 90 deg, held beyond 1/6
  EXPECT_NEAR(membrane_moduli(t, 1.0, green(1.0 / 12.0), 0.0, 0.0).c11, 2.0 * 10.5, 1e-9);  // half way
  EXPECT_NEAR(membrane_moduli(t, 1.0, 0.1, 0.1, 0.2).c12, 0.0, 1e-9);  // 45 deg: negative is clamped
  t.bending = {{{1, 2, 3, 4, 5}, {2, 2, 2, 2, 2}, {8, 8, 8, 8, 8}}};
  const BendingModuli b = bending_moduli(t, 1.0, 15.0);
  EXPECT_DOUBLE_EQ(b.d22, 2.5 / 4.0);  // row 0 is the edge along warp: bending along weft
  EXPECT_DOUBLE_EQ(b.d11, 8.0 / 4.0);
  EXPECT_DOUBLE_EQ(bending_moduli(t, 1.0, 1000.0).d22, 5.0 / 4.0);
}

TEST(ClothStability, StepIsJustBelowTheLimitOfASingleSpring) {
  Spectrum spectrum;
  spectrum.membrane = 1e6;
  EXPECT_NEAR(stable_step(spectrum, 0.0, 0.0, 1.0), 2e-3, 1e-12);
  // With damping: dt^2 lambda / 4 + dt beta lambda / 2 = 1.
  const double dt = stable_step(spectrum, 1e-3, 0.0, 1.0);
  EXPECT_NEAR(dt * dt * 1e6 / 4 + dt * 1e-3 * 1e6 / 2, 1.0, 1e-9);
  // Damping across the cloth costs 0.3 of itself while the membrane's waves are faster.
  spectrum.bending = 1e4;
  const auto along = [&](double step) { return step * step * 1.01e6 / 4; };
  const auto across = [&](double step, double beta) { return step * step * 1e4 / 4 + step * beta * 1e4 / 2; };
  const double soft = stable_step(spectrum, 0.0, 0.02, 0.8), hard = stable_step(spectrum, 0.0, 1.0, 0.8);
  EXPECT_NEAR(along(soft) + 0.3 * across(soft, 0.02), 0.64, 1e-9);
  EXPECT_NEAR(across(hard, 1.0) + 0.3 * along(hard), 0.64, 1e-9);
  // damping_part() is the inverse of that.
  EXPECT_EQ(damping_part(spectrum, 0.0, 0.02, 0.8, 0.9), 1.0);
  for (const double least : {0.5, 0.9}) {
    const double part = damping_part(spectrum, 0.0, 1.0, 0.8, least);
    EXPECT_LT(part, 1.0);
    EXPECT_NEAR(stable_step(spectrum, 0.0, part, 0.8), least * stable_step(spectrum, 0.0, 0.0, 0.8), 1e-9);
  }
}

// ---------------------------------------------------------------------------------------------------------------------

/// A shaken sheet of 5 mm edges whose inertia is scaled from `length` on, with some of its components held.
struct Scaled {
  explicit Scaled(double length, double held = 0.0, Index nx = 24, Index ny = 24)
      : garment(sheet(nx, ny, 0.005, 0.6)),
        topology(garment),
        elements(topology, fabric()),
        masses(topology.vertex_area),
        free(masses.size()) {
    for (double& mass : masses) mass *= fabric().density_kg_per_m2;
    scaling = std::make_unique<MassScaling>(topology, elements.stiffest_membrane(), fabric().density_kg_per_m2, masses,
                                            length);
    RandomStream random(11, 2);
    for (std::size_t i = 0; i < masses.size(); ++i) {
      const auto w = static_cast<float>(1.0 / masses[i]);
      const auto one = [&] { return random.uniform() < held ? 0.0f : w; };
      free[i] = {one(), one(), one(), 0.0f};
    }
  }
  /// p(W L) W f.
  std::vector<Float4> operator()(const std::vector<Float4>& f) const {
    std::vector<Float4> a(f.size());
    for (std::size_t i = 0; i < f.size(); ++i) a[i] = {f[i].x * free[i].x, f[i].y * free[i].y, f[i].z * free[i].z, 0};
    const Float4* out = scaling->apply(a.data(), free.data());
    return {out, out + f.size()};
  }
  /// Largest eigenvalue of p(W L) W K by power iteration: membrane along x and y, bending along z.
  std::array<double, 2> largest() const {
    const std::size_t n = masses.size();
    RandomStream random(5, 1);
    std::vector<Float4> u(n), k(n);
    for (Float4& value : u)
      value = {static_cast<float>(random.uniform() - 0.5), static_cast<float>(random.uniform() - 0.5),
               static_cast<float>(random.uniform() - 0.5), 0.0f};
    std::vector<std::array<double, 2>> plane(n), plane_out(n);
    std::vector<double> w(n), w_out(n);
    std::array<double, 2> growth{};
    for (int iteration = 0; iteration < 150; ++iteration) {
      for (std::size_t i = 0; i < n; ++i) plane[i] = {u[i].x, u[i].y}, w[i] = u[i].z;
      elements.membrane_stiffness(plane, plane_out);
      elements.bending_stiffness(w, w_out);
      double before[2] = {}, after[2] = {};
      for (std::size_t i = 0; i < n; ++i)
        k[i] = {static_cast<float>(plane_out[i][0]), static_cast<float>(plane_out[i][1]), static_cast<float>(w_out[i]),
                0.0f};
      const std::vector<Float4> next = (*this)(k);
      for (std::size_t i = 0; i < n; ++i) {
        before[0] += masses[i] * (u[i].x * u[i].x + u[i].y * u[i].y), before[1] += masses[i] * u[i].z * u[i].z;
        after[0] += masses[i] * (next[i].x * next[i].x + next[i].y * next[i].y);
        after[1] += masses[i] * next[i].z * next[i].z;
      }
      for (int part = 0; part < 2; ++part) growth[part] = std::sqrt(after[part] / before[part]);
      for (std::size_t i = 0; i < n; ++i)
        u[i] = {next[i].x / static_cast<float>(growth[0]), next[i].y / static_cast<float>(growth[0]),
                next[i].z / static_cast<float>(growth[1]), 0.0f};
    }
    return growth;
  }
  Garment garment;
  Topology topology;
  Elements elements;
  std::vector<double> masses;
  std::vector<Float4> free;
  std::unique_ptr<MassScaling> scaling;
};
std::vector<Float4> random_forces(std::size_t n, std::uint64_t seed) {
  RandomStream random(seed, 3);
  std::vector<Float4> f(n);
  const auto one = [&] { return static_cast<float>(random.uniform() - 0.5); };
  for (Float4& value : f) value = {one(), one(), one(), 0.0f};
  return f;
}
double work(const std::vector<Float4>& f, const std::vector<Float4>& u) {
  double sum = 0.0;
  for (std::size_t i = 0; i < f.size(); ++i)
    sum += static_cast<double>(f[i].x) * u[i].x + static_cast<double>(f[i].y) * u[i].y +
           static_cast<double>(f[i].z) * u[i].z;
  return sum;
}

TEST(ClothMassScaling, BoundOfTheEigenvaluesHoldsWhateverIsHeld) {
  for (const double length : {0.003, 0.01, 0.017, 0.03}) {
    const Scaled free(length);
    ASSERT_GT(free.scaling->stages(), 1);
    const Spectrum spectrum = largest_frequencies(free.elements, free.masses, *free.scaling);
    EXPECT_EQ(spectrum.membrane, free.scaling->largest());
    for (const double held : {0.0, 0.02, 0.3, 0.6}) {
      const std::array<double, 2> largest = Scaled(length, held).largest();
      EXPECT_LE(largest[0], spectrum.membrane) << "length " << length << ", held " << held;
      EXPECT_LE(largest[1], spectrum.bending) << "length " << length << ", held " << held;
    }
    EXPECT_GT(free.largest()[0], 0.5 * spectrum.membrane) << "the bound is not loose";
  }
}

TEST(ClothMassScaling, IsSymmetricPositiveAndKeepsMomentum) {
  // Numbers of vertices that are divisible by eight, and not.
  for (const auto& [held, rows] : {std::pair(0.0, 24), std::pair(0.1, 24), std::pair(0.0, 23), std::pair(0.1, 23)}) {
    const Scaled scaled(0.01, held, 25, rows);
    const std::size_t n = scaled.masses.size();
    const std::vector<Float4> f = random_forces(n, 1), g = random_forces(n, 2);
    const std::vector<Float4> a = scaled(f), b = scaled(g);
    EXPECT_NEAR(work(f, b), work(g, a), 1e-5 * std::sqrt(work(f, a) * work(g, b)));
    EXPECT_GT(work(f, a), 0.0);
    if (held > 0.0) continue;
    double forced = 0.0, gained = 0.0;
    for (std::size_t i = 0; i < n; ++i)
      forced += static_cast<double>(f[i].x), gained += scaled.masses[i] * static_cast<double>(a[i].x);
    EXPECT_NEAR(gained, forced, 1e-4 * std::sqrt(static_cast<double>(n)));
  }
}

TEST(ClothMassScaling, LongWavesKeepTheirInertia) {
  // A wave along the sheet with half its length as the wavelength: k = 2 pi / 57.5 mm. p = 1 - (k l)^2 / 3 and less.
  const Scaled scaled(0.002);
  std::vector<Float4> f(scaled.masses.size());
  const double k = 2.0 * std::numbers::pi / 0.0575;
  for (std::size_t i = 0; i < f.size(); ++i)
    f[i].z = static_cast<float>(scaled.masses[i] * std::cos(k * scaled.topology.place[i][0]));
  const std::vector<Float4> a = scaled(f);
  double sum = 0.0, all = 0.0;
  for (std::size_t i = 0; i < f.size(); ++i)
    sum += f[i].z * static_cast<double>(a[i].z), all += f[i].z * std::cos(k * scaled.topology.place[i][0]);
  const double kl2 = std::pow(0.002 * k, 2);
  EXPECT_LT(sum / all, 1.0);
  EXPECT_NEAR(sum / all, 1.0 - kl2 / 3.0, 0.5 * kl2);
}

TEST(Cloth, ScaledInertiaTakesFewerSubstepsAndHangsTheSame) {
  const auto garment = std::make_shared<const Garment>(sheet(30, 12, 0.006, 0.5));
  Scene scene;
  scene.ground_height.reset();
  scene.pins = {0, 348};
  Positions shapes[2];
  Index substeps[2];
  for (int scaled = 0; scaled < 2; ++scaled) {
    Params p;
    p.settle_damping_per_s = 20.0;
    p.inertia_length_m = scaled ? 0.012 : 0.0;
    p.fine_inertia_length_m = 0.0;
    Cloth cloth(p);
    cloth.reset(garment, fabric(), scene);
    cloth.settle({.speed = 1e-4, .hold_frames = 30, .max_frames = 400});
    shapes[scaled] = cloth.positions();
    substeps[scaled] = cloth.last_substeps();
  }
  EXPECT_LT(3 * substeps[1], substeps[0]);
  EXPECT_LT((shapes[0] - shapes[1]).rowwise().norm().maxCoeff(), 5e-5);
  EXPECT_GT((shapes[0] - garment->positions).rowwise().norm().maxCoeff(), 0.05) << "it did hang";
}

// ---------------------------------------------------------------------------------------------------------------------

struct Fold {
  /// @param row vertices of the garment's first row.
  explicit Fold(std::shared_ptr<const Garment> g, const Fabric& f, Params p = {}, Index row = 20)
      : garment(std::move(g)), cloth(p) {
    cloth.reset(garment, f, Scene());
    const std::vector<Index> corners{0, garment->vertex_count() - row};
    cloth.grasp(corners);
    start.resize(2, 3);
    for (int k = 0; k < 2; ++k) start.row(k) = cloth.positions().row(corners[k]);
  }
  Positions targets(Index frame) const {
    const double a = std::numbers::pi * std::min(1.0, static_cast<double>(frame) / frames);
    Positions t = start;
    t.col(0).array() += 0.18 * (1.0 - std::cos(a));
    t.col(2).array() += 0.19 * std::sin(a) + 0.02 * (1.0 - std::cos(a));
    return t;
  }
  void run(Index from, Index to) {
    for (Index k = from; k < to; ++k) cloth.step(targets(k + 1));
  }
  static constexpr Index frames = 80;
  std::shared_ptr<const Garment> garment;
  Cloth cloth;
  Positions start;
};
std::shared_ptr<const Garment> folding_sheet() { return std::make_shared<const Garment>(sheet(20, 12, 0.02, 0.5)); }
/// A sheet of the same size, so fine that inertia is scaled and candidates are searched for few vertices.
std::shared_ptr<const Garment> fine_sheet() { return std::make_shared<const Garment>(sheet(60, 36, 0.0065, 0.3)); }
constexpr Index kFineRow = 60;

/// Largest eigenvalue of M^-1 (dt^2/4 K + dt/2 C) at these positions, K and C by differences of the forces, by power
/// iteration.
double explicit_number(const Elements& elements, const std::vector<double>& masses, const Positions& x, double dt) {
  const std::size_t n = masses.size();
  const __m256d per_unit = _mm256_set1_pd(1.0 / elements.unit());
  using Field = std::vector<Vec3>;
  const auto forces = [&](const Field& u, double shift, double speed) {
    std::vector<Fixed4> at(n);
    std::vector<Float4> v(n), f(n);
    for (std::size_t i = 0; i < n; ++i) {
      const Vec3 p = x.row(static_cast<Index>(i)).transpose() + shift * u[i];
      at[i] = to_fixed(_mm256_setr_pd(p.x(), p.y(), p.z(), 0.0), per_unit);
      const Eigen::Vector3f w = (speed * u[i]).cast<float>();
      v[i] = {w.x(), w.y(), w.z(), 0.0f};
    }
    elements.add_forces(at.data(), v.data(), f.data());
    Field out(n);
    for (std::size_t i = 0; i < n; ++i) out[i] = Vec3(f[i].x, f[i].y, f[i].z);
    return out;
  };
  RandomStream random(9, 4);
  Field u(n);
  for (Vec3& value : u) value = Vec3(random.uniform(), random.uniform(), random.uniform()).array() - 0.5;
  double number = 0.0;
  for (int iteration = 0; iteration < 200; ++iteration) {
    double norm = 0.0, largest = 0.0;
    for (std::size_t i = 0; i < n; ++i) norm += masses[i] * u[i].squaredNorm();
    for (Vec3& value : u) largest = std::max(largest, (value /= std::sqrt(norm)).norm());
    const double small = 2e-6 / largest, slow = 0.1 / largest;  // m, m/s
    const Field up = forces(u, small, 0.0), down = forces(u, -small, 0.0);
    const Field moving = forces(u, 0.0, slow), still = forces(u, 0.0, 0.0);
    number = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      const Vec3 next = dt * dt / 4 / (2.0 * small) * (down[i] - up[i]) + dt / 2 / slow * (still[i] - moving[i]);
      number += u[i].dot(next);
      u[i] = next / masses[i];
    }
  }
  return number;
}

TEST(ClothStability, FoldedClothKeepsTheBound) {
  Fabric f = fabric();
  f.damping_stretch_s = 0.0;
  f.damping_bend_s = 1.0;
  Fold fold(folding_sheet(), f);
  const Topology topology(*fold.garment);
  std::vector<double> masses = topology.vertex_area;
  for (double& mass : masses) mass *= f.density_kg_per_m2;
  const Spectrum spectrum =
      largest_frequencies(Elements(topology, f), masses, MassScaling(topology, {}, 1.0, masses, 0.0));
  Index frame = 0;
  for (const Index stop : {0, 40, 70, 80}) {
    fold.run(frame, stop);
    frame = stop;
    for (const double least_step : {0.5, 0.88, 0.95}) {  // damping leads, both are equal, the membrane leads
      Elements elements(topology, f);
      const double part = damping_part(spectrum, 0.0, f.damping_bend_s, 0.8, least_step);
      EXPECT_LT(part, 1.0);
      elements.scale_damping(part);
      const double dt = stable_step(spectrum, 0.0, part * f.damping_bend_s, 0.8);
      const double number = explicit_number(elements, masses, fold.cloth.positions(), dt);
      EXPECT_LT(number, 0.64) << "frame " << frame << ", least step " << least_step;
      EXPECT_GT(number, 0.4);
    }
  }
}

/// A sheet that is laid over itself along given paths: the part beyond a line rolls over until its layers are closer
/// than they may be, and shakes a little.
struct Rolling {
  Rolling() : garment(sheet(36, 20, 0.005, 0.4)) {}
  Positions at(double t) const {
    Positions x = garment.positions;
    constexpr double kLine = 0.08;  // m, of 0.175 m
    const double angle = std::numbers::pi * std::min(1.0, t / 0.6);
    const double radius = 0.008 - 0.0072 * std::min(1.0, t / 0.9);  // m: the layers end 1.6 mm apart
    for (Index i = 0; i < x.rows(); ++i) {
      const double beyond = x(i, 0) - kLine;
      if (beyond <= 0.0) continue;
      const double bent = std::min(angle, beyond / radius), straight = beyond - radius * bent;
      x(i, 0) = kLine + radius * std::sin(bent) + straight * std::cos(bent);
      x(i, 2) = radius * (1.0 - std::cos(bent)) + straight * std::sin(bent);
      if (i % 7 == 0) x(i, 2) += 0.0006 * std::sin(40.0 * t + 0.3 * static_cast<double>(i)) * std::min(1.0, 5.0 * t);
    }
    return x;
  }
  Garment garment;
};

TEST(ClothContact, EveryPairWithinItsDistanceIsACandidateThoughFewVerticesAreSearchedFor) {
  const Rolling rolling;
  const Topology topology(rolling.garment);
  Fabric f = fabric();
  f.thickness_m = 0.002;
  const Elements elements(topology, f);
  const SelfContact contact(topology, PatchTree(topology), f, 0.4f, 0.25f, 0);
  SelfContact::State state;
  contact.clear(state);
  const auto n = static_cast<std::size_t>(topology.vertices);
  std::vector<Double4> x(n), v(n);
  std::vector<Fixed4> fixed(n);
  const std::vector<Fixed4> rest = Shape(rolling.garment.positions).x;
  constexpr double kStep = 0.6e-3, kEnd = 1.2;
  const __m256d per_unit = _mm256_set1_pd(1.0 / elements.unit());
  const auto place = [&](double t) {
    const Positions now = rolling.at(t), next = rolling.at(t + kStep);
    for (std::size_t i = 0; i < n; ++i) {
      const auto row = static_cast<Index>(i);
      const Vec3 p = now.row(row), u = (next.row(row) - now.row(row)) / kStep;
      x[i] = {p.x(), p.y(), p.z(), 0.0};
      v[i] = {u.x(), u.y(), u.z(), 0.0};
      fixed[i] = to_fixed(load(x[i]), per_unit);
    }
  };
  const auto known = [&](const Pairs& pairs) {
    std::set<std::array<std::int32_t, 4>> set;
    for (const Candidate& c : pairs.candidate) set.insert({c.v[0], c.v[1], c.v[2], c.v[3]});
    EXPECT_EQ(set.size(), pairs.size()) << "a pair is listed twice";
    return set;
  };
  long few = 0, pairs = 0;
  for (long step = 0; step * kStep < kEnd; ++step) {
    place(static_cast<double>(step) * kStep);
    const bool due = !state.valid || state.elapsed + kStep > state.horizon;
    contact.prepare(state, x.data(), v.data(), fixed.data(), elements.unit(), kStep);
    few += due && state.elapsed > 0.0;
    if (step % 25 == 0) {
      const auto faces = known(state.vertex_triangle), edges = known(state.edge_edge);
      const auto near = [&](const std::array<std::int32_t, 4>& q, auto is_edge) {
        constexpr bool kEdges = decltype(is_edge)::value;
        double low[2][3], high[2][3];
        std::fill(&low[0][0], &low[0][0] + 6, 1e9), std::fill(&high[0][0], &high[0][0] + 6, -1e9);
        for (int k = 0; k < 4; ++k) {
          const Double4& p = x[static_cast<std::size_t>(q[static_cast<std::size_t>(k)])];
          const int side = k >= (kEdges ? 2 : 1);
          const double c[3] = {p.x, p.y, p.z};
          for (int d = 0; d < 3; ++d)
            low[side][d] = std::min(low[side][d], c[d]), high[side][d] = std::max(high[side][d], c[d]);
        }
        const double reach = (kEdges ? 0.8 : 1.0) * f.thickness_m;
        for (int d = 0; d < 3; ++d)
          if (low[0][d] > high[1][d] + reach || low[1][d] > high[0][d] + reach) return false;
        const auto distance = [&](const std::vector<Fixed4>& shape) {
          const Stored m(measure<kEdges>([&](int k, int) { return q[static_cast<std::size_t>(k)]; }, nullptr,
                                         shape.data(), static_cast<float>(elements.unit())));
          return static_cast<double>(m.distance[0]);
        };
        // Neighbours in the rest shape have a smaller distance of their own.
        return distance(fixed) < reach && distance(rest) > 2.0 * reach;
      };
      for (std::int32_t i = 0; i < topology.vertices; ++i)
        for (const auto& face : topology.faces) {
          if (face[0] == i || face[1] == i || face[2] == i) continue;
          const std::array<std::int32_t, 4> q{i, face[0], face[1], face[2]};
          if (!near(q, std::false_type{})) continue;
          ++pairs;
          EXPECT_TRUE(faces.count(q)) << "vertex " << i << " in step " << step;
        }
      for (std::size_t e = 0; e < topology.edges.size(); ++e)
        for (std::size_t g = e + 1; g < topology.edges.size(); ++g) {
          const auto &a = topology.edges[e], &b = topology.edges[g];
          if (a[0] == b[0] || a[0] == b[1] || a[1] == b[0] || a[1] == b[1]) continue;
          const std::array<std::int32_t, 4> q{a[0], a[1], b[0], b[1]};
          if (!near(q, std::true_type{})) continue;
          ++pairs;
          EXPECT_TRUE(edges.count(q)) << "edge " << e << " in step " << step;
        }
    }
    const Positions next = rolling.at(static_cast<double>(step + 1) * kStep);
    state.elapsed += kStep;
    for (std::size_t i = 0; i < n; ++i) {
      const Vec3 p = next.row(static_cast<Index>(i));
      state.path[i] += static_cast<float>((p - Vec3(x[i].x, x[i].y, x[i].z)).norm());
      const Vec3 path(state.start[i].x + state.elapsed * state.drift[i].x,
                      state.start[i].y + state.elapsed * state.drift[i].y,
                      state.start[i].z + state.elapsed * state.drift[i].z);
      if ((p - path).norm() > contact.slack()) state.valid = false;
    }
  }
  EXPECT_GT(pairs, 5000);
  EXPECT_GT(few, 10) << "all were searched for each time";
}

TEST(ClothContact, WhatWasFlatIsSearchedWholeOnceItIsFlatNoMore) {
  // A valley whose normals keep within a cone: no search, though the feet of its walls are within thickness.
  Garment garment = sheet(21, 12, 0.005);
  const double line = 0.05, tilt = 0.35;
  for (Index i = 0; i < garment.vertex_count(); ++i) {
    const double beyond = garment.rest(i, 0) - line;
    garment.positions(i, 0) = line + std::cos(tilt) * beyond;
    garment.positions(i, 2) = std::sin(tilt) * std::abs(beyond);
  }
  const Topology topology(garment);
  Fabric f = fabric();
  f.thickness_m = 0.012;
  const SelfContact contact(topology, PatchTree(topology), f, 0.4f, 0.25f, 0);
  SelfContact::State state;
  contact.clear(state);
  const auto n = static_cast<std::size_t>(topology.vertices);
  std::vector<Double4> x(n), v(n);
  const auto search = [&] {
    for (std::size_t i = 0; i < n; ++i) {
      const auto row = garment.positions.row(static_cast<Index>(i));
      x[i] = {row[0], row[1], row[2], 0.0};
    }
    contact.prepare(state, x.data(), v.data(), Shape(garment.positions).x.data(), kUnit, 1e-3);
  };
  search();
  EXPECT_EQ(state.vertex_triangle.size(), 0u);
  garment.positions(20, 0) -= 0.006;  // the tip of a wall bends back
  garment.positions(20, 2) -= 0.004;
  state.elapsed += 1e-3;
  state.valid = false;
  search();
  EXPECT_GT(state.elapsed, 0.0) << "all were searched for";
  const auto across = [&](const Candidate& c) { return c.v[0] % 21 == 9 && c.v[1] % 21 > 10; };
  EXPECT_GE(std::count_if(state.vertex_triangle.candidate.begin(), state.vertex_triangle.candidate.end(), across), 12);
}

TEST(Cloth, FoldsSettlesAndNeverCrossesItself) {
  for (const double thickness : {0.0005, 0.001, 0.004}) {
    Fabric f = fabric();
    f.thickness_m = thickness;
    Fold fold(folding_sheet(), f);
    for (Index k = 0; k < Fold::frames; ++k) {
      fold.run(k, k + 1);
      ASSERT_EQ(count_intersections(fold.cloth.positions(), fold.garment->faces), 0) << "frame " << k;
    }
    fold.cloth.release();
    const SettleResult result = fold.cloth.settle({});
    EXPECT_TRUE(result.settled) << result.max_speed;
    EXPECT_EQ(count_intersections(fold.cloth.positions(), fold.garment->faces), 0);
    EXPECT_GT(fold.cloth.diagnostics().contacts, 20);
    EXPECT_GE(fold.cloth.positions().col(2).minCoeff(), thickness);
  }
}

/// Columns from 0.4 to 175 mm apart: a coarse mesh whose few small faces would ask for more substeps than are allowed.
TEST(Cloth, FewSmallFacesInACoarseMeshRun) {
  std::vector<double> column{0.0, 0.0004};
  while (column.back() - column[column.size() - 2] < 0.175)
    column.push_back(column.back() + std::min(0.175, 1.8 * (column.back() - column[column.size() - 2])));
  Garment g = sheet(static_cast<Index>(column.size()), 5, 0.1);
  for (Index i = 0; i < g.vertex_count(); ++i)
    g.rest(i, 0) = g.positions(i, 0) = column[static_cast<std::size_t>(i) % column.size()];
  Fabric f = fabric();
  f.stretch_warp_n_per_m = f.stretch_weft_n_per_m = 8890.0;
  f.stretch_shear_n_per_m = 122.5;
  f.density_kg_per_m2 = 0.407;
  Scene scene;
  scene.ground_height.reset();
  scene.pins = {0, g.vertex_count() - static_cast<Index>(column.size())};
  const auto garment = std::make_shared<const Garment>(std::move(g));
  Params p;
  p.fine_inertia_length_m = 0.0;
  Cloth explicitly(p);
  EXPECT_THROW(explicitly.reset(garment, f, scene), ConfigError);
  Cloth cloth((Params()));
  cloth.reset(garment, f, scene);
  cloth.settle({.speed = 1e-3, .hold_frames = 10, .max_frames = 600});
  EXPECT_LT(cloth.last_substeps(), 200);
  EXPECT_LT(cloth.diagnostics().max_speed, 0.1);
  EXPECT_LT(cloth.diagnostics().max_strain, 0.05);
  EXPECT_LT(cloth.positions().col(2).minCoeff(), -0.2) << "it hangs";
}

/// Cotton and denim at their real stiffness, without damping of their own: few substeps, no crossing, at rest soon.
TEST(Cloth, FineStiffClothFoldsInFewSubstepsAndNeverCrossesItself) {
  for (const bool denim : {false, true}) {
    Fabric f = fabric();
    f.density_kg_per_m2 = denim ? 0.407 : 0.15;
    f.stretch_warp_n_per_m = f.stretch_weft_n_per_m = denim ? 8890.0 : 261.0;
    f.stretch_shear_n_per_m = denim ? 122.5 : 105.0;
    f.poisson = denim ? 0.0 : 0.243;
    f.bend_warp_n_m = denim ? 4.7e-5 : 1.4e-5;
    f.bend_weft_n_m = f.bend_bias_n_m = denim ? 2.5e-5 : 1.05e-5;
    f.thickness_m = denim ? 0.001066 : 0.000318;
    f.damping_air_per_s = f.damping_bend_s = f.damping_stretch_s = 0.0;
    Fold fold(fine_sheet(), f, {}, kFineRow);
    for (Index k = 0; k < Fold::frames; k += 8) {
      fold.run(k, k + 8);
      ASSERT_EQ(count_intersections(fold.cloth.positions(), fold.garment->faces), 0) << "frame " << k;
      EXPECT_LT(fold.cloth.last_substeps(), 75);
    }
    fold.cloth.release();
    EXPECT_TRUE(fold.cloth.settle({}).settled);
    EXPECT_EQ(count_intersections(fold.cloth.positions(), fold.garment->faces), 0);
  }
}

TEST(Cloth, FineClothFoldsSettlesAndNeverCrossesItself) {
  for (const double thickness : {0.0005, 0.001}) {
    Fabric f = fabric();
    f.thickness_m = thickness;
    Fold fold(fine_sheet(), f, {}, kFineRow);
    for (Index k = 0; k < Fold::frames; k += 8) {
      fold.run(k, k + 8);
      ASSERT_EQ(count_intersections(fold.cloth.positions(), fold.garment->faces), 0) << "frame " << k;
    }
    fold.cloth.release();
    EXPECT_TRUE(fold.cloth.settle({}).settled);
    EXPECT_EQ(count_intersections(fold.cloth.positions(), fold.garment->faces), 0);
    EXPECT_GT(fold.cloth.diagnostics().contacts, 100);
    EXPECT_GE(fold.cloth.positions().col(2).minCoeff(), thickness);
  }
}

TEST(Cloth, LayersRestAtThicknessAndDoNotCreep) {
  // Two sheets of one garment, the upper one thickness above the lower.
  Garment two = sheet(12, 12, 0.02, 0.5);
  const Garment upper = sheet(8, 8, 0.021, 0.5);
  const Index n = two.vertex_count();
  const Fabric f = fabric();
  two.positions.conservativeResize(n + 64, 3);
  two.rest.conservativeResize(n + 64, 2);
  two.positions.bottomRows(64) = upper.positions.rowwise() + Eigen::RowVector3d(0.03, 0.04, 2.0 * f.thickness_m);
  two.rest.bottomRows(64) = upper.rest;
  const Index faces = two.face_count();
  two.faces.conservativeResize(faces + upper.face_count(), 3);
  two.faces.bottomRows(upper.face_count()) = (upper.faces.array() + static_cast<int>(n)).matrix();
  two.hash = 77;
  Cloth cloth{Params{}};
  cloth.reset(std::make_shared<const Garment>(two), f, Scene());
  for (int k = 0; k < 30; ++k) cloth.step(kNothing);
  const Positions before = cloth.positions();
  for (int k = 0; k < 120; ++k) cloth.step(kNothing);
  EXPECT_LT((cloth.positions() - before).cwiseAbs().maxCoeff(), 2e-5);
  const auto top = cloth.positions().bottomRows(64).col(2);
  EXPECT_GT(top.minCoeff(), 1.85 * f.thickness_m);
  EXPECT_LT(top.maxCoeff(), 2.02 * f.thickness_m);
}

/// A T-shirt of two layers on coarse edges. Its folds vibrated for ever while pairs in contact yielded to its weight.
TEST(Cloth, FoldsOfTwoLayersComeToRest) {
  const Outline outline = shirt_outline(ShirtSize{});
  const GeneratedMesh front = generate_mesh(outline, {.edge_m = 0.04});
  SewnMesh sewn =
      sew_front_and_back(front.mesh, [&](const Vec2& a, const Vec2& b) { return !is_open_at(outline, a, b); });
  const auto garment = std::make_shared<const Garment>(make_garment(sewn.mesh, "shirt", {}, std::move(sewn.form)));
  const std::vector<Index> hands{front.vertices.at("left_sleeve_top"), front.vertices.at("left_body_bottom")};
  for (const bool soft : {false, true}) {
    Fabric f = fabric();
    f.thickness_m = 0.001;
    if (soft) {
      f.bend_warp_n_m *= 0.25;
      f.bend_weft_n_m *= 0.25;
      f.bend_bias_n_m *= 0.25;
    } else {
      f.friction = 0.2;
      f.self_friction = 0.12;
    }
    Cloth cloth{Params{}};
    cloth.reset(garment, f, Scene());
    Positions start(2, 3);
    for (Index k = 0; k < 2; ++k) start.row(k) = cloth.positions().row(hands[static_cast<std::size_t>(k)]);
    cloth.grasp(hands);
    constexpr int kFrames = 96;
    for (int frame = 1; frame <= kFrames; ++frame) {
      const double a = std::numbers::pi * frame / kFrames;
      Positions to = start;
      to.col(0).array() += 0.426 * (1.0 - std::cos(a));
      to.col(2).array() += 0.38 * std::sin(a) + 0.05 * frame / kFrames;
      cloth.step(to);
    }
    cloth.release();
    const SettleResult rest = cloth.settle({0.005, 6, 240});
    EXPECT_TRUE(rest.settled) << rest.max_speed << " m/s, " << (soft ? "soft" : "slippery");
    EXPECT_EQ(count_intersections(cloth.positions(), garment->faces), 0);
  }
}

TEST(Cloth, LayersSeparateWhenLiftedAgain) {
  Fold fold(folding_sheet(), fabric());
  fold.run(0, Fold::frames);
  fold.cloth.settle({0.005, 6, 60});
  EXPECT_GT(fold.cloth.diagnostics().contacts, 0);
  for (Index k = Fold::frames; k > 0; --k) {
    fold.cloth.step(fold.targets(k - 1));
    ASSERT_EQ(count_intersections(fold.cloth.positions(), fold.garment->faces), 0) << "frame " << k;
  }
  fold.cloth.release();
  fold.cloth.settle({0.005, 6, 200});
  EXPECT_LT(fold.cloth.positions().col(2).maxCoeff(), 0.01);
  EXPECT_EQ(fold.cloth.diagnostics().contacts, 0);
}

TEST(Cloth, SnapshotInContactContinuesBitForBitInAnotherObject) {
  for (const bool fine : {false, true}) {
    const auto garment = fine ? fine_sheet() : folding_sheet();
    const Index row = fine ? kFineRow : 20;
    Fold fold(garment, fabric(), {}, row);
    fold.run(0, 75);
    EXPECT_GT(fold.cloth.diagnostics().contacts, 0);
    const auto snapshot = fold.cloth.save();
    fold.run(75, 80);
    fold.cloth.release();
    fold.cloth.settle({0.005, 6, 40});
    Fold other(garment, fabric(), {}, row);
    other.run(0, 7);
    other.cloth.restore(*snapshot);
    other.run(75, 80);
    other.cloth.release();
    other.cloth.settle({0.005, 6, 40});
    EXPECT_EQ(fold.cloth.positions(), other.cloth.positions()) << "fine: " << fine;
    EXPECT_EQ(fold.cloth.velocities(), other.cloth.velocities());
  }
}

TEST(Cloth, AllocatesNothingInTheFrameLoop) {
  for (const bool fine : {false, true}) {
    Fold fold(fine ? fine_sheet() : folding_sheet(), fabric(), {}, fine ? kFineRow : 20);
    std::vector<Positions> targets;
    for (Index k = 0; k < Fold::frames; ++k) targets.push_back(fold.targets(k + 1));
    const long before = allocations;
    for (const auto& t : targets) fold.cloth.step(t);
    fold.cloth.settle({0.005, 6, 30});
    EXPECT_EQ(allocations - before, 0) << "fine: " << fine;
  }
}

TEST(Cloth, OverlappingStartPushesApartGently) {
  Garment two = sheet(8, 8, 0.02, 0.5);
  const Garment upper = two;
  const Index n = two.vertex_count();
  const Fabric f = fabric();
  two.positions.conservativeResize(2 * n, 3);
  two.rest.conservativeResize(2 * n, 2);
  two.positions.bottomRows(n) = upper.positions.rowwise() + Eigen::RowVector3d(0.007, 0.004, 1.2 * f.thickness_m);
  two.positions.topRows(n).col(2).array() += f.thickness_m;
  two.rest.bottomRows(n) = upper.rest;
  const Index faces = two.face_count();
  two.faces.conservativeResize(2 * faces, 3);
  two.faces.bottomRows(faces) = (upper.faces.array() + static_cast<int>(n)).matrix();
  two.hash = 78;
  Cloth cloth{Params{}};
  cloth.reset(std::make_shared<const Garment>(two), f, Scene());
  double fastest = 0.0;
  for (int k = 0; k < 60; ++k) {
    cloth.step(kNothing);
    fastest = std::max(fastest, cloth.velocities().rowwise().norm().maxCoeff());
  }
  EXPECT_LT(fastest, 0.02);
}

TEST(Cloth, OverstretchingGraspIsReported) {
  Cloth cloth{Params{}};
  cloth.reset(std::make_shared<const Garment>(sheet(8, 8, 0.02)), fabric(), Scene());
  const std::vector<Index> corners{0, 7};
  cloth.grasp(corners);
  Positions targets(2, 3);
  for (int k = 0; k < 2; ++k) targets.row(k) = cloth.positions().row(corners[k]);
  cloth.step(targets);
  EXPECT_TRUE(cloth.diagnostics().warning.empty());
  for (int k = 0; k < 20; ++k) {
    targets(1, 0) += 0.004;
    cloth.step(targets);
  }
  EXPECT_THAT(cloth.diagnostics().warning,
              ::testing::MatchesRegex(
                  "a grasp stretched the cloth by [0-9]+\\.[0-9] %, more than grasp_strain_warning = [0-9]+ %"));
  EXPECT_GT(cloth.diagnostics().max_grasp_strain, 0.15);
}

TEST(Cloth, StiffnessProportionalDampingTakesMoreSubstepsAndStaysStable) {
  Fabric f = fabric();
  Fold plain(folding_sheet(), f);
  plain.run(0, 1);
  f.damping_stretch_s = 1e-3;
  f.damping_bend_s = 1e-3;
  Fold damped(folding_sheet(), f);
  damped.run(0, 30);
  EXPECT_GT(damped.cloth.last_substeps(), plain.cloth.last_substeps());
  EXPECT_LT(damped.cloth.diagnostics().max_speed, 3.0);
}

TEST(Cloth, BendingDampingTakesVibrationAndLeavesTheTurning) {
  // A bent sheet that turns about its bending axis in free space: it straightens and vibrates.
  Fabric f = fabric();
  f.damping_air_per_s = 0.0;
  f.bend_warp_n_m = f.bend_weft_n_m = f.bend_bias_n_m = 2e-4;
  const Garment garment = sheet(11, 5, 0.02, 0.4);
  std::vector<double> mass(garment.vertex_count(), 0.0);
  for (Index k = 0; k < garment.face_count(); ++k) {
    const auto at = [&](int corner) { return garment.rest.row(garment.faces(k, corner)); };
    const Eigen::RowVector2d u = at(1) - at(0), w = at(2) - at(0);
    for (int corner = 0; corner < 3; ++corner)
      mass[garment.faces(k, corner)] += f.density_kg_per_m2 * std::abs(u.x() * w.y() - u.y() * w.x()) / 6.0;
  }
  Scene scene;
  scene.ground_height.reset();
  scene.gravity = Vec3::Zero();
  constexpr double kRadius = 0.06, kTurn = 8.0;  // m, rad/s
  Positions x = garment.positions, v = x;
  for (Index i = 0; i < x.rows(); ++i) {
    const double a = (garment.rest(i, 0) - 0.1) / kRadius;
    x.row(i) << kRadius * std::sin(a), garment.rest(i, 1), kRadius * (1.0 - std::cos(a));
    v.row(i) << kTurn * x(i, 2), 0.0, -kTurn * x(i, 0);
  }
  const auto angular = [&](const Cloth& cloth) {
    Vec3 sum = Vec3::Zero(), centre = Vec3::Zero();
    double total = 0.0;
    for (Index i = 0; i < x.rows(); ++i) {
      centre += mass[i] * Vec3(cloth.positions().row(i).transpose());
      total += mass[i];
    }
    centre /= total;
    for (Index i = 0; i < x.rows(); ++i)
      sum += mass[i] *
             (Vec3(cloth.positions().row(i).transpose()) - centre).cross(Vec3(cloth.velocities().row(i).transpose()));
    return sum.y();
  };
  double vibration[2];
  for (const auto& [damping, inertia_length] : {std::pair(0.0, 0.0), std::pair(0.02, 0.01), std::pair(0.02, 0.0)}) {
    f.damping_bend_s = damping;
    Params params;
    params.inertia_length_m = inertia_length;
    Cloth cloth{params};
    cloth.reset(std::make_shared<const Garment>(garment), f, scene);
    cloth.set_state(x, v, {});
    const double start = angular(cloth);
    for (int k = 0; k < 60; ++k) cloth.step(kNothing);
    EXPECT_NEAR(angular(cloth) / start, 1.0, 0.01) << "damping " << damping << ", inertia length " << inertia_length;
    double kinetic = 0.0;
    for (Index i = 0; i < x.rows(); ++i) kinetic += 0.5 * mass[i] * cloth.velocities().row(i).squaredNorm();
    vibration[damping > 0.0] = kinetic;
  }
  EXPECT_LT(vibration[1], 0.6 * vibration[0]);
}

TEST(Cloth, DampingMayShortenTheSubstepToItsShare) {
  Fabric f = fabric();
  f.damping_stretch_s = f.damping_bend_s = 0.0;
  const auto substeps = [&](double least) {
    Params params;
    params.damping_least_step = least;
    params.self_contact = false;
    Cloth cloth{params};
    cloth.reset(folding_sheet(), f, Scene());
    cloth.step(kNothing);
    return static_cast<double>(cloth.last_substeps());
  };
  const double undamped = substeps(0.75);
  f.damping_stretch_s = 1e-3;
  EXPECT_NEAR(substeps(0.75) * 0.75, undamped, 1.0);
  EXPECT_NEAR(substeps(0.5) * 0.5, undamped, 1.0);
  EXPECT_GT(substeps(0.0), 4.0 * undamped);
  f.damping_stretch_s = 1e-9;
  EXPECT_EQ(substeps(0.75), undamped);
}

TEST(Cloth, RefusalsSayWhatAndWhy) {
  const auto garment = std::make_shared<const Garment>(sheet(4, 4, 0.02));
  Cloth cloth{Params{}};
  const auto message = [&](auto&& change) {
    Fabric f = fabric();
    Scene s;
    change(f, s);
    return test::message_of<ConfigError>([&] { cloth.reset(garment, f, s); });
  };
  EXPECT_THAT(message([](Fabric& f, Scene&) { f.stretch_warp_n_per_m = 0; }), HasSubstr("fabric.stretch_n_per_m.warp"));
  EXPECT_THAT(message([](Fabric& f, Scene&) { f.density_kg_per_m2 = -1; }), HasSubstr("density_kg_per_m2"));
  EXPECT_THAT(message([](Fabric& f, Scene&) { f.poisson = 1.5; }), HasSubstr("poisson"));
  EXPECT_THAT(message([](Fabric& f, Scene&) { f.thickness_m = 0; }), HasSubstr("thickness_m"));
  EXPECT_THAT(message([](Fabric&, Scene& s) { s.pins = {99}; }), HasSubstr("scene.pins"));
  EXPECT_THAT(message([](Fabric& f, Scene&) { f.stretch_warp_n_per_m = 1e12; }), HasSubstr("max_substeps"));
}

TEST(Cloth, DivergenceNamesTheFrameAndNeedsAReset) {
  Fold fold(folding_sheet(), fabric());
  fold.run(0, 2);
  Positions far = fold.targets(3);
  far.col(2).setConstant(1e200);
  EXPECT_THAT(test::message_of<Diverged>([&] { fold.cloth.step(far); }), HasSubstr("frame 3"));
  EXPECT_THROW(fold.cloth.step(fold.targets(3)), Error);
  fold.cloth.reset(fold.garment, fabric(), Scene());
  fold.cloth.step(kNothing);
}

}  // namespace
}  // namespace weft::cloth
