// Obstacles: distance and gradient against finite differences, the points of edges and faces, the keys of a file.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "meshes/obstacle_mesh.hpp"
#include "simulation/scene.hpp"
#include "simulation/surroundings.hpp"
#include "weft/config.hpp"
#include "weft/random.hpp"
#include "weft/simulator.hpp"

namespace weft {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

std::vector<Obstacle> three_kinds() {
  Obstacle half_space, box, cylinder;
  const Eigen::Matrix3d turned =
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(0.3, -0.5, 0.8).normalized()).toRotationMatrix();
  box.kind = Obstacle::Kind::box;
  box.half_size = {0.3, 0.2, 0.1};
  box.rounding = 0.03;
  cylinder.kind = Obstacle::Kind::cylinder;
  cylinder.half_size = {0.1, 0.1, 0.25};
  cylinder.rounding = 0.02;
  std::vector<Obstacle> all{half_space, box, cylinder};
  for (Obstacle& o : all) o.axes = turned, o.centre = {0.1, -0.2, 0.3};
  return all;
}

Vec3 somewhere(RandomStream& random, double extent) {
  return {extent * random.normal(), extent * random.normal(), extent * random.normal()};
}

TEST(Obstacles, GradientOfTheDistanceIsThatOfFiniteDifferences) {
  RandomStream random(1);
  for (const Obstacle& o : three_kinds()) {
    int compared = 0;
    for (int k = 0; k < 2000; ++k) {
      const Vec3 x = o.centre + somewhere(random, 0.2);
      const ObstacleDistance at = obstacle_distance(o, x);
      EXPECT_NEAR(at.normal.norm(), 1.0, 1e-12);
      constexpr double h = 1e-6;
      Vec3 slope;
      double bend = 0.0;
      for (int c = 0; c < 3; ++c) {
        const Vec3 step = h * Vec3::Unit(c);
        const double up = obstacle_distance(o, x + step).distance, down = obstacle_distance(o, x - step).distance;
        slope[c] = (up - down) / (2.0 * h);
        bend = std::max(bend, std::abs(up + down - 2.0 * at.distance));
      }
      if (bend > 1e-9) continue;  // a kink inside the body, where the nearest side changes
      ++compared;
      EXPECT_LT((slope - at.normal).norm(), 1e-5) << static_cast<int>(o.kind) << " at " << x.transpose();
    }
    EXPECT_GT(compared, 1900);
  }
}

TEST(Obstacles, DistanceIsThatToTheNearestPointOfTheSurface) {
  RandomStream random(2);
  for (const Obstacle& o : three_kinds())
    for (int k = 0; k < 500; ++k) {
      const Vec3 x = o.centre + somewhere(random, 0.4);
      const ObstacleDistance at = obstacle_distance(o, x);
      if (at.distance < 0.0) continue;  // exact outside only
      EXPECT_NEAR(obstacle_distance(o, x - at.distance * at.normal).distance, 0.0, 1e-12);
      EXPECT_NEAR(obstacle_distance(o, x + 0.1 * at.normal).distance, at.distance + 0.1, 1e-12);
    }
}

TEST(Obstacles, DistanceIsConvexInsideAndOutside) {
  RandomStream random(3);
  for (const Obstacle& o : three_kinds())
    for (int k = 0; k < 2000; ++k) {
      const Vec3 a = o.centre + somewhere(random, 0.3), b = o.centre + somewhere(random, 0.3);
      const double middle = obstacle_distance(o, 0.5 * (a + b)).distance;
      EXPECT_LE(middle, 0.5 * (obstacle_distance(o, a).distance + obstacle_distance(o, b).distance) + 1e-12);
    }
}

TEST(Obstacles, NearestPointOfAnEdgeIsTheLowestOfManyAlongIt) {
  RandomStream random(4);
  int found = 0;
  for (const Obstacle& o : three_kinds())
    for (int k = 0; k < 2000; ++k) {
      const Vec3 a = o.centre + somewhere(random, 0.3), b = a + somewhere(random, 0.1);
      const ObstacleDistance at_a = obstacle_distance(o, a), at_b = obstacle_distance(o, b);
      double lowest = std::min(at_a.distance, at_b.distance);
      for (int s = 1; s < 200; ++s) lowest = std::min(lowest, obstacle_distance(o, a + s / 200.0 * (b - a)).distance);
      const auto contact = nearest_in_edge(o, a, b, at_a, at_b);
      const double got = contact ? contact->at.distance : std::min(at_a.distance, at_b.distance);
      EXPECT_LE(got, lowest + 1e-4 * (b - a).norm());
      EXPECT_GE(got, lowest - (b - a).norm() / 400.0);  // half of a step
      if (!contact) continue;
      ++found;
      EXPECT_NEAR(contact->weight[0] + contact->weight[1] + contact->weight[2], 1.0, 1e-12);
      EXPECT_NEAR(obstacle_distance(o, contact->weight[0] * a + contact->weight[1] * b).distance, got, 1e-12);
    }
  EXPECT_GT(found, 200);
}

TEST(Obstacles, NearestPointOfAFaceIsTheLowestOfManyInIt) {
  RandomStream random(5);
  int found = 0;
  for (const Obstacle& o : three_kinds())
    for (int k = 0; k < 4000; ++k) {
      // Faces near a corner or rim, outside of the body.
      const Vec3 tip = o.centre + o.axes * Vec3(o.half_size.x(), o.kind == Obstacle::Kind::box ? o.half_size.y() : 0.0,
                                                o.half_size.z());
      const Vec3 a = tip + somewhere(random, 0.1), b = tip + somewhere(random, 0.1), c = tip + somewhere(random, 0.1);
      const auto contact = nearest_in_face(o, a, b, c);
      if (!contact || contact->at.distance < 0.001) continue;
      double lowest = 1e9;
      for (int i = 0; i <= 60; ++i)
        for (int j = 0; i + j <= 60; ++j)
          lowest = std::min(lowest, obstacle_distance(o, a + i / 60.0 * (b - a) + j / 60.0 * (c - a)).distance);
      ++found;
      EXPECT_LE(contact->at.distance, lowest + 1e-9);
      EXPECT_GE(contact->at.distance, lowest - 0.01);
      const Vec3 point = contact->weight[0] * a + contact->weight[1] * b + contact->weight[2] * c;
      EXPECT_NEAR(obstacle_distance(o, point).distance, contact->at.distance, 1e-9);
    }
  EXPECT_GT(found, 50);
}

TEST(Obstacles, DistanceIsLinearBetweenPointsAboveOneFlatSide) {
  RandomStream random(6);
  int compared = 0;
  for (const Obstacle& o : three_kinds())
    for (int k = 0; k < 20000; ++k) {
      const Vec3 a = o.centre + somewhere(random, 0.3), b = o.centre + somewhere(random, 0.3);
      const int side = flat_side(o, a, 0.001);
      if (side == 0 || flat_side(o, b, 0.001) != side) continue;
      ++compared;
      const double middle = obstacle_distance(o, 0.5 * (a + b)).distance;
      EXPECT_NEAR(middle, 0.5 * (obstacle_distance(o, a).distance + obstacle_distance(o, b).distance), 1e-12);
    }
  EXPECT_GT(compared, 1000);
}

TEST(Obstacles, DrawnMeshesLieOnTheSurface) {
  for (const Obstacle& o : three_kinds()) {
    const Mesh mesh = obstacle_mesh(o, {0.0, 0.0, 1.0});
    double highest = -1.0;
    for (Index v = 0; v < mesh.positions.rows(); ++v) {
      const double distance = obstacle_distance(o, mesh.positions.row(v).transpose()).distance;
      highest = std::max(highest, distance);
      if (o.kind != Obstacle::Kind::half_space) {
        EXPECT_NEAR(distance, 0.0, 1e-12);
      }
    }
    EXPECT_NEAR(highest, 0.0, 1e-12);
    EXPECT_LT(mesh.faces.maxCoeff(), mesh.positions.rows());
  }
}

ConfigNode yaml(const std::string& text) { return ConfigNode::parse(text, "scene.yaml"); }

TEST(Obstacles, AreReadFromAFile) {
  const auto all =
      read_obstacles(yaml("- box: {centre_m: [0, 0, 1], size_m: [0.2, 0.4, 0.6], turn_deg: [0, 90, 0]}\n"
                          "- cylinder: {centre_m: [0, 0, 1], radius_m: 0.02, length_m: 1, axis: [0, 2, 0]}\n"
                          "- half_space: {point_m: [0, 0, -1], normal: [0, 0, 3], friction: 0.2}\n"
                          "- table: {size_m: [1, 0.6], edge_radius_m: 0.01}\n"));
  ASSERT_EQ(all.size(), 4u);
  EXPECT_EQ(all[0].name, "box");
  EXPECT_NEAR(obstacle_distance(all[0], {0.0, 0.0, 1.2}).distance, 0.1, 1e-12);  // its x is turned to -z
  EXPECT_DOUBLE_EQ(all[0].rounding, 0.005);
  EXPECT_FALSE(all[0].friction.has_value());
  EXPECT_NEAR(obstacle_distance(all[1], {0.0, 0.4, 1.05}).distance, 0.03, 1e-12);
  EXPECT_NEAR(obstacle_distance(all[1], {0.0, 0.6, 1.0}).distance, 0.1, 1e-12);
  EXPECT_NEAR(obstacle_distance(all[2], {5.0, 5.0, 0.0}).distance, 1.0, 1e-12);
  EXPECT_EQ(all[2].friction, 0.2);
  EXPECT_NEAR(obstacle_distance(all[3], {0.0, 0.0, 0.1}).distance, 0.1, 1e-12);  // its top is at 0
  EXPECT_DOUBLE_EQ(all[3].rounding, 0.01);
  EXPECT_TRUE(read_obstacles(ConfigNode()).empty());
  EXPECT_EQ(read_ground(ConfigNode()), 0.0);
  EXPECT_EQ(read_ground(yaml("none")), std::nullopt);
  EXPECT_EQ(read_ground(yaml("{height_m: -0.7}")), -0.7);
}

TEST(Obstacles, RefusalsNameFileLineKeyAndValue) {
  const auto refused = [](const std::string& text) {
    try {
      read_obstacles(yaml(text));
    } catch (const ConfigError& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  EXPECT_THAT(refused("{box: {}}"), HasSubstr("must be a list of obstacles"));
  EXPECT_THAT(refused("- {}"), HasSubstr("must be a mapping with one key"));
  EXPECT_THAT(refused("- boxx: {}"), HasSubstr("nearest: box"));
  EXPECT_THAT(refused("- box: {size_m: [1, 1, 1]}"), HasSubstr("centre_m"));
  EXPECT_THAT(refused("- box: {centre_m: [0, 0, 0], size_m: [1, 1]}"), HasSubstr("3 numbers"));
  EXPECT_THAT(refused("-\n  box: {centre_m: [0, 0, 0], size_m: [1, 1, -1]}"), HasSubstr("scene.yaml:2"));
  EXPECT_THAT(refused("- box: {centre_m: [0, 0, 0], size_m: [1, 1, 1], edge_radius_m: 0.6}"),
              HasSubstr("edge_radius_m = 0.6, must be at most 0.5"));
  EXPECT_THAT(refused("- cylinder: {centre_m: [0, 0, 0], length_m: 1}"), HasSubstr("radius_m"));
  EXPECT_THAT(refused("- half_space: {point_m: [0, 0, 0], normal: [0, 0, 0]}"), HasSubstr("not all zero"));
  EXPECT_THAT(refused("- table: {size_m: [1, 1], friction: -0.1}"), HasSubstr("friction = -0.1"));
  EXPECT_THAT(refused("- table: {size_m: [1, 1], thicknes_m: 0.1}"), HasSubstr("nearest: thickness_m"));
  EXPECT_THAT([] { read_obstacles(yaml("- table: {size_m: [1, 1]}"), 0.0); },
              ThrowsMessage<ConfigError>(HasSubstr("has its top at 0 m, must be above the ground at 0 m")));
  EXPECT_NO_THROW(read_obstacles(yaml("- table: {size_m: [1, 1], top_m: 0.1}"), 0.0));
}

TEST(Obstacles, ASceneRepeatsItself) {
  const ConfigNode config = ConfigNode::load(WEFT_SOURCE_DIR "/configs/experiments/scenes/over_the_bar.yaml");
  const SceneRun run = read_scene(config);
  ASSERT_FALSE(run.scene.obstacles.empty());
  const SceneRun again =
      read_scene(config.merged(ConfigNode::mapping({{"obstacles", write_scene(run, "x.obj").at("obstacles")}})));
  ASSERT_EQ(again.scene.obstacles.size(), run.scene.obstacles.size());
  EXPECT_EQ(again.scene.obstacles[0].centre, run.scene.obstacles[0].centre);
}

std::shared_ptr<Garment> square(double z) {
  Mesh mesh;
  mesh.positions.resize(4, 3);
  mesh.positions << 0, 0, z, 0.1, 0, z, 0, 0.1, z, 0.1, 0.1, z;
  mesh.rest = mesh.positions.leftCols<2>();
  mesh.faces.resize(2, 3);
  mesh.faces << 0, 1, 3, 0, 3, 2;
  return std::make_shared<Garment>(make_garment(mesh, "square"));
}

TEST(Obstacles, ClothStartsAThicknessAboveThemAndNotInsideThem) {
  Scene scene;
  scene.ground_height = -0.7;
  scene.obstacles = read_obstacles(yaml("- table: {size_m: [1, 1]}"));
  const Positions lying = start_positions(*square(0.0), scene, 0.002);
  EXPECT_NEAR((lying.col(2).array() - 0.002).abs().maxCoeff(), 0.0, 1e-15);
  EXPECT_EQ(start_positions(*square(0.5), scene, 0.002), square(0.5)->positions);
  EXPECT_THROW(start_positions(*square(-0.01), scene, 0.002), ConfigError);
  // Layers lie on height 0, the work surface, not on the ground below the table.
  const auto layered = square(0.0);
  layered->form.layers = {0.0, 0.0, 1.0, 1.0};
  EXPECT_NEAR(start_positions(*layered, scene, 0.002)(3, 2), 0.004, 1e-15);
}

TEST(Obstacles, ResetChecksThem) {
  Scene scene;
  scene.obstacles = three_kinds();
  SimulatorCapabilities can;
  const auto refused = [&] {
    try {
      check_reset("toy", square(2.0).get(), Fabric(), scene, can);
    } catch (const ConfigError& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  EXPECT_THAT(refused(), HasSubstr("capability obstacles"));
  can.obstacles = true;
  can.orthotropic = true;
  EXPECT_EQ(refused(), "accepted");
  scene.obstacles[1].rounding = 0.2;
  EXPECT_THAT(refused(), HasSubstr("scene.obstacles.1"));
  scene.obstacles = three_kinds();
  scene.obstacles[2].centre.x() = std::nan("");
  EXPECT_THAT(refused(), HasSubstr("not finite"));
  scene.obstacles = three_kinds();
  scene.obstacles[0].axes *= 2.0;
  EXPECT_THAT(refused(), HasSubstr("orthonormal"));
  scene.obstacles = three_kinds();
  scene.obstacles[0].friction = -1.0;
  EXPECT_THAT(refused(), HasSubstr("friction"));
}

}  // namespace
}  // namespace weft
