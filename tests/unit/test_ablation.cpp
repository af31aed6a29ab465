#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <nlohmann/json.hpp>
#include <thread>

#include "experiments/sweep.hpp"
#include "test_support.hpp"

namespace weft::test {
namespace {

// The least that a session config must hold to be read; no cell of these tests runs a session.
constexpr const char* kTask = R"(
garment: towel.yaml
material: basic.yaml
predictor: {plugin: rollout}
seed: 77
planning: {instances: 4, iterations: 10}
)";

struct Files {
  Folder folder;
  Files() { folder.write("task.yaml", kTask); }
  AblationPlan plan(const std::string& rest, const std::uint64_t* first = nullptr) const {
    return read_ablation(ConfigNode::load(folder.write("ablation.yaml", "task: task.yaml\n" + rest)), first);
  }
  std::string refusal(const std::string& rest) const {
    return message_of<ConfigError>([&] { plan(rest); });
  }
  AblationOptions options(const std::string& name, AblationRunner runner, int jobs = 1) const {
    AblationOptions o;
    o.folder = folder / name;
    o.jobs = jobs;
    o.registry = std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{folder.path()});
    o.runner = std::move(runner);
    return o;
  }
};

constexpr const char* kTwoFactors = R"(
set: {planning.noise: 0.5}
factors:
  optimiser:
    rprop: {optimiser: {plugin: rprop}}
    sampling: {optimiser: {plugin: mppi, params: {samples: 8}}, planning.iterations: 20}
  planning.instances: [1, 4, 16]
baseline: {optimiser: rprop}
seeds: {first: 5, count: 3}
)";

/// Arms differ by known amounts; a cell's number is a function of its config and seed only.
AblationOutcome formula(const ConfigNode& session, Host&) {
  const auto seed = static_cast<double>(session.at("seed").as_int());
  const double instances = session.at("planning").at("instances").as_double();
  const bool sampling = session.find("optimiser") && session.at("optimiser").at("plugin").as_string() == "mppi";
  AblationOutcome outcome;
  outcome.metrics = {{"error_mm", 10.0 * seed + (sampling ? 2.0 : 0.0) + 1.0 / instances},
                     {"seconds", 0.5 * instances}};
  outcome.paired_by = "case" + std::to_string(static_cast<int>(seed));
  return outcome;
}

TEST(AblationPlan, ArmsAreTheProductOfTheLevels) {
  const auto plan = Files().plan(kTwoFactors);
  ASSERT_EQ(plan.arms.size(), 6u);
  EXPECT_EQ(plan.factors, (std::vector<std::string>{"optimiser", "planning.instances"}));
  EXPECT_EQ(plan.arms[0].name, "rprop, 1");
  EXPECT_EQ(plan.arms[5].name, "sampling, 16");
  EXPECT_EQ(plan.arms[5].levels, (std::vector<std::string>{"sampling", "16"}));
  const ConfigNode& config = plan.arms[5].config;
  EXPECT_EQ(config.at("planning").at("instances").as_int(), 16);
  EXPECT_EQ(config.at("planning").at("iterations").as_int(), 20);
  EXPECT_EQ(config.at("planning").at("noise").as_double(), 0.5);
  EXPECT_EQ(config.at("optimiser").at("params").at("samples").as_int(), 8);
  EXPECT_EQ(plan.arms[0].config.at("planning").at("iterations").as_int(), 10);
  EXPECT_FALSE(config.has("seed"));
  EXPECT_EQ(plan.seeds, (std::vector<std::uint64_t>{5, 6, 7}));
}

TEST(AblationPlan, EachArmIsComparedWithItsLikeAtTheBaselinesLevels) {
  const auto plan = Files().plan(kTwoFactors);
  const std::vector<std::size_t> wanted = {0, 1, 2, 0, 1, 2};
  for (std::size_t a = 0; a < 6; ++a) EXPECT_EQ(plan.arms[a].baseline, wanted[a]);
  const auto one = Files().plan("factors: {planning.instances: [1, 4]}\nbaseline: 4\nseeds: [3, 1]\n");
  EXPECT_EQ(one.arms[0].baseline, 1u);
  EXPECT_EQ(one.seeds, (std::vector<std::uint64_t>{3, 1}));
  const auto silent = Files().plan("factors: {planning.instances: [1, 4]}\nseeds: [3]\n");
  EXPECT_EQ(silent.arms[1].baseline, 0u);
}

TEST(AblationPlan, NestedKeysChangeOnlyWhatTheyNameAndPluginsAreReplacedWhole) {
  const auto plan = Files().plan(
      "set: {planning.noise: 0.5, planning: {noise: 0.25}, optimiser: {plugin: mppi, params: {samples: 8}}}\n"
      "factors: {optimiser: {a: {}, b: {optimiser: {plugin: rprop}}}}\nseeds: [1]\n");
  EXPECT_EQ(plan.arms[0].config.at("planning").at("noise").as_double(), 0.25);  // the later one, such as --set adds
  EXPECT_EQ(plan.arms[0].config.at("planning").at("iterations").as_int(), 10);
  EXPECT_EQ(plan.arms[0].config.at("optimiser").at("params").at("samples").as_int(), 8);
  EXPECT_FALSE(plan.arms[1].config.at("optimiser").has("params"));
}

TEST(AblationPlan, FirstSeedCanBeReplaced) {
  const std::uint64_t first = 100;
  EXPECT_EQ(Files().plan(kTwoFactors, &first).seeds, (std::vector<std::uint64_t>{100, 101, 102}));
}

TEST(AblationPlan, RefusesWithFileLineAndTheNearestName) {
  using testing::AllOf;
  using testing::HasSubstr;
  const Files s;
  const std::string seeds = "seeds: [1]\n", factors = "factors: {planning.instances: [1, 4]}\n";
  EXPECT_THAT(s.refusal(factors), HasSubstr("seeds is missing"));
  EXPECT_THAT(s.refusal(seeds), HasSubstr("factors is missing"));
  EXPECT_THAT(s.refusal(seeds + "factors: {planning.instances: []}\n"), HasSubstr("not empty"));
  EXPECT_THAT(s.refusal(seeds + "factors: {planning.instances: [4, 4]}\n"), HasSubstr("twice"));
  EXPECT_THAT(s.refusal(seeds + "factors: {planning.instance: [1]}\n"), HasSubstr("nearest: instances"));
  EXPECT_THAT(s.refusal(seeds + "factors: {planning.instances: [-1]}\n"), HasSubstr("must be in [1, 4096]"));
  EXPECT_THAT(s.refusal(seeds + factors + "baseline: 5\n"), AllOf(HasSubstr("ablation.yaml:4"), HasSubstr("no level")));
  EXPECT_THAT(s.refusal(seeds + factors + "baseline: {planing.instances: 4}\n"),
              HasSubstr("nearest: planning.instances"));
  EXPECT_THAT(s.refusal(factors + "seeds: {first: 1}\n"), HasSubstr("count"));
  EXPECT_THAT(s.refusal(factors + "seeds: [1, 1]\n"), HasSubstr("twice"));
  EXPECT_THAT(s.refusal(factors + "seeds: [-1]\n"), HasSubstr(">= 0"));
  EXPECT_THAT(s.refusal(seeds + "factors: {seed: [1, 2]}\n"), HasSubstr("`seeds` does that"));
  EXPECT_THAT(s.refusal(seeds + factors + "arms: 3\n"), HasSubstr("arms"));
  EXPECT_THAT(message_of<ConfigError>([&] {
                read_ablation(ConfigNode::load(s.folder.write("a.yaml", "task: none.yaml\n" + seeds + factors)));
              }),
              HasSubstr("none.yaml"));
}

TEST(AblationPlan, PhysicsCasesTakeThePlaceOfSeeds) {
  using testing::HasSubstr;
  const Folder folder;
  folder.write("physics.yaml", std::string(kTask) + "physics: {tests: [rest, free fall]}\n");
  const auto plan = [&](const std::string& rest, const std::uint64_t* first = nullptr) {
    return read_ablation(
        ConfigNode::load(folder.write("ablation.yaml", "task: physics.yaml\nmeasure: physics\n" + rest)), first);
  };
  const std::string simulators =
      "factors: {simulator: {a: {simulator: {plugin: cloth}}, b: {simulator: {plugin: b}}}}\n";
  const auto two = plan(simulators);
  EXPECT_EQ(two.arms.size(), 2u);
  EXPECT_EQ(two.seeds, (std::vector<std::uint64_t>{0, 1}));
  ASSERT_EQ(two.cases.size(), 2u);
  EXPECT_TRUE(two.cases[0].starts_with("free fall, "));
  EXPECT_TRUE(two.cases[1].starts_with("rest, "));
  EXPECT_EQ(plan("set: {physics: {tests: [folds], folds: {count: 40}}}\n" + simulators).cases.back(),
            "folds, seeds 31 to 40");
  AblationRow row{1, 1, "", {{{"rest: motion m", 1e-7}}, "rest"}};
  EXPECT_EQ(ablation_csv(two, {row}),
            "simulator,seed,case,status,rest: motion m,failure\nb,1,\"" + two.cases[1] + "\",done,1e-07,\n");

  const auto refusal = [&](const std::string& rest) { return message_of<ConfigError>([&] { plan(rest); }); };
  EXPECT_THAT(refusal(simulators + "seeds: [1]\n"), HasSubstr("runs the cases of the suite"));
  EXPECT_THAT(refusal("factors: {physics.fold.count: [1, 2]}\n"), HasSubstr("nearest: folds"));
  EXPECT_THAT(refusal("factors: {t: {a: {physics.tests: [rest]}, b: {physics.tests: [free fall]}}}\n"),
              HasSubstr("different cases"));
  const std::uint64_t first = 3;
  EXPECT_THROW(plan(simulators, &first), ConfigError);
}

TEST(Ablation, RowsComeInOrderWhateverTheNumberOfJobs) {
  const Files s;
  const auto plan = s.plan(kTwoFactors);
  const auto one = run_ablation(plan, s.options("one", formula, 1));
  const auto four = run_ablation(plan, s.options("four", formula, 4));
  ASSERT_EQ(one.size(), 18u);
  EXPECT_EQ(ablation_csv(plan, one), ablation_csv(plan, four));
  EXPECT_EQ(ablation_json(plan, one), ablation_json(plan, four));
  for (std::size_t i = 0; i < 18; ++i) {
    EXPECT_EQ(one[i].seed, 5 + i / 6);
    EXPECT_EQ(one[i].arm, i % 6);
  }
}

TEST(Ablation, SessionsGetTheirSeedAndOneThread) {
  const Files s;
  const auto plan = s.plan("factors: {planning.instances: [1]}\nseeds: [9]\n");
  run_ablation(plan, s.options("out", [](const ConfigNode& session, Host& host) {
    EXPECT_EQ(host.seed(), 9u);
    EXPECT_EQ(host.threads(), 1);
    return formula(session, host);
  }));
  const auto wide = s.plan("set: {threads: 3}\nfactors: {planning.instances: [1]}\nseeds: [9]\n");
  run_ablation(wide, s.options("wide", [](const ConfigNode& session, Host& host) {
    EXPECT_EQ(host.threads(), 3);
    return formula(session, host);
  }));
}

TEST(Ablation, FailedCellsAreRecordedAndCostOnlyThemselves) {
  const Files s;
  const auto plan = s.plan(kTwoFactors);
  const AblationRunner runner = [](const ConfigNode& session, Host& host) -> AblationOutcome {
    const auto instances = session.at("planning").at("instances").as_int();
    if (instances == 4 && session.at("seed").as_int() == 6) throw Diverged("frame 12, vertex 3");
    if (instances == 16 && session.at("seed").as_int() == 7) throw 5;
    return formula(session, host);
  };
  const auto rows = run_ablation(plan, s.options("out", runner));
  ASSERT_EQ(rows.size(), 18u);
  int failed = 0;
  for (const auto& row : rows) failed += !row.failure.empty();
  EXPECT_EQ(failed, 4);
  const auto json = nlohmann::json::parse(ablation_json(plan, rows));
  EXPECT_EQ(json["arms"][1]["done"], 2);
  EXPECT_EQ(json["arms"][1]["failed"][0]["failure"], "frame 12, vertex 3");
  EXPECT_EQ(json["arms"][4]["metrics"]["error_mm"]["difference"]["n"], 2);  // the pairs that both ran
  EXPECT_THAT(ablation_csv(plan, rows), testing::HasSubstr("rprop,4,6,failed,,,\"frame 12, vertex 3\"\n"));
  // A failure is a result: it is not tried again.
  std::atomic<int> calls{0};
  run_ablation(plan, s.options("out", [&](const ConfigNode& session, Host& host) {
    ++calls;
    return formula(session, host);
  }));
  EXPECT_EQ(calls, 0);
}

TEST(Ablation, DifferencesArePaired) {
  // Seeds differ by 10 mm, arms by 2 mm: only a paired comparison sees the 2 mm exactly.
  const Files s;
  const auto plan = s.plan(kTwoFactors);
  const auto json = nlohmann::json::parse(ablation_json(plan, run_ablation(plan, s.options("out", formula))));
  const auto& arm = json["arms"][4];
  EXPECT_EQ(arm["baseline"], "rprop, 4");
  EXPECT_NEAR(arm["metrics"]["error_mm"]["mean"], 62.25, 1e-12);
  EXPECT_NEAR(arm["metrics"]["error_mm"]["sd"], 10.0, 1e-12);
  const auto& difference = arm["metrics"]["error_mm"]["difference"];
  EXPECT_EQ(difference["n"], 3);
  EXPECT_NEAR(difference["mean"], 2.0, 1e-12);
  EXPECT_NEAR(difference["mean_95"][0], 2.0, 1e-12);
  EXPECT_NEAR(difference["mean_95"][1], 2.0, 1e-12);
  EXPECT_TRUE(json["arms"][0]["baseline"].is_null());
  EXPECT_FALSE(json["arms"][0]["metrics"]["error_mm"].contains("difference"));
  EXPECT_EQ(json["complete"], true);
}

TEST(Ablation, CasesThatAreNotTheSameAreNotCompared) {
  const Files s;
  const auto plan = s.plan(kTwoFactors);
  const auto rows = run_ablation(plan, s.options("out", [](const ConfigNode& session, Host& host) {
    AblationOutcome o = formula(session, host);
    if (session.at("planning").at("instances").as_int() == 16 &&
        session.find("optimiser")->at("plugin").as_string() == "mppi")
      o.paired_by = "another goal";
    return o;
  }));
  const auto json = nlohmann::json::parse(ablation_json(plan, rows));
  EXPECT_EQ(json["arms"][5]["unpaired"], 3);
  EXPECT_EQ(json["arms"][5]["metrics"]["error_mm"]["difference"]["n"], 0);
  EXPECT_TRUE(json["arms"][5]["metrics"]["error_mm"]["difference"]["mean"].is_null());
  EXPECT_THAT(ablation_table(plan, rows, "error_mm"), testing::HasSubstr("NOT ALL PAIRED"));
}

TEST(Ablation, KilledAtAnyMomentItIsFinishedByTheNextRun) {
  const Files s;
  const auto plan = s.plan(kTwoFactors);
  const std::string whole = ablation_csv(plan, run_ablation(plan, s.options("whole", formula)));
  for (const int after_ms : {5, 40, 75}) {
    const std::string name = "killed" + std::to_string(after_ms);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      try {
        run_ablation(plan, s.options(
                               name,
                               [](const ConfigNode& session, Host& host) {
                                 std::this_thread::sleep_for(std::chrono::milliseconds(10));
                                 return formula(session, host);
                               },
                               2));
      } catch (...) {
      }
      _exit(0);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(after_ms));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    std::atomic<int> calls{0};
    const auto rows = run_ablation(plan, s.options(name, [&](const ConfigNode& session, Host& host) {
      ++calls;
      return formula(session, host);
    }));
    EXPECT_EQ(ablation_csv(plan, rows), whole) << calls;
    EXPECT_GT(calls, 0);
  }
}

TEST(Ablation, HalfWrittenRowsDoNotCount) {
  const Files s;
  const auto plan = s.plan("factors: {planning.instances: [1]}\nseeds: [1]\n");
  run_ablation(plan, s.options("out", formula));
  std::filesystem::path row;
  for (const auto& entry : std::filesystem::directory_iterator(s.folder / "out" / "cells")) row = entry.path();
  std::filesystem::rename(row, row.string() + ".tmp");
  int calls = 0;
  run_ablation(plan, s.options("out", [&](const ConfigNode& session, Host& host) {
    ++calls;
    return formula(session, host);
  }));
  EXPECT_EQ(calls, 1);
  std::ofstream(row) << "{\"schema\": ";
  EXPECT_THAT(message_of<ConfigError>([&] { run_ablation(plan, s.options("out", formula)); }),
              testing::AllOf(testing::HasSubstr(row.filename().string()), testing::HasSubstr("damaged")));
}

TEST(Ablation, AFolderHoldsOneAblation) {
  const Files s;
  run_ablation(s.plan("factors: {planning.instances: [1, 2]}\nseeds: [1]\n"), s.options("out", formula));
  const auto other = s.plan("set: {planning.noise: 0.25}\nfactors: {planning.instances: [1, 2]}\nseeds: [1]\n");
  EXPECT_THAT(message_of<ConfigError>([&] { run_ablation(other, s.options("out", formula)); }),
              testing::HasSubstr("another config"));
  // More seeds of the same are welcome.
  const auto more = s.plan("factors: {planning.instances: [1, 2]}\nseeds: [1, 2]\n");
  EXPECT_EQ(run_ablation(more, s.options("out", formula)).size(), 4u);
}

TEST(Ablation, CancelledSessionsLeaveNoRow) {
  const Files s;
  const auto plan = s.plan(kTwoFactors);
  std::atomic<bool> cancel{false};
  int calls = 0;
  auto options = s.options("out", [&](const ConfigNode& session, Host& host) {
    if (++calls == 4) cancel = true;
    return formula(session, host);
  });
  options.cancel = &cancel;
  EXPECT_EQ(run_ablation(plan, options).size(), 3u);
  cancel = false;
  EXPECT_EQ(run_ablation(plan, options).size(), 18u);
}

TEST(Ablation, MetricsThatAreNoNumbersSurvive) {
  const Files s;
  const auto plan = s.plan("factors: {planning.instances: [1]}\nseeds: [1]\n");
  const AblationRunner runner = [](const ConfigNode&, Host&) {
    return AblationOutcome{{{"a", std::nan("")}, {"b", 0.1}}, "x"};
  };
  run_ablation(plan, s.options("out", runner));
  const auto rows = run_ablation(plan, s.options("out", runner));  // read back
  EXPECT_TRUE(std::isnan(rows[0].outcome.metrics[0].second));
  EXPECT_EQ(rows[0].outcome.metrics[1].second, 0.1);
  EXPECT_THAT(ablation_csv(plan, rows), testing::HasSubstr("1,1,done,,0.1,\n"));
}

TEST(AblationStatistics, OfFewValues) {
  const auto none = ablation_statistics({}, 1000, 1);
  EXPECT_EQ(none.n, 0u);
  EXPECT_TRUE(std::isnan(none.mean));
  const auto one = ablation_statistics({3.0}, 1000, 1);
  EXPECT_EQ(one.mean, 3.0);
  EXPECT_EQ(one.median, 3.0);
  EXPECT_TRUE(std::isnan(one.mean_interval.first));
  const auto four = ablation_statistics({4.0, 1.0, 2.0, 10.0}, 1000, 1);
  EXPECT_EQ(four.median, 3.0);
  EXPECT_EQ(four.mean, 4.25);
  EXPECT_NEAR(four.sd, std::sqrt((0.0625 + 10.5625 + 5.0625 + 33.0625) / 3.0), 1e-12);
}

TEST(AblationStatistics, BootstrapIntervalsCoverTheMean) {
  // 95 % intervals of the mean of 30 normal values hold 0 in about 94 % of the cases (the percentile bootstrap's slight
  // lack).
  RandomStream random(8);
  int covered = 0;
  constexpr int trials = 400;
  for (int t = 0; t < trials; ++t) {
    std::vector<double> values(30);
    for (double& v : values) v = random.normal();
    const auto s = ablation_statistics(values, 400, 1);
    covered += s.mean_interval.first <= 0.0 && 0.0 <= s.mean_interval.second;
    EXPECT_LE(s.mean_interval.first, s.mean);
    EXPECT_GE(s.mean_interval.second, s.mean);
  }
  EXPECT_NEAR(static_cast<double>(covered) / trials, 0.94, 0.035);
}

}  // namespace
}  // namespace weft::test
