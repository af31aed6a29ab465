// The drag against positions computed by hand.
#include <gtest/gtest.h>

#include <cmath>

#include "trajectory/drag/drag.cpp"  // the class is compiled in: what is tested here does not need the loader
#include "weft/random.hpp"

namespace weft::drag {
namespace {

enum Shape : Index { kS, kH, kA, kO, kL, kPhi, kSize };

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

double step(double u) { return u * u * u * (10.0 - 15.0 * u + 6.0 * u * u); }

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

Vector random_x(const Drag& drag, RandomStream& random) {
  const Box box = drag.decision_bounds(1);
  Vector x(kSize);
  for (Index i = 0; i < kSize; ++i) x[i] = random.uniform(box.lower[i], box.upper[i]);
  return x;
}

TEST(Drag, StartsAtTheGraspPoints) {
  const Drag drag(Params{});
  for (const Manipulation& m : {straight(), skew()})
    EXPECT_LT((drag.targets(m, drag.initial_state(m)) - m.grasp_points).cwiseAbs().maxCoeff(), 1e-15);
}

TEST(Drag, PositionsInEveryPhase) {
  // Lift over [0, 0.25] to 0.1 m, move over [0.15, 0.75] to 0.6 + 0.02, the height falling to 0.05, lower over [0.6, 0.9]
  // to the drop height 0.03, back over [0.75, 1].
  const Drag drag(Params{});
  Manipulation m = straight();
  m.drop_height = 0.03;
  const auto expect = [&](double s, double x, double z) {
    const Positions g = drag.targets(m, at(s));
    expect_row(g, 0, x, 0.2, z);
    expect_row(g, 1, x, -0.2, z);
  };
  expect(-0.1, 0.0, 0.0);
  expect(0.125, 0.0, 0.05);                                      // half of the lift
  expect(0.45, 0.31, 0.075);                                     // half of the move
  expect(0.75, 0.62, 0.04);                                      // the end of the move, half of lowering
  expect(0.875, 0.61, 0.03 + 0.02 * (1.0 - step(0.275 / 0.3)));  // half of the way back
  expect(1.0, 0.6, 0.03);
  expect(1.7, 0.6, 0.03);
}

TEST(Drag, ShapeParametersAreInForceFromTheStart) {
  const Drag drag(Params{});
  expect_row(drag.targets(straight(), at(0.125, kH, 0.1)), 0, 0.0, 0.2, 0.1);
  expect_row(drag.targets(straight(), at(0.45, kH, 0.1)), 0, 0.31, 0.2, 0.125);  // half of the way to arrival
  expect_row(drag.targets(straight(), at(0.45, kA, 0.1)), 0, 0.31, 0.2, 0.125);
  expect_row(drag.targets(straight(), at(0.75, kA, 0.1)), 0, 0.62, 0.2, 0.1);  // half of lowering
  expect_row(drag.targets(straight(), at(0.75, kO, 0.1)), 0, 0.72, 0.2, 0.05);
  for (const Index k : {kH, kA, kO}) expect_row(drag.targets(straight(), at(1.0, k, 0.1)), 0, 0.6, 0.2, 0.05);
  expect_row(drag.targets(straight(), at(1.0, kL, 0.1)), 0, 0.7, 0.2, 0.05);
  expect_row(drag.targets(straight(), at(1.2, kL, 0.1)), 0, 0.7, 0.2, 0.05);
}

TEST(Drag, HeadingTurnsThePathAndTheHands) {
  // 90 degrees: d' = +y, and the offset +0.2 y turns to -0.2 x.
  const Positions g = Drag(Params{}).targets(straight(), at(1.0, kPhi, 90.0));
  expect_row(g, 0, -0.2, 0.6, 0.05);
  expect_row(g, 1, 0.2, 0.6, 0.05);
}

TEST(Drag, HandsKeepTheirDistance) {
  const Manipulation m = skew();
  const double distance = (m.grasp_points.row(0) - m.grasp_points.row(1)).norm();
  for (double s = 0.05; s < 1.2; s += 0.05) {
    const Positions g = Drag(Params{}).targets(m, at(s, kPhi, 20.0));
    EXPECT_NEAR((g.row(0) - g.row(1)).norm(), distance, 1e-12);
  }
}

TEST(Drag, OneHandFollowsTheMidpoint) {
  Params one;
  one.path.hands = 1;
  Manipulation m = straight(), left = m;
  left.grasp_vertices = {0};
  left.grasp_points = m.grasp_points.topRows(1);
  EXPECT_EQ(Drag(one).hands(), 1);
  const Positions g = Drag(one).targets(left, at(0.45));
  ASSERT_EQ(g.rows(), 1);
  expect_row(g, 0, 0.31, 0.2, 0.075);
  EXPECT_THROW(Drag(one).initial_state(m), ShapeError);
}

TEST(Drag, HeightsCountFromTheGraspPoints) {
  const Manipulation m = skew();
  const Positions g = Drag(Params{}).targets(m, at(1.0));
  expect_row(g, 0, 0.31 - 0.42, -0.12 + 0.17, 0.771);
}

TEST(Drag, NeverBelowContactHeight) {
  const Drag drag(Params{});
  const Manipulation m = skew();
  for (double s = 0.0; s <= 1.1; s += 0.01) {
    const Vector state = at(s, kH, -0.3);
    EXPECT_GE(drag.targets(m, state).col(2).minCoeff(), m.contact_height);
    // Below it the height has no effect.
    const Vector gradient = drag.targets_pullback(m, state, Positions::Constant(2, 3, 1.0));
    if (s > 0.05 && s < 0.3) {
      EXPECT_EQ(gradient[kH], 0.0);
    }
  }
}

TEST(Drag, HandsStartAndEndSlowly) {
  const Drag drag(Params{});
  const Manipulation m = straight();
  Vector state = drag.initial_state(m), x = drag.encode(drag.default_controls(1), state);
  x << x[0], 0.1, 0.1, 0.05, 0.1, 30.0;
  const Controls controls = drag.decode(x, 11, state);
  std::vector<Positions> path = {drag.targets(m, state)};
  for (Index j = 0; j < controls.rows(); ++j) {
    const SegmentPath segment = drag.segment(m, state, controls.row(j).transpose());
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
  EXPECT_GT(fastest, 1.875 * 0.77 / 1.2);  // the move takes 1.2 s: 0.77 m in the turning frame, plus the turn
  EXPECT_LT(fastest, 2.0);
  EXPECT_LT(hardest, 10.0);  // no jump of the speed: one of 1 m/s would be 60 m/s^2
}

TEST(Drag, PathDoesNotDependOnThePace) {
  const Drag drag(Params{});
  const Manipulation m = skew();
  RandomStream random(3);
  const Vector x = random_x(drag, random);
  Vector quick = x, slow = x;
  quick[0] = 1.0 / 40.0;
  slow[0] = 1.0 / 80.0;
  const auto after = [&](const Vector& y, int frames) {
    Vector state = drag.initial_state(m);
    const Vector row = drag.decode(y, 1, state).row(0).transpose();
    for (int k = 0; k < frames; ++k) state = drag.advance(m, state, row);
    return drag.targets(m, state);
  };
  for (const int frames : {5, 20, 31, 40})
    EXPECT_LT((after(quick, frames) - after(slow, 2 * frames)).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(Drag, ADragTakesFromSixTenthsOfASecondOn) {
  const Drag drag(Params{});
  const Box box = drag.decision_bounds(25);
  EXPECT_NEAR(box.upper[0], 1.0 / 36.0, 1e-10);
  const Vector start = drag.initial_state(straight());
  EXPECT_EQ(drag.release_segment(straight(), start, drag.decode(box.upper, 25, start)), 3);
  EXPECT_EQ(drag.release_segment(straight(), start, drag.default_controls(25)), 10);
  Vector state = start;
  for (int k = 0; k < 119; ++k) state += drag.default_controls(1).row(0).transpose();
  EXPECT_FALSE(drag.released(state));
  EXPECT_TRUE(drag.released(state + drag.default_controls(1).row(0).transpose()));
}

TEST(Drag, ALaterPlanContinuesWithoutAJump) {
  const Drag drag(Params{});
  const Manipulation m = skew();
  RandomStream random(4);
  const Vector first = random_x(drag, random);
  Vector state = drag.initial_state(m);
  for (int k = 0; k < 24; ++k) state = drag.advance(m, state, drag.decode(first, 1, state).row(0).transpose());
  // The same decision vector is the same path.
  EXPECT_LT((drag.encode(drag.decode(first, 5, state), state) - first).cwiseAbs().maxCoeff(), 1e-12);
  // Slowed down segment by segment it keeps its shape; what comes after the release hardly counts.
  Controls slowed = drag.decode(first, 3, state);
  slowed.row(1) *= 0.5;
  EXPECT_LT((drag.encode(slowed, state) - first).tail(5).cwiseAbs().maxCoeff(), 1e-12);
  Vector ending = first;
  ending[0] = 1.0 / 12.0;
  Controls padded = drag.default_controls(4);
  padded.topRows(2) = drag.decode(ending, 2, state);
  EXPECT_LT(((drag.encode(padded, state) - ending).array() / drag.decision_scale(4).array()).abs().maxCoeff(), 0.1);
}

TEST(Drag, EncodeIsTheNearest) {
  const Drag drag(Params{});
  const Vector state = drag.initial_state(straight());
  RandomStream random(5);
  Controls controls = drag.default_controls(6);
  for (Index i = 0; i < controls.size(); ++i) controls.data()[i] += 1e-3 * random.uniform(0.0, 1.0);
  const Vector x = drag.encode(controls, state);
  const Controls rest = drag.decode(x, 6, state) - controls;
  EXPECT_GT(rest.norm(), 1e-4);
  EXPECT_LT(drag.decode_pullback(x, 6, state, rest).norm(), 1e-12);  // the gradient of |rest|^2 / 2
}

TEST(Drag, PullbacksMatchCentralDifferences) {
  const Drag drag(Params{});
  RandomStream random(7);
  double worst = 0.0;
  for (int trial = 0; trial < 200; ++trial) {
    const Manipulation m = trial % 2 ? straight() : skew();
    Vector state = at(random.uniform(0.02, 1.3));
    for (Index k = 1; k < kSize; ++k) state[k] = random.uniform(-1.0, 1.0) * (k == kPhi ? 60.0 : 0.2);
    Positions w(2, 3);
    for (Index i = 0; i < 6; ++i) w.data()[i] = random.normal();
    const Eigen::ArrayXd height = drag.targets(m, state).col(2).array() - m.contact_height;
    if ((height > 0.0 && height < 1e-3).any()) continue;  // the kink
    const Vector gradient = drag.targets_pullback(m, state, w);
    for (Index i = 0; i < kSize; ++i) {
      const double h = i == kPhi ? 1e-3 : 1e-6;
      Vector up = state, down = state;
      up[i] += h;
      down[i] -= h;
      const double slope = (drag.targets(m, up) - drag.targets(m, down)).cwiseProduct(w).sum() / (2 * h);
      worst = std::max(worst, std::abs(slope - gradient[i]) / std::max(1.0, std::abs(slope)));
    }
    const Vector x = random_x(drag, random);
    Controls c(4, kSize);
    for (Index i = 0; i < c.size(); ++i) c.data()[i] = random.normal();
    const Vector slopes = drag.decode_pullback(x, 4, state, c);
    for (Index i = 0; i < kSize; ++i) {
      Vector up = x, down = x;
      up[i] += 1e-5;
      down[i] -= 1e-5;
      const double slope = (drag.decode(up, 4, state) - drag.decode(down, 4, state)).cwiseProduct(c).sum() / 2e-5;
      worst = std::max(worst, std::abs(slope - slopes[i]) / std::max(1.0, std::abs(slope)));
    }
  }
  EXPECT_LT(worst, 1e-7);
}

TEST(Drag, RefusesWhatItCannotDo) {
  const Drag drag(Params{});
  Manipulation m = straight();
  const Vector s = drag.initial_state(m);
  EXPECT_THROW(drag.targets(m, Vector::Zero(5)), ShapeError);
  EXPECT_THROW(drag.targets_pullback(m, s, Positions::Zero(1, 3)), ShapeError);
  EXPECT_THROW(drag.decode(Vector::Zero(12), 2, s), ShapeError);
  EXPECT_THROW(drag.decode_pullback(Vector::Zero(6), 2, s, Controls::Zero(3, 6)), ShapeError);
  EXPECT_THROW(drag.encode(Controls::Zero(2, 5), s), ShapeError);
  EXPECT_THROW(drag.decision_bounds(-1), ShapeError);
  m.displacement.setZero();
  EXPECT_THROW(drag.initial_state(m), ConfigError);
  m.displacement = {std::numeric_limits<double>::quiet_NaN(), 0.0};
  EXPECT_THROW(drag.targets(m, s), ConfigError);
  Params params;
  params.path.duration_s = 0.5;
  EXPECT_THROW(Drag{params}, ConfigError) << "shorter than duration_min_s";
  params = {};
  params.path.duration_max_s = 1.9;
  EXPECT_THROW(Drag{params}, ConfigError);
}

}  // namespace
}  // namespace weft::drag
