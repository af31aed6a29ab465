// Obstacles in the cloth plugin: what moves over edges, corners and bars, and what must not change.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

// Compiled in, so that allocations are counted (with -march as the plugin).
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
#include "weft/mesh.hpp"

namespace weft::cloth {
namespace {

const Positions kNothing(0, 3);

/// n x n vertices h apart, around the origin at height z.
std::shared_ptr<const Garment> square(Index n, double h, double z) {
  Mesh mesh;
  mesh.source = "square";
  mesh.positions.resize(n * n, 3);
  mesh.rest.resize(n * n, 2);
  const double middle = 0.5 * h * static_cast<double>(n - 1);
  for (Index r = 0; r < n; ++r)
    for (Index c = 0; c < n; ++c) {
      const double x = static_cast<double>(c) * h - middle, y = static_cast<double>(r) * h - middle;
      mesh.rest.row(r * n + c) << x, y;
      mesh.positions.row(r * n + c) << x, y, z;
    }
  mesh.faces.resize(2 * (n - 1) * (n - 1), 3);
  Index f = 0;
  for (Index r = 0; r + 1 < n; ++r)
    for (Index c = 0; c + 1 < n; ++c) {
      const int a = static_cast<int>(r * n + c), b = a + 1, d = static_cast<int>(a + n), e = d + 1;
      mesh.faces.row(f++) << a, b, e;
      mesh.faces.row(f++) << a, e, d;
    }
  return std::make_shared<const Garment>(make_garment(mesh, "square"));
}

Fabric fabric() {
  Fabric f;
  f.damping_air_per_s = 2.0;
  f.damping_bend_s = 0.01;
  f.friction = 0.5;
  return f;
}

Obstacle body(Obstacle::Kind kind, const Vec3& centre, const Vec3& half_size, double rounding) {
  Obstacle o;
  o.kind = kind;
  o.name = kind == Obstacle::Kind::box ? "box" : "cylinder";
  o.centre = centre;
  o.half_size = half_size;
  o.rounding = rounding;
  return o;
}
/// A cube whose top is at the origin's height, smaller than the sheets that fall on it.
Scene cube(double rounding) {
  Scene scene;
  scene.ground_height = -0.2;
  scene.obstacles = {body(Obstacle::Kind::box, {0.013, 0.007, -0.05}, {0.05, 0.05, 0.05}, rounding)};
  return scene;
}
Scene bar() {
  Scene scene;
  scene.ground_height.reset();
  scene.obstacles = {body(Obstacle::Kind::cylinder, {0.0, 0.0, -0.02}, {0.02, 0.02, 0.3}, 0.005)};
  scene.obstacles[0].axes.col(0) = Vec3(0.0, 0.0, 1.0);
  scene.obstacles[0].axes.col(1) = Vec3(1.0, 0.0, 0.0);
  scene.obstacles[0].axes.col(2) = Vec3(0.0, 1.0, 0.0);
  return scene;
}

/// The least distance (m) of any of 66 points of every face to the obstacles.
double least_distance(const Scene& scene, const Garment& garment, const Positions& x) {
  double least = std::numeric_limits<double>::infinity();
  for (const Obstacle& obstacle : scene.obstacles)
    for (Index f = 0; f < garment.face_count(); ++f) {
      const auto corner = [&](int k) { return Vec3(x.row(garment.faces(f, k)).transpose()); };
      for (int i = 0; i <= 10; ++i)
        for (int j = 0; i + j <= 10; ++j)
          least = std::min(
              least,
              obstacle_distance(obstacle, 0.1 * (i * corner(0) + j * corner(1) + (10 - i - j) * corner(2))).distance);
    }
  return least;
}

// The cube's edges, and its corners, are smaller than the faces: vertices alone would let the cloth fall through them.
TEST(ClothOnObstacles, EdgesAndFacesKeepOffACube) {
  for (const double rounding : {0.0, 0.01}) {
    const auto garment = square(16, 0.02, 0.02);
    const Scene scene = cube(rounding);
    Cloth cloth{Params()};
    cloth.reset(garment, fabric(), scene);
    double least = 1.0;
    for (int k = 0; k < 90; ++k) {
      cloth.step(kNothing);
      least = std::min(least, least_distance(scene, *garment, cloth.positions()));
    }
    EXPECT_GT(least, 0.5 * fabric().thickness_m) << "rounding " << rounding;
    EXPECT_LT(cloth.positions().col(2).minCoeff(), -0.03);  // it hangs over all sides
  }
}

TEST(ClothOnObstacles, HangsOverABarAndComesToRest) {
  for (const double edge : {0.02, 0.01}) {
    const auto garment = square(edge < 0.015 ? 25 : 13, edge, 0.01);
    const Scene scene = bar();
    Cloth cloth{Params()};
    cloth.reset(garment, fabric(), scene);
    for (int k = 0; k < 30; ++k) cloth.step(kNothing);
    const SettleResult rest = cloth.settle({0.005, 6, 900});
    EXPECT_TRUE(rest.settled) << edge << " m, speed " << rest.max_speed;
    EXPECT_GT(least_distance(scene, *garment, cloth.positions()), 0.5 * fabric().thickness_m);
    EXPECT_LT(cloth.positions().col(2).minCoeff(), -0.08);
    EXPECT_GT(cloth.positions().col(2).maxCoeff(), 0.0);
  }
}

TEST(ClothOnObstacles, AHeldSheetIsDraggedOverTheEdgeOfATable) {
  const auto garment = square(13, 0.02, 0.0);
  Scene scene;
  scene.ground_height = -0.5;
  scene.obstacles = {body(Obstacle::Kind::box, {-0.5, 0.0, -0.015}, {0.5, 0.4, 0.015}, 0.005)};
  Cloth cloth{Params()};
  cloth.reset(garment, fabric(), scene);
  const std::vector<Index> hands = {12, 168};
  cloth.grasp(hands);
  Positions targets(2, 3);
  for (int k = 0; k < 2; ++k) targets.row(k) = cloth.positions().row(hands[k]);
  double least = 1.0;
  for (int k = 0; k < 90; ++k) {
    targets.rowwise() += Eigen::RowVector3d(0.0005, 0.0, -0.003);
    cloth.step(targets);
    least = std::min(least, least_distance(scene, *garment, cloth.positions()));
  }
  EXPECT_GT(least, 0.4 * fabric().thickness_m);
  EXPECT_LT(cloth.diagnostics().max_strain, 0.3);
}

TEST(ClothOnObstacles, FrictionOfAnObstacleReplacesTheFabrics) {
  const auto garment = square(7, 0.02, 0.0);
  Scene scene;
  scene.ground_height.reset();
  Obstacle slope;
  slope.axes.col(0) = Vec3(0.8, 0.0, -0.6);
  slope.axes.col(2) = Vec3(0.6, 0.0, 0.8);
  scene.obstacles = {slope};
  auto tilted = std::make_shared<Garment>(*garment);
  tilted->positions = garment->positions * slope.axes.transpose();
  const auto moved = [&](std::optional<double> friction) {
    scene.obstacles[0].friction = friction;
    Cloth cloth{Params()};
    cloth.reset(tilted, fabric(), scene);
    const Positions start = cloth.positions();
    for (int k = 0; k < 30; ++k) cloth.step(kNothing);
    return (cloth.positions() - start).rowwise().norm().mean();
  };
  EXPECT_GT(moved(std::nullopt), 0.1);  // tan = 0.75 > 0.5
  EXPECT_LT(moved(0.8), 1e-4);
  EXPECT_GT(moved(0.0), 1.5 * moved(std::nullopt));
}

TEST(ClothOnObstacles, SnapshotContinuesBitForBitInAnotherObject) {
  for (const double edge : {0.02, 0.01}) {
    const auto garment = square(edge < 0.015 ? 25 : 13, edge, 0.01);
    Cloth cloth{Params()}, other{Params()};
    cloth.reset(garment, fabric(), cube(0.01));
    other.reset(garment, fabric(), cube(0.01));
    for (int k = 0; k < 25; ++k) cloth.step(kNothing);
    const auto snapshot = cloth.save();
    other.step(kNothing);
    other.restore(*snapshot);
    for (int k = 0; k < 15; ++k) cloth.step(kNothing), other.step(kNothing);
    EXPECT_EQ(cloth.positions(), other.positions());
    EXPECT_EQ(cloth.velocities(), other.velocities());
  }
}

TEST(ClothOnObstacles, AllocatesNothingInTheFrameLoop) {
  for (const double edge : {0.02, 0.01}) {
    Cloth cloth{Params()};
    cloth.reset(square(edge < 0.015 ? 25 : 13, edge, 0.01), fabric(), cube(0.01));
    const long before = allocations;
    for (int k = 0; k < 40; ++k) cloth.step(kNothing);
    cloth.settle({0.005, 6, 20});
    EXPECT_EQ(allocations - before, 0) << edge;
  }
}

TEST(ClothOnObstacles, AnObstacleOutOfReachChangesOnlyTheSubstep) {
  // Both runs obey the same equations; far from any obstacle they differ as two substeps do.
  const auto garment = square(9, 0.02, 0.02);
  Scene scene;
  Cloth without{Params()}, with{Params()};
  without.reset(garment, fabric(), scene);
  scene.obstacles = {body(Obstacle::Kind::box, {3.0, 0.0, 0.0}, {0.1, 0.1, 0.1}, 0.01)};
  with.reset(garment, fabric(), scene);
  for (int k = 0; k < 40; ++k) without.step(kNothing), with.step(kNothing);
  EXPECT_LT((without.positions() - with.positions()).rowwise().norm().maxCoeff(), 1e-4);
}

}  // namespace
}  // namespace weft::cloth
