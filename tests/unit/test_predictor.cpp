#include "weft/predictor.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "toy_trajectory.hpp"

namespace weft {
namespace {

struct CheckCases : testing::Test {
  CheckCases() {
    Garment garment;
    garment.positions = Positions::Zero(3, 3);
    task.garment = std::make_shared<const Garment>(garment);
    task.trajectory = std::make_shared<const test::ToyTrajectory>();
    one.shape = std::make_shared<const Positions>(garment.positions);
    one.state = Vector::Zero(static_cast<Index>(task.trajectory->state().size()));
    one.controls = Controls::Zero(3, static_cast<Index>(task.trajectory->controls().size()));
    one.segments = {1, 3};
  }
  /// The error message about a second case that `change` has changed.
  template <class Wanted = ShapeError, class Change>
  std::string refusal(const Change& change) const {
    PredictionCase other = one;
    change(other);
    try {
      check_cases("plugin", task, {one, other}, 3);
    } catch (const Wanted& error) {
      return error.what();
    }
    return "";
  }
  Task task;
  PredictionCase one;
};

TEST_F(CheckCases, TakesWhatFits) {
  EXPECT_NO_THROW(check_cases("plugin", task, {}));
  EXPECT_NO_THROW(check_cases("plugin", task, {one, one}, 3));
  one.previous = one.shape;
  one.segments.clear();
  EXPECT_NO_THROW(check_cases("plugin", task, {one}));
}

TEST_F(CheckCases, NamesThePluginTheCaseAndWhatIsWrong) {
  const std::string at = "plugin: case 1: ";
  const auto short_shape = std::make_shared<const Positions>(Positions::Zero(2, 3));
  EXPECT_EQ(refusal([](auto& c) { c.shape.reset(); }), at + "has no shape");
  EXPECT_EQ(refusal([&](auto& c) { c.shape = short_shape; }), at + "shape rows = 2, must be 3");
  EXPECT_EQ(refusal([&](auto& c) { c.previous = short_shape; }), at + "previous rows = 2, must be 3");
  EXPECT_TRUE(refusal([](auto& c) { c.state.conservativeResize(c.state.size() + 1); }).starts_with(at + "state = "));
  EXPECT_TRUE(refusal([](auto& c) { c.controls.resize(3, 0); }).starts_with(at + "control columns = 0"));
  EXPECT_EQ(refusal([](auto& c) { c.controls = Controls::Zero(4, c.controls.cols()); }),
            at + "control rows = 4, must be at most 3");
  for (const std::vector<Index>& bad : {std::vector<Index>{0}, {4}, {2, 2}, {3, 1}})
    EXPECT_TRUE(refusal([&](auto& c) { c.segments = bad; }).starts_with(at + "segments must ascend within [1, 3]"));
}

TEST_F(CheckCases, RefusesWhatIsNotFinite) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto bad = std::make_shared<const Positions>(Positions::Constant(3, 3, nan));
  const std::string at = "plugin: case 1: ", end = " must be finite";
  EXPECT_EQ(refusal<Error>([&](auto& c) { c.shape = bad; }), at + "shape" + end);
  EXPECT_EQ(refusal<Error>([&](auto& c) { c.previous = bad; }), at + "previous" + end);
  EXPECT_EQ(refusal<Error>([&](auto& c) { c.state[0] = nan; }), at + "state" + end);
  EXPECT_EQ(refusal<Error>([&](auto& c) { c.controls(2, 0) = nan; }), at + "controls" + end);
  EXPECT_EQ(refusal<Error>([&](auto& c) { c.knowledge.centre[1] = nan; }), at + "knowledge" + end);
  EXPECT_EQ(refusal<Error>([&](auto& c) { c.knowledge.width[1] = nan; }), at + "knowledge" + end);
}

TEST_F(CheckCases, BindingComesFirst) { EXPECT_THROW(check_cases("plugin", Task(), {one}), Error); }

TEST(PlainPrediction, HoldsShapesAndFailuresAndRefusesDerivatives) {
  std::vector<std::vector<ShapeDistribution>> shapes(2);
  shapes[0].push_back({Positions::Ones(1, 3), Positions(0, 3)});
  const PlainPrediction none_failed(shapes), one_failed(shapes, {"", "broken"});
  EXPECT_EQ(none_failed.shapes()[0][0].mean, Positions::Ones(1, 3));
  EXPECT_EQ(none_failed.failure(1), "");
  EXPECT_EQ(one_failed.failure(1), "broken");
  EXPECT_THROW(none_failed.pullback({}), Unsupported);
  EXPECT_THROW(none_failed.jvp({}), Unsupported);
  EXPECT_THROW(PlainPrediction(shapes, {"broken"}), ShapeError);
}

}  // namespace
}  // namespace weft
