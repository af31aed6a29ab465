// The checks around a plugin's object: what they find, whom they name, and what they leave alone.
#include "loader/checked.hpp"

#include <cmath>
#include <functional>
#include <limits>
#include <new>

#include "loader/where.hpp"
#include "sdk/machine_failure.hpp"
#include "unit/test_support.hpp"
#include "unit/toy_trajectory.hpp"
#include "weft/optimiser.hpp"
#include "weft/simulator.hpp"

namespace weft {
namespace {

using test::message_of;
using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

class BadTrajectory final : public test::ToyTrajectory {
 public:
  std::function<void(Vector& d_state, Vector& d_control)> spoil = [](Vector&, Vector&) {};
  std::function<void()> before_advance = [] {};
  Vector advance(const Manipulation& m, ConstVec state, ConstVec control) const override {
    before_advance();
    return Trajectory::advance(m, state, control);
  }
  void advance_pullback(const Manipulation& m, ConstVec state, ConstVec control, ConstVec d_next, Vector& d_state,
                        Vector& d_control) const override {
    Trajectory::advance_pullback(m, state, control, d_next, d_state, d_control);
    spoil(d_state, d_control);
  }
};

struct CheckedTrajectories : testing::Test {
  std::shared_ptr<BadTrajectory> bad = std::make_shared<BadTrajectory>();
  std::shared_ptr<Trajectory> trajectory = checked("lift", std::shared_ptr<Trajectory>(bad), PluginChecks::all);
  Manipulation m;
  Vector one = Vector::Ones(1), d_state, d_control;
  std::string pull() {
    const Step step("planning");
    return message_of<Error>([&] { trajectory->advance_pullback(m, one, one, one, d_state, d_control); });
  }
};

TEST_F(CheckedTrajectories, SizesAndNumbersOfAPullback) {
  EXPECT_NO_THROW(trajectory->advance_pullback(m, one, one, one, d_state, d_control));
  bad->spoil = [](Vector&, Vector& of_control) { of_control.resize(0); };
  EXPECT_THAT(pull(),
              StartsWith("trajectory lift, planning: d_control from advance_pullback() has size 0, must have 1; "
                         "`weft conformance lift`"));
  bad->spoil = [](Vector& of_state, Vector&) { of_state = Vector::Zero(2); };
  EXPECT_THAT(pull(), StartsWith("trajectory lift, planning: d_state from advance_pullback() has size 2, must have 1"));
  bad->spoil = [](Vector& of_state, Vector&) { of_state[0] = kNaN; };
  EXPECT_THAT(pull(), StartsWith("trajectory lift, planning: d_state from advance_pullback() is not finite"));
}

TEST_F(CheckedTrajectories, NonsenseInGivesNonsenseOutAndNoBlame) {
  const Vector nan = Vector::Constant(1, kNaN);
  EXPECT_TRUE(std::isnan(trajectory->advance(m, nan, one)[0]));
  EXPECT_NO_THROW(trajectory->advance_pullback(m, one, one, nan, d_state, d_control));
  EXPECT_TRUE(std::isnan(trajectory->progress(nan)));
}

TEST_F(CheckedTrajectories, AWrongCallIsItsCallersFault) {
  const Vector two = Vector::Ones(2);
  EXPECT_EQ(message_of<ShapeError>([&] { trajectory->advance(m, two, one); }),
            "weft: gave trajectory lift a state of size 2, must have 1");
  const PluginCall caller("predictor mine", "predict()");
  EXPECT_EQ(message_of<ShapeError>([&] { trajectory->advance(m, one, two); }),
            "predictor mine, predict(): gave trajectory lift a control of size 2, must have 1");
  const auto results_only = checked("lift", std::shared_ptr<Trajectory>(bad), PluginChecks::results);
  EXPECT_THAT(message_of<ShapeError>([&] { results_only->advance(m, two, one); }), StartsWith("trajectory lift, "));
}

TEST_F(CheckedTrajectories, EveryExceptionIsNamedOnceAndKeepsItsType) {
  const Step step("planning");
  const auto message = [&](std::function<void()> thrower) {
    bad->before_advance = std::move(thrower);
    return message_of<Error>([&] { trajectory->advance(m, one, one); });
  };
  EXPECT_EQ(message([] { throw 42; }), "trajectory lift, planning: it threw something that is not a std::exception");
  EXPECT_EQ(message([] { throw std::out_of_range("map::at"); }), "trajectory lift, planning: map::at");
  EXPECT_EQ(message([] { throw Diverged("lift: too far"); }), "trajectory lift, planning: too far");
  EXPECT_THROW(trajectory->advance(m, one, one), Diverged);
  // A plugin that calls another one: the inner one is named.
  const auto outer_bad = std::make_shared<BadTrajectory>();
  outer_bad->before_advance = [&] { trajectory->advance(m, one, one); };
  const auto outer = checked("outer", std::shared_ptr<Trajectory>(outer_bad), PluginChecks::all);
  EXPECT_EQ(message_of<Diverged>([&] { outer->advance(m, one, one); }), "trajectory lift, planning: too far");
  // Failures of the machine stay what they are, so that the work is tried again.
  EXPECT_EQ(message([] { throw std::bad_alloc(); }), "trajectory lift, planning: there was not enough memory");
  EXPECT_THROW(trajectory->advance(m, one, one), OutOfMemory);
  EXPECT_EQ(message([] { throw ReadError("x.h5: is locked"); }), "trajectory lift, planning: x.h5: is locked");
  EXPECT_THROW(trajectory->advance(m, one, one), ReadError);
  EXPECT_EQ(message([] { throw WriteError("x.h5: full"); }), "trajectory lift, planning: x.h5: full");
  EXPECT_THROW(trajectory->advance(m, one, one), WriteError);
}

TEST_F(CheckedTrajectories, WithoutChecksItIsThePluginsOwnObject) {
  const std::shared_ptr<void> own(bad, static_cast<Trajectory*>(bad.get()));
  EXPECT_EQ(checked("trajectory", "lift", own, PluginChecks::none).get(), own.get());
}

/// |x|^2 / 2, which fails on demand.
class Bowl final : public Objective {
 public:
  std::function<void()> before = [] {};
  Index dim() const override { return 2; }
  ObjectiveCapabilities capabilities() const override { return {.gradients = true}; }
  Evaluation evaluate(ConstMatrix x, const std::vector<Index>&, const EvaluationRequest&) override {
    before();
    return {.costs = 0.5 * x.colwise().squaredNorm().transpose(), .gradients = x};
  }
};

/// Evaluates the starts, or what it is told to, and returns them, or what it is told to.
class OneShot final : public Optimiser {
 public:
  std::function<void(Matrix& x, std::vector<Index>& instances)> ask = [](Matrix&, std::vector<Index>&) {};
  std::function<void(std::vector<OptimiserResult>& results)> answer = [](std::vector<OptimiserResult>&) {};
  OptimiserCapabilities capabilities() const override { return {}; }
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box&, ConstVec,
                                        const OptimiserOptions&, const OptimiserObserver& observer) const override {
    Matrix x = starts;
    std::vector<Index> instances;
    for (Index i = 0; i < x.cols(); ++i) instances.push_back(i);
    ask(x, instances);
    const Evaluation e = objective.evaluate(x, instances, {});
    observer(0, e.costs);
    std::vector<OptimiserResult> results;
    for (Index i = 0; i < starts.cols(); ++i)
      results.push_back({.status = OptimiserStatus::converged, .x = starts.col(i), .cost = e.costs[i]});
    answer(results);
    return results;
  }
};

struct CheckedOptimisers : testing::Test {
  std::shared_ptr<OneShot> bad = std::make_shared<OneShot>();
  std::shared_ptr<Optimiser> optimiser = checked("shot", std::shared_ptr<Optimiser>(bad), PluginChecks::all);
  Bowl bowl;
  std::vector<OptimiserResult> run(const OptimiserObserver& observer = [](Index, const Vector&) { return true; }) {
    const Step segment("segment", 3);
    const Step step("planning");
    return optimiser->minimise(bowl, Matrix::Constant(2, 3, 0.5), {Vector::Zero(2), Vector::Ones(2)}, Vector::Ones(2),
                               {}, observer);
  }
  std::string message() {
    return message_of<Error>([&] { run(); });
  }
};

TEST_F(CheckedOptimisers, PassOnWhatIsRight) {
  const auto results = run();
  ASSERT_EQ(results.size(), 3u);
  EXPECT_EQ(results[2].cost, 0.25);
}

TEST_F(CheckedOptimisers, WhatTheyAskForIsChecked) {
  const std::string who = "optimiser shot, planning, segment 3: ";
  bad->ask = [](Matrix& x, std::vector<Index>&) { x = Matrix::Zero(1, 3); };
  EXPECT_THAT(message(), StartsWith(who + "a point x that it evaluates has size 1, must have 2"));
  bad->ask = [](Matrix& x, std::vector<Index>&) { x(1, 1) = kNaN; };
  EXPECT_THAT(message(), StartsWith(who + "a point x that it evaluates is not finite"));
  bad->ask = [](Matrix& x, std::vector<Index>&) { x(1, 1) = 1.5; };
  EXPECT_THAT(message(), StartsWith(who + "a point x that it evaluates is out of bounds"));
  bad->ask = [](Matrix&, std::vector<Index>& instances) { instances = {0, 2, 1}; };
  EXPECT_THAT(message(), StartsWith(who + "it evaluates instance 1, must ascend in [0, 2]"));
  bad->ask = [](Matrix&, std::vector<Index>& instances) { instances.pop_back(); };
  EXPECT_THAT(message(), HasSubstr("has size 2, must have 3"));
}

TEST_F(CheckedOptimisers, WhatTheyReturnIsChecked) {
  const std::string who = "optimiser shot, planning, segment 3: ";
  bad->answer = [](std::vector<OptimiserResult>& r) { r.pop_back(); };
  EXPECT_THAT(message(), StartsWith(who + "the list of results from minimise() has size 2, must have 3"));
  bad->answer = [](std::vector<OptimiserResult>& r) { r[1].x.resize(0); };
  EXPECT_THAT(message(), StartsWith(who + "x of a result from minimise() has size 0, must have 2"));
  bad->answer = [](std::vector<OptimiserResult>& r) { r[1].cost = kNaN; };
  EXPECT_THAT(message(), StartsWith(who + "the cost of a result from minimise() is NaN"));
  bad->answer = [](std::vector<OptimiserResult>& r) { r[1].status = static_cast<OptimiserStatus>(99); };
  EXPECT_THAT(message(), StartsWith(who + "the status of a result"));
}

TEST_F(CheckedOptimisers, AreNotBlamedForTheObjectiveOrTheObserver) {
  bowl.before = [] { throw Diverged("the cloth flew away"); };
  EXPECT_EQ(message_of<Diverged>([&] { run(); }), "the cloth flew away");
  bowl.before = [] {};
  EXPECT_EQ(message_of<Error>([&] { run([](Index, const Vector&) -> bool { throw Error("enough"); }); }), "enough");
}

TEST(CheckedSimulators, AConfigErrorOfResetIsTheUsers) {
  class Picky final : public SimulatorBase {
   public:
    Picky() : SimulatorBase("picky") {}
    SimulatorCapabilities capabilities() const override { return {}; }

   protected:
    void start() override { throw ConfigError("fabric.yaml:3: friction = 7, must be below 1"); }
    void advance_frame(const Positions&, double, Positions&, Positions&) override {}
  };
  const auto simulator = checked("picky", std::shared_ptr<Simulator>(std::make_shared<Picky>()), PluginChecks::all);
  const auto garment =
      std::make_shared<Garment>(make_garment({.positions = Positions::Random(3, 3),
                                              .faces = Faces{{0, 1, 2}},
                                              .rest = RestPositions{{0.0, 0.0}, {1.0, 0.0}, {0.0, 1.0}}},
                                             "triangle", {}));
  EXPECT_EQ(message_of<ConfigError>([&] { simulator->reset(garment, Fabric(), Scene()); }),
            "fabric.yaml:3: friction = 7, must be below 1");
}

}  // namespace
}  // namespace weft
