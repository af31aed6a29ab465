// Plans and estimates that the simulator corrects.
#include <atomic>
#include <cmath>
#include <numeric>

#include "session/estimate_corrector.hpp"
#include "session/plan_chain.hpp"
#include "session/shape_filter.hpp"
#include "session/towel_session.hpp"
#include "session/twin.hpp"
#include "simulation/fold.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

using testing::Each;
using testing::HasSubstr;

/// A session whose predictor is wrong by millimetres, as a network is: another simulator.
const std::vector<std::string> kWrong = {
    "predictor={plugin: rollout, params: {simulator: {plugin: bullet}}}", "goal.controls=[2.3, 0, 0.1, 0, 0]",
    "planning={instances: 2, iterations: 4, replan_iterations: 1, horizon: 12}", "true_material=[0.4, 0.6, 0.5, 0.5]"};

class Correction : public Session {
 protected:
  SessionResult corrected(const std::vector<std::string>& more = {}, int threads = 2) {
    return run(with(with(kWrong, {"correction={simulations: 5, iterations: 3, later_simulations: 2}"}), more), threads);
  }
};

TEST_F(Correction, BringsASessionCloserToItsGoal) {
  const SessionResult plain = run(kWrong), result = corrected();
  EXPECT_TRUE(result.released);
  EXPECT_LT(result.error_mm, 0.6 * plain.error_mm);
  const auto& first = result.rounds.front().correction;
  ASSERT_TRUE(first);
  ASSERT_LE(first->steps.size(), 5u);
  EXPECT_TRUE(first->steps.front().is_candidate);
  EXPECT_EQ(first->forecast_mm, first->steps.front().error_mm);
  // The plan in force is the best of those simulated.
  double best = std::numeric_limits<double>::infinity();
  for (const auto& step : first->steps) {
    EXPECT_EQ(step.best, step.loss < best);
    best = std::min(best, step.loss);
  }
  EXPECT_EQ(result.rounds.front().plan.loss, best);
  // The twin has the true material, so what it forecasts is what happens.
  EXPECT_NEAR(result.rounds.back().plan.predicted_error_mm, result.error_mm, 0.02);
  EXPECT_LT(result.error_mm, first->corrected_mm + 0.02);
}

TEST_F(Correction, SameBitsWhateverTheNumberOfThreads) {
  const SessionResult one = corrected({}, 1), two = corrected({}, 2);
  ASSERT_EQ(one.rounds.size(), two.rounds.size());
  EXPECT_EQ(one.final_shape, two.final_shape);
  for (std::size_t j = 0; j < one.rounds.size(); ++j)
    EXPECT_EQ(one.rounds[j].plan.controls, two.rounds[j].plan.controls) << j;
}

TEST_F(Correction, StartsFromTheForecastOfTheSegmentInWhichItIsReady) {
  for (const Index lag : {0, 1, 3}) {
    const SessionResult result = corrected({"correction.lag=" + std::to_string(lag)});
    Index count = 0;
    for (std::size_t j = 1; j < result.rounds.size(); ++j) {
      const auto& correction = result.rounds[j].correction;
      if (!correction) continue;
      ++count;
      EXPECT_EQ(correction->started + lag, static_cast<Index>(j));
      // The forecast at the true material is exact: the plan in force is simulated as it was before.
      EXPECT_NEAR(correction->forecast_mm, result.rounds[j - 1].plan.predicted_error_mm, 0.02) << lag << ", " << j;
    }
    EXPECT_GE(count, 1) << lag;
  }
}

TEST_F(Correction, ADroppedOneLeavesThePlanInForceAndIsRepeatedWithoutAClock) {
  // No correction takes less than a nanosecond, so all later ones are dropped.
  const SessionResult late = corrected({"correction.time_budget_s=1e-9"});
  ASSERT_FALSE(late.dropped_corrections.empty());
  const auto& first = late.rounds.front().plan.controls;
  for (std::size_t j = 1; j < late.rounds.size(); ++j) {
    const auto& plan = late.rounds[j].plan.controls;
    EXPECT_EQ(plan, first.bottomRows(plan.rows())) << j;
  }
  std::string dropped;
  for (const Index segment : late.dropped_corrections)
    dropped += (dropped.empty() ? "" : ", ") + std::to_string(segment);
  const SessionResult again = corrected({"correction.dropped=[" + dropped + "]"});
  EXPECT_EQ(again.final_shape, late.final_shape);
  EXPECT_EQ(again.dropped_corrections, late.dropped_corrections);
}

TEST_F(Correction, WaitsUntilTheMaterialIsKnown) {
  const auto wide = corrected({"knowledge=given", "given_centre=[0.5, 0.5, 0.5, 0.5]", "given_width=[1, 1, 0.1, 0.1]",
                               "correction.max_width=0.5"});
  for (const auto& round : wide.rounds) EXPECT_TRUE(!round.correction || round.correction->steps.empty());
  const auto narrow = corrected({"knowledge=given", "given_centre=[0.4, 0.6, 0.5, 0.5]",
                                 "given_width=[0.5, 0.5, 0.1, 0.1]", "correction.max_width=0.5"});
  EXPECT_FALSE(narrow.rounds.front().correction->steps.empty());
}

TEST_F(Correction, APlanThatDoesNotReleaseIsFollowedByAnother) {
  const SessionResult result =
      corrected({"planning={instances: 1, iterations: 0, replan_iterations: 0, horizon: 3, leeway: 0}"});
  EXPECT_FALSE(result.rounds.front().plan.releases);
  EXPECT_GT(result.rounds.size(), 3u);
  EXPECT_TRUE(result.released);
}

TEST_F(Correction, TheNetworkPlansAgainUntilTheFirstCorrection) {
  const SessionResult result = corrected({"knowledge=given", "given_centre=[0.5, 0.5, 0.5, 0.5]",
                                          "given_width=[1, 1, 1, 1]", "correction.later_simulations=0"});
  Index plans = 0;
  for (const auto& round : result.rounds) plans += round.plan.evaluations > 0 ? 1 : 0;
  EXPECT_GT(plans, 2);
}

TEST_F(Correction, TheTwinFollowsAClothThatItDoesNotKnow) {
  // It believes in another fabric. Pulled to what is seen, it forecasts the next shapes better than from the start alone.
  const std::vector<std::string> mistaken = {"knowledge=given", "given_centre=[0.4, 0.3, 0.8, 0.5]",
                                             "given_width=[0.1, 0.1, 0.1, 0.1]"};
  const auto errors = [&](const SessionResult& result) {
    double sum = 0.0;
    for (std::size_t j = 3; j + 1 < result.rounds.size(); ++j)
      sum += mean_distance_mm(result.rounds[j].plan.shapes.front().mean, result.rounds[j].observed);
    return sum / static_cast<double>(result.rounds.size() - 4);
  };
  const double pulled = errors(corrected(mistaken));
  const double never_pulled = errors(corrected(with(mistaken, {"correction.later_simulations=0"})));
  EXPECT_GT(never_pulled, 1.0);
  EXPECT_LT(pulled, 0.6 * never_pulled);
}

TEST_F(Correction, TrialsLearnWhatTheSimulationMisses) {
  // Planner and twin believe in another fabric, and nobody estimates it.
  const std::vector<std::string> mistaken = {"knowledge=given",
                                             "given_centre=[0.4, 0.45, 0.6, 0.5]",
                                             "given_width=[0.1, 0.1, 0.1, 0.1]",
                                             "predictor={plugin: rollout}",
                                             "planning.iterations=2",
                                             "planning.instances=1"};
  double first = 0.0, last = 0.0;
  for (const char* goal : {"[2.3, 0, 0.1, 0, 0]", "[2, 0, -0.1, 0.0003, 0]"}) {
    const auto asked = with(mistaken, {std::string("goal.controls=") + goal, "trials=3"});
    const SessionResult result = corrected(asked);
    ASSERT_EQ(result.trials.size(), 3u);
    for (const auto& trial : result.trials) EXPECT_TRUE(trial.released);
    EXPECT_EQ(result.trials.back().error_mm, result.error_mm);
    EXPECT_EQ(result.trials.front().error_mm, corrected(with(asked, {"trials=1"})).error_mm)
        << "nothing is known before";
    first += result.trials.front().error_mm;
    last += result.trials.back().error_mm;
  }
  EXPECT_GT(first, 2.0);
  EXPECT_LT(last, 0.6 * first);
}

TEST_F(Correction, AStoppedSessionKeepsWhatWasExecuted) {
  // Stopped while its estimates are corrected: with one thread they are computed after the signal.
  const auto settings = with(kEstimate, {"estimation.correction.simulations=6", "correction={simulations: 2}"});
  ConfigNode config = ConfigNode::load(folder_ / "task.yaml");
  for (const auto& assignment : settings) config = apply_override(config, assignment);
  SessionParams params;
  read_params(config, params);
  for (const Index last : {0, 1}) {
    std::atomic<bool> stop = false;
    HostOptions options{.threads = 1, .seed = 4};
    options.cancel = &stop;
    const auto host = make_host(std::make_shared<PluginRegistry>(), options);
    const SessionResult result = run_configured_session(
        params, config, *host, [&](const SessionRound&, Index number, double) { stop = number == last; });
    EXPECT_FALSE(result.released);
    EXPECT_EQ(std::ssize(result.rounds), last + 1);
    EXPECT_EQ(result.estimates.size(), result.rounds.size());
    EXPECT_TRUE(result.final_shape.allFinite());
  }
}

TEST_F(Correction, ASecondTrialIsPlannedWithWhatTheFirstOneShowed) {
  // One plan is simulated: not the one of the trial before, which knew nothing.
  const auto settings = with(kEstimate, {"correction={simulations: 1, later_simulations: 0, max_width: 1}",
                                         "planning.replan=false", "planning.iterations=4"});
  const SessionResult one = run(settings), two = run(with(settings, {"trials=2"}));
  EXPECT_EQ(two.trials.front().error_mm, one.error_mm);
  EXPECT_LT(two.rounds.front().knowledge.width.mean(), one.rounds.front().knowledge.width.mean());
  EXPECT_NE(two.rounds.front().plan.controls, one.rounds.front().plan.controls);
}

TEST_F(Correction, TrialsThatWouldLearnNothingAreRefused) {
  EXPECT_THAT(test::message_of<ConfigError>([&] { run({"trials=2"}); }), HasSubstr("nothing would be learned"));
  EXPECT_THAT(test::message_of<ConfigError>([&] {
                corrected({"trials=2", "correction.time_budget_s=1"});
              }),
              HasSubstr("1 with a time budget"));
}

TEST_F(Session, EstimatesByTheSimulatorFindTheMaterial) {
  const std::vector<std::string> wrong =
      with(with(kWrong, kEstimate),
           {"planning.horizon=8", "predictor={plugin: rollout, params: {simulator: {plugin: bullet}, sigma_m: 0.001}}",
            "estimation.correction={simulations: 12, later_simulations: 5, segments: 2}"});
  const SessionResult result = run(wrong);
  ASSERT_GE(result.estimates.size(), 3u);
  EXPECT_FALSE(result.estimates.front().corrected);
  const Estimate& last = result.estimates.back();
  ASSERT_TRUE(last.corrected);
  EXPECT_LT((*last.corrected - *result.true_material).cwiseAbs().maxCoeff(), 0.02);
  EXPECT_LT(last.residual_mm, 0.1);
  EXPECT_LE(last.simulations, 5);
  // The interval is as wide as the declared error of the model at least.
  EXPECT_GT(last.knowledge.width.minCoeff(), 0.02);
  const SessionResult again = run(wrong, 1);
  EXPECT_EQ(again.estimates.back().knowledge.centre, last.knowledge.centre);
}

TEST_F(Session, EstimatesByTheSimulatorKnowNothingOfWhatTheyCannotSee) {
  const SessionResult result =
      run(with(with(kWrong, kEstimate), {"planning.horizon=8", "max_segments=1", "observation={noise_m: 0.3}",
                                         "estimation.correction={simulations: 4, later_simulations: 2, segments: 1}"}));
  const auto& width = result.estimates.front().knowledge.width;
  for (const Index p : {0, 1, 2}) EXPECT_GT(width(p), 0.9) << p;
}

class TwinOfATowel : public Session {
 protected:
  TwinOfATowel() { run({"planning={instances: 1, iterations: 0, replan_iterations: 0}"}); }
};

TEST_F(TwinOfATowel, FoldsAsTheSimulatorDoesFromAnySegment) {
  const Task cloth = task();
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  const Twin twin(cloth, {}, *host);
  const MaterialProperties q = MaterialProperties::Constant(0.3), other = MaterialProperties::Constant(0.7);
  const Controls controls = cloth.trajectory->default_controls(14);
  const FoldResult whole = simulate_fold(*host->create<Simulator>(cloth.simulator), cloth, q, controls);
  const FoldResult twins = twin.fold(twin.start(q), controls);
  EXPECT_EQ(twins.shapes.back(), whole.shapes.back());
  EXPECT_EQ(twins.segments, whole.segments);
  // A simulator that was busy with another fabric in between.
  TwinState state = twin.start(q);
  for (Index j = 0; j < 3; ++j) state = twin.advance(state, controls.row(j).transpose());
  EXPECT_EQ(state.positions, whole.shapes[3]);
  EXPECT_NE(twin.fold(twin.start(other), controls).shapes.back(), whole.shapes.back());
  EXPECT_EQ(twin.fold(state, controls.bottomRows(controls.rows() - 3)).shapes.back(), whole.shapes.back());
}

TEST_F(TwinOfATowel, ASequenceThatGetsLongerHasTheShapesOfTheWhole) {
  const Task cloth = task();
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  const Twin twin(cloth, {}, *host);
  const MaterialProperties q = MaterialProperties::Constant(0.3);
  const Controls controls = cloth.trajectory->default_controls(14);
  const FoldResult whole = simulate_fold(*host->create<Simulator>(cloth.simulator), cloth, q, controls);
  TwinSequence sequence = twin.sequence(q, controls.topRows(1));
  for (Index k = 2; k <= whole.segments; ++k) {
    ASSERT_TRUE(sequence.goes_on());
    twin.sequence(MaterialProperties::Constant(0.7), controls.topRows(2));  // the simulator is busy in between
    sequence = twin.longer(std::move(sequence), controls.topRows(k));
  }
  EXPECT_TRUE(sequence.released);
  EXPECT_FALSE(sequence.goes_on());
  ASSERT_EQ(std::ssize(sequence.shapes), whole.segments);
  for (Index k = 0; k < whole.segments; ++k) EXPECT_EQ(sequence.shapes[k], whole.shapes[k + 1]);
}

TEST_F(TwinOfATowel, IsPulledToWhatIsSeenAndNotToItsNoise) {
  const Task cloth = task();
  const Garment& garment = *cloth.garment;
  const Index n = garment.vertex_count();
  const ShapeFilter filter(garment);
  // The real cloth differs by a smooth field of 4 mm.
  const Positions& simulated = garment.positions;
  Positions real = simulated;
  for (Index v = 0; v < n; ++v) real(v, 2) += 0.004 * std::cos(6.0 * simulated(v, 0));
  const auto rms = [&](const Positions& shape) {
    return std::sqrt((shape - real).squaredNorm() / static_cast<double>(n));
  };
  // Without noise it is met where it is seen, and guessed where not.
  Observation seen{.positions = real, .observed = std::vector<bool>(n, true)};
  EXPECT_LT(rms(filter.pulled(simulated, seen, {})), 1e-6);
  for (Index v = 0; v < n; v += 3) seen.observed[v] = false;
  EXPECT_LT(rms(filter.pulled(simulated, seen, {})), 0.0008);
  // With noise it keeps the field and loses the noise.
  RandomStream random(7, 1);
  seen.sigma = 0.002;
  for (Index k = 0; k < seen.positions.size(); ++k) seen.positions.data()[k] += seen.sigma * random.normal();
  EXPECT_LT(rms(filter.pulled(simulated, seen, {})), 0.0025);
  EXPECT_GT(rms(seen.positions), 0.0028);
  // A simulation that is right is left alone; held vertices stay.
  Observation noise{.positions = simulated, .observed = {}, .sigma = 0.002, .height_sigma = 0.0};
  for (Index k = 0; k < noise.positions.size(); ++k) noise.positions.data()[k] += noise.sigma * random.normal();
  EXPECT_LT(std::sqrt((filter.pulled(simulated, noise, {}) - simulated).squaredNorm() / static_cast<double>(n)),
            0.0012);
  const Positions held = filter.pulled(simulated, seen, {0, 5});
  EXPECT_LT((held.row(0) - simulated.row(0)).norm(), 1e-6);
  EXPECT_LT((held.row(5) - simulated.row(5)).norm(), 1e-6);
}

}  // namespace
}  // namespace weft
