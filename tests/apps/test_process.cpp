#include <cstdio>
#include <nlohmann/json.hpp>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

// `weft run` with a process as the environment, as a user starts it (docs/environment-protocol.md).

namespace weft {
namespace {

using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;

class EnvironmentCommand : public testing::Test {
 protected:
  EnvironmentCommand() {
    folder_.write("task.yaml", "garment: " WEFT_SOURCE_DIR
                               "/configs/garments/towel_coarse.yaml\n"
                               "material: " WEFT_SOURCE_DIR
                               "/configs/fabrics/basic.yaml\n"
                               "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
                               "predictor: {plugin: rollout}\n"
                               "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n"
                               "knowledge: none\n"
                               "goal: {random: {min_distance_mm: 10}, material: [0.5, 0.5, 0.5, 0.5]}\n"
                               "settle: {max_frames: 30}\n"
                               "seed: 3\n");
  }
  /// Runs weft in the folder.
  Outcome weft(const std::string& arguments) const {
    return test::run_shell("unset WEFT_PLUGIN_PATH; cd '" + folder_.path().string() + "' && '" WEFT_PROGRAM "' " +
                           arguments);
  }
  nlohmann::json summary(const std::string& run) const {
    std::ifstream stream(folder_ / run / "summary.json");
    return nlohmann::json::parse(stream);
  }
  /// Runs the task with a Python program that answers the greeting and then does this.
  Outcome run_with(const std::string& then, const std::string& options = "") const {
    folder_.write("robot.py",
                  "import json, sys, time\n"
                  "hello = json.loads(sys.stdin.readline())\n"
                  "print(json.dumps({'type': 'hello', 'protocol': 'weft environment', 'version': 1}), flush=True)\n"
                  "sys.stdin.readline()\n" +
                      then + "\n");
    return weft("run task.yaml --quiet --out broken --set environment.command=[python3,robot.py] " + options);
  }
  bool has_results(const std::string& run) const { return std::filesystem::exists(folder_ / run / "session.h5"); }

  Folder folder_;
};

TEST_F(EnvironmentCommand, ReplaysARecordedSession) {
  const Outcome recorded = weft("run task.yaml --quiet --out recorded");
  ASSERT_EQ(recorded.code, 0) << recorded.output;
  const Outcome exported = weft("export recorded --to csv --every 12 --out replay");
  ASSERT_EQ(exported.code, 0) << exported.output;
  // The command of docs/examples/replay_environment.py.
  const std::string command = "--set environment.command=[python3,'" WEFT_SOURCE_DIR
                              "/docs/examples/replay_environment.py',replay/vertices.csv] --set knowledge=none";
  const Outcome replayed = weft("run task.yaml --out replayed " + command);
  ASSERT_EQ(replayed.code, 0) << replayed.output;
  EXPECT_THAT(replayed.output, HasSubstr("observed error"));
  const auto first = summary("recorded"), second = summary("replayed");
  EXPECT_EQ(second["shapes"], "observed");
  EXPECT_TRUE(second["true_material"].is_null());
  char iou[40];
  std::snprintf(iou, sizeof iou, "mm), IoU %.3f, ", second["silhouette_iou"].get<double>());
  EXPECT_THAT(replayed.output, HasSubstr(iou));
  std::string success = "no success within 30 mm";
  for (const int limit : {30, 20, 10})
    if (second["success_" + std::to_string(limit) + "mm"].get<bool>())
      success = ", success within " + std::to_string(limit) + " mm";
  EXPECT_THAT(replayed.output, HasSubstr(success));
  EXPECT_EQ(second["segments"], first["segments"]);
  EXPECT_EQ(second["released"], true);
  // The goal is the same, and so is the cloth, but for the digits of the CSV file.
  EXPECT_GT(first["error_mm"].get<double>(), 5.0);
  EXPECT_NEAR(second["error_mm"].get<double>(), first["error_mm"].get<double>(), 1e-3);
  // The saved config starts the command where it was first started.
  const Outcome again = weft("run replayed/config.yaml --quiet --out again");
  ASSERT_EQ(again.code, 0) << again.output;
  EXPECT_EQ(summary("again")["error_mm"], second["error_mm"]);
}

TEST_F(EnvironmentCommand, AProcessThatDiesIsNamedWithItsEnd) {
  const Outcome exited = run_with("sys.exit(3)");
  EXPECT_EQ(exited.code, 1);
  EXPECT_THAT(exited.output,
              HasSubstr("error: environment `python3 robot.py` ended with exit code 3 before it answered observe"));
  const Outcome failed = run_with("raise RuntimeError('no camera')");
  EXPECT_EQ(failed.code, 1);
  EXPECT_THAT(failed.output, AllOf(HasSubstr("RuntimeError: no camera"),  // its own stderr
                                   HasSubstr("ended with exit code 1 before it answered observe")));
  const Outcome killed = run_with("import os, signal; os.kill(os.getpid(), signal.SIGKILL)");
  EXPECT_EQ(killed.code, 1);
  EXPECT_THAT(killed.output, HasSubstr("was ended by SIGKILL (Killed) before it answered observe"));
  EXPECT_FALSE(has_results("broken"));
}

TEST_F(EnvironmentCommand, AnswersThatBreakTheProtocolAreShown) {
  const std::pair<const char*, const char*> cases[] = {
      {"print('moving ...', flush=True); time.sleep(60)",
       "answered observe with 'moving ...', must be one line of JSON"},
      {"print('{\"type\": \"executed\"}', flush=True); time.sleep(60)",
       "answered observe with type 'executed', must be 'observation'"},
      {"print('{\"type\": \"error\", \"message\": \"no cloth in view\"}', flush=True); time.sleep(60)",
       "refuses observe: no cloth in view"},
  };
  for (const auto& [then, expected] : cases) {
    const Outcome outcome = run_with(then);
    EXPECT_EQ(outcome.code, 1) << then;
    EXPECT_THAT(outcome.output, AllOf(HasSubstr("error: environment `python3 robot.py` "), HasSubstr(expected)))
        << then;
  }
  EXPECT_THAT(run_with("time.sleep(60)", "--set environment.timeout_s=0.5").output,
              HasSubstr(" within 0.5 s (environment.timeout_s)"));
  EXPECT_FALSE(has_results("broken"));
}

TEST_F(EnvironmentCommand, ACommandThatDoesNotStartIsAnErrorInTheConfig) {
  const Outcome missing = weft("run task.yaml --quiet --out broken --set environment.command=[no_such_robot]");
  EXPECT_EQ(missing.code, 2);
  EXPECT_THAT(missing.output, HasSubstr("error: --set: environment.command = [no_such_robot]: cannot be run: No such "
                                        "file or directory"));
  const Outcome script = weft("run task.yaml --quiet --out broken --set environment.command=[python3,nowhere.py]");
  EXPECT_EQ(script.code, 1);
  EXPECT_THAT(script.output,
              AllOf(HasSubstr("nowhere.py"), HasSubstr("ended with exit code 2 before it answered hello")));
  const Outcome folder = weft(
      "run task.yaml --quiet --out broken --set environment.command=[python3,x.py] --set environment.folder=nowhere");
  EXPECT_EQ(folder.code, 2);
  EXPECT_THAT(folder.output, AllOf(HasSubstr("the working folder "), HasSubstr("nowhere does not exist")));
  EXPECT_FALSE(has_results("broken"));
}

}  // namespace
}  // namespace weft
