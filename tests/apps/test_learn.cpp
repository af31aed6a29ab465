// `weft learn` as people use it, on a coarse towel with few examples: one command to a task that plans with its model.
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::Not;

const std::string kExperiment = "extends: " WEFT_SOURCE_DIR
                                "/configs/experiments/towel_small.yaml\n"
                                "data: {shard_examples: 8}\n"
                                "learn: {examples: 24, calibration_examples: 16, held_out_examples: 16}\n"
                                "predictor: {params: {training: {iterations: 60, warmup: 5, evaluate_every: 10, "
                                "checkpoint_every: 10}}}\n"
                                "planning: {instances: 2, iterations: 2, replan_iterations: 1}\n"
                                "goal: {random: {min_distance_mm: 5}}\n"
                                "max_segments: 12\n";

class Learn : public testing::Test {
 protected:
  Learn() { folder_.write("experiment.yaml", kExperiment); }

  static std::string program() { return "unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' "; }
  /// Runs weft in a folder below the test's, so that no result holds that folder's name.
  Outcome weft(const std::string& in, const std::string& arguments) const {
    fs::create_directories(folder_ / in);
    return test::run_shell("cd '" + (folder_ / in).string() + "'; " + program() + arguments);
  }
  /// Starts weft and kills it, as a power cut would, when this file is there.
  void kill_when(const std::string& in, const std::string& file, const std::string& arguments) const {
    fs::create_directories(folder_ / in);
    test::run_shell("cd '" + (folder_ / in).string() + "'; " + program() + arguments +
                    " & pid=$!; for i in $(seq 2000); do test -e '" + file +
                    "' && break; kill -0 $pid 2>/dev/null || break; sleep 0.02; done; kill -KILL $pid; wait $pid");
  }
  nlohmann::json json_of(const fs::path& file) const {
    std::ifstream stream(folder_ / file);
    return nlohmann::json::parse(stream);
  }
  /// Name and bytes of the files of a result that do not depend on the time (docs/file-formats.md).
  std::map<std::string, std::string> contents(const fs::path& of) const {
    std::map<std::string, std::string> found;
    for (const auto& entry : fs::recursive_directory_iterator(folder_ / of)) {
      const std::string name = entry.path().filename().string();
      if (!entry.is_regular_file() || name == "report.html" || name == "times.json") continue;
      std::ifstream stream(entry.path(), std::ios::binary);
      found[entry.path().lexically_relative(folder_ / of).string()] = {std::istreambuf_iterator<char>(stream), {}};
    }
    return found;
  }
  std::string refused(const std::string& arguments) const {
    const Outcome outcome = weft(".", arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    return outcome.output;
  }

  Folder folder_;
};

/// Whether the build learns. Without libtorch the refusal names it.
#define WEFT_NEEDS_TORCH()                                                                                   \
  if (WEFT_HAS_TORCH == 0) {                                                                                 \
    EXPECT_THAT(weft("a", "learn ../experiment.yaml --out out").output, HasSubstr("made without libtorch")); \
    return;                                                                                                  \
  }

TEST_F(Learn, OneCommandLeadsToATaskThatRunsAndSurvivesKills) {
  WEFT_NEEDS_TORCH()
  const std::string learn = "learn ../experiment.yaml --jobs 2 --out out";
  const Outcome whole = weft("a", learn);
  ASSERT_EQ(whole.code, 0) << whole.output;
  EXPECT_THAT(whole.output, AllOf(HasSubstr("to go in all"), HasSubstr("settled shape           n"),
                                  HasSubstr("sigma cannot be judged: 16 held-out examples"),
                                  HasSubstr("weft run out/task.yaml"), Not(HasSubstr("warning"))));
  const auto record = json_of("a/out/learn.json");
  EXPECT_EQ(record.at("numbers").at("iterations"), 60);
  EXPECT_TRUE(record.at("hours").is_null());
  EXPECT_EQ(record.at("seeds"), (nlohmann::json{{"fit", 1}, {"calibration", 2}, {"held_out", 3}}));
  for (const char* step : {"examples", "training", "calibration", "evaluation"})
    EXPECT_TRUE(record.at("steps").contains(step)) << step;
  EXPECT_EQ(record.at("steps").at("evaluation").at("settled"),
            json_of("a/out/evaluation/prediction.json").at("settled"));
  const auto seconds = json_of("a/out/times.json").at("learn.json").at("seconds");
  EXPECT_GT(seconds.at("examples").get<double>(), 0.0);

  // Killed in every step, and once more before anything was planned.
  for (const char* file : {"out/trial/shard-00000.h5", "out/learn.json", "out/examples/calibration/shard-00000.h5",
                           "out/model/fitted.checkpoint.h5", "out/model/model.h5", "out/evaluation/prediction.json"})
    kill_when("b", file, learn);
  const Outcome resumed = weft("b", learn);
  ASSERT_EQ(resumed.code, 0) << resumed.output;
  const auto right = contents("a/out"), found = contents("b/out");
  for (const auto& [name, bytes] : right) {
    ASSERT_TRUE(found.contains(name)) << name;
    EXPECT_TRUE(found.at(name) == bytes) << name << " holds other bytes";
  }
  for (const auto& [name, bytes] : found) EXPECT_TRUE(right.contains(name)) << name << " was left";

  // A finished folder is not worked on again; its record is the result.
  const Outcome again = weft("b", learn + " --json");
  EXPECT_EQ(again.code, 0) << again.output;
  EXPECT_EQ(nlohmann::json::parse(again.output), record);
  EXPECT_TRUE(contents("b/out") == right);
  // What else it is refuses, and what differs is named.
  EXPECT_THAT(refused("learn experiment.yaml --out b/out --set data.jitter=0.4"), HasSubstr("data.jitter 0.5 -> 0.4"));
  EXPECT_THAT(refused("learn experiment.yaml --out b/out --set learn.examples=32"), HasSubstr("24 -> 32"));
  EXPECT_TRUE(contents("b/out") == right);

  // The task stands alone, also in another place.
  fs::rename(folder_ / "a/out", folder_ / "moved");
  const Outcome run = weft(".", "run moved/task.yaml --quiet --out run --set predictor.params.kernels=auto");
  ASSERT_EQ(run.code, 0) << run.output;
  EXPECT_TRUE(json_of("run/summary.json").at("error_mm").is_number());
  // And the config gives the same model again.
  const ConfigNode config = ConfigNode::load(folder_ / "moved/config.yaml");
  EXPECT_EQ(config.at("learn").at("examples").as_int(), 24);
  EXPECT_EQ(config.at("predictor").at("params").at("training").at("iterations").as_int(), 60);
}

TEST_F(Learn, HoursBecomeNumbersThatStay) {
  WEFT_NEEDS_TORCH()
  // The shortest time gives the fewest examples, and the fit is killed before it takes long.
  const std::string learn = "learn ../experiment.yaml --quiet --jobs 2 --out out --hours 0.001";
  kill_when("a", "out/learn.json", learn);
  const auto record = json_of("a/out/learn.json");
  EXPECT_EQ(record.at("hours"), 0.001);
  EXPECT_GT(record.at("rates").at("examples_per_s").get<double>(), 0.0);
  EXPECT_GT(record.at("rates").at("iterations_per_s").get<double>(), 0.0);
  const auto& numbers = record.at("numbers");
  EXPECT_EQ(numbers.at("iterations").get<int>(), std::max(100, 3 * numbers.at("examples").get<int>()));
  EXPECT_EQ(numbers.at("held_out_examples"), 64);
  const ConfigNode config = ConfigNode::load(folder_ / "a/out/config.yaml");
  EXPECT_EQ(config.at("learn").at("examples").as_int(), numbers.at("examples").get<int>());
  EXPECT_EQ(config.at("predictor").at("params").at("training").at("iterations").as_int(), numbers.at("iterations"));

  kill_when("a", "out/examples/calibration/shard-00000.h5", learn);
  EXPECT_EQ(json_of("a/out/learn.json"), record);
  EXPECT_THAT(refused("learn experiment.yaml --out a/out --hours 0.002"), HasSubstr("hours 0.001 -> 0.002"));
  EXPECT_THAT(refused("learn experiment.yaml --out a/out"), HasSubstr("Nothing was changed"));
}

TEST_F(Learn, OneProcessLearnsInAFolder) {
  WEFT_NEEDS_TORCH()
  fs::create_directories(folder_ / "a");
  const Outcome both =
      test::run_shell("cd '" + (folder_ / "a").string() + "'; " + program() +
                      "learn ../experiment.yaml --quiet --out out & pid=$!; for i in $(seq 500); do "
                      "ls out/claims/*.claim >/dev/null 2>&1 && break; sleep 0.02; done; '" WEFT_PROGRAM
                      "' learn ../experiment.yaml --out out; echo code $?; kill -KILL $pid; wait $pid");
  EXPECT_THAT(both.output, AllOf(HasSubstr("another `weft learn` is at work there"), HasSubstr("code 2")));
}

TEST_F(Learn, ADryRunWritesNothing) {
  const Outcome dry = weft(".", "learn experiment.yaml --dry-run");
  EXPECT_EQ(dry.code, 0) << dry.output;
  EXPECT_THAT(dry.output, AllOf(HasSubstr("examples/fit: 24, seed 1"), HasSubstr("examples/held_out: 16, seed 3"),
                                HasSubstr("60 iterations"), HasSubstr("results/learn-experiment")));
  // A task whose predictor does not learn gets one that does.
  const Outcome task =
      weft(".", "learn '" WEFT_SOURCE_DIR "/configs/tasks/towel_fold.yaml' --dry-run --json --hours 2 --out x");
  EXPECT_EQ(task.code, 0) << task.output;
  EXPECT_EQ(nlohmann::json::parse(task.output), (nlohmann::json{{"folder", "x"}, {"hours", 2.0}}));
  EXPECT_THAT(weft(".", "learn '" WEFT_SOURCE_DIR "/configs/tasks/towel_fold.yaml' --dry-run").output,
              HasSubstr("it gets emd"));
  // On a cluster it is one job.
  const Outcome job = weft(".", "learn experiment.yaml --hours 1 --on slurm --dry-run");
  EXPECT_EQ(job.code, 0) << job.output;
  EXPECT_THAT(job.output, AllOf(HasSubstr("learn experiment.yaml --hours 1"), HasSubstr("#SBATCH")));
  for (const char* made : {"results", "x"}) EXPECT_FALSE(fs::exists(folder_ / made)) << made;
}

TEST_F(Learn, WithoutSlurmOnSlurmSaysSo) {
  for (const char* command : {"learn experiment.yaml", "generate experiment.yaml --examples 2"}) {
    const Outcome outcome = test::run_shell("cd '" + folder_.path().string() +
                                            "' && PATH=/nowhere '" WEFT_PROGRAM "' " + command + " --on slurm --out y");
    EXPECT_EQ(outcome.code, 2) << command;
    EXPECT_THAT(outcome.output, HasSubstr("sbatch is not in PATH")) << command;
  }
  for (const char* option : {"--share", "--fail-fast"})
    EXPECT_THAT(refused(std::string("generate experiment.yaml --examples 2 --out y --on slurm --dry-run ") + option),
                HasSubstr("leave it out"));
  EXPECT_FALSE(fs::exists(folder_ / "y"));
}

TEST_F(Learn, TakesTheFolderOfAnImport) {
  ASSERT_EQ(weft(".", "garment towel --edge 0.08 --out napkin.obj --yaml").code, 0);
  const Outcome imported = weft(".", "garment import napkin.yaml --out here --garment-name small --no-tuning");
  ASSERT_EQ(imported.code, 0) << imported.output;
  EXPECT_THAT(imported.output, HasSubstr("weft learn here"));
  const Outcome dry = weft(".", "learn here --dry-run");
  EXPECT_EQ(dry.code, 0) << dry.output;
  EXPECT_THAT(dry.output, AllOf(HasSubstr("to fold small in here/learned"), Not(HasSubstr("it gets emd"))));
}

TEST_F(Learn, WrongUseSaysWhy) {
  EXPECT_THAT(refused("learn"), HasSubstr("task is required"));
  EXPECT_THAT(refused("learn none.yaml"), HasSubstr("none.yaml"));
  fs::create_directory(folder_ / "empty");
  EXPECT_THAT(refused("learn empty"), HasSubstr("holds no file NAME_experiment.yaml"));
  folder_.write("two/a_experiment.yaml", "");
  folder_.write("two/b_experiment.yaml", "");
  EXPECT_THAT(refused("learn two"), HasSubstr("several files"));
  EXPECT_THAT(refused("learn experiment.yaml --hours 0"), HasSubstr("must be in [0.001, 10000]"));
  EXPECT_THAT(refused("learn experiment.yaml --hours nan"), HasSubstr("must be in"));
  EXPECT_THAT(refused("learn experiment.yaml --hours 1 --set learn.examples=9"),
              HasSubstr("--hours finds this number"));
  EXPECT_THAT(refused("learn experiment.yaml --hours 1 --set predictor.params.training.iterations=9"),
              HasSubstr("--hours finds this number"));
  EXPECT_THAT(refused("learn experiment.yaml --set learn.examples=1"),
              AllOf(HasSubstr("learn.examples = 1"), HasSubstr("make more")));
  EXPECT_THAT(refused("learn experiment.yaml --set learn.exampels=9"), HasSubstr("nearest: examples"));
  EXPECT_THAT(refused("learn experiment.yaml --detach"), HasSubstr("--on"));
  folder_.write("file", "");
  EXPECT_THAT(refused("learn experiment.yaml --out file"), HasSubstr("it is a file"));
  EXPECT_FALSE(fs::exists(folder_ / "results"));
}

}  // namespace
}  // namespace weft
