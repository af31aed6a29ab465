// The keyframes against positions computed by hand.
#include <gtest/gtest.h>

#include <cmath>

#include "trajectory/keyframes/keyframes.cpp"  // the class is compiled in: what is tested here does not need the loader
#include "weft/random.hpp"

namespace weft::keyframes {
namespace {

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

/// The index of a state variable or control.
Index find(const std::vector<Variable>& variables, const std::string& name) {
  for (std::size_t i = 0; i < variables.size(); ++i)
    if (variables[i].name == name) return static_cast<Index>(i);
  throw Error("no variable " + name);
}

/// The state that constant controls with one shape change reach at s.
Vector at(const Keyframes& keyframes, double s, const std::string& name = "s", double x = 1.0) {
  Vector state = Vector::Zero(std::ssize(keyframes.state()));
  state[find(keyframes.state(), name)] = s * x;
  state[0] = s;
  return state;
}

Params one_pose() {
  Params p;
  p.poses = 1;
  return p;
}

Params with_turns() {
  Params p;
  p.turn = true;
  p.times = {0.2, 0.45, 0.8};
  return p;
}

void expect_row(const Positions& g, Index i, double x, double y, double z) {
  EXPECT_NEAR(g(i, 0), x, 1e-12);
  EXPECT_NEAR(g(i, 1), y, 1e-12);
  EXPECT_NEAR(g(i, 2), z, 1e-12);
}

Vector random_x(const Keyframes& keyframes, RandomStream& random) {
  const Box box = keyframes.decision_bounds(1);
  Vector x(box.lower.size());
  for (Index i = 0; i < x.size(); ++i) x[i] = random.uniform(box.lower[i], box.upper[i]);
  return x;
}

TEST(Keyframes, StartsAtTheGraspPoints) {
  const Keyframes keyframes(Params{});
  for (const Manipulation& m : {straight(), skew()})
    EXPECT_LT((keyframes.targets(m, keyframes.initial_state(m)) - m.grasp_points).cwiseAbs().maxCoeff(), 1e-15);
}

TEST(Keyframes, DefaultPosesLieOnAHalfEllipse) {
  const Keyframes keyframes(Params{});
  const double root = std::sqrt(0.5), share = 0.5 * (1.0 - root);
  const auto expect = [&](double s, double x, double z) {
    const Positions g = keyframes.targets(straight(), at(keyframes, s));
    expect_row(g, 0, x, 0.2, z);
    expect_row(g, 1, x, -0.2, z);
  };
  expect(-0.1, 0.0, 0.0);
  expect(0.25, 0.6 * share, 0.3 * root + 0.05 * share);
  expect(0.5, 0.3, 0.325);
  expect(0.75, 0.6 * (1.0 - share), 0.3 * root + 0.05 * (1.0 - share));
  expect(1.0, 0.6, 0.05);
  expect(1.7, 0.6, 0.05);
}

TEST(Keyframes, PositionsBetweenThePoses) {
  // One pose: knots 0, 1/4, 1/2, 3/4, 1. The bends of phi_1 are 24, -48, 24, those of phi_2 are -4, 24, -20.
  // phi_1 = 1/32, 1/4, 23/32 at 1/8, 1/4, 3/8; phi_2 = -1/192, -1/24 at 1/8, 1/4 and 19/24 at 3/4.
  const Keyframes keyframes(one_pose());
  const auto expect = [&](double s, double one, double two) {
    expect_row(keyframes.targets(straight(), at(keyframes, s)), 0, 0.3 * one + 0.6 * two, 0.2,
               0.325 * one + 0.05 * two);
  };
  expect(1.0 / 8.0, 1.0 / 32.0, -1.0 / 192.0);
  expect(0.25, 0.25, -1.0 / 24.0);
  expect(0.5, 1.0, 0.0);
  expect(0.75, 0.25, 19.0 / 24.0);
  // 3/8: the cubic of phi_2 between -1/24 (bend -4) and 0 (bend 24): -1/48 - h^2 / 16 (24 - 4).
  expect(0.375, 23.0 / 32.0, -1.0 / 48.0 - 20.0 / 256.0);
}

TEST(Keyframes, ShapeParametersAreInForceFromTheStart) {
  const Keyframes keyframes(one_pose());
  const Manipulation m = straight();
  expect_row(keyframes.targets(m, at(keyframes, 0.5, "along_1", 0.1)), 0, 0.4, 0.2, 0.325);
  expect_row(keyframes.targets(m, at(keyframes, 0.5, "across_1", 0.1)), 0, 0.3, 0.3, 0.325);
  expect_row(keyframes.targets(m, at(keyframes, 0.5, "up_1", 0.1)), 0, 0.3, 0.2, 0.425);
  expect_row(keyframes.targets(m, at(keyframes, 0.5, "along_end", 0.1)), 0, 0.3, 0.2, 0.325);
  expect_row(keyframes.targets(m, at(keyframes, 0.25, "up_1", 0.4)), 0, 0.05, 0.2, 0.25 * 0.725 - 0.05 / 24.0);
  for (const char* name : {"along_1", "across_1", "up_1"})
    expect_row(keyframes.targets(m, at(keyframes, 1.0, name, 0.1)), 0, 0.6, 0.2, 0.05);
  for (const double s : {1.0, 1.2}) {
    expect_row(keyframes.targets(m, at(keyframes, s, "along_end", 0.1)), 0, 0.7, 0.2, 0.05);
    expect_row(keyframes.targets(m, at(keyframes, s, "across_end", 0.1)), 0, 0.6, 0.3, 0.05);
  }
}

TEST(Keyframes, PosesAndTimesCanBeGiven) {
  Params p;
  p.poses = 2;
  p.times = {0.3, 0.6};
  p.along_m = {-0.1, 0.7};
  p.across_m = {0.05, -0.05};
  p.up_m = {0.2, 0.4};
  const Keyframes keyframes(p);
  expect_row(keyframes.targets(straight(), at(keyframes, 0.3)), 0, -0.1, 0.25, 0.2);
  expect_row(keyframes.targets(straight(), at(keyframes, 0.6)), 0, 0.7, 0.15, 0.4);
  expect_row(keyframes.targets(straight(), at(keyframes, 1.0)), 0, 0.6, 0.2, 0.05);
}

TEST(Keyframes, HeadingsTurnTheHandsAboutTheirMidpoint) {
  const Keyframes keyframes(with_turns());
  // 90 degrees: the offset +0.2 y turns to -0.2 x.
  Positions g = keyframes.targets(straight(), at(keyframes, 1.0, "turn_end", 90.0));
  expect_row(g, 0, 0.4, 0.0, 0.05);
  expect_row(g, 1, 0.8, 0.0, 0.05);
  const double x = 0.3 * (1.0 - std::cos(0.45 * std::numbers::pi));
  g = keyframes.targets(straight(), at(keyframes, 0.45, "turn_2", -90.0));
  EXPECT_NEAR(g(0, 0), x + 0.2, 1e-12);
  EXPECT_NEAR(g(1, 0), x - 0.2, 1e-12);
}

TEST(Keyframes, SplinesAreSmoothAndStartAndEndAtRest) {
  const std::vector<double> times = {0.15, 0.5, 0.6, 0.9};
  const Splines splines(times);
  Vector value, slope, before, after, around;
  for (const double knot : {0.0, 0.075, 0.15, 0.5, 0.6, 0.9, 0.95, 1.0}) {
    const double h = 1e-6;
    splines.evaluate(knot, value, slope);
    splines.evaluate(knot - h, around, before);
    splines.evaluate(knot + h, around, after);
    // Second derivatives on both sides of the knot.
    EXPECT_LT(((after - slope) / h - (slope - before) / h).cwiseAbs().maxCoeff(), 0.05) << knot;
    if (knot == 0.0 || knot == 1.0) {
      EXPECT_EQ(slope, Vector::Zero(5));
    }
  }
  for (Index j = 0; j < 4; ++j) {
    splines.evaluate(times[j], value, slope);
    EXPECT_LT((value - Vector::Unit(5, j)).cwiseAbs().maxCoeff(), 1e-14);
  }
}

TEST(Keyframes, OneHandFollowsTheMidpoint) {
  Params one;
  one.path.hands = 1;
  Manipulation m = straight(), left = m;
  left.grasp_vertices = {0};
  left.grasp_points = m.grasp_points.topRows(1);
  EXPECT_EQ(Keyframes(one).hands(), 1);
  const Positions g = Keyframes(one).targets(left, at(Keyframes(one), 0.5));
  ASSERT_EQ(g.rows(), 1);
  expect_row(g, 0, 0.3, 0.2, 0.325);
  EXPECT_THROW(Keyframes(one).initial_state(m), ShapeError);
}

TEST(Keyframes, HeightsCountFromTheGraspPoints) {
  const Manipulation m = skew();
  const Keyframes keyframes(Params{});
  expect_row(keyframes.targets(m, at(keyframes, 1.0)), 0, 0.31 - 0.42, -0.12 + 0.17, 0.771);
}

TEST(Keyframes, NeverBelowContactHeight) {
  const Keyframes keyframes(Params{});
  const Manipulation m = skew();
  for (double s = 0.0; s <= 1.1; s += 0.01) {
    const Vector state = at(keyframes, s, "up_1", -0.5);
    EXPECT_GE(keyframes.targets(m, state).col(2).minCoeff(), m.contact_height);
    if (s > 0.05 && s < 0.3) {  // below it the height has no effect
      const Vector gradient = keyframes.targets_pullback(m, state, Positions::Constant(2, 3, 1.0));
      EXPECT_EQ(gradient[find(keyframes.state(), "up_1")], 0.0);
    }
  }
}

TEST(Keyframes, HandsStartAndEndSlowly) {
  const Keyframes keyframes(with_turns());
  const Manipulation m = straight();
  Vector state = keyframes.initial_state(m), x = keyframes.encode(keyframes.default_controls(1), state);
  x.segment(1, 11).setConstant(0.1);
  x.tail(4).setConstant(30.0);
  const Controls controls = keyframes.decode(x, 9, state);
  std::vector<Positions> path = {keyframes.targets(m, state)};
  for (Index j = 0; j < controls.rows(); ++j) {
    const SegmentPath segment = keyframes.segment(m, state, controls.row(j).transpose());
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
  EXPECT_LT((path[96] - path[95]).norm() / kFrameSeconds, 0.02);  // 1.6 s
  EXPECT_LT((path[108] - path[96]).norm(), 1e-12);                // then at rest
  EXPECT_GT(fastest, 0.6 / 1.6);
  EXPECT_LT(fastest, 3.0);
  EXPECT_LT(hardest, 20.0);  // no jump of the speed: one of 1 m/s would be 60 m/s^2
}

TEST(Keyframes, PathDoesNotDependOnThePace) {
  const Keyframes keyframes(Params{});
  const Manipulation m = skew();
  RandomStream random(3);
  const Vector x = random_x(keyframes, random);
  Vector quick = x, slow = x;
  quick[0] = 1.0 / 40.0;
  slow[0] = 1.0 / 80.0;
  const auto after = [&](const Vector& y, int frames) {
    Vector state = keyframes.initial_state(m);
    const Vector row = keyframes.decode(y, 1, state).row(0).transpose();
    for (int k = 0; k < frames; ++k) state = keyframes.advance(m, state, row);
    return keyframes.targets(m, state);
  };
  for (const int frames : {5, 20, 31, 40})
    EXPECT_LT((after(quick, frames) - after(slow, 2 * frames)).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(Keyframes, AFastFoldWithOneHandTakesThreeSegments) {
  Params p;
  p.path.hands = 1;
  p.path.duration_s = 0.6;
  const Keyframes keyframes(p);
  Manipulation m = straight();
  m.grasp_vertices = {0};
  m.grasp_points = Positions(m.grasp_points.topRows(1));
  const Vector start = keyframes.initial_state(m);
  EXPECT_EQ(keyframes.release_segment(m, start, keyframes.default_controls(25)), 3);
  Vector state = start;
  for (int k = 0; k < 35; ++k) state += keyframes.default_controls(1).row(0).transpose();
  EXPECT_FALSE(keyframes.released(state));
  EXPECT_TRUE(keyframes.released(state + keyframes.default_controls(1).row(0).transpose()));
  EXPECT_EQ(keyframes.release_segment(m, start, keyframes.decode(keyframes.decision_bounds(25).upper, 25, start)), 2);
}

TEST(Keyframes, ALaterPlanContinuesWithoutAJump) {
  const Keyframes keyframes(Params{});
  const Manipulation m = skew();
  RandomStream random(4);
  const Vector first = random_x(keyframes, random);
  Vector state = keyframes.initial_state(m);
  for (int k = 0; k < 24; ++k)
    state = keyframes.advance(m, state, keyframes.decode(first, 1, state).row(0).transpose());
  // The same decision vector is the same path.
  EXPECT_LT((keyframes.encode(keyframes.decode(first, 5, state), state) - first).cwiseAbs().maxCoeff(), 1e-12);
  // Slowed down segment by segment it keeps its shape; what comes after the release hardly counts.
  Controls slowed = keyframes.decode(first, 3, state);
  slowed.row(1) *= 0.5;
  EXPECT_LT((keyframes.encode(slowed, state) - first).tail(11).cwiseAbs().maxCoeff(), 1e-12);
  Vector ending = first;
  ending[0] = 1.0 / 12.0;
  Controls padded = keyframes.default_controls(4);
  padded.topRows(2) = keyframes.decode(ending, 2, state);
  EXPECT_LT(((keyframes.encode(padded, state) - ending).array() / keyframes.decision_scale(4).array()).abs().maxCoeff(),
            0.1);
}

TEST(Keyframes, EncodeIsTheNearest) {
  const Keyframes keyframes(Params{});
  const Vector state = keyframes.initial_state(straight());
  RandomStream random(5);
  Controls controls = keyframes.default_controls(6);
  for (Index i = 0; i < controls.size(); ++i) controls.data()[i] += 1e-3 * random.uniform(0.0, 1.0);
  const Vector x = keyframes.encode(controls, state);
  const Controls rest = keyframes.decode(x, 6, state) - controls;
  EXPECT_GT(rest.norm(), 1e-4);
  EXPECT_LT(keyframes.decode_pullback(x, 6, state, rest).norm(), 1e-12);  // the gradient of |rest|^2 / 2
}

TEST(Keyframes, PullbacksMatchCentralDifferences) {
  const Keyframes keyframes(with_turns());
  const Index size = std::ssize(keyframes.state());
  RandomStream random(7);
  double worst = 0.0;
  for (int trial = 0; trial < 200; ++trial) {
    const Manipulation m = trial % 2 ? straight() : skew();
    Vector state = at(keyframes, random.uniform(0.02, 1.3));
    for (Index k = 1; k < size; ++k) state[k] = random.uniform(-1.0, 1.0) * (k > 11 ? 60.0 : 0.2);
    Positions w(2, 3);
    for (Index i = 0; i < 6; ++i) w.data()[i] = random.normal();
    const Eigen::ArrayXd height = keyframes.targets(m, state).col(2).array() - m.contact_height;
    if ((height > 0.0 && height < 1e-3).any()) continue;  // the kink
    const Vector gradient = keyframes.targets_pullback(m, state, w);
    for (Index i = 0; i < size; ++i) {
      const double h = i > 11 ? 1e-3 : 1e-6;
      Vector up = state, down = state;
      up[i] += h;
      down[i] -= h;
      const double slope = (keyframes.targets(m, up) - keyframes.targets(m, down)).cwiseProduct(w).sum() / (2 * h);
      worst = std::max(worst, std::abs(slope - gradient[i]) / std::max(1.0, std::abs(slope)));
    }
    const Vector x = random_x(keyframes, random);
    Controls c(4, size);
    for (Index i = 0; i < c.size(); ++i) c.data()[i] = random.normal();
    const Vector slopes = keyframes.decode_pullback(x, 4, state, c);
    for (Index i = 0; i < size; ++i) {
      Vector up = x, down = x;
      up[i] += 1e-5;
      down[i] -= 1e-5;
      const double slope =
          (keyframes.decode(up, 4, state) - keyframes.decode(down, 4, state)).cwiseProduct(c).sum() / 2e-5;
      worst = std::max(worst, std::abs(slope - slopes[i]) / std::max(1.0, std::abs(slope)));
    }
  }
  EXPECT_LT(worst, 1e-7);
}

TEST(Keyframes, RefusesWhatItCannotDo) {
  const Keyframes keyframes(Params{});
  Manipulation m = straight();
  const Vector s = keyframes.initial_state(m);
  EXPECT_THROW(keyframes.targets(m, Vector::Zero(11)), ShapeError);
  EXPECT_THROW(keyframes.targets_pullback(m, s, Positions::Zero(1, 3)), ShapeError);
  EXPECT_THROW(keyframes.decode(Vector::Zero(24), 2, s), ShapeError);
  EXPECT_THROW(keyframes.decode_pullback(Vector::Zero(12), 2, s, Controls::Zero(3, 12)), ShapeError);
  EXPECT_THROW(keyframes.encode(Controls::Zero(2, 11), s), ShapeError);
  EXPECT_THROW(keyframes.decision_bounds(-1), ShapeError);
  m.displacement.setZero();
  EXPECT_THROW(keyframes.initial_state(m), ConfigError);
  m.displacement = {std::numeric_limits<double>::quiet_NaN(), 0.0};
  EXPECT_THROW(keyframes.targets(m, s), ConfigError);
  Params params;
  params.path.duration_s = 0.3;
  EXPECT_THROW(Keyframes{params}, ConfigError) << "shorter than duration_min_s";
  params = {};
  params.path.duration_max_s = 1.5;
  EXPECT_THROW(Keyframes{params}, ConfigError);
  params = {};
  params.times = {0.2, 0.2, 0.8};
  EXPECT_THROW(Keyframes{params}, ConfigError) << "not ascending";
  params.times = {0.2, 0.8};
  EXPECT_THROW(Keyframes{params}, ConfigError) << "one per pose";
  params = {};
  params.up_m = {0.1};
  EXPECT_THROW(Keyframes{params}, ConfigError);
  params = with_turns();
  params.path.hands = 1;
  EXPECT_THROW(Keyframes{params}, ConfigError) << "one hand has no heading";
}

}  // namespace
}  // namespace weft::keyframes
