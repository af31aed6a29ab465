#include <gtest/gtest.h>

#include <cmath>

#include "test_objectives.hpp"
#include "trajectory/arc/arc.cpp"
#include "trajectory/spline/least_squares.cpp"
#include "trajectory/spline/spline.cpp"
#include "unit/serial_host.hpp"

namespace weft::spline {
namespace {

/// Makes an arc for every request, so that no loader is needed.
class ArcHost final : public test::SerialHost {
 protected:
  std::shared_ptr<void> create_erased(const std::string& kind, const ConfigNode& slot) override {
    EXPECT_EQ(kind, "trajectory");
    EXPECT_EQ(slot.at("plugin").as_string(), "arc");
    return std::static_pointer_cast<void>(std::shared_ptr<Trajectory>(std::make_shared<arc::Arc>(arc::Params())));
  }
};

Spline make(const std::string& over, std::int64_t points = 6) {
  static ArcHost host;
  Params p;
  p.over = over;
  p.control_points = points;
  return Spline(p, host);
}

Manipulation fold() {
  Manipulation m;
  m.grasp_vertices = {0, 1};
  m.grasp_points.resize(2, 3);
  m.grasp_points << 0, 0.2, 0.002, 0, -0.2, 0.002;
  m.displacement = {0.6, 0.0};
  m.contact_height = 0.002;
  return m;
}

Vector random_point(const Spline& spline, std::uint64_t key, double spread = 1.0) {
  RandomStream random(9, key);
  const Box box = spline.decision_bounds(25);
  const Vector scale = spline.decision_scale(25);
  const Controls defaults = spline.default_controls(1);
  Vector x(box.dim());
  for (Index i = 0; i < x.size(); ++i)
    x[i] = std::clamp(defaults(0, i % 5) + spread * scale[i] * random.normal(), box.lower[i], box.upper[i]);
  return x;
}

class Over : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Both, Over, testing::Values("progress", "horizon"));

TEST_P(Over, ControlsStateAndGeometryAreTheArcs) {
  const Spline spline = make(GetParam());
  const arc::Arc arc{arc::Params()};
  const Manipulation m = fold();
  ASSERT_EQ(spline.controls().size(), arc.controls().size());
  for (std::size_t i = 0; i < arc.controls().size(); ++i) EXPECT_EQ(spline.controls()[i].name, arc.controls()[i].name);
  const Vector state = arc.initial_state(m);
  EXPECT_EQ(spline.initial_state(m), state);
  const Vector control = arc.default_controls(1).row(0).transpose();
  EXPECT_EQ(spline.advance(m, state, control), arc.advance(m, state, control));
  EXPECT_EQ(spline.targets(m, arc.advance(m, state, control)), arc.targets(m, arc.advance(m, state, control)));
  EXPECT_EQ(spline.progress(state), 0.0);
}

TEST_P(Over, DecisionSizeIsThatOfTheControlPointsWhateverTheHorizon) {
  for (const Index horizon : {1, 7, 25}) EXPECT_EQ(make(GetParam(), 6).decision_size(horizon), 30);
  EXPECT_EQ(make(GetParam(), 4).decision_size(25), 20);
}

TEST_P(Over, EqualControlPointsGiveThatControlThroughout) {
  const Spline spline = make(GetParam());
  const Vector state = spline.initial_state(fold());
  Controls points(6, 5);
  const Eigen::RowVectorXd one = (Eigen::RowVectorXd(5) << 2.5, 1e-4, -0.3, 2e-4, -1e-4).finished();
  points.rowwise() = one;
  const Controls c = spline.decode(Eigen::Map<const Vector>(points.data(), points.size()), 12, state);
  for (Index j = 0; j < 12; ++j) EXPECT_TRUE(c.row(j).isApprox(one, 1e-14)) << j;
}

TEST(Spline, StraightLinesAreReproduced) {
  // Control points on a line give a line: B-splines of degree 3 reproduce polynomials of degree 1 at the Greville
  // abscissae.
  const Spline spline = make("horizon");
  const Vector state = spline.initial_state(fold());
  Controls points = Controls::Zero(6, 5);
  for (Index i = 0; i < 6; ++i) points(i, 2) = 0.1 * static_cast<double>(i - 1);  // value 0.1 t at parameter t
  points.col(0).setConstant(2.0);
  const Controls c = spline.decode(Eigen::Map<const Vector>(points.data(), points.size()), 10, state);
  for (Index j = 0; j < 10; ++j) EXPECT_NEAR(c(j, 2), 0.1 * 3.0 * static_cast<double>(j) / 9.0, 1e-14) << j;
}

TEST(Spline, OverProgressAPaceHalfAsFastSpreadsTheSameShapeOverTwiceAsManySegments) {
  const Spline spline = make("progress");
  const Vector state = spline.initial_state(fold());
  Controls points = Controls::Zero(6, 5);
  for (Index i = 0; i < 6; ++i) points(i, 2) = 0.1 * static_cast<double>(i);
  points.col(0).setConstant(3.0);
  const Controls fast = spline.decode(Eigen::Map<const Vector>(points.data(), points.size()), 12, state);
  points.col(0).setConstant(1.5);
  const Controls slow = spline.decode(Eigen::Map<const Vector>(points.data(), points.size()), 12, state);
  for (Index j = 0; j < 5; ++j) EXPECT_NEAR(fast(j, 2), slow(2 * j, 2), 1e-12) << j;
}

TEST(Spline, AfterReleaseTheControlsStayAsTheyAre) {
  const Spline spline = make("progress");
  const Vector state = spline.initial_state(fold());
  const Vector x = random_point(spline, 3);
  const Controls c = spline.decode(x, 25, state);
  const Index u = spline.release_segment(fold(), state, c);
  for (Index j = u + 1; j < 25; ++j) EXPECT_EQ(c.row(j), c.row(u));
}

TEST_P(Over, PointsOfTheBoxStayWithinTheControlBounds) {
  const Spline spline = make(GetParam());
  const Vector state = spline.initial_state(fold());
  const auto variables = spline.controls();
  RandomStream random(2);
  for (int trial = 0; trial < 50; ++trial) {
    const Box box = spline.decision_bounds(25);
    Vector x(box.dim());
    for (Index i = 0; i < x.size(); ++i) x[i] = random.below(2) == 0 ? box.lower[i] : box.upper[i];  // corners
    const Controls c = spline.decode(x, 25, state);
    for (Index k = 0; k < 5; ++k) {
      EXPECT_GE(c.col(k).minCoeff(), variables[k].lower - 1e-12);
      EXPECT_LE(c.col(k).maxCoeff(), variables[k].upper + 1e-12);
    }
  }
}

TEST_P(Over, PullbackIsExact) {
  const Manipulation m = fold();
  for (const std::int64_t points : {4, 6, 9}) {
    const Spline spline = make(GetParam(), points);
    Vector state = spline.initial_state(m);
    for (int trial = 0; trial < 6; ++trial) {
      if (trial == 3) {  // from the middle of a session
        for (int f = 0; f < 40; ++f) state = spline.advance(m, state, spline.default_controls(1).row(0).transpose());
      }
      const Vector x = random_point(spline, static_cast<std::uint64_t>(trial)), scale = spline.decision_scale(9);
      RandomStream random(4, static_cast<std::uint64_t>(trial));
      Controls w(9, 5);
      for (Index i = 0; i < w.size(); ++i) w.data()[i] = random.normal() / scale[i % 5];
      const Vector gradient = spline.decode_pullback(x, 9, state, w);
      for (Index i = 0; i < x.size(); ++i) {
        const double h = 1e-5 * scale[i];
        Vector up = x, down = x;
        up[i] += h;
        down[i] -= h;
        const double slope = (spline.decode(up, 9, state) - spline.decode(down, 9, state)).cwiseProduct(w).sum() / 2e-5;
        EXPECT_NEAR(gradient[i] * scale[i], slope, 1e-6 * (1.0 + std::abs(slope)))
            << points << " " << trial << " " << i;
      }
    }
  }
}

TEST_P(Over, EncodeGivesBackWhatDecodeMade) {
  const Manipulation m = fold();
  const Spline spline = make(GetParam());
  Vector state = spline.initial_state(m);
  for (int trial = 0; trial < 8; ++trial) {
    if (trial == 4)
      for (int f = 0; f < 40; ++f) state = spline.advance(m, state, spline.default_controls(1).row(0).transpose());
    for (const Index horizon : {1, 3, 9, 25}) {
      const Controls c = spline.decode(random_point(spline, static_cast<std::uint64_t>(trial)), horizon, state);
      const Controls again = spline.decode(spline.encode(c, state), horizon, state);
      const Vector scale = spline.decision_scale(horizon);
      for (Index i = 0; i < c.size(); ++i) EXPECT_NEAR(again.data()[i], c.data()[i], 1e-9 * scale[i % 5]) << trial;
    }
  }
}

TEST(Spline, EncodeIsTheLeastSquaresFit) {
  // Over the horizon decode is linear: the residual of the fit is at right angles to everything it can make.
  const Spline spline = make("horizon");
  const Vector state = spline.initial_state(fold());
  RandomStream random(6);
  Controls c = spline.default_controls(8);  // ends with the release: all segments count the same
  for (Index j = 0; j < 8; ++j)
    for (Index k = 1; k < 5; ++k) c(j, k) += spline.decision_scale(8)[k] * random.normal();
  const Vector x = spline.encode(c, state);
  const Controls rest = spline.decode(x, 8, state) - c;
  const Vector gradient = spline.decode_pullback(x, 8, state, rest);
  EXPECT_LT(gradient.cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_GT(rest.norm(), 1e-3);
}

TEST(Spline, EncodeHardlyHeedsWhatComesAfterRelease) {
  const Spline spline = make("progress");
  const Vector state = spline.initial_state(fold());
  Controls c = spline.default_controls(12);
  for (Index j = 0; j < 8; ++j) c(j, 2) = 0.02 * static_cast<double>(j);
  Controls other = c;
  other.bottomRows(3).col(2).setConstant(-0.8);  // meaningless segments
  const Controls a = spline.decode(spline.encode(c, state), 12, state);
  const Controls b = spline.decode(spline.encode(other, state), 12, state);
  EXPECT_LT((a - b).topRows(8).cwiseAbs().maxCoeff(), 1e-3);
  EXPECT_LT((a - c).topRows(8).col(2).cwiseAbs().maxCoeff(), 5e-3);
}

TEST(Spline, RefusesWrongSizes) {
  const Spline spline = make("progress");
  const Vector state = spline.initial_state(fold());
  EXPECT_THROW(spline.decode(Vector::Zero(29), 4, state), ShapeError);
  EXPECT_THROW(spline.decode_pullback(Vector::Zero(30), 4, state, Controls::Zero(3, 5)), ShapeError);
  EXPECT_THROW(spline.encode(Controls::Zero(4, 4), state), ShapeError);
  EXPECT_THROW(spline.decision_size(-1), ShapeError);
}

TEST(Spline, ObeysTheLaws) {
  test::PluginBench bench;
  for (const char* over : {"progress", "horizon"}) {
    std::string failed;
    for (const auto& law :
         check_conformance(bench.host(), "trajectory",
                           ConfigNode::parse(std::string("{plugin: spline, params: {over: ") + over + "}}", "t")))
      if (!law.passed) failed += law.law + " " + std::to_string(law.measured) + " " + law.detail + "\n";
    EXPECT_EQ(failed, "") << over;
  }
}

}  // namespace
}  // namespace weft::spline
