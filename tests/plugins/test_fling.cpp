// The fling against positions computed by hand.
#include <gtest/gtest.h>

#include <cmath>

#include "trajectory/fling/fling.cpp"  // the class is compiled in: what is tested here does not need the loader
#include "weft/random.hpp"

namespace weft::fling {
namespace {

enum Shape : Index { kS, kH, kR, kB, kL, kPhi, kSize };

/// Grasp points 0.4 m apart along y at x = 0, d = 0.6 m along +x.
Manipulation straight() {
  Manipulation m;
  m.grasp_vertices = {0, 1};
  m.grasp_points.resize(2, 3);
  m.grasp_points << 0.0, 0.2, 0.0, 0.0, -0.2, 0.0;
  m.displacement = {0.6, 0.0};
  m.drop_height = 0.05;
  return m;
}

/// The grasp points are not symmetric to d, d points into the second quadrant, on a table of 0.7 m.
Manipulation skew() {
  Manipulation m;
  m.grasp_vertices = {3, 7};
  m.grasp_points.resize(2, 3);
  m.grasp_points << 0.31, -0.12, 0.701, 0.18, 0.33, 0.701;
  m.displacement = {-0.42, 0.17};
  m.drop_height = 0.07;
  m.contact_height = 0.701;
  return m;
}

Vector at(double s) {
  Vector state = Vector::Zero(kSize);
  state[kS] = s;
  return state;
}

/// The state that constant controls with the shape change x_k reach at s.
Vector at(double s, Index k, double x) {
  Vector state = at(s);
  state[k] = s * x;
  return state;
}

void expect_row(const Positions& g, Index i, double x, double y, double z) {
  EXPECT_NEAR(g(i, 0), x, 1e-12);
  EXPECT_NEAR(g(i, 1), y, 1e-12);
  EXPECT_NEAR(g(i, 2), z, 1e-12);
}

Vector random_x(const Fling& fling, RandomStream& random) {
  const Box box = fling.decision_bounds(1);
  Vector x(kSize);
  for (Index i = 0; i < kSize; ++i) x[i] = random.uniform(box.lower[i], box.upper[i]);
  return x;
}

TEST(Fling, StartsAtTheGraspPoints) {
  const Fling fling(Params{});
  for (const Manipulation& m : {straight(), skew()})
    EXPECT_LT((fling.targets(m, fling.initial_state(m)) - m.grasp_points).cwiseAbs().maxCoeff(), 1e-15);
}

TEST(Fling, PositionsInEveryPhase) {
  // Lift over [0, 0.4] to 0.4 m, swing over [0.3, 0.65] to 0.6 + 0.3, lay over [0.65, 0.9] to 0.65, pull over [0.8, 1].
  const Fling fling(Params{});
  const auto expect = [&](double s, double x, double z) {
    const Positions g = fling.targets(straight(), at(s));
    expect_row(g, 0, x, 0.2, z);
    expect_row(g, 1, x, -0.2, z);
  };
  expect(-0.1, 0.0, 0.0);
  expect(0.2, 0.0, 0.2);        // half of the lift
  expect(0.475, 0.45, 0.4);     // half of the swing
  expect(0.65, 0.9, 0.4);       // out
  expect(0.775, 0.775, 0.225);  // half of laying down: 0.9 - 0.25 / 2, 0.4 - 0.35 / 2
  expect(0.9, 0.625, 0.05);     // down, half of the pull
  expect(1.0, 0.6, 0.05);
  expect(1.7, 0.6, 0.05);
}

TEST(Fling, ShapeParametersAreInForceFromTheStart) {
  const Fling fling(Params{});
  expect_row(fling.targets(straight(), at(0.2, kH, 0.1)), 0, 0.0, 0.2, 0.25);
  expect_row(fling.targets(straight(), at(0.65, kH, -0.1)), 0, 0.9, 0.2, 0.3);
  expect_row(fling.targets(straight(), at(0.65, kR, 0.1)), 0, 1.0, 0.2, 0.4);
  expect_row(fling.targets(straight(), at(0.9, kB, 0.1)), 0, 0.675, 0.2, 0.05);  // half of a pull of 0.15
  for (const Index k : {kH, kR, kB}) expect_row(fling.targets(straight(), at(1.0, k, 0.1)), 0, 0.6, 0.2, 0.05);
  expect_row(fling.targets(straight(), at(1.0, kL, 0.1)), 0, 0.7, 0.2, 0.05);
  expect_row(fling.targets(straight(), at(1.2, kL, 0.1)), 0, 0.7, 0.2, 0.05);
}

TEST(Fling, HeadingTurnsThePathAndTheHands) {
  // 90 degrees: d' = +y, and the offset +0.2 y turns to -0.2 x.
  const Positions g = Fling(Params{}).targets(straight(), at(1.0, kPhi, 90.0));
  expect_row(g, 0, -0.2, 0.6, 0.05);
  expect_row(g, 1, 0.2, 0.6, 0.05);
}

TEST(Fling, HandsKeepTheirDistanceUnlessStretched) {
  const Manipulation m = skew();
  const double distance = (m.grasp_points.row(0) - m.grasp_points.row(1)).norm();
  Params stretched;
  stretched.stretch = 0.05;
  for (double s = 0.05; s < 1.2; s += 0.05) {
    const Positions g = Fling(Params{}).targets(m, at(s, kPhi, 20.0));
    EXPECT_NEAR((g.row(0) - g.row(1)).norm(), distance, 1e-12);
    const Positions wide = Fling(stretched).targets(m, at(s, kPhi, 20.0));
    if (s > 0.4) {
      EXPECT_NEAR((wide.row(0) - wide.row(1)).norm(), 1.05 * distance, 1e-12);
    }
  }
}

TEST(Fling, OneHandFollowsTheMidpoint) {
  Params one;
  one.path.hands = 1;
  Manipulation m = straight(), left = m;
  left.grasp_vertices = {0};
  left.grasp_points = m.grasp_points.topRows(1);
  EXPECT_EQ(Fling(one).hands(), 1);
  const Positions g = Fling(one).targets(left, at(0.775));
  ASSERT_EQ(g.rows(), 1);
  expect_row(g, 0, 0.775, 0.2, 0.225);
  EXPECT_THROW(Fling(one).initial_state(m), ShapeError);
}

TEST(Fling, HeightsCountFromTheGraspPoints) {
  const Manipulation m = skew();
  const Positions g = Fling(Params{}).targets(m, at(1.0));
  expect_row(g, 0, 0.31 - 0.42, -0.12 + 0.17, 0.771);
}

TEST(Fling, NeverBelowContactHeight) {
  Params low;
  low.height_m = 0.02;
  const Fling fling(low);
  const Manipulation m = skew();
  for (double s = 0.0; s <= 1.1; s += 0.01) {
    const Vector state = at(s, kH, -0.3);
    EXPECT_GE(fling.targets(m, state).col(2).minCoeff(), m.contact_height);
    // Below it the height has no effect.
    const Vector gradient = fling.targets_pullback(m, state, Positions::Constant(2, 3, 1.0));
    if (s > 0.05 && s < 0.65) {
      EXPECT_EQ(gradient[kH], 0.0);
    }
  }
}

TEST(Fling, HandsStartAndEndSlowly) {
  const Fling fling(Params{});
  const Manipulation m = straight();
  Vector state = fling.initial_state(m), x = fling.encode(fling.default_controls(1), state);
  x << x[0], 0.1, 0.1, 0.05, 0.1, 30.0;
  const Controls controls = fling.decode(x, 11, state);
  std::vector<Positions> path = {fling.targets(m, state)};
  for (Index j = 0; j < controls.rows(); ++j) {
    const SegmentPath segment = fling.segment(m, state, controls.row(j).transpose());
    path.insert(path.end(), segment.targets.begin(), segment.targets.end());
    state = segment.end_state;
  }
  double fastest = 0.0, hardest = 0.0;
  for (std::size_t k = 1; k < path.size(); ++k)
    fastest = std::max(fastest, (path[k] - path[k - 1]).rowwise().norm().maxCoeff() / kFrameSeconds);
  for (std::size_t k = 2; k < path.size(); ++k)
    hardest = std::max(hardest, (path[k] - 2.0 * path[k - 1] + path[k - 2]).rowwise().norm().maxCoeff() /
                                    (kFrameSeconds * kFrameSeconds));
  EXPECT_LT((path[1] - path[0]).norm() / kFrameSeconds, 0.02);
  EXPECT_LT((path[120] - path[119]).norm() / kFrameSeconds, 0.02);  // 2 s
  EXPECT_LT((path[132] - path[120]).norm(), 1e-12);                 // then at rest
  EXPECT_GT(fastest, 1.875 * 1.0 / 0.7);  // the swing takes 0.7 s: 1.1 m in the turning frame, plus the turn
  EXPECT_LT(fastest, 4.0);
  EXPECT_LT(hardest, 20.0);  // no jump of the speed: one of 1 m/s would be 60 m/s^2
}

TEST(Fling, PathDoesNotDependOnThePace) {
  const Fling fling(Params{});
  const Manipulation m = skew();
  RandomStream random(3);
  const Vector x = random_x(fling, random);
  Vector quick = x, slow = x;
  quick[0] = 1.0 / 40.0;
  slow[0] = 1.0 / 80.0;
  const auto after = [&](const Vector& y, int frames) {
    Vector state = fling.initial_state(m);
    const Vector row = fling.decode(y, 1, state).row(0).transpose();
    for (int k = 0; k < frames; ++k) state = fling.advance(m, state, row);
    return fling.targets(m, state);
  };
  for (const int frames : {5, 20, 31, 40})
    EXPECT_LT((after(quick, frames) - after(slow, 2 * frames)).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(Fling, AFlingTakesFromSixTenthsOfASecondOn) {
  const Fling fling(Params{});
  const Box box = fling.decision_bounds(25);
  EXPECT_NEAR(box.upper[0], 1.0 / 36.0, 1e-10);
  const Vector start = fling.initial_state(straight());
  EXPECT_EQ(fling.release_segment(straight(), start, fling.decode(box.upper, 25, start)), 3);
  EXPECT_EQ(fling.release_segment(straight(), start, fling.default_controls(25)), 10);
  Vector state = start;
  for (int k = 0; k < 119; ++k) state += fling.default_controls(1).row(0).transpose();
  EXPECT_FALSE(fling.released(state));
  EXPECT_TRUE(fling.released(state + fling.default_controls(1).row(0).transpose()));
}

TEST(Fling, ALaterPlanContinuesWithoutAJump) {
  const Fling fling(Params{});
  const Manipulation m = skew();
  RandomStream random(4);
  const Vector first = random_x(fling, random);
  Vector state = fling.initial_state(m);
  for (int k = 0; k < 24; ++k) state = fling.advance(m, state, fling.decode(first, 1, state).row(0).transpose());
  // The same decision vector is the same path.
  EXPECT_LT((fling.encode(fling.decode(first, 5, state), state) - first).cwiseAbs().maxCoeff(), 1e-12);
  // Slowed down segment by segment it keeps its shape; what comes after the release hardly counts.
  Controls slowed = fling.decode(first, 3, state);
  slowed.row(1) *= 0.5;
  EXPECT_LT((fling.encode(slowed, state) - first).tail(5).cwiseAbs().maxCoeff(), 1e-12);
  Vector ending = first;
  ending[0] = 1.0 / 12.0;
  Controls padded = fling.default_controls(4);
  padded.topRows(2) = fling.decode(ending, 2, state);
  EXPECT_LT(((fling.encode(padded, state) - ending).array() / fling.decision_scale(4).array()).abs().maxCoeff(), 0.1);
}

TEST(Fling, EncodeIsTheNearest) {
  const Fling fling(Params{});
  const Vector state = fling.initial_state(straight());
  RandomStream random(5);
  Controls controls = fling.default_controls(6);
  for (Index i = 0; i < controls.size(); ++i) controls.data()[i] += 1e-3 * random.uniform(0.0, 1.0);
  const Vector x = fling.encode(controls, state);
  const Controls rest = fling.decode(x, 6, state) - controls;
  EXPECT_GT(rest.norm(), 1e-4);
  EXPECT_LT(fling.decode_pullback(x, 6, state, rest).norm(), 1e-12);  // the gradient of |rest|^2 / 2
}

TEST(Fling, PullbacksMatchCentralDifferences) {
  Params params;
  params.stretch = 0.03;
  const Fling fling(params);
  RandomStream random(7);
  double worst = 0.0;
  for (int trial = 0; trial < 200; ++trial) {
    const Manipulation m = trial % 2 ? straight() : skew();
    Vector state = at(random.uniform(0.02, 1.3));
    for (Index k = 1; k < kSize; ++k) state[k] = random.uniform(-1.0, 1.0) * (k == kPhi ? 60.0 : 0.2);
    Positions w(2, 3);
    for (Index i = 0; i < 6; ++i) w.data()[i] = random.normal();
    const Eigen::ArrayXd height = fling.targets(m, state).col(2).array() - m.contact_height;
    if ((height > 0.0 && height < 1e-3).any()) continue;  // the kink
    const Vector gradient = fling.targets_pullback(m, state, w);
    for (Index i = 0; i < kSize; ++i) {
      const double h = i == kPhi ? 1e-3 : 1e-6;
      Vector up = state, down = state;
      up[i] += h;
      down[i] -= h;
      const double slope = (fling.targets(m, up) - fling.targets(m, down)).cwiseProduct(w).sum() / (2 * h);
      worst = std::max(worst, std::abs(slope - gradient[i]) / std::max(1.0, std::abs(slope)));
    }
    const Vector x = random_x(fling, random);
    Controls c(4, kSize);
    for (Index i = 0; i < c.size(); ++i) c.data()[i] = random.normal();
    const Vector slopes = fling.decode_pullback(x, 4, state, c);
    for (Index i = 0; i < kSize; ++i) {
      Vector up = x, down = x;
      up[i] += 1e-5;
      down[i] -= 1e-5;
      const double slope = (fling.decode(up, 4, state) - fling.decode(down, 4, state)).cwiseProduct(c).sum() / 2e-5;
      worst = std::max(worst, std::abs(slope - slopes[i]) / std::max(1.0, std::abs(slope)));
    }
  }
  EXPECT_LT(worst, 1e-7);
}

TEST(Fling, RefusesWhatItCannotDo) {
  const Fling fling(Params{});
  Manipulation m = straight();
  const Vector s = fling.initial_state(m);
  EXPECT_THROW(fling.targets(m, Vector::Zero(5)), ShapeError);
  EXPECT_THROW(fling.targets_pullback(m, s, Positions::Zero(1, 3)), ShapeError);
  EXPECT_THROW(fling.decode(Vector::Zero(12), 2, s), ShapeError);
  EXPECT_THROW(fling.decode_pullback(Vector::Zero(6), 2, s, Controls::Zero(3, 6)), ShapeError);
  EXPECT_THROW(fling.encode(Controls::Zero(2, 5), s), ShapeError);
  EXPECT_THROW(fling.decision_bounds(-1), ShapeError);
  m.displacement.setZero();
  EXPECT_THROW(fling.initial_state(m), ConfigError);
  m.displacement = {std::numeric_limits<double>::quiet_NaN(), 0.0};
  EXPECT_THROW(fling.targets(m, s), ConfigError);
  Params params;
  params.path.duration_s = 0.5;
  EXPECT_THROW(Fling{params}, ConfigError) << "shorter than duration_min_s";
  params = {};
  params.path.duration_max_s = 1.9;
  EXPECT_THROW(Fling{params}, ConfigError);
}

}  // namespace
}  // namespace weft::fling
