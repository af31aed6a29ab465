#include "session/goal_surface.hpp"

#include <gmock/gmock.h>
#include <png.h>

#include <cmath>

#include "unit/test_support.hpp"
#include "weft/error.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

/// A square sheet of n x n cells of two triangles each, edge 0.2 m, lower left corner at the origin.
Garment sheet(int n) {
  Garment garment;
  garment.positions.resize((n + 1) * (n + 1), 3);
  garment.faces.resize(2 * n * n, 3);
  for (int i = 0; i <= n; ++i)
    for (int j = 0; j <= n; ++j) garment.positions.row(i * (n + 1) + j) << 0.2 * i / n, 0.2 * j / n, 0.0;
  for (int i = 0, f = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const int a = i * (n + 1) + j, b = a + n + 1;
      garment.faces.row(f++) << a, b, a + 1;
      garment.faces.row(f++) << a + 1, b, b + 1;
    }
  }
  return garment;
}

double loss(const GoalSurface& goal, const Positions& shape) {
  return 0.5 * goal.residuals(goal.pairs(shape), shape).squaredNorm();
}

class GoalSurfaces : public testing::Test {
 protected:
  Garment cloth_ = sheet(6), other_ = sheet(5);
  GoalSurface goal_{GoalKind::surface, other_.positions, other_.faces, cloth_};
  Positions moved(double x, double y, double z) const {
    return cloth_.positions.rowwise() + Eigen::RowVector3d(x, y, z);
  }
};

TEST_F(GoalSurfaces, AnotherTriangulationOfTheSameShapeIsNoDifference) {
  EXPECT_NEAR(goal_.chamfer_mm(cloth_.positions), 0.0, 1e-9);
  EXPECT_NEAR(loss(goal_, cloth_.positions), 0.0, 1e-12);
  EXPECT_NEAR(goal_.iou(cloth_.positions), 1.0, 1e-12);
}

TEST_F(GoalSurfaces, AHeightIsMeasuredInBothDirections) {
  EXPECT_NEAR(goal_.chamfer_mm(moved(0, 0, 0.003)), 3.0, 1e-9);
  // Every pair of the surface and of the outline is 3 mm apart: 2 parts of 9 / 6 + 9 / 6.
  EXPECT_NEAR(loss(goal_, moved(0, 0, 0.003)), 6.0, 1e-9);
}

TEST_F(GoalSurfaces, TheOutlineTellsHowFarAClothHasSlid) {
  // A quarter of the square's outline goes away from each edge: of the outline alone mean d^2 over half of it.
  const double slid = loss(goal_, moved(0.01, 0, 0));
  EXPECT_GT(slid, 0.4 * 100.0 / 3.0);
  EXPECT_LT(slid, 1.0 * 100.0 / 3.0);
  EXPECT_GT(goal_.chamfer_mm(moved(0.01, 0, 0)), 0.1);
}

TEST_F(GoalSurfaces, GradientsAndChangesAreThoseOfTheResiduals) {
  RandomStream random(5, 1);
  Positions shape = moved(0.004, -0.003, 0.002), change(shape.rows(), 3);
  for (Index k = 0; k < shape.size(); ++k) {
    shape.data()[k] += 0.002 * random.normal();
    change.data()[k] = random.normal();
  }
  for (const GoalKind kind : {GoalKind::surface, GoalKind::points, GoalKind::silhouette}) {
    const GoalSurface goal(kind, other_.positions, kind == GoalKind::points ? Faces(0, 3) : other_.faces, cloth_);
    const GoalPairs pairs = goal.pairs(shape);
    const Vector residuals = goal.residuals(pairs, shape);
    ASSERT_EQ(residuals.size(), goal.residual_count());
    const Positions gradient = goal.pullback(pairs, residuals);
    EXPECT_NEAR(residuals.dot(goal.residual_change(pairs, change)), gradient.cwiseProduct(change).sum(), 1e-9);
    // The pairs move too, but at the nearest points that changes nothing to first order.
    constexpr double h = 1e-7;
    const double slope = (loss(goal, shape + h * change) - loss(goal, shape - h * change)) / (2.0 * h);
    EXPECT_NEAR(slope, gradient.cwiseProduct(change).sum(), 1e-3 * std::abs(slope)) << static_cast<int>(kind);
  }
}

TEST_F(GoalSurfaces, ASilhouetteKnowsNoHeights) {
  const GoalSurface goal(GoalKind::silhouette, moved(0, 0, 0.05), cloth_.faces, cloth_);
  Positions bent = cloth_.positions;
  bent.col(2) = bent.col(0);
  EXPECT_NEAR(loss(goal, bent), 0.0, 1e-12);
  EXPECT_NEAR(goal.chamfer_mm(bent), 0.0, 1e-9);
  EXPECT_GT(loss(goal, moved(0.01, 0, 0)), 0.1);
}

TEST_F(GoalSurfaces, PointsHaveNoOutlineAndNoSilhouette) {
  const GoalSurface goal(GoalKind::points, cloth_.positions, Faces(0, 3), cloth_);
  EXPECT_NEAR(goal.chamfer_mm(cloth_.positions), 0.0, 1e-9);
  EXPECT_TRUE(std::isnan(goal.iou(cloth_.positions)));
  EXPECT_THROW(GoalSurface(GoalKind::points, Positions(0, 3), Faces(0, 3), cloth_), ShapeError);
  EXPECT_THROW(GoalSurface(GoalKind::surface, Positions::Zero(3, 3), other_.faces.topRows(0), cloth_), ShapeError);
}

class Masks : public testing::Test {
 protected:
  std::filesystem::path write(int width, int height, const std::vector<unsigned char>& grey) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = width;
    image.height = height;
    image.format = PNG_FORMAT_GRAY;
    const auto file = folder_ / "mask.png";
    EXPECT_NE(png_image_write_to_file(&image, file.c_str(), 0, grey.data(), 0, nullptr), 0);
    return file;
  }
  test::Folder folder_;
  Positions positions_;
  Faces faces_;
};

TEST_F(Masks, WhiteIsClothAndTheFirstRowIsOnTop) {
  // Above: two pixels on the left; below: one on the right.
  const auto file = write(3, 2, {255, 255, 0, 0, 0, 255});
  read_mask(file, 0.01, {0.1, -0.2}, positions_, faces_);
  ASSERT_EQ(faces_.rows(), 4);
  EXPECT_NEAR(positions_.col(0).minCoeff(), 0.1, 1e-12);
  EXPECT_NEAR(positions_.col(0).maxCoeff(), 0.13, 1e-12);
  EXPECT_NEAR(positions_(0, 1), -0.19, 1e-12);  // the upper row
  EXPECT_NEAR(positions_(1, 0), 0.12, 1e-12);
  EXPECT_NEAR(positions_(4, 0), 0.12, 1e-12);
  EXPECT_NEAR(positions_(4, 1), -0.2, 1e-12);
}

TEST_F(Masks, WhatIsNoMaskIsRefused) {
  const auto reads = [&](const std::filesystem::path& file) { read_mask(file, 0.01, {0, 0}, positions_, faces_); };
  EXPECT_THAT(
      [&] {
        reads(write(2, 1, {0, 100}));
      },
      testing::ThrowsMessage<ConfigError>(testing::HasSubstr("has no white pixel")));
  EXPECT_THAT([&] { reads(folder_.write("text.png", "no picture")); },
              testing::ThrowsMessage<ConfigError>(testing::HasSubstr("is no PNG")));
  EXPECT_THAT([&] { reads(folder_ / "missing.png"); },
              testing::ThrowsMessage<ConfigError>(testing::HasSubstr("no such file")));
}

}  // namespace
}  // namespace weft
