// The arc against positions computed by hand (design section 3).
#include <gtest/gtest.h>

#include <cmath>

#include "simulation/random_controls.hpp"
#include "trajectory/arc/arc.cpp"  // the class is compiled in: what is tested here does not need the loader
#include "weft/random.hpp"

namespace weft::arc {
namespace {

Vector vec(std::initializer_list<double> values) {
  Vector v(static_cast<Index>(values.size()));
  std::copy(values.begin(), values.end(), v.data());
  return v;
}

/// Grasp points 0.4 m apart along y at x = 0, d = 0.6 m along +x: fold line x = 0.3, delta = 0, eps = +-0.2.
Manipulation straight() {
  Manipulation m;
  m.grasp_vertices = {0, 1};
  m.grasp_points.resize(2, 3);
  m.grasp_points << 0.0, 0.2, 0.0, 0.0, -0.2, 0.0;
  m.displacement = {0.6, 0.0};
  m.drop_height = 0.05;
  return m;
}

/// A skew one: the grasp points are not symmetric to d, d points into the second quadrant.
Manipulation skew() {
  Manipulation m;
  m.grasp_vertices = {3, 7};
  m.grasp_points.resize(2, 3);
  m.grasp_points << 0.31, -0.12, 0.001, 0.18, 0.33, 0.001;
  m.displacement = {-0.42, 0.17};
  m.drop_height = 0.07;
  m.contact_height = 0.001;
  return m;
}

void expect_row(const Positions& g, Index i, double x, double y, double z) {
  EXPECT_NEAR(g(i, 0), x, 1e-12);
  EXPECT_NEAR(g(i, 1), y, 1e-12);
  EXPECT_NEAR(g(i, 2), z, 1e-12);
}

TEST(Arc, InitialStateIsTheMiddleOfTheMove) {
  const Vector s = Arc(Params{}).initial_state(straight());
  EXPECT_TRUE(s.isApprox(vec({0.0, 0.3, 0.0, 0.3, 0.0}), 1e-15)) << s.transpose();
}

TEST(Arc, StartsAtTheGraspPoints) {
  const Arc arc(Params{});
  for (const Manipulation& m : {straight(), skew()})
    EXPECT_LT((arc.targets(m, arc.initial_state(m)) - m.grasp_points).cwiseAbs().maxCoeff(), 1e-15);
}

TEST(Arc, OneHandMovesAsTheMidpointOfTwo) {
  Params one_hand;
  one_hand.hands = 1;
  const Arc one(one_hand), two(Params{});
  const Manipulation both = skew();
  Manipulation m = both;
  m.grasp_vertices = {3};
  m.grasp_points = both.grasp_points.colwise().mean();
  EXPECT_EQ(one.hands(), 1);
  for (const double theta : {0.0, 50.0, 180.0}) {
    const Vector s = vec({theta, 0.2, 12.0, 0.1, -0.3});
    EXPECT_TRUE(one.targets(m, s).isApprox(two.targets(both, s).colwise().mean(), 1e-12)) << theta;
  }
  EXPECT_THROW(one.targets(both, vec({0.0, 0.2, 0.0, 0.0, 0.0})), ShapeError);
}

TEST(Arc, PositionsAtNinetyDegrees) {
  // u = 0 - 0.3; cos = 0, sin = 1: over the fold line, at height 0.3 + h/2.
  const Positions g = Arc(Params{}).targets(straight(), vec({90.0, 0.3, 0.0, 0.3, 0.0}));
  expect_row(g, 0, 0.3, 0.2, 0.325);
  expect_row(g, 1, 0.3, -0.2, 0.325);
}

TEST(Arc, PositionsAtOneHundredAndEightyDegreesAndBeyond) {
  for (double theta : {180.0, 200.0, 725.0}) {
    const Positions g = Arc(Params{}).targets(straight(), vec({theta, 0.3, 0.0, 0.3, 0.0}));
    expect_row(g, 0, 0.6, 0.2, 0.05);
    expect_row(g, 1, 0.6, -0.2, 0.05);
  }
}

TEST(Arc, PositionsAtSixtyDegrees) {
  // cos 60 = 1/2: x = 0.3 - 0.15, z = 0.3 sin 60 + 0.025 / 2.
  const Positions g = Arc(Params{}).targets(straight(), vec({60.0, 0.3, 0.0, 0.3, 0.0}));
  expect_row(g, 0, 0.15, 0.2, 0.15 * std::sqrt(3.0) + 0.0125);
}

TEST(Arc, NegativeThetaIsTheStart) {
  const Positions g = Arc(Params{}).targets(straight(), vec({-30.0, 0.3, 0.0, 0.3, 0.0}));
  expect_row(g, 0, 0.0, 0.2, 0.0);
}

TEST(Arc, PhiTurnsTheHeading) {
  // phi = 90: d' = +y, T = -x. At theta = 180: g = a + 0.3 y +- 0.2 (-x).
  const Positions g = Arc(Params{}).targets(straight(), vec({180.0, 0.3, 90.0, 0.3, 0.0}));
  expect_row(g, 0, 0.1, 0.3, 0.05);
  expect_row(g, 1, 0.5, 0.3, 0.05);
  // phi = 30 at theta = 90: g = a +- 0.2 T, T = (-1/2, sqrt(3)/2).
  const Positions q = Arc(Params{}).targets(straight(), vec({90.0, 0.3, 30.0, 0.3, 0.0}));
  expect_row(q, 0, 0.2, 0.1 * std::sqrt(3.0), 0.325);
  expect_row(q, 1, 0.4, -0.1 * std::sqrt(3.0), 0.325);
}

TEST(Arc, AxisPointShiftsThePathAndRadiusWidensIt) {
  const Positions g = Arc(Params{}).targets(straight(), vec({180.0, 0.35, 0.0, 0.32, -0.04}));
  expect_row(g, 0, 0.67, 0.16, 0.05);
  expect_row(g, 1, 0.67, -0.24, 0.05);
  const Positions q = Arc(Params{}).targets(straight(), vec({90.0, 0.35, 0.0, 0.32, -0.04}));
  expect_row(q, 0, 0.32, 0.16, 0.375);
}

TEST(Arc, HalfATurnMirrorsAcrossTheFoldLine) {
  const Manipulation m = skew();
  const Arc arc(Params{});
  Vector s = arc.initial_state(m);
  s[0] = 180.0;
  const Positions g = arc.targets(m, s);
  // The fold line runs through a_0, perpendicular to d.
  const Vec2 n = m.displacement / m.displacement.norm();
  const Vec2 a = s.tail<2>();
  for (Index i = 0; i < 2; ++i) {
    const Vec2 g0 = m.grasp_points.row(i).head<2>().transpose();
    const Vec2 mirrored = g0 - 2.0 * (g0 - a).dot(n) * n;
    expect_row(g, i, mirrored.x(), mirrored.y(), 0.07);
  }
}

TEST(Arc, NeverBelowContactHeight) {
  Manipulation m = straight();
  m.contact_height = 0.002;
  m.grasp_points.col(2).setConstant(0.002);
  const Arc arc(Params{});
  // delta of hand 1 beyond r puts the plain arc below the surface.
  m.grasp_points(0, 0) = 0.5;
  for (double theta = 0.0; theta <= 180.0; theta += 7.5)
    for (double r : {0.01, 0.1, 0.3})
      EXPECT_GE(arc.targets(m, vec({theta, r, 10.0, 0.3, 0.0})).col(2).minCoeff(), 0.002);
}

TEST(Arc, RefusesADisplacementOfNoLength) {
  const Arc arc(Params{});
  Manipulation m = straight();
  m.displacement.setZero();
  EXPECT_THROW(arc.initial_state(m), ConfigError);
  EXPECT_THROW(arc.targets(m, Vector::Zero(5)), ConfigError);
  m.displacement.setConstant(std::numeric_limits<double>::quiet_NaN());
  EXPECT_THROW(arc.initial_state(m), ConfigError);
  m.displacement = {2 * Params{}.r_min_m * 0.99, 0.0};
  EXPECT_THROW(arc.initial_state(m), ConfigError) << "r_0 would lie below r_min";
}

TEST(Arc, RefusesBadShapes) {
  const Arc arc(Params{});
  const Manipulation m = straight();
  const Vector s = arc.initial_state(m);
  EXPECT_THROW(arc.advance(m, Vector::Zero(4), Vector::Zero(5)), ShapeError);
  EXPECT_THROW(arc.advance(m, s, Vector::Zero(6)), ShapeError);
  EXPECT_THROW(arc.targets(m, Vector::Zero(6)), ShapeError);
  EXPECT_THROW(arc.decode(Vector::Zero(9), 2, s), ShapeError);
  EXPECT_THROW(arc.encode(Controls::Zero(2, 4), s), ShapeError);
  EXPECT_THROW(arc.targets_pullback(m, s, Positions::Zero(1, 3)), ShapeError);
  EXPECT_THROW(arc.decision_bounds(-1), ShapeError);
  Manipulation three = m;
  three.grasp_points = Positions::Zero(3, 3);
  EXPECT_THROW(arc.initial_state(three), ShapeError);
}

TEST(Arc, AdvanceAddsAndKeepsTheRadiusAboveItsLeast) {
  const Arc arc(Params{});
  const Manipulation m = straight();
  EXPECT_TRUE(arc.advance(m, vec({170, 0.3, 1, 0.3, 0}), vec({2, 0.001, -0.5, 0.002, -0.001}))
                  .isApprox(vec({172, 0.301, 0.5, 0.302, -0.001}), 1e-15));
  const Vector low = arc.advance(m, vec({0, 0.0101, 0, 0, 0}), vec({1, -0.002, 0, 0, 0}));
  EXPECT_EQ(low[1], Params{}.r_min_m);
  Vector d_state, d_control;
  arc.advance_pullback(m, vec({0, 0.0101, 0, 0, 0}), vec({1, -0.002, 0, 0, 0}), Vector::Ones(5), d_state, d_control);
  EXPECT_EQ(d_state, vec({1, 0, 1, 1, 1}));
  EXPECT_EQ(d_control, vec({1, 0, 1, 1, 1}));
}

TEST(Arc, ReleaseSegmentOfConstantTurns) {
  const Arc arc(Params{});
  const Manipulation m = straight();
  const Vector s = arc.initial_state(m);
  Controls one = Controls::Zero(25, 5);
  one.col(0).setConstant(1.0);
  EXPECT_EQ(arc.release_segment(m, s, one), 15);
  EXPECT_EQ(arc.release_segment(m, s, arc.default_controls(25)), 8);  // 7.5 segments
  EXPECT_EQ(arc.release_segment(m, s, one.topRows(10)), 10);          // never reached: the last one
}

TEST(Arc, DecodeIsRowByRow) {
  const Arc arc(Params{});
  const Vector s = Vector::Zero(5);
  Vector x(10);
  for (Index i = 0; i < 10; ++i) x[i] = static_cast<double>(i);
  const Controls c = arc.decode(x, 2, s);
  EXPECT_EQ(c(0, 4), 4.0);
  EXPECT_EQ(c(1, 0), 5.0);
  EXPECT_EQ(arc.encode(c, s), x);
  EXPECT_EQ(arc.decode_pullback(x, 2, s, c), x);
  EXPECT_EQ(arc.decision_bounds(2).lower[5], Params{}.dtheta_min_deg);
  EXPECT_EQ(arc.decision_scale(2)[6], Params{}.dr_scale_m);
  EXPECT_EQ(arc.decode(Vector(0), 0, s).rows(), 0);
}

TEST(Arc, PullbackOfTargetsMatchesCentralDifferences) {
  const Arc arc(Params{});
  RandomStream random(7);
  double worst = 0.0;
  for (int trial = 0; trial < 200; ++trial) {
    const Manipulation m = trial % 2 ? straight() : skew();
    Vector s = arc.initial_state(m);
    s[0] = random.uniform(-40.0, 220.0);
    s[1] = random.uniform(0.0, 0.5);  // below r_min and above
    s[2] = random.uniform(-90.0, 90.0);
    s[3] += random.uniform(-0.1, 0.1);
    s[4] += random.uniform(-0.1, 0.1);
    Positions w(2, 3);
    for (Index i = 0; i < 6; ++i) w.data()[i] = random.normal();
    const Vector gradient = arc.targets_pullback(m, s, w);
    // Kinks: stay away from them by more than the difference step.
    const Vec3 kinks(s[0], s[0] - 180.0, (s[1] - Params{}.r_min_m) * 1e3);
    const Eigen::ArrayXd height = arc.targets(m, s).col(2).array() - m.contact_height;
    if (kinks.cwiseAbs().minCoeff() < 0.1 || (height > 0.0 && height < 1e-4).any()) continue;
    for (Index i = 0; i < 5; ++i) {
      const double h = 1e-5 * (i == 0 || i == 2 ? 10.0 : 1.0);
      Vector up = s, down = s;
      up[i] += h;
      down[i] -= h;
      const double slope = ((arc.targets(m, up) - arc.targets(m, down)).cwiseProduct(w)).sum() / (2 * h);
      worst = std::max(worst, std::abs(slope - gradient[i]) / std::max(1.0, std::abs(slope)));
    }
  }
  EXPECT_LT(worst, 1e-7);
}

// --- random controls (framework), on the trajectory that they are for -----------------------------------------------

/// Draws of one distribution, [draws][horizon, 5]; dtheta in multiples of its default, the others in their scales.
std::vector<Controls> draws(const RandomControlsParams& params, int count, Index horizon) {
  const Arc arc(Params{});
  const auto variables = arc.controls();
  std::vector<Controls> all;
  for (int i = 0; i < count; ++i) {
    RandomStream random(11, static_cast<std::uint64_t>(i));
    Controls controls = random_controls(arc, horizon, params, random);
    EXPECT_EQ(controls.rows(), horizon);
    for (Index c = 0; c < controls.cols(); ++c) {
      const auto& v = variables[c];
      EXPECT_GE(controls.col(c).minCoeff(), v.lower);
      EXPECT_LE(controls.col(c).maxCoeff(), v.upper);
      controls.col(c) /= c == 0 ? v.default_value : v.scale;
    }
    all.push_back(controls);
  }
  return all;
}

TEST(RandomControls, PaceIsLogUniformAndTheRestStillWithoutDriftAndWalk) {
  RandomControlsParams params;
  params.drift = params.walk = 0.0;
  double sum = 0.0;
  int slow = 0;
  constexpr int kCount = 4000;
  for (const auto& controls : draws(params, kCount, 3)) {
    const double pace = controls(0, 0);
    ASSERT_GE(pace, 0.6 - 1e-12);
    ASSERT_LE(pace, 1.6 + 1e-12);
    EXPECT_TRUE(controls.col(0).isConstant(pace, 1e-12));
    EXPECT_TRUE(controls.rightCols(4).isZero(0.0));
    sum += std::log(pace);
    slow += pace < 0.6 * std::sqrt(std::sqrt(1.6 / 0.6));
  }
  EXPECT_NEAR(sum / kCount, 0.5 * std::log(0.6 * 1.6), 5.0 * std::log(1.6 / 0.6) / std::sqrt(12.0 * kCount));
  EXPECT_NEAR(slow, 0.25 * kCount, 5.0 * std::sqrt(kCount * 0.25 * 0.75));
}

TEST(RandomControls, DriftIsConstantWithinATrajectoryAndVariesBetweenThem) {
  RandomControlsParams params;
  params.pace_low = params.pace_high = 1.0;
  params.walk = 0.0;
  constexpr int kCount = 4000;
  Eigen::Array<double, 1, 5> squares = Eigen::Array<double, 1, 5>::Zero();
  double product = 0.0;
  for (const auto& controls : draws(params, kCount, 4)) {
    for (Index c = 0; c < 5; ++c) EXPECT_TRUE(controls.col(c).isConstant(controls(0, c), 1e-12));
    Eigen::Array<double, 1, 5> z = controls.row(0).array();
    z(0) = (z(0) - 1.0) * 4.0;  // its default is 4 scales
    squares += z.square();
    product += z(1) * z(2);
  }
  for (Index c = 0; c < 5; ++c) EXPECT_NEAR(std::sqrt(squares(c) / kCount), 0.7, 0.04) << c;
  EXPECT_NEAR(product / kCount, 0.0, 5.0 * 0.49 / std::sqrt(kCount));  // each control has its own
}

TEST(RandomControls, WalkIsStationaryAndAsSmoothAsAsked) {
  for (const double smoothness : {0.0, 0.8}) {
    RandomControlsParams params;
    params.pace_low = params.pace_high = 1.0;
    params.drift = 0.0;
    params.smoothness = smoothness;
    constexpr int kCount = 4000;
    constexpr Index kHorizon = 10;
    Eigen::Array<double, 1, 5> first = Eigen::Array<double, 1, 5>::Zero(), last = first, next = first;
    for (const auto& controls : draws(params, kCount, kHorizon)) {
      Eigen::Array<double, kHorizon, 5> z = controls.array();
      z.col(0) = (z.col(0) - 1.0) * 4.0;
      first += z.row(0).square();
      last += z.row(kHorizon - 1).square();
      next += z.row(0) * z.row(1);
    }
    for (Index c = 0; c < 5; ++c) {
      EXPECT_NEAR(std::sqrt(first(c) / kCount), 0.5, 0.03) << c;
      EXPECT_NEAR(std::sqrt(last(c) / kCount), 0.5, 0.03) << c;
      EXPECT_NEAR(next(c) / first(c), smoothness, 0.08) << c;
    }
  }
}

TEST(RandomControls, DefaultsMakeShortAndLongFolds) {
  const Arc arc(Params{});
  const Manipulation m = straight();
  std::vector<int> folds(26, 0);
  int unreleased = 0;
  for (int i = 0; i < 2000; ++i) {
    RandomStream random(5, static_cast<std::uint64_t>(i)), again = random;
    const Controls controls = random_controls(arc, 25, {}, random);
    EXPECT_EQ(random_controls(arc, 25, {}, again), controls);
    const Index u = arc.release_segment(m, arc.initial_state(m), controls);
    ++folds.at(u);
    unreleased += !arc.released(arc.segment_states(m, arc.initial_state(m), controls).row(u - 1).transpose());
  }
  // The default takes 8 segments. From half of that to three times as many, nothing in between left out.
  for (std::size_t u = 4; u <= 24; ++u) EXPECT_GT(folds[u], 0) << u;
  EXPECT_LT(unreleased, 60);
}

}  // namespace
}  // namespace weft::arc
