#include "meshes/intersections.hpp"
#include "meshes/mesher.hpp"
#include "test_support.hpp"

namespace weft {
namespace {

using test::message_of;

using ::testing::HasSubstr;

void expect_good(const GeneratedMesh& generated, double min_angle_deg) {
  EXPECT_GE(generated.quality.min_angle_deg, min_angle_deg);
  EXPECT_LE(generated.quality.max_angle_deg, 180.0 - 2.0 * min_angle_deg + 1e-9);
  EXPECT_EQ(count_intersections(generated.mesh.positions, generated.mesh.faces), 0);
  // A disc: V - E + F = 1.
  const Index edges = edges_of(generated.mesh.faces).rows();
  EXPECT_EQ(generated.mesh.positions.rows() - edges + generated.mesh.faces.rows(), 1);
}

TEST(Generator, TowelIsTheRectangleAskedFor) {
  const GeneratedMesh towel = generate_mesh(towel_outline({0.5, 0.3}), {0.02});
  expect_good(towel, 30.0);
  EXPECT_NEAR(towel.quality.area_m2, 0.15, 1e-9);
  EXPECT_NEAR(towel.mesh.rest.col(0).maxCoeff(), 0.25, 1e-12);
  EXPECT_NEAR(towel.mesh.rest.col(0).minCoeff(), -0.25, 1e-12);
  EXPECT_NEAR(towel.quality.edge_median_m, 0.02, 0.002);
  const auto corner = towel.vertices.at("left_top");
  EXPECT_EQ(towel.mesh.rest(corner, 0), -0.25);
  EXPECT_EQ(towel.mesh.rest(corner, 1), 0.3);
}

TEST(Generator, ShirtHasSizeAndNamedCorners) {
  const GeneratedMesh shirt = generate_mesh(shirt_outline({}), {0.022});
  expect_good(shirt, 30.0);
  EXPECT_NEAR(shirt.mesh.rest.col(0).maxCoeff() - shirt.mesh.rest.col(0).minCoeff(), 0.6, 1e-5);
  EXPECT_NEAR(shirt.mesh.rest.col(1).maxCoeff(), 0.7, 1e-6);
  EXPECT_NEAR(shirt.mesh.rest.col(1).minCoeff(), 0.0, 1e-6);
  const auto at = [&](const char* name) -> Vec2 { return shirt.mesh.rest.row(shirt.vertices.at(name)).transpose(); };
  EXPECT_NEAR(at("left_sleeve_top").x(), -0.3, 1e-6);
  EXPECT_EQ(at("left_body_bottom").y(), 0.0);
  for (const char* name : {"sleeve_top", "sleeve_bottom", "armpit", "body_bottom", "collar"}) {
    const Vec2 left = at((std::string("left_") + name).c_str());
    const Vec2 right = at((std::string("right_") + name).c_str());
    EXPECT_LT(left.x(), 0.0) << name;
    EXPECT_EQ(left.x(), -right.x()) << name;
    EXPECT_EQ(left.y(), right.y()) << name;
  }
  EXPECT_EQ(at("collar").x(), 0.0);
}

TEST(Generator, TrousersAndLongSleevesComeOut) {
  const GeneratedMesh trousers = generate_mesh(trousers_outline({}), {0.025});
  expect_good(trousers, 30.0);
  EXPECT_TRUE(trousers.vertices.count("crotch"));
  const GeneratedMesh shirt = generate_mesh(shirt_outline(long_sleeve_size()), {0.025});
  expect_good(shirt, 30.0);
  EXPECT_TRUE(shirt.vertices.count("left_sleeve_top"));
}

TEST(Generator, GradedMeshIsFineAtTheLineAndCoarseElsewhere) {
  MeshSize size;
  size.edge_m = 0.03;
  size.fine_edge_m = 0.01;
  size.fine_band_m = 0.03;
  size.fine_lines.push_back({Vec2(0.0, -1.0), Vec2(0.0, 2.0)});
  const GeneratedMesh shirt = generate_mesh(shirt_outline({}), size);
  expect_good(shirt, 28.0);
  double near = 0.0, far = 0.0;
  int near_count = 0, far_count = 0;
  const auto edges = edges_of(shirt.mesh.faces);
  for (Index e = 0; e < edges.rows(); ++e) {
    const Vec2 a = shirt.mesh.rest.row(edges(e, 0)).transpose();
    const Vec2 b = shirt.mesh.rest.row(edges(e, 1)).transpose();
    const double x = std::abs(a.x() + b.x()) / 2.0;
    if (x < 0.02) near += (a - b).norm(), ++near_count;
    if (x > 0.18) far += (a - b).norm(), ++far_count;
  }
  EXPECT_NEAR(near / near_count, 0.01, 0.0015);
  EXPECT_GT(far / far_count, 0.024);
}

TEST(Generator, SameInputGivesTheSameBits) {
  const GeneratedMesh a = generate_mesh(shirt_outline({}), {0.03});
  const GeneratedMesh b = generate_mesh(shirt_outline({}), {0.03});
  EXPECT_EQ(a.mesh.positions, b.mesh.positions);
  EXPECT_EQ(a.mesh.faces, b.mesh.faces);
  EXPECT_EQ(a.vertices, b.vertices);
}

TEST(Generator, NumbersNeighboursNearEachOther) {
  const GeneratedMesh shirt = generate_mesh(shirt_outline({}), {0.015});
  const auto edges = edges_of(shirt.mesh.faces);
  double jump = 0.0;
  for (Index e = 0; e < edges.rows(); ++e) jump += edges(e, 1) - edges(e, 0);
  EXPECT_LT(jump / static_cast<double>(edges.rows()), 0.1 * static_cast<double>(shirt.mesh.positions.rows()));
}

TEST(Generator, MeshSizeGrowsFromTheBand) {
  MeshSize size;
  size.edge_m = 0.03;
  size.fine_edge_m = 0.01;
  size.fine_band_m = 0.05;
  size.growth = 0.2;
  size.fine_lines.push_back({Vec2(0.0, 0.0), Vec2(0.0, 1.0)});
  EXPECT_DOUBLE_EQ(size.at(Vec2(0.05, 0.5)), 0.01);
  EXPECT_NEAR(size.at(Vec2(0.10, 0.5)), 0.02, 1e-12);
  EXPECT_DOUBLE_EQ(size.at(Vec2(0.50, 0.5)), 0.03);
}

TEST(Generator, RefusesContradictorySizes) {
  ShirtSize shirt;
  shirt.sleeve_length_m = 0.3;
  EXPECT_THAT(message_of<ConfigError>([&] { shirt_outline(shirt); }), HasSubstr("must be wider than neck_width_m"));
  shirt = {};
  shirt.armhole_m = 0.9;
  EXPECT_THAT(message_of<ConfigError>([&] { shirt_outline(shirt); }), HasSubstr("reaches below the bottom hem"));
  shirt = {};
  shirt.sleeve_width_m = 0.5;
  EXPECT_THAT(message_of<ConfigError>([&] { shirt_outline(shirt); }), HasSubstr("reaches into the body"));
  TrousersSize trousers;
  trousers.inseam_m = 1.0;
  EXPECT_THAT(message_of<ConfigError>([&] { trousers_outline(trousers); }), HasSubstr("must be less than length_m"));
}

TEST(Generator, RefusesBadOutlines) {
  Outline bow;
  bow.points = {{Vec2(0, 0)}, {Vec2(1, 1)}, {Vec2(1, 0)}, {Vec2(0, 1)}};
  EXPECT_THAT(message_of<ConfigError>([&] { generate_mesh(bow, {0.1}); }), HasSubstr("crosses side"));
  Outline clockwise;
  clockwise.points = {{Vec2(0, 0)}, {Vec2(0, 1)}, {Vec2(1, 1)}, {Vec2(1, 0)}};
  EXPECT_THAT(message_of<ConfigError>([&] { generate_mesh(clockwise, {0.1}); }), HasSubstr("runs clockwise"));
  EXPECT_THAT(message_of<ConfigError>([&] { generate_mesh(towel_outline({}), {1e-5}); }),
              HasSubstr("must be at most 200000"));
}

}  // namespace
}  // namespace weft
