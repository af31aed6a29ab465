// What a crash, a hang or a call of exit() in a plugin costs: one cell, and a message that names the plugin.
#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

const std::string kTask = "garment: " WEFT_SOURCE_DIR
                          "/configs/garments/towel_coarse.yaml\n"
                          "material: " WEFT_SOURCE_DIR
                          "/configs/fabrics/basic.yaml\n"
                          "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
                          "predictor: {plugin: rollout}\n"
                          "goal: {random: {min_distance_mm: 10}}\n"
                          "settle: {max_frames: 30}\n"
                          "planning: {instances: 1, iterations: 1, replan_iterations: 0, horizon: 12}\n";

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("WEFT_PLUGIN_PATH='" WEFT_BAD_PLUGINS "' '" WEFT_PROGRAM "' " + arguments);
}
std::string misbehaving(const std::string& how) { return "{plugin: misbehaves, params: {how: " + how + "}}"; }

TEST(Isolation, RunNamesThePluginAndTheCall) {
  const Folder folder;
  const auto task = folder.write("task.yaml", kTask + "optimiser: {plugin: rprop}\n");
  const auto run = [&](const std::string& how) {
    return weft_command("run '" + task.string() + "' --quiet --out '" + (folder / "out").string() +
                        "' --set optimiser='" + misbehaving(how) + "'");
  };
  const Outcome segv = run("segv");
  EXPECT_EQ(segv.code, 128 + 11) << segv.output;
  EXPECT_THAT(segv.output, AllOf(HasSubstr("error: SIGSEGV"), HasSubstr("plugin optimiser misbehaves"),
                                 HasSubstr("write_nowhere"), HasSubstr("minimise()")));
  const Outcome overflow = run("overflow");
  EXPECT_THAT(overflow.output, AllOf(HasSubstr("error: SIGSEGV"), HasSubstr("plugin optimiser misbehaves")));
  for (const std::string call : {"exit", "_exit", "_Exit", "quick_exit"}) {
    const Outcome left = run(call);
    EXPECT_EQ(left.code, 1) << left.output;
    EXPECT_THAT(left.output, AllOf(HasSubstr("error: a call of " + call + "(0) in plugin optimiser misbehaves"),
                                   HasSubstr("Misbehaves::minimise"), HasSubstr("minimise()")));
  }
  EXPECT_THAT(run("fork").output, AllOf(HasSubstr("the forked process ended with 7"), Not(HasSubstr("a call of"))));
  EXPECT_THAT(run("abort").output, AllOf(HasSubstr("error: SIGABRT"), HasSubstr("plugin optimiser misbehaves")));
  const Outcome thrown = run("throw");
  EXPECT_EQ(thrown.code, 1);
  EXPECT_THAT(thrown.output, AllOf(HasSubstr("misbehaves"), HasSubstr("not a std::exception")));
}

/// The first ^C is answered at once; a plugin that does not come back is named by the second one, which ends weft.
TEST(Isolation, RunNamesThePluginThatKeepsItFromStopping) {
  const Folder folder;
  const auto task = folder.write("task.yaml", kTask + "optimiser: " + misbehaving("loop") + "\n");
  const std::string out = (folder / "out").string();
  for (const auto& [signal, code] : {std::pair("INT", 128 + 2), std::pair("TERM", 128 + 15)}) {
    Outcome outcome;
    for (const char* pause : {"0.5", "1", "2", "4", "8"}) {  // until the goal is made, which takes hardly any time
      outcome = test::run_shell("WEFT_PLUGIN_PATH='" WEFT_BAD_PLUGINS "' '" WEFT_PROGRAM "' run '" + task.string() +
                                "' --quiet --out '" + out + "' 2>'" + out + ".txt' & weft=$!\nsleep " + pause +
                                "; kill -" + signal + " $weft; until grep -q 'stopping; ' '" + out +
                                ".txt' || ! kill -0 $weft; do sleep 0.02; done\nsleep 0.2; kill -" + signal +
                                " $weft; wait $weft; code=$?; cat '" + out + ".txt'; exit $code");
      std::filesystem::remove_all(out);
      if (outcome.output.find("turn_for_ever") != std::string::npos) break;
    }
    EXPECT_EQ(outcome.code, code) << outcome.output;
    EXPECT_THAT(outcome.output,
                AllOf(HasSubstr("stopping; ^C or SIGTERM once more ends weft at once"),
                      HasSubstr(std::string("error: SIG") + signal), HasSubstr("plugin optimiser misbehaves"),
                      HasSubstr("turn_for_ever"), HasSubstr("minimise()")));
  }
}

TEST(Isolation, CostsItsCellOnly) {
  const Folder folder;
  folder.write("task.yaml", kTask);
  std::string factors = "task: task.yaml\nseeds: [1]\nfactors:\n  optimiser:\n    good: {optimiser: {plugin: rprop}}\n";
  for (const char* how : {"segv", "abort", "exit", "_exit", "throw", "thread_throws", "loop"})
    factors += std::string("    ") + how + ": {optimiser: " + misbehaving(how) + "}\n";
  const auto file = folder.write("ablation.yaml", factors);
  const std::string command = "ablate '" + file.string() + "' --out '" + (folder / "out").string() + "' --jobs 2 ";
  const Outcome first = weft_command(command + "--cell-limit 3 --quiet");
  EXPECT_EQ(first.code, 1);
  EXPECT_THAT(first.output,
              HasSubstr("warning: 7 of 8 cells failed: 1 refused, 5 crashed, 1 hung; --retry-failed tries 6 of "
                        "them again, --retry-failed=all tries all of them\n"));
  std::ifstream stream(folder / "out/ablation.json");
  const auto json = nlohmann::json::parse(stream);
  const auto failure = [&](const std::string& name) {
    for (const auto& arm : json.at("arms"))
      if (arm.at("name") == name && arm.at("failed").size() == 1) return arm.at("failed").at(0);
    return nlohmann::json{{"status", "done"}, {"failure", ""}};
  };
  const auto text = [&](const std::string& name) {
    return failure(name).at("status").get<std::string>() + ": " + failure(name).at("failure").get<std::string>();
  };
  EXPECT_EQ(text("good"), "done: ");
  const auto blamed = HasSubstr("plugin optimiser misbehaves");
  EXPECT_THAT(text("segv"),
              AllOf(HasSubstr("crashed: SIGSEGV"), blamed, HasSubstr("write_nowhere"), HasSubstr("minimise")));
  EXPECT_THAT(text("abort"), AllOf(HasSubstr("crashed: SIGABRT"), blamed));
  EXPECT_THAT(text("exit"), AllOf(HasSubstr("crashed: a call of exit(0)"), blamed));
  EXPECT_THAT(text("_exit"), AllOf(HasSubstr("crashed: a call of _exit(0)"), blamed, HasSubstr("minimise")));
  EXPECT_THAT(text("throw"), AllOf(HasSubstr("refused: "), HasSubstr("misbehaves")));
  EXPECT_THAT(text("thread_throws"), AllOf(HasSubstr("crashed: SIGABRT"), blamed, HasSubstr("from a thread")));
  EXPECT_THAT(text("loop"), AllOf(HasSubstr("hung: used 3 s of CPU time"), blamed, HasSubstr("turn_for_ever")));

  // Nothing is run again unless it is asked for; then what crashed or hung is, and what was refused is not.
  const Outcome again = weft_command(command);
  EXPECT_EQ(again.code, 1);
  EXPECT_THAT(again.output, Not(HasSubstr("/8  ")));
  const Outcome retried = weft_command(command + "--retry-failed --cell-limit 3");
  EXPECT_EQ(retried.code, 1);
  EXPECT_THAT(retried.output, AllOf(HasSubstr("8/8  "), HasSubstr("segv, seed 1: crashed: SIGSEGV"),
                                    Not(HasSubstr("throw, seed 1: refused")), Not(HasSubstr("good, seed 1"))));
  const Outcome all = weft_command(command + "--retry-failed=all --fail-fast --cell-limit 3");
  EXPECT_EQ(all.code, 1);
  EXPECT_THAT(all.output, HasSubstr("interrupted; run the same command again"));
}

Outcome with_toys(const std::string& arguments) {
  return test::run_shell("WEFT_PLUGIN_PATH='" WEFT_TOYS "' '" WEFT_PROGRAM "' " + arguments);
}
nlohmann::json read_json(const std::filesystem::path& file) {
  std::ifstream stream(file);
  return nlohmann::json::parse(stream);
}

TEST(Isolation, EvaluatePhysicsLosesItsCaseOnly) {
  const Folder folder;
  const auto file = folder.write("physics.yaml",
                                 "extends: task.yaml\nsimulator: {plugin: toy_simulator}\n"
                                 "physics: {tests: [free fall, hanging], garment_edge_m: 0.05}\n");
  // The toy has one stiffness for warp and weft.
  folder.write("task.yaml", std::regex_replace(kTask, std::regex("basic.yaml"), "basic_isotropic.yaml") +
                                "optimiser: {plugin: rprop}\n");
  const auto evaluate = [&](const std::string& fault, const std::string& more) {
    return with_toys("evaluate physics '" + file.string() + "' --jobs 2 --out '" + (folder / fault).string() +
                     "' --set simulator.params.fault=" + fault + " --accept-changed " + more);
  };
  const Outcome segv = evaluate("null_pointer", "");
  EXPECT_EQ(segv.code, 1) << segv.output;
  const auto rows = read_json(folder / "null_pointer/physics.json").at("rows");
  std::size_t crashed = 0;
  for (const auto& row : rows) {
    if (row.at("quantity") != "crashed") continue;
    ++crashed;
    EXPECT_FALSE(row.at("passed").get<bool>());
    EXPECT_THAT(row.at("note").get<std::string>(),
                AllOf(HasSubstr("SIGSEGV"), HasSubstr("plugin simulator toy_simulator")));
  }
  // The toy falls, and refuses the fabric of the other case, which so is not lost.
  EXPECT_EQ(crashed, 1u) << rows;
  EXPECT_GT(rows.size(), 1u);
  const Outcome spins = evaluate("spin", "--quiet --cell-limit 1 --set 'physics.tests=[free fall]'");
  EXPECT_EQ(spins.code, 1) << spins.output;
  EXPECT_EQ(read_json(folder / "spin/physics.json").at("rows").at(0).at("quantity"), "hung");
}

TEST(Isolation, EvaluatePredictionLosesItsBatchOnly) {
  const Folder folder;
  const auto file = folder.write("experiment.yaml", "extends: " WEFT_SOURCE_DIR
                                                    "/configs/experiments/towel_small.yaml\n"
                                                    "predictor: {plugin: toy_predictor, params: {}}\n");
  const std::string data = (folder / "data").string();
  ASSERT_EQ(with_toys("generate '" + file.string() + "' --examples 8 --quiet --out '" + data + "'").code, 0);
  const auto evaluate = [&](const std::string& out, const std::string& more) {
    return with_toys("evaluate prediction '" + file.string() + "' --data '" + data + "' --out '" +
                     (folder / out).string() + "' --set evaluation.split=all --set evaluation.batch=4 " + more);
  };
  // The same numbers in a child process and in this one.
  ASSERT_EQ(evaluate("child", "--quiet").code, 0);
  ASSERT_EQ(evaluate("here", "--quiet --in-process").code, 0);
  EXPECT_EQ(read_json(folder / "child/prediction.json"), read_json(folder / "here/prediction.json"));
  const Outcome crashed = evaluate("crashed", "--set predictor.params.fault=null_pointer");
  EXPECT_EQ(crashed.code, 1) << crashed.output;
  EXPECT_THAT(crashed.output,
              AllOf(HasSubstr("4 cases crashed: SIGSEGV"), HasSubstr("plugin predictor toy_predictor")));
  const auto json = read_json(folder / "crashed/prediction.json");
  EXPECT_EQ(json.at("failures").at(0).at("status"), "crashed");
  EXPECT_GE(json.at("failed").get<int>(), 16);
  const Outcome spins = evaluate("spins",
                                 "--quiet --cell-limit 1 --set evaluation.max_examples=1 "
                                 "--set evaluation.random_starts=1 --set predictor.params.fault=spin");
  EXPECT_EQ(spins.code, 1) << spins.output;
  EXPECT_EQ(read_json(folder / "spins/prediction.json").at("failures").at(0).at("status"), "hung");
}

}  // namespace
}  // namespace weft
