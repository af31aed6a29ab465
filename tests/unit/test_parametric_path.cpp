// ParametricPath with a small path that uses every coordinate.
#include <cmath>
#include <numbers>

#include "test_support.hpp"
#include "weft/parametric_path.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

using test::message_of;

constexpr double kRadians = std::numbers::pi / 180.0;

/// Up in the first half and down in the second, while the hands swing to the left, turn and spread.
class Hop final : public ParametricPath {
 public:
  enum : Index { kHeight, kAside, kHeading, kTurn, kSpread };
  explicit Hop(const PathParams& params = {})
      : ParametricPath("hop", params,
                       {{"height", "m", 0.1},
                        {"aside", "m", 0.2},
                        {"heading", "deg", 30.0},
                        {"turn", "deg", 60.0},
                        {"spread", "1", 0.05}}) {}

 private:
  void path(const Manipulation& m, double s, ConstVec x, PathPoint& q) const override {
    const Profile all = minimum_jerk(s, 0.0, 1.0), rise = minimum_jerk(s, 0.0, 0.5), fall = minimum_jerk(s, 0.5, 1.0);
    q.along.at = m.displacement.norm() * all;
    q.across.at = x[kAside] * (rise - fall);
    q.across.by_shape[kAside] = rise.value - fall.value;
    q.up.at = (0.3 + x[kHeight]) * (rise - fall) + m.drop_height * fall;
    q.up.by_shape[kHeight] = rise.value - fall.value;
    q.heading.at = kRadians * x[kHeading] * all;
    q.heading.by_shape[kHeading] = kRadians * all.value;
    q.turn.at = kRadians * x[kTurn] * all;
    q.turn.by_shape[kTurn] = kRadians * all.value;
    q.spread.at = x[kSpread] * rise;
    q.spread.by_shape[kSpread] = rise.value;
  }
};

/// Grasp points 0.4 m apart along y at x = 0, d = 0.6 m along +x, on a table of 0.1 m.
Manipulation table() {
  Manipulation m;
  m.grasp_vertices = {0, 1};
  m.grasp_points.resize(2, 3);
  m.grasp_points << 0.0, 0.2, 0.1, 0.0, -0.2, 0.1;
  m.displacement = {0.6, 0.0};
  m.contact_height = 0.1;
  return m;
}

/// The state that constant controls with the shape x reach at s.
Vector at(double s, double height, double aside = 0.0, double heading = 0.0, double turn = 0.0, double spread = 0.0) {
  Vector state(6);
  state << 1.0, height, aside, heading, turn, spread;
  return s * state;
}

void expect_rows(const Positions& g, const Vec3& first, const Vec3& second) {
  EXPECT_LT((g.row(0).transpose() - first).norm(), 1e-14) << g;
  EXPECT_LT((g.row(1).transpose() - second).norm(), 1e-14) << g;
}

TEST(ParametricPath, MinimumJerkIsAStepAtRestAtBothEnds) {
  EXPECT_EQ(minimum_jerk(0.2, 0.2, 0.6).value, 0.0);
  EXPECT_EQ(minimum_jerk(0.7, 0.2, 0.6).value, 1.0);
  EXPECT_EQ(minimum_jerk(0.7, 0.2, 0.6).slope, 0.0);
  EXPECT_NEAR(minimum_jerk(0.3, 0.2, 0.6).value, 53.0 / 512.0, 1e-15);  // u = 1/4
  EXPECT_NEAR(minimum_jerk(0.4, 0.2, 0.6).slope, 1.875 / 0.4, 1e-14);
  const Profile sum = 2.0 * minimum_jerk(0.4, 0.2, 0.6) - minimum_jerk(0.7, 0.2, 0.6);
  EXPECT_NEAR(sum.value, 0.0, 1e-15);
  EXPECT_NEAR(sum.slope, 2.0 * 1.875 / 0.4, 1e-13);
}

TEST(ParametricPath, EveryCoordinateMovesTheHands) {
  const Hop hop;
  const Manipulation m = table();
  expect_rows(hop.targets(m, at(0.5, 0.0)), {0.3, 0.2, 0.4}, {0.3, -0.2, 0.4});
  expect_rows(hop.targets(m, at(1.0, 0.0)), {0.6, 0.2, 0.15}, {0.6, -0.2, 0.15});
  expect_rows(hop.targets(m, at(0.5, 0.1)), {0.3, 0.2, 0.5}, {0.3, -0.2, 0.5});
  expect_rows(hop.targets(m, at(0.5, 0.0, 0.2)), {0.3, 0.4, 0.4}, {0.3, 0.0, 0.4});
  expect_rows(hop.targets(m, at(0.5, 0.0, 0.2, 180.0)), {-0.2, 0.5, 0.4}, {-0.2, 0.1, 0.4});  // half of it: 90 degrees
  expect_rows(hop.targets(m, at(1.0, 0.0, 0.0, 0.0, 90.0)), {0.4, 0.0, 0.15}, {0.8, 0.0, 0.15});
  expect_rows(hop.targets(m, at(1.0, 0.0, 0.0, 0.0, 0.0, 0.05)), {0.6, 0.21, 0.15}, {0.6, -0.21, 0.15});
  expect_rows(hop.targets(m, at(0.5, -0.4)), {0.3, 0.2, 0.1}, {0.3, -0.2, 0.1});  // not below the table
}

TEST(ParametricPath, StartsExactlyAtTheGraspPoints) {
  const Hop hop;
  Manipulation m = table();
  m.grasp_points << 0.31, -0.12, 0.103, 0.18, 0.33, 0.101;
  EXPECT_EQ(hop.targets(m, hop.initial_state(m)), m.grasp_points);
  // A sum of controls divided by a progress near 0 is large or infinite; the hands do not move.
  for (const double s : {-1.0, 0.0, 1e-320, 1e-12, 1.0001e-9, 1e-8}) {
    Vector state = at(1.0, 10.0, 10.0, 3600.0, 3600.0, 10.0);
    state[0] = s;
    EXPECT_LT((hop.targets(m, state) - m.grasp_points).cwiseAbs().maxCoeff(), 2e-12) << s;
    EXPECT_LT(hop.targets_pullback(m, state, Positions::Ones(2, 3)).cwiseAbs().maxCoeff(), 1e-3) << s;
  }
  EXPECT_FALSE(hop.targets(m, Vector::Constant(6, std::numeric_limits<double>::quiet_NaN())).allFinite());
}

TEST(ParametricPath, RestsAfterTheEnd) {
  const Hop hop;
  const Manipulation m = table();
  const Vector end = at(1.0, 0.1, 0.2, 20.0, 30.0, 0.02);
  EXPECT_LT((hop.targets(m, 1.7 * end) - hop.targets(m, end)).cwiseAbs().maxCoeff(), 1e-14);
}

TEST(ParametricPath, PullbackMatchesCentralDifferences) {
  const Hop hop;
  RandomStream random(11);
  double worst = 0.0;
  for (int trial = 0; trial < 200; ++trial) {
    Manipulation m = table();
    m.grasp_points << 0.31, -0.12, 0.103, 0.18, 0.33, 0.101;
    m.displacement = {-0.42, 0.17};
    const double s = random.uniform(0.02, 1.3);
    if (std::abs(s - 1.0) < 1e-4 || std::abs(s - 0.5) < 1e-4) continue;
    const Vector state = at(s, random.uniform(-0.1, 0.1), random.uniform(-0.2, 0.2), random.uniform(-60.0, 60.0),
                            random.uniform(-60.0, 60.0), random.uniform(-0.3, 0.3));
    Positions w(2, 3);
    for (Index i = 0; i < w.size(); ++i) w.data()[i] = random.normal();
    const Vector gradient = hop.targets_pullback(m, state, w);
    for (Index i = 0; i < state.size(); ++i) {
      const double h = i == 3 || i == 4 ? 1e-3 : 1e-6;
      Vector up = state, down = state;
      up[i] += h;
      down[i] -= h;
      const double slope = (hop.targets(m, up) - hop.targets(m, down)).cwiseProduct(w).sum() / (2.0 * h);
      worst = std::max(worst, std::abs(slope - gradient[i]) / std::max(1.0, std::abs(slope)));
    }
  }
  EXPECT_LT(worst, 1e-7);
}

TEST(ParametricPath, VariablesFollowFromTheShapeAndThePace) {
  PathParams params;
  params.duration_s = 1.0;
  params.duration_min_s = 0.5;
  params.duration_max_s = 4.0;
  const Hop hop(params);
  const auto controls = hop.controls(), state = hop.state();
  ASSERT_EQ(controls.size(), 6u);
  ASSERT_EQ(state.size(), 6u);
  EXPECT_EQ(controls[0].name + " " + controls[1].name + " " + controls[3].unit, "ds dheight deg/frame");
  EXPECT_EQ(state[0].name + " " + state[1].name + " " + state[3].unit, "s height deg");
  const auto near = [](double got, double wanted) { EXPECT_NEAR(got, wanted, 1e-8 * wanted); };
  near(controls[0].default_value, 1.0 / 60.0);
  near(controls[0].lower, 1.0 / 240.0);
  near(controls[0].upper, 1.0 / 30.0);
  near(controls[0].scale, 0.2 / 60.0);
  near(controls[1].upper, 0.1 / 30.0);
  near(controls[1].scale, 0.15 * 0.1 / 60.0);
  EXPECT_EQ(controls[1].lower, -controls[1].upper);
  EXPECT_EQ(state[3].upper, 3600.0);
  // 60 frames to the release, and the shape's changes in their units whatever the horizon.
  EXPECT_EQ(hop.release_segment(table(), Vector::Zero(6), hop.default_controls(25)), 5);
  for (const Index horizon : {1, 7}) {
    const Box box = hop.decision_bounds(horizon);
    ASSERT_EQ(box.dim(), 6);
    near(box.upper[1], 0.1);
    near(box.upper[3], 30.0);
    near(-box.lower[3], 30.0);
    near(hop.decision_scale(horizon)[3], 0.15 * 30.0);
  }
}

TEST(ParametricPath, DecodeAndEncodeAreInverse) {
  const Hop hop;
  Vector x(6);
  x << 0.02, 0.05, -0.1, 20.0, -40.0, 0.01;
  const Vector state = at(0.3, 0.02);
  const Controls controls = hop.decode(x, 3, state);
  ASSERT_EQ(controls.rows(), 3);
  for (Index j = 0; j < 3; ++j) {
    EXPECT_EQ(controls(j, 0), x[0]);
    EXPECT_LT((controls.row(j).tail(5).transpose() - x[0] * x.tail(5)).norm(), 1e-15);
  }
  EXPECT_LT((hop.encode(controls, state) - x).norm(), 1e-13);
  // The gradient of the squared distance vanishes at the nearest x; a segment after the release hardly counts.
  Controls other = controls;
  other.row(1) *= 1.3;
  other(2, 4) += 1e-3;
  const Vector nearest = hop.encode(other, state);
  const Controls rest = hop.decode(nearest, 3, state) - other;
  EXPECT_GT(rest.norm(), 1e-3);
  EXPECT_LT(hop.decode_pullback(nearest, 3, state, rest).norm(), 1e-13);
  Vector fast = x;
  fast[0] = 1.0 / 12.0;
  Controls ended = hop.default_controls(3);
  ended.topRows(1) = hop.decode(fast, 1, state);
  EXPECT_LT((hop.encode(ended, state) - fast).norm(), 0.02 * fast.norm());
}

TEST(ParametricPath, RefusesWhatItCannotDo) {
  const Hop hop;
  Manipulation m = table();
  const Vector s = hop.initial_state(m);
  EXPECT_EQ(message_of<Error>([&] { hop.targets(m, Vector::Zero(5)); }).rfind("hop: state", 0), 0u);
  EXPECT_THROW(hop.progress(Vector::Zero(5)), ShapeError);
  EXPECT_THROW(hop.targets_pullback(m, s, Positions::Zero(1, 3)), ShapeError);
  EXPECT_THROW(hop.decode(Vector::Zero(12), 2, s), ShapeError);
  EXPECT_THROW(hop.decode_pullback(Vector::Zero(6), 2, s, Controls::Zero(3, 6)), ShapeError);
  EXPECT_THROW(hop.encode(Controls::Zero(2, 5), s), ShapeError);
  EXPECT_THROW(hop.decision_size(-1), ShapeError);
  m.grasp_points.conservativeResize(1, 3);
  EXPECT_THROW(hop.initial_state(m), ShapeError) << "one hand of two";
  m = table();
  m.displacement.setZero();
  EXPECT_EQ(message_of<Error>([&] { hop.initial_state(m); }),
            "hop: |d| = 0 (displacement of the grasp points), must be above 0: d is the direction");
  PathParams params;
  params.duration_min_s = 3.0;
  EXPECT_EQ(message_of<Error>([&] { Hop{params}; }),
            "hop: duration_s = 2 s, must be in [duration_min_s, duration_max_s] = [3, 5]");
}

}  // namespace
}  // namespace weft
