#include "session/shape_errors.hpp"

#include <gmock/gmock.h>

#include <Eigen/Geometry>
#include <cmath>

#include "unit/test_support.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

/// A square of n x n cells of two triangles each, turned by an angle about its
/// centre.
Positions square(double edge, Eigen::Vector2d centre, double angle = 0.0, int n = 7) {
  Positions positions((n + 1) * (n + 1), 3);
  for (int i = 0; i <= n; ++i) {
    for (int j = 0; j <= n; ++j) {
      const Eigen::Vector2d from(edge * (static_cast<double>(i) / n - 0.5), edge * (static_cast<double>(j) / n - 0.5));
      const Eigen::Vector2d to = centre + Eigen::Rotation2Dd(angle) * from;
      positions.row(i * (n + 1) + j) << to.x(), to.y(),
          0.01 * i;  // heights do not matter
    }
  }
  return positions;
}
Faces square_faces(int n = 7) {
  Faces faces(2 * n * n, 3);
  for (int i = 0, f = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const int a = i * (n + 1) + j, b = a + n + 1;
      faces.row(f++) << a, b, a + 1;
      faces.row(f++) << a + 1, b, b + 1;
    }
  }
  return faces;
}

TEST(SilhouetteIou, OfTheSameShapeIsOne) {
  const Positions one = square(0.3, {0.2, -0.4}, 0.3);
  EXPECT_EQ(silhouette_iou(one, one, square_faces()), 1.0);
}

TEST(SilhouetteIou, OfSquaresOnTheRasterIsExact) {
  // 0.2 m wide, moved by 50 mm and by 30 mm: 150 x 170 cells of 2 x 200 x 200 -
  // 150 x 170 are in both.
  const Positions one = square(0.2, {0.1, 0.1}), moved = square(0.2, {0.15, 0.13});
  EXPECT_DOUBLE_EQ(silhouette_iou(one, moved, square_faces()), 25500.0 / (80000.0 - 25500.0));
  EXPECT_DOUBLE_EQ(silhouette_iou(moved, one, square_faces()), 25500.0 / (80000.0 - 25500.0));
  const Positions inside = square(0.1, {0.1, 0.1});
  EXPECT_DOUBLE_EQ(silhouette_iou(one, inside, square_faces()), 0.25);
}

TEST(SilhouetteIou, OfShapesThatDoNotMeetIsZero) {
  EXPECT_EQ(silhouette_iou(square(0.2, {0, 0}), square(0.2, {0.21, 0}), square_faces()), 0.0);
  EXPECT_EQ(silhouette_iou(square(0.2, {0, 0}), square(0.2, {0, -30.0}), square_faces()), 0.0);
}

TEST(SilhouetteIou, OfTurnedSquaresIsTheOctagon) {
  // A square of edge 1 and the same turned by 45 degrees share an octagon of
  // area 2 (sqrt(2) - 1). The raster counts areas to about the cell times the
  // length of the outlines.
  const double both = 2.0 * (std::sqrt(2.0) - 1.0), exact = both / (2.0 - both);
  const double pi = std::acos(-1.0);
  const Positions one = square(0.5, {0.0123, 0.0456}), turned = square(0.5, {0.0123, 0.0456}, pi / 4.0);
  EXPECT_NEAR(silhouette_iou(one, turned, square_faces()), exact, 1e-3);
  EXPECT_NEAR(silhouette_iou(one, turned, square_faces(), 1e-4), exact, 1e-4);
}

TEST(SilhouetteIou, CountsWhatLiesDoubleOnce) {
  // Folded in half about x = 0: the silhouette is the half, and all triangles
  // of it lie twice, half of them upside down.
  const Positions flat = square(0.2, {0.0, 0.0}, 0.0, 8);
  Positions folded = flat;
  folded.col(0) = folded.col(0).cwiseAbs();
  EXPECT_DOUBLE_EQ(silhouette_iou(flat, folded, square_faces(8)), 0.5);
  EXPECT_EQ(silhouette_iou(folded, folded, square_faces(8)), 1.0);
}

/// A slow reference: tests the centre of every cell against every triangle by
/// the signs of three areas.
double brute_force_iou(const Positions& a, const Positions& b, const Faces& faces, double cell, int half) {
  const auto covers = [&](const Positions& shape, double x, double y) {
    for (Index f = 0; f < faces.rows(); ++f) {
      bool left = false, right = false;
      for (int k = 0; k < 3; ++k) {
        const auto p = shape.row(faces(f, k)), q = shape.row(faces(f, (k + 1) % 3));
        const double area = (q(0) - p(0)) * (y - p(1)) - (q(1) - p(1)) * (x - p(0));
        left |= area > 0.0;
        right |= area < 0.0;
      }
      if (!(left && right)) return true;
    }
    return false;
  };
  double both = 0.0, any = 0.0;
  for (int i = -half; i < half; ++i) {
    for (int j = -half; j < half; ++j) {
      const double x = (i + 0.5) * cell, y = (j + 0.5) * cell;
      const bool in_a = covers(a, x, y), in_b = covers(b, x, y);
      both += in_a && in_b;
      any += in_a || in_b;
    }
  }
  return both / any;
}

TEST(SilhouetteIou, IsThatOfTheSlowReferenceForCrumpledCloth) {
  RandomStream random(3, stream_key("crumple"));
  for (int trial = 0; trial < 5; ++trial) {
    Positions shapes[2] = {square(0.1, {0.0, 0.0}, 0.2, 4), square(0.1, {0.01, 0.0}, 0.9, 4)};
    for (auto& shape : shapes)
      for (Index i = 0; i < shape.size(); ++i) shape.data()[i] += 0.02 * random.normal();
    const double iou = silhouette_iou(shapes[0], shapes[1], square_faces(4), 0.002);
    EXPECT_GT(iou, 0.1);
    EXPECT_DOUBLE_EQ(iou, brute_force_iou(shapes[0], shapes[1], square_faces(4), 0.002, 100)) << trial;
  }
}

TEST(SilhouetteIou, IsNotANumberWhereThereIsNoSilhouette) {
  Positions upright = square(0.2, {0.0, 0.0});
  upright.col(2) = upright.col(1);
  upright.col(1).setZero();
  const Positions flat = square(0.2, {0.0, 0.0});
  EXPECT_TRUE(std::isnan(silhouette_iou(upright, upright, square_faces())));
  EXPECT_EQ(silhouette_iou(flat, upright, square_faces()), 0.0);
  Positions lost = flat;
  lost(3, 0) = 1e9;
  EXPECT_TRUE(std::isnan(silhouette_iou(flat, lost, square_faces())));
  EXPECT_THROW(silhouette_iou(flat, flat.topRows(4), square_faces()), ShapeError);
}

Task square_task() {
  Garment garment;
  garment.positions = square(0.2, {0.0, 0.0}, 0.0, 1);
  garment.faces = square_faces(1);
  garment.vertices = {{"corner", 0}, {"same_corner", 0}, {"other", 2}};
  Task task;
  task.garment = std::make_shared<const Garment>(garment);
  task.manipulation.grasp_vertices = {2, 3};
  return task;
}

TEST(SilhouetteArea, CountsWhatIsCoveredOnce) {
  Positions two(2 * 64, 3);
  two << square(0.2, {0.1, 0.1}), square(0.2, {0.2, 0.1});  // half of each lies over the other
  Faces faces(2 * square_faces().rows(), 3);
  faces << square_faces(), (square_faces().array() + 64).matrix();
  EXPECT_NEAR(silhouette_area(two, faces), 0.06, 1e-9);
  EXPECT_NEAR(silhouette_area(square(0.2, {0, 0}, 0.3), square_faces(), 0.0005), 0.04, 4e-5);
  EXPECT_TRUE(std::isnan(silhouette_area(square(0.2, {300, 0}), square_faces())));
}

TEST(ShapeErrors, AreThoseOfTheVerticesThatCount) {
  const Task task = square_task();
  const Positions goal = task.garment->positions;
  Positions shape = goal;
  shape(0, 2) += 0.004;
  shape(1, 0) += 0.040;
  shape(2, 1) -= 0.010;
  shape(3, 2) += 0.020;
  const ShapeErrors all = shape_errors(shape, goal, task);
  EXPECT_NEAR(all.max_mm, 40.0, 1e-9);
  EXPECT_NEAR(all.grasped_mm, 15.0, 1e-9);
  EXPECT_NEAR(all.named_mm, 7.0, 1e-9) << "a vertex with two names counts once";
  EXPECT_EQ(all.iou, silhouette_iou(shape, goal, task.garment->faces));
  EXPECT_LT(all.iou, 1.0);
  const ShapeErrors some = shape_errors(shape, goal, task, {true, false, false, true});
  EXPECT_NEAR(some.max_mm, 20.0, 1e-9);
  EXPECT_NEAR(some.grasped_mm, 20.0, 1e-9);
  EXPECT_NEAR(some.named_mm, 4.0, 1e-9);
  EXPECT_EQ(some.iou, all.iou) << "the silhouette is that of the whole shape";
  const ShapeErrors none = shape_errors(shape, goal, task, {false, true, false, false});
  EXPECT_TRUE(std::isnan(none.grasped_mm));
  EXPECT_TRUE(std::isnan(none.named_mm));
}

TEST(ShapeErrors, ASuccessIsAMeanErrorUpToTheLimit) {
  EXPECT_TRUE(succeeds(10.0, 10));
  EXPECT_FALSE(succeeds(10.001, 10));
  EXPECT_FALSE(succeeds(std::nan(""), 30));
}

}  // namespace
}  // namespace weft
