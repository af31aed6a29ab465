// Whole sessions on a coarse towel, with the plugins that ship.
#include <cmath>
#include <nlohmann/json.hpp>

#include "session/replay.hpp"
#include "session/session_file.hpp"
#include "session/towel_session.hpp"
#include "unit/gltf_sheet.hpp"
#include "weft/hdf5_file.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

static_assert(stream_key("goal") == 0x676f616c);

TEST_F(Session, ComesCloserToTheGoalThanTheDefaultControl) {
  const SessionResult result = run();
  EXPECT_TRUE(result.released);
  EXPECT_GE(result.default_error_mm, 20.0);
  EXPECT_LT(result.error_mm, 0.7 * result.default_error_mm);
  EXPECT_LE(result.rounds.size(), 14u);
  // The start, the executed segments, the settling.
  EXPECT_GT(result.settle.frames, 6);
  EXPECT_EQ(static_cast<Index>(result.frames.size()),
            1 + static_cast<Index>(result.rounds.size()) * kFramesPerSegment + result.settle.frames);
}

TEST_F(Session, SameSeedSameBitsWhateverTheNumberOfThreads) {
  const SessionResult one = run({}, 1), two = run({}, 2);
  EXPECT_EQ(one.final_shape, two.final_shape);
  EXPECT_EQ(one.error_mm, two.error_mm);
  ASSERT_EQ(one.rounds.size(), two.rounds.size());
  for (std::size_t i = 0; i < one.rounds.size(); ++i) {
    EXPECT_EQ(one.rounds[i].plan.controls, two.rounds[i].plan.controls) << i;
    EXPECT_EQ(one.rounds[i].plan.losses, two.rounds[i].plan.losses) << i;
  }
}

TEST_F(Session, WithoutReplansTheFirstPlanIsExecutedToItsEnd) {
  // Another fabric than the planner believes in, so that a re-plan would change the plan.
  const std::vector<std::string> mistaken = {"knowledge=given", "given_centre=[0.9, 0.1, 0.5, 0.5]",
                                             "given_width=[0, 0, 0, 0]", "true_material=[0.2, 0.9, 0.4, 0.6]"};
  auto open = mistaken;
  open.push_back("planning.replan=false");
  for (const bool is_corrected : {false, true}) {
    auto settings = open;
    if (is_corrected) settings.push_back("correction={simulations: 3, later_simulations: 2}");
    const SessionResult result = run(settings);
    EXPECT_TRUE(result.released);
    EXPECT_EQ(result.rounds.front().correction.has_value(), is_corrected);
    const Controls& first = result.rounds.front().plan.controls;
    ASSERT_EQ(first.rows(), static_cast<Index>(result.rounds.size()));
    for (Index j = 1; j < first.rows(); ++j) {
      EXPECT_EQ(result.rounds[j].plan.controls, first.bottomRows(first.rows() - j)) << j;
      EXPECT_FALSE(result.rounds[j].correction) << j;
    }
  }
  const SessionResult closed = run(mistaken);
  EXPECT_NE(closed.rounds.back().plan.controls, run(open).rounds.back().plan.controls);
}

TEST_F(Session, WithoutReplansAPlanThatEndsBeforeItReleasesIsFollowedByAnother) {
  const std::vector<std::string> settings = {"planning.replan=false", "planning.horizon=3", "planning.leeway=3"};
  auto corrected = settings;
  corrected.push_back("correction={simulations: 2}");
  const SessionResult plain = run(settings), other = run(corrected);
  ASSERT_GT(plain.rounds.size(), 3u);
  ASSERT_GT(other.rounds.size(), 3u);
  // Only plans that release are corrected, so the second plan is the same with corrections.
  EXPECT_EQ(other.rounds[3].plan.controls, plain.rounds[3].plan.controls);
}

TEST_F(Session, PropertiesCanBeUnknownOneByOne) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.replan_iterations=0",
                                          "planning.instances=1", "true_material=[0.2, 0.9, 0.4, 0.6]"};
  const auto knowledge = [&](const std::string& more) {
    auto all = quick;
    all.push_back(more);
    return run(all).rounds.front().knowledge;
  };
  const MaterialKnowledge some = knowledge("unknown=[bend, thickness]");
  EXPECT_EQ(some.centre, (PropertyVector() << 0.2, 0.5, 0.4, 0.5).finished());
  EXPECT_EQ(some.width, (PropertyVector() << 0, 1, 0, 1).finished());
  EXPECT_EQ(knowledge("unknown=[]").width, PropertyVector::Zero());
  EXPECT_THAT(test::message_of<ConfigError>([&] { run({"unknown=[bending]"}); }),
              testing::AllOf(testing::HasSubstr("unknown"), testing::HasSubstr("nearest: bend")));
  EXPECT_THAT(test::message_of<ConfigError>([&] {
                run({"unknown=[bend]", "knowledge=none"});
              }),
              testing::HasSubstr("left out with knowledge: none"));
}

TEST_F(Session, ASecondTrialBeginsWithTheEstimateOfTheFirst) {
  const std::vector<std::string> settings = {"knowledge=estimate", "planning.replan=false", "estimation.instances=1",
                                             "estimation.iterations=3"};
  auto two = settings;
  two.push_back("trials=2");
  const SessionResult first = run(settings), second = run(two);
  EXPECT_EQ(first.rounds.front().knowledge.width, MaterialKnowledge::none().width);
  EXPECT_EQ(second.rounds.front().knowledge.centre, first.estimates.back().knowledge.centre);
  EXPECT_EQ(second.rounds.front().knowledge.width, first.estimates.back().knowledge.width);
  ASSERT_EQ(second.trials.size(), 2u);
  EXPECT_EQ(second.trials.front().error_mm, first.error_mm);
}

TEST_F(Session, AnotherSeedIsAnotherGoalAndAnotherFabric) {
  const SessionResult a = run({"planning.iterations=0", "planning.replan_iterations=0"});
  const SessionResult b = run({"planning.iterations=0", "planning.replan_iterations=0", "seed=5"});
  EXPECT_NE(a.goal, b.goal);
  EXPECT_NE(a.true_material.value(), b.true_material.value());
}

TEST_F(Session, AnotherPlanningHorizonIsNoOtherGoal) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.replan_iterations=0",
                                          "planning.instances=1"};
  auto longer = quick, other = quick;
  longer.push_back("planning.horizon=20");
  other.push_back("goal.horizon=12");
  const SessionResult a = run(quick), b = run(longer), c = run(other);
  EXPECT_EQ(a.goal, b.goal);
  EXPECT_EQ(a.default_shape, b.default_shape);
  EXPECT_NE(a.goal, c.goal);
}

TEST_F(Session, HorizonFollowsThePaper) {
  const SessionResult result = run({"planning.iterations=0", "planning.replan_iterations=0", "planning.instances=1"});
  EXPECT_EQ(result.rounds[0].plan.horizon, 14);
  for (std::size_t i = 1; i < result.rounds.size(); ++i) {
    // The preceding plan minus its executed segment, plus the leeway of 5.
    const Index before = result.rounds[i - 1].plan.controls.rows() - 1;
    EXPECT_EQ(result.rounds[i].plan.horizon, std::max<Index>(1, before) + 5);
  }
  EXPECT_LT(result.rounds.back().plan.controls.rows(), 2);  // the executed segment was the one that released
}

TEST_F(Session, GoalsByControlsByObjAndByRecordedSession) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.replan_iterations=0",
                                          "planning.instances=1"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.end(), quick.begin(), quick.end());
    return run(more);
  };
  // The default control reaches exactly the goal that it made.
  const SessionResult by_controls = with({"goal.controls=[2, 0, 0, 0, 0]"});
  EXPECT_EQ(by_controls.default_error_mm, 0.0);
  EXPECT_EQ(by_controls.error_mm, 0.0);
  const Task same = task();
  const Garment& garment = *same.garment;
  write_obj(folder_ / "goal.obj", {by_controls.goal, garment.faces, garment.rest, "goal"}, true);
  const SessionResult by_obj = with({"goal.obj=" + (folder_ / "goal.obj").string()});
  EXPECT_EQ(by_obj.goal, by_controls.goal);
  write_session(folder_ / "session.h5", by_controls, task(), resolved_, "{}");
  const SessionResult by_example = with({"goal.example=" + (folder_ / "session.h5").string()});
  EXPECT_EQ(by_example.goal, by_controls.final_shape);
}

/// Goals whose points are not the garment's.
class GoalWithoutCorrespondence : public Session {
 protected:
  SessionResult folded(std::vector<std::string> more) {
    more.insert(more.begin(), {"planning={instances: 2, iterations: 6, replan_iterations: 1, horizon: 12}",
                               "true_material=[0.4, 0.6, 0.5, 0.5]"});
    return run(more);
  }
  /// What a session makes of a goal that other controls reach, as a mesh whose vertices have other numbers.
  std::string mesh() {
    const SessionResult made =
        folded({"goal.controls=[2.3, 0, 0.1, 0, 0]", "planning.iterations=0", "planning.replan_iterations=0"});
    const Task cloth = task();
    const Index n = made.goal.rows();
    Mesh mesh{.positions = made.goal.colwise().reverse(), .faces = cloth.garment->faces, .rest = {}, .source = ""};
    mesh.rest.resize(0, 2);
    for (Index k = 0; k < mesh.faces.size(); ++k) mesh.faces.data()[k] = static_cast<int>(n - 1 - mesh.faces.data()[k]);
    write_obj(folder_ / "other.obj", mesh, true);
    goal_ = made.goal;
    return "goal.mesh=" + (folder_ / "other.obj").string();
  }
  Positions goal_;
};

TEST_F(GoalWithoutCorrespondence, AMeshIsReachedByItsNearestPoints) {
  const std::string mesh = this->mesh();
  const SessionResult result = folded({mesh, "planning.loss=chamfer"});
  EXPECT_EQ(result.goal.rows(), 0);
  EXPECT_TRUE(std::isnan(result.error_mm));
  EXPECT_LT(result.chamfer_mm, 0.7 * result.default_chamfer_mm);
  EXPECT_LT(mean_distance_mm(result.final_shape, goal_), 0.7 * mean_distance_mm(result.default_shape, goal_));
  const auto summary = nlohmann::json::parse(session_summary_json(result));
  EXPECT_TRUE(summary["error_mm"].is_null());
  EXPECT_TRUE(summary["success_10mm"].is_null());
  EXPECT_EQ(summary["chamfer_mm"], result.chamfer_mm);
  EXPECT_EQ(summary["silhouette_iou"], result.errors.iou);
  // The file keeps the goal as it was given.
  write_session(folder_ / "session.h5", result, task(), resolved_, "{}");
  const SessionRecord record = read_session(folder_ / "session.h5");
  EXPECT_FALSE(record.has_correspondence);
  EXPECT_EQ(record.goal, result.surface->positions());
  EXPECT_EQ(record.goal_faces, result.surface->faces());
  EXPECT_NEAR(record.goal_distance_mm(result.final_shape), result.chamfer_mm, 1e-9);
}

TEST_F(GoalWithoutCorrespondence, CorrectionsGoByWhatTheGoalShows) {
  const std::string mesh = this->mesh();
  const SessionResult result =
      folded({mesh, "planning.loss=chamfer", "predictor={plugin: rollout, params: {simulator: {plugin: bullet}}}",
              "correction={simulations: 3, iterations: 3, later_simulations: 2}"});
  ASSERT_TRUE(result.rounds.front().correction.has_value());
  const auto& steps = result.rounds.front().correction->steps;
  EXPECT_GT(steps.size(), 1u);
  EXPECT_LE(result.rounds.front().correction->corrected_mm, result.rounds.front().correction->forecast_mm);
  EXPECT_LT(result.chamfer_mm, result.default_chamfer_mm);
}

TEST_F(GoalWithoutCorrespondence, ASimulatedGoalKeepsItsVertices) {
  const SessionResult result = folded({"goal.controls=[2.3, 0, 0.1, 0, 0]", "planning.loss=silhouette"});
  EXPECT_LT(result.error_mm, result.default_error_mm);
  EXPECT_LT(result.chamfer_mm, result.default_chamfer_mm);
  ASSERT_NE(result.surface, nullptr);
  EXPECT_EQ(result.surface->kind(), GoalKind::silhouette);
}

TEST_F(GoalWithoutCorrespondence, GltfHasItsUpAxisAlongY) {
  const std::filesystem::path file = folder_.write("goal.gltf", test::kGltfSheet);
  try {
    const SessionResult result = folded({"goal.mesh=" + file.string(), "planning.loss=chamfer", "planning.iterations=0",
                                         "planning.replan_iterations=0"});
    EXPECT_NEAR((result.surface->positions().col(2).array() - 1.0).abs().maxCoeff(), 0.0, 1e-6);
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("this build of weft reads OBJ only"));
  }
}

TEST_F(GoalWithoutCorrespondence, ALossThatCannotCompareIsRefused) {
  const std::string mesh = this->mesh();
  EXPECT_THAT([&] { folded({mesh}); },
              testing::ThrowsMessage<ConfigError>(testing::HasSubstr("use chamfer or silhouette")));
  EXPECT_THAT(
      [&] {
        folded({"goal.mask.file=" + folder_.write("mask.png", "").string(), "planning.loss=chamfer"});
      },
      testing::ThrowsMessage<ConfigError>(testing::HasSubstr("use silhouette")));
  EXPECT_THAT([&] { folded({"goal.mask.metres_per_pixel=0.002"}); },
              testing::ThrowsMessage<ConfigError>(testing::HasSubstr("goal.mask.file names the PNG")));
  EXPECT_THAT(
      [&] {
        folded({mesh, "planning.loss=chamfer", "planning.vertices=[1]"});
      },
      testing::ThrowsMessage<ConfigError>(testing::HasSubstr("which compares nearest points")));
  const std::string least_squares = "optimiser={plugin: ceres, params: {method: levenberg_marquardt}}";
  EXPECT_THAT(
      [&] {
        folded({mesh, "planning.loss=silhouette", least_squares});
      },
      testing::ThrowsMessage<Unsupported>(testing::HasSubstr("planning.loss = silhouette does not have")));
}

TEST_F(Session, EstimatesBesideTheSessionAndRepeatsBitForBit) {
  const SessionResult one = run(kEstimate, 1), two = run(kEstimate, 2);
  ASSERT_EQ(one.rounds.size(), two.rounds.size());
  ASSERT_EQ(one.estimates.size(), one.rounds.size());
  for (std::size_t i = 0; i < one.estimates.size(); ++i) {
    EXPECT_EQ(one.estimates[i].losses, two.estimates[i].losses) << i;
    EXPECT_EQ(one.estimates[i].knowledge.centre, two.estimates[i].knowledge.centre) << i;
    EXPECT_EQ(one.estimates[i].knowledge.width, two.estimates[i].knowledge.width) << i;
    EXPECT_EQ(one.rounds[i].plan.controls, two.rounds[i].plan.controls) << i;
  }
  EXPECT_EQ(one.final_shape, two.final_shape);
}

TEST_F(Session, APlanUsesTheEstimateThatItsLagAllows) {
  for (const Index lag : {0, 2}) {
    const SessionResult result = run(with(kEstimate, {"knowledge_lag=" + std::to_string(lag)}));
    ASSERT_GE(result.rounds.size(), 5u);
    for (std::size_t j = 0; j < result.rounds.size(); ++j) {
      const Index seen = static_cast<Index>(j) - lag;
      const MaterialKnowledge expected = seen <= 0 ? MaterialKnowledge::none() : result.estimates[seen - 1].knowledge;
      EXPECT_EQ(result.rounds[j].knowledge.centre, expected.centre) << lag << ", " << j;
      EXPECT_EQ(result.rounds[j].knowledge.width, expected.width) << lag << ", " << j;
    }
  }
}

TEST_F(Session, LearnsWhatTheClothShows) {
  // The predictor is the simulator of the fold itself, so only the estimator's own error remains.
  const SessionResult result =
      run({"knowledge=estimate", "true_material=[0.15, 0.85, 0.2, 0.75]", "planning.iterations=1",
           "goal.controls=[2.3, 0, 0.1, 0, 0]", "planning.replan_iterations=0", "planning.instances=1",
           "planning.horizon=8", "predictor={plugin: rollout, params: {sigma_m: 0.001}}",
           "estimation={instances: 2, iterations: 25, later_iterations: 5}", "knowledge_lag=0"});
  const auto& last = result.estimates.back().knowledge;
  const PropertyVector error = (last.centre - result.true_material.value()).cwiseAbs();
  for (Index p = 0; p < 4; ++p) EXPECT_LT(error(p), 0.12) << kPropertyNames[p];
  EXPECT_LT(last.width.mean(), 0.5 * result.estimates.front().knowledge.width.mean() + 0.1);
}

TEST_F(Session, SeesNoisyAndPartialShapesAndIsJudgedByTheTruth) {
  const std::vector<std::string> poor =
      with(kEstimate, {"observation={noise_m: 0.002, hidden_share: 0.3, lost_share: 0.2}"});
  const SessionResult one = run(poor, 1), two = run(poor, 2);
  ASSERT_EQ(one.rounds.size(), two.rounds.size());
  EXPECT_EQ(one.rounds.back().observed, two.rounds.back().observed);
  EXPECT_EQ(one.estimates.back().knowledge.width, two.estimates.back().knowledge.width);
  EXPECT_EQ(one.final_shape, two.final_shape);
  EXPECT_NE(one.rounds.back().observed, one.final_shape);
  EXPECT_EQ(one.error_mm, mean_distance_mm(one.final_shape, one.goal));
  // 56 % of the vertices are observed, to within the noise. The others are taken from the plan's prediction.
  std::vector<double> off;
  for (Index v = 0; v < one.final_shape.rows(); ++v)
    off.push_back((one.rounds.back().observed.row(v) - one.final_shape.row(v)).norm());
  std::nth_element(off.begin(), off.begin() + static_cast<std::ptrdiff_t>(off.size() / 2), off.end());
  EXPECT_LT(off[off.size() / 2], 0.012);
}

TEST_F(Session, HiddenVerticesStayHiddenAndNoiseIsAsLargeAsItSays) {
  const Task towel = (run({"planning.iterations=0", "planning.instances=1", "planning.replan_iterations=0"}), task());
  const auto registry = std::make_shared<PluginRegistry>();
  const auto host = make_host(registry, {.threads = 1});
  SimulatorEnvironment environment(host->create<Simulator>(towel.simulator), towel, PropertyVector::Constant(0.5),
                                   {.noise_m = 0.003, .hidden_share = 0.25, .lost_share = 0.25}, 9);
  const Index n = towel.garment->vertex_count();
  std::vector<int> times(n);
  double square = 0.0;
  constexpr int kLooks = 200;
  for (int k = 0; k < kLooks; ++k) {
    const Observation seen = environment.observe();
    EXPECT_EQ(seen.sigma, 0.003);
    for (Index v = 0; v < n; ++v) times[v] += seen.sees(v);
    square += (seen.positions - *environment.true_shape()).squaredNorm() / static_cast<double>(3 * n * kLooks);
  }
  EXPECT_NEAR(std::sqrt(square), 0.003, 1e-4);
  Index hidden = 0;
  for (const int t : times) {
    hidden += t == 0;
    if (t > 0) {
      EXPECT_NEAR(t, 0.75 * kLooks, 40);
    }
  }
  EXPECT_NEAR(static_cast<double>(hidden), 0.25 * static_cast<double>(n), 0.15 * static_cast<double>(n));
}

TEST(ObserveShape, AHeightBiasIsOnePerSessionAndAsLargeAsItSays) {
  const Positions flat = Positions::Constant(5, 3, 0.1);
  const ObservationParams params{.height_bias_m = 0.002};
  double square = 0.0;
  constexpr std::uint64_t kSessions = 400;
  for (std::uint64_t seed = 0; seed < kSessions; ++seed) {
    const Observation first = observe_shape(flat, params, seed, 0), later = observe_shape(flat, params, seed, 7);
    EXPECT_EQ(first.positions, later.positions);
    EXPECT_EQ(first.positions.leftCols(2), flat.leftCols(2));
    EXPECT_EQ(first.height_sigma, 0.002);
    EXPECT_EQ(first.positions.col(2).minCoeff(), first.positions.col(2).maxCoeff());
    square += std::pow(first.positions(0, 2) - 0.1, 2) / static_cast<double>(kSessions);
  }
  EXPECT_NEAR(std::sqrt(square), 0.002, 0.0002);
}

TEST_F(Session, DrawnKnowledgeHoldsTheTruth) {
  std::vector<std::string> quick = {"planning.iterations=0", "planning.instances=1", "planning.replan_iterations=0",
                                    "knowledge=drawn", "drawn_width=0.4"};
  const SessionResult result = run(quick);
  const auto& k = result.rounds.front().knowledge;
  EXPECT_EQ(k.width, PropertyVector::Constant(0.4));
  for (Index p = 0; p < 4; ++p) {
    EXPECT_LE(std::abs(k.centre(p) - (*result.true_material)(p)), 0.2);
    EXPECT_NE(k.centre(p), (*result.true_material)(p));
  }
}

TEST_F(Session, AnEstimateStartsFromThePrior) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.instances=1",
                                          "planning.replan_iterations=0", "knowledge=estimate"};
  const auto prior = with(quick, {"prior=drawn", "drawn_width=0.04"});
  const MaterialKnowledge drawn = run(with(prior, {"knowledge=drawn", "prior=none"})).rounds.front().knowledge;
  const SessionResult result = run(prior);
  EXPECT_EQ(result.rounds.front().knowledge.centre, drawn.centre);
  EXPECT_EQ(result.rounds.front().knowledge.width, drawn.width);
  // What is known never gets wider, and no search from nothing is closer to the truth after one segment.
  for (const auto& round : result.rounds) EXPECT_LE(round.knowledge.width.mean(), 0.04 + 1e-12);
  const auto deviation = [](const SessionResult& r) {
    return (r.estimates.front().posterior->mode - *r.true_material).cwiseAbs().mean();
  };
  EXPECT_LT(deviation(result), deviation(run(quick)));
  // A second fold does not forget it, and estimates alone start from it.
  const auto sure = with(quick, {"prior=drawn", "drawn_width=0.001"});
  for (const auto& round : run(with(sure, {"trials=2"})).rounds) EXPECT_LE(round.knowledge.width.mean(), 0.001 + 1e-12);
  const auto alone = [&](const std::vector<std::string>& overrides) {
    ConfigNode config = ConfigNode::load(folder_ / "task.yaml");
    for (const auto& assignment : with(overrides, {"estimation={instances: 1, iterations: 1, later_iterations: 0}"}))
      config = apply_override(config, assignment);
    SessionParams params;
    read_params(config, params);
    const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
    return estimate_alone(params, config, nullptr, *host).estimates.front().posterior->mode;
  };
  EXPECT_NE(alone(prior), alone(quick));
  const auto given = run(with(quick, {"prior=given", "given_centre=[0.2, 0.3, 0.4, 0.5]",
                                      "given_width=[0.1, 0.2, 0.3, 0.4]", "unknown=[stretch]"}));
  EXPECT_EQ(given.rounds.front().knowledge.centre, MaterialProperties(0.2, 0.3, 0.5, 0.5));
  EXPECT_EQ(given.rounds.front().knowledge.width, PropertyVector(0.1, 0.2, 1.0, 0.4));
}

TEST_F(Session, RefusesBadGoalsAndMaterialsBeforeAnyWork) {
  const auto message = [&](const std::vector<std::string>& overrides) {
    return test::message_of<ConfigError>([&] { run(overrides); });
  };
  // A simulator that cannot start: bad goals and materials are refused before it is asked to.
  const std::string broken = "simulator={plugin: cloth, params: {min_substeps: 1, max_substeps: 1}}";
  EXPECT_THAT(message({broken}), testing::HasSubstr("max_substeps"));
  const auto points = folder_.write("point.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").string();
  const std::pair<std::vector<std::string>, std::string> cases[] = {
      {{"true_material=[0.5, 0.5]"}, "--set: true_material = [0.5, 0.5], must be a list of 4 numbers"},
      {{"goal.material=[1]"}, "--set: goal.material = [1], must be a list of 4 numbers"},
      {{"estimation.deviation_scale=[1, 2]"}, "--set: estimation.deviation_scale = [1, 2], must be a list of 4"},
      {{"knowledge=given"}, "--set: knowledge = given, which needs given_centre and given_width"},
      {{"knowledge=estimate", "prior=given"}, "--set: prior = given, which needs given_centre and given_width"},
      {{"knowledge=none", "prior=drawn"}, "--set: prior = drawn, must be left out with knowledge: none; only estimate"},
      {{"knowledge=given", "given_centre=[1]"}, "--set: given_centre = [1], must be a list of 4 numbers"},
      {{"scene.gravity_m_per_s2=[-9.81]"}, "--set: scene.gravity_m_per_s2 = [-9.81], must be a list of 3 numbers"},
      {{"planning.vertices=[99999]"}, "--set: planning.vertices.0 = 99999, must be a vertex in [0, "},
      {{"planning.vertex_weights=[1]"}, "--set: planning.vertex_weights has 1 numbers, must have "},
      {{"manipulation.grasp=[left_top]"}, "--set: manipulation.grasp = [left_top], must be 2 named vertices"},
      {{"trajectory={plugin: drag, params: {hands: 1}}"}, "], must be 1 named vertex: the trajectory drives 1 hand"},
      {{"manipulation.grasp=[left_botom, left_top]"}, "--set: manipulation.grasp.0 = left_botom: garment towel: "},
      {{"manipulation.displacement_m=[1]"}, "--set: manipulation.displacement_m = [1], must be a list of 2 numbers"},
      {{"manipulation.displacement_m=[0, 0]"}, "--set: manipulation.displacement_m = [0, 0]: arc: |d| = 0 m"},
      {{"predictor=null"}, ": predictor = nothing, must be a predictor plugin"},
      {{"goal.controls=[1, 2]"}, "goal.controls has 2 numbers, must have 5"},
      {{"goal.controls=[99, 0, 0, 0, 0]"}, "--set: goal.controls.0 = 99, must be in [0.5, 4] deg/frame (dtheta)"},
      {{"goal.controls=[[2, 0, 0, 0, 0], [2, 0, -9, 0, 0]]"}, "--set: goal.controls.1.2 = -9, must be in ["},
      {{"goal.controls=[2, 0, 0, 0, 0]", "goal.obj=x.obj"},
       "--set: goal.controls is given together with goal.obj; give at most one"},
      {{"goal.obj=/none.obj"}, "--set: goal.obj = /none.obj: /none.obj: no such file"},
      {{"goal.obj=" + points}, ": has 3 vertices, must have the garment's "},
      {{"goal.example=/none.h5"}, "--set: goal.example = /none.h5: /none.h5: does not exist"},
  };
  for (const auto& [overrides, expected] : cases)
    EXPECT_THAT(message(with(overrides, {broken})), testing::HasSubstr(expected)) << overrides.front();
  EXPECT_THAT(message({"manipulation.displacement_m=[0, 0]"}), testing::HasSubstr("`weft displacement`"));
}

TEST_F(Session, SessionFileHoldsWhatTheSummarySays) {
  const SessionResult result = run({"planning.iterations=1"});
  write_session(folder_ / "session.h5", result, task(), resolved_, "{}");
  const auto file = Hdf5File::open(folder_ / "session.h5");
  EXPECT_EQ(file.read_positions("/final_shape"), result.final_shape);
  EXPECT_EQ(file.list("/rounds").size(), result.rounds.size());
  EXPECT_EQ(file.shape("/frames"),
            (std::vector<Index>{static_cast<Index>(result.frames.size()), result.goal.rows(), 3}));
  const auto summary = nlohmann::json::parse(file.read_text("/summary"));
  EXPECT_EQ(summary["error_mm"].get<double>(),
            mean_distance_mm(file.read_positions("/final_shape"), file.read_positions("/goal")));
  const ShapeErrors errors = shape_errors(file.read_positions("/final_shape"), file.read_positions("/goal"), task());
  EXPECT_EQ(summary["max_error_mm"].get<double>(), errors.max_mm);
  EXPECT_EQ(summary["grasped_error_mm"].get<double>(), errors.grasped_mm);
  EXPECT_EQ(summary["named_error_mm"].get<double>(), errors.named_mm);
  EXPECT_EQ(summary["silhouette_iou"].get<double>(), errors.iou);
  EXPECT_GE(errors.max_mm, result.error_mm);
  for (const int limit : {10, 20, 30})
    EXPECT_EQ(summary["success_" + std::to_string(limit) + "mm"].get<bool>(), result.error_mm <= limit);
  EXPECT_FALSE(summary.contains("plan_seconds")) << "what a clock gave lies apart";
  EXPECT_EQ(nlohmann::json::parse(session_times_json(result))["plan_seconds"].size(), result.rounds.size());
  EXPECT_EQ(summary["knowledge"].size(), result.rounds.size());
  ASSERT_EQ(summary["plan_ended"].size(), result.rounds.size());
  const auto& ended = summary["plan_ended"][0];
  EXPECT_EQ(ended["status"], to_string(result.rounds[0].plan.ended.status));
  EXPECT_EQ(ended["message"], result.rounds[0].plan.ended.message);
  int instances = 0;
  for (const auto& [status, number] : ended["instances"].items()) instances += number.get<int>();
  EXPECT_EQ(instances, static_cast<int>(result.rounds[0].plan.losses.size()));
  EXPECT_EQ(file.read_text("/config"), resolved_.to_yaml());
}

}  // namespace
}  // namespace weft
