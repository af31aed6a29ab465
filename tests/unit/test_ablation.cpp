#include "experiments/ablation.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

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
  for (std::size_t a = 0; a < 6; ++a) EXPECT_EQ(plan.baseline[a], wanted[a]);
  const auto one = Files().plan("factors: {planning.instances: [1, 4]}\nbaseline: 4\nseeds: [3, 1]\n");
  EXPECT_EQ(one.baseline[0], 1u);
  EXPECT_EQ(one.seeds, (std::vector<std::uint64_t>{3, 1}));
  const auto silent = Files().plan("factors: {planning.instances: [1, 4]}\nseeds: [3]\n");
  EXPECT_EQ(silent.baseline[1], 0u);
}

TEST(AblationPlan, TasksAreAFactorWhoseLevelsAreFiles) {
  const Files files;
  files.folder.write("other.yaml", std::string(kTask) + "max_segments: 7\n");
  const auto plan = [&](const std::string& rest) {
    return read_ablation(ConfigNode::load(
        files.folder.write("tasks.yaml", "tasks: [task.yaml, other.yaml]\nset: {planning.noise: 0.5}\n" + rest)));
  };
  const std::string levels = "factors: {knowledge: [\"none\", \"drawn\", \"true\"]}\nseeds: [1]\n";
  const auto both = plan(levels + "baseline: \"none\"\ntarget: {knowledge: \"true\"}\n");
  EXPECT_EQ(both.factors, (std::vector<std::string>{"task", "knowledge"}));
  ASSERT_EQ(both.arms.size(), 6u);
  EXPECT_EQ(both.arms[4].name, "other, drawn");
  EXPECT_EQ(both.arms[4].config.at("max_segments").as_int(), 7);
  EXPECT_FALSE(both.arms[1].config.has("max_segments"));
  for (const auto& arm : both.arms) EXPECT_EQ(arm.config.at("planning").at("noise").as_double(), 0.5);
  EXPECT_EQ(both.baseline, (std::vector<std::size_t>{0, 0, 0, 3, 3, 3}));
  EXPECT_EQ(both.target, (std::vector<std::size_t>{2, 2, 2, 5, 5, 5}));
  // The first level of the first factor of the settings, not the first task.
  EXPECT_EQ(plan(levels).baseline, both.baseline);
  EXPECT_TRUE(plan(levels).target.empty());

  using testing::HasSubstr;
  const auto refusal = [&](const std::string& rest) { return message_of<ConfigError>([&] { plan(rest); }); };
  EXPECT_THAT(refusal(levels + "task: task.yaml\n"), HasSubstr("left out with `task`"));
  EXPECT_THAT(refusal("factors: {task: [a]}\nseeds: [1]\n"), HasSubstr("must not name a factor 'task'"));
  EXPECT_THAT(refusal(levels + "target: {knowledge: all}\n"), HasSubstr("is not a level of knowledge"));
  EXPECT_THAT(
      message_of<ConfigError>([&] {
        read_ablation(ConfigNode::load(files.folder.write("twice.yaml", "tasks: [task.yaml, ./task.yaml]\n" + levels)));
      }),
      HasSubstr("the second task called 'task'"));
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
  EXPECT_THAT(s.refusal(seeds + factors + "baseline: 5\n"),
              AllOf(HasSubstr("ablation.yaml:4"), HasSubstr("is not a level of")));
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
  SweepRow row{1, 1, "", {{{"rest: motion m", 1e-7}}, "rest"}};
  EXPECT_EQ(ablation_csv(two, {row}),
            "simulator,seed,case,status,rest: motion m,failure,identity\nb,1,\"" + two.cases[1] + "\",done,1e-07,,\n");

  const auto refusal = [&](const std::string& rest) { return message_of<ConfigError>([&] { plan(rest); }); };
  EXPECT_THAT(refusal(simulators + "seeds: [1]\n"), HasSubstr("runs the cases of the suite"));
  EXPECT_THAT(refusal("factors: {physics.fold.count: [1, 2]}\n"), HasSubstr("nearest: folds"));
  EXPECT_THAT(refusal("factors: {t: {a: {physics.tests: [rest]}, b: {physics.tests: [free fall]}}}\n"),
              HasSubstr("different cases"));
  const std::uint64_t first = 3;
  EXPECT_THROW(plan(simulators, &first), ConfigError);
}

/// Rows of all cells: seeds differ by 10 mm, arms by 2 mm.
std::vector<SweepRow> rows_of(const AblationPlan& plan) {
  std::vector<SweepRow> rows;
  for (const auto seed : plan.seeds) {
    for (std::size_t a = 0; a < plan.arms.size(); ++a) {
      const double instances = plan.arms[a].config.at("planning").at("instances").as_double();
      const bool sampling = plan.arms[a].levels.front() == "sampling";
      SweepRow row{a, seed, "", {}};
      row.outcome.metrics = {{"error_mm", 10.0 * static_cast<double>(seed) + (sampling ? 2.0 : 0.0) + 1.0 / instances},
                             {"seconds", 0.5 * instances}};
      row.outcome.paired_by = "case" + std::to_string(seed);
      rows.push_back(row);
    }
  }
  return rows;
}
SweepRow& row_of(std::vector<SweepRow>& rows, std::size_t arm, std::uint64_t seed) {
  return *std::find_if(rows.begin(), rows.end(), [&](const auto& r) { return r.arm == arm && r.seed == seed; });
}

TEST(Ablation, FailedCellsAreCountedAndLeaveTheirPairsOut) {
  const auto plan = Files().plan(kTwoFactors);
  auto rows = rows_of(plan);
  row_of(rows, 1, 6).failure = "frame 12, vertex 3";
  row_of(rows, 1, 6).status = WorkStatus::diverged;
  row_of(rows, 1, 6).outcome = {};
  const auto json = nlohmann::json::parse(ablation_json(plan, rows));
  EXPECT_EQ(json["arms"][1]["done"], 2);
  EXPECT_EQ(json["arms"][1]["failed"][0]["failure"], "frame 12, vertex 3");
  EXPECT_EQ(json["arms"][1]["failed"][0]["status"], "diverged");
  EXPECT_EQ(json["arms"][4]["metrics"]["error_mm"]["difference"]["n"], 2);  // the pairs that both ran
  EXPECT_THAT(ablation_csv(plan, rows), testing::HasSubstr("rprop,4,6,diverged,,,\"frame 12, vertex 3\",\n"));
}

TEST(Ablation, DifferencesArePaired) {
  // Seeds differ by 10 mm, arms by 2 mm: only a paired comparison sees the 2 mm exactly.
  const auto plan = Files().plan(kTwoFactors);
  const auto json = nlohmann::json::parse(ablation_json(plan, rows_of(plan)));
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

TEST(Ablation, MediansAreComparedWithBaselineAndTarget) {
  const auto plan =
      Files().plan("factors: {planning.instances: [1, 2, 4]}\nbaseline: 1\ntarget: 4\nseeds: {first: 1, count: 5}\n");
  std::vector<SweepRow> rows;
  for (const auto seed : plan.seeds)
    for (std::size_t a = 0; a < 3; ++a) {
      SweepRow row{a, seed, "", {}};
      const double base = 10.0 + static_cast<double>(seed);
      row.outcome.metrics = {{"error_mm", a == 0 ? 4.0 * base : a == 1 ? 1.75 * base : base}};
      rows.push_back(row);
    }
  row_of(rows, 2, 1).failure = "the target of seed 1 is missing";
  const auto json = nlohmann::json::parse(ablation_json(plan, rows));
  EXPECT_FALSE(json["arms"][0]["metrics"]["error_mm"].contains("medians"));
  const auto& medians = json["arms"][1]["metrics"]["error_mm"]["medians"];
  EXPECT_EQ(medians["n"], 4);
  EXPECT_NEAR(medians["baseline_over_own"], 4.0 / 1.75, 1e-12);
  EXPECT_NEAR(medians["gap_closed"], 2.25 / 3.0, 1e-12);
  EXPECT_NEAR(medians["baseline_over_own_95"][0], 4.0 / 1.75, 1e-12);  // paired, so every sample has this ratio
  EXPECT_NEAR(medians["gap_closed_95"][1], 2.25 / 3.0, 1e-12);
  EXPECT_NEAR(json["arms"][2]["metrics"]["error_mm"]["medians"]["gap_closed"], 1.0, 1e-12);
  EXPECT_THAT(ablation_table(plan, rows, "error_mm"),
              testing::AllOf(testing::HasSubstr("2.29"), testing::HasSubstr("75 %")));
  const auto without = Files().plan("factors: {planning.instances: [1, 2, 4]}\nseeds: {first: 1, count: 5}\n");
  const auto plain = nlohmann::json::parse(ablation_json(without, rows));
  EXPECT_FALSE(plain["arms"][1]["metrics"]["error_mm"]["medians"].contains("gap_closed"));
  EXPECT_EQ(plain["arms"][1]["metrics"]["error_mm"]["medians"]["n"], 5);
}

TEST(Ablation, CasesThatAreNotTheSameAreNotCompared) {
  const auto plan = Files().plan(kTwoFactors);
  auto rows = rows_of(plan);
  for (auto& row : rows) {
    if (row.arm == 5) row.outcome.paired_by = "another goal";
  }
  const auto json = nlohmann::json::parse(ablation_json(plan, rows));
  EXPECT_EQ(json["arms"][5]["unpaired"], 3);
  EXPECT_EQ(json["arms"][5]["metrics"]["error_mm"]["difference"]["n"], 0);
  EXPECT_TRUE(json["arms"][5]["metrics"]["error_mm"]["difference"]["mean"].is_null());
  EXPECT_THAT(ablation_table(plan, rows, "error_mm"), testing::HasSubstr("NOT ALL PAIRED"));
}

TEST(AblationPlan, ManySeedsAreReadAtOnceAndNumbersThatOverflowAreRefused) {
  const Files files;
  const std::string factors = "factors: {planning.instances: [1]}\n";
  EXPECT_EQ(files.plan(factors + "seeds: {first: 5, count: 1000000}").seeds.size(), 1'000'000u);
  EXPECT_THAT(files.refusal(factors + "seeds: {first: 9223372036854775807, count: 2}"),
              testing::HasSubstr("must be in [0, 9e18]"));
}

}  // namespace
}  // namespace weft::test
