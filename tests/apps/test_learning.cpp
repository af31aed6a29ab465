// generate, train and evaluate as people use them, on a coarse towel. After a kill at any moment the same command
// finishes the rest, and the result equals that of an uninterrupted run.
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>

#include "learning/dataset_files.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/dataset.hpp"

namespace weft {
namespace {

using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::Not;

const std::string kConfig = WEFT_SOURCE_DIR "/configs/experiments/towel_small.yaml";

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
/// Kills the command after a while, as a power cut would.
Outcome killed_command(double seconds, const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; timeout -s KILL " + std::to_string(seconds) + " '" WEFT_PROGRAM "' " +
                         arguments);
}
std::string quoted(const std::filesystem::path& path) { return "'" + path.string() + "'"; }

std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}
/// Everything in a folder whose name begins with "shard-": name and hash of the content.
std::map<std::string, std::size_t> shards_of(const std::filesystem::path& folder) {
  std::map<std::string, std::size_t> all;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const auto name = entry.path().filename().string();
    if (name.rfind("shard-", 0) == 0) all[name] = std::hash<std::string>{}(bytes_of(entry.path()));
  }
  return all;
}

TEST(Learning, GenerateTrainEvaluateSurviveBeingKilled) {
  const Folder folder;
  const auto whole = folder / "whole", parts = folder / "parts";
  const std::string generate = "generate '" + kConfig + "' --examples 72 ";
  const Outcome made = weft_command(generate + "--jobs 2 --json --out " + quoted(whole));
  ASSERT_EQ(made.code, 0) << made.output;
  EXPECT_EQ(nlohmann::json::parse(made.output).at("made"), 72);
  const auto truth = shards_of(whole);
  ASSERT_EQ(truth.size(), 5u);
  std::filesystem::create_directory(parts);
  std::ofstream(parts / "shard-00003.h5.tmp1") << "left by a run that was killed";

  // Killed again and again, in parts, with other thread counts.
  for (const double seconds : {0.3, 0.7, 1.1, 1.7})
    killed_command(seconds, generate + "--jobs 1 --out " + quoted(parts));
  EXPECT_EQ(weft_command(generate + "--shard 2/2 --jobs 3 --quiet --out " + quoted(parts)).code, 0);
  EXPECT_EQ(weft_command(generate + "--shard 1/2 --jobs 1 --quiet --out " + quoted(parts)).code, 0);
  EXPECT_EQ(shards_of(parts), truth);

  const auto info = nlohmann::json::parse(weft_command("dataset info --json " + quoted(whole)).output);
  EXPECT_EQ(info.at("examples"), 72);
  EXPECT_EQ(info.at("failed"), 0);
  EXPECT_EQ(weft_command("dataset check " + quoted(whole)).code, 0);
  std::ofstream(parts / "shard-00001.h5", std::ios::binary) << bytes_of(whole / "shard-00001.h5").substr(0, 3000);
  const Outcome damaged = weft_command("dataset check " + quoted(parts));
  EXPECT_EQ(damaged.code, 1);
  EXPECT_THAT(damaged.output, HasSubstr("shard-00001.h5"));
  // Whatever the number of threads: all damaged files, in their order.
  std::ofstream(parts / "shard-00000.h5", std::ios::binary) << "no dataset";
  const auto found_by = [&](const std::string& jobs) {
    return weft_command("dataset check --json --jobs " + jobs + " " + quoted(parts)).output;
  };
  const auto found = nlohmann::json::parse(found_by("1"));
  EXPECT_EQ(found.at("bad"), 2);
  EXPECT_THAT(found.at("problems").at(0).get<std::string>(), HasSubstr("shard-00000.h5"));
  EXPECT_THAT(found.at("problems").at(1).get<std::string>(), HasSubstr("shard-00001.h5"));
  EXPECT_EQ(found_by("4"), found_by("1"));
  EXPECT_EQ(weft_command("generate '" + kConfig + "' --examples 8 --seed 99 --out " + quoted(whole)).code, 2);

  const std::string train = "train '" + kConfig + "' --jobs 1 --quiet --data " + quoted(whole) + " --out ";
  const Outcome trained = weft_command(train + quoted(folder / "a/model.h5"));
  if (WEFT_HAS_TORCH == 0) {
    EXPECT_THAT(trained.output, HasSubstr("made without libtorch"));
    return;
  }
  ASSERT_EQ(trained.code, 0) << trained.output;
  // A fit that came to its end is not made again.
  const auto written = std::filesystem::last_write_time(folder / "a/model.h5");
  const Outcome again = weft_command("train '" + kConfig + "' --jobs 1 --data " + quoted(whole) + " --out " +
                                     quoted(folder / "a/model.h5"));
  EXPECT_EQ(again.code, 0) << again.output;
  EXPECT_THAT(again.output, HasSubstr("is fitted already; remove it to fit it again"));
  EXPECT_EQ(std::filesystem::last_write_time(folder / "a/model.h5"), written);
  // With all shapes in memory, and example by example, the fit is the same.
  const Outcome at_once = weft_command(train + quoted(folder / "m/model.h5") + " --in-memory");
  ASSERT_EQ(at_once.code, 0) << at_once.output;
  EXPECT_TRUE(bytes_of(folder / "a/model.h5") == bytes_of(folder / "m/model.h5")) << "not the same bytes";
  // Killed as soon as the first checkpoint is written.
  test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + train + quoted(folder / "b/model.h5") +
                  " & pid=$!; for i in $(seq 600); do test -e " + quoted(folder / "b/model.checkpoint.h5") +
                  " && break; sleep 0.05; done; kill -KILL $pid; wait $pid");
  const Outcome resumed = weft_command(train + quoted(folder / "b/model.h5"));
  EXPECT_EQ(resumed.code, 0) << resumed.output;
  EXPECT_TRUE(bytes_of(folder / "a/model.h5") == bytes_of(folder / "b/model.h5")) << "not the same bytes";
  const auto curve = nlohmann::json::parse(bytes_of(folder / "b/training.json"));
  EXPECT_EQ(curve.at("stopped_by"), "iterations");
  EXPECT_EQ(curve.at("curve").size(), 4u);

  const Outcome evaluated =
      weft_command("evaluate prediction '" + kConfig + "' --quiet --data " + quoted(whole) +
                   " --set predictor.params.model=" + quoted(folder / "a/model.h5") + " --out " + quoted(folder / "e"));
  ASSERT_EQ(evaluated.code, 0) << evaluated.output;
  const auto figures = nlohmann::json::parse(bytes_of(folder / "e/prediction.json"));
  const double error = figures.at("settled").at("from_start").at("mean_mm");
  EXPECT_LT(error, figures.at("baselines").at("persistence").at("mean_mm").get<double>());
  EXPECT_LT(error, figures.at("baselines").at("mean_shape").at("mean_mm").get<double>());
  // The examples are held out, and no warning says otherwise.
  EXPECT_THAT(evaluated.output, Not(HasSubstr("warning")));
  // A prediction without knowledge of the material is further off and less likely. (By how much sigma grows after 50 examples
  // depends on the last digits, and so on the processor.) Sigma is neither far too small nor so large that all lies within it.
  const auto settled = [&](const char* what, const char* figure) {
    return figures.at("settled").at(what).at(figure).get<double>();
  };
  EXPECT_GT(settled("no_knowledge", "mean_mm"), 1.05 * error);
  EXPECT_GT(settled("no_knowledge", "nll"), settled("from_start", "nll") + 0.2);
  for (const char* what : {"from_start", "from_random", "no_knowledge"}) {
    EXPECT_GT(settled(what, "coverage_1sigma"), 0.45) << what;
    EXPECT_LT(settled(what, "coverage_1sigma"), 0.9) << what;
    EXPECT_GT(settled(what, "nse"), 0.3) << what;
    EXPECT_LT(settled(what, "nse"), 5.0) << what;
  }
  for (const char* key : {"by_step", "by_step_from_random", "by_step_no_knowledge"}) {
    ASSERT_GE(figures.at(key).size(), 5u);
    for (const auto& step : figures.at(key)) {
      EXPECT_GT(step.at("n"), 0);
      for (const char* figure : {"mean_mm", "sigma_mm", "nse"}) EXPECT_GT(step.at(figure).get<double>(), 0.0) << key;
      if (step.at("n") < 5) continue;
      EXPECT_GT(step.at("coverage_1sigma").get<double>(), 0.3) << key << step;
      EXPECT_LT(step.at("coverage_1sigma").get<double>(), 0.98) << key << step;
    }
  }
  EXPECT_THAT(bytes_of(folder / "e/prediction.csv"), HasSubstr("settled.no_knowledge"));
  // Standard errors: several predictions from within one example count as one observation.
  const auto& from_start = figures.at("settled").at("from_start");
  double squares = 0.0;
  for (const auto& one : figures.at("cases")) squares += std::pow(one.at("error_mm").get<double>() - error, 2);
  const auto n = from_start.at("n").get<double>();
  EXPECT_NEAR(from_start.at("mean_mm_se").get<double>(), std::sqrt(squares) / n, 1e-9);
  EXPECT_EQ(from_start.at("examples"), from_start.at("n"));
  const auto &first = figures.at("by_step_from_random")[0], &within = figures.at("settled").at("from_random");
  EXPECT_EQ(first.at("examples"), figures.at("by_step")[0].at("n"));
  EXPECT_EQ(first.at("n"), 4 * first.at("examples").get<int>());
  EXPECT_GT(within.at("nse_se").get<double>(), 0.0);
  EXPECT_GT(within.at("coverage_1sigma_se").get<double>(), 0.0);
  for (const auto& one : figures.at("by_step")) EXPECT_EQ(one.at("nse_se").is_null(), one.at("examples") == 1);
  const auto figures_of_starts = [&](int starts, const char* name) {
    const Outcome outcome =
        weft_command("evaluate prediction '" + kConfig + "' --data " + quoted(whole) +
                     " --set predictor.params.model=" + quoted(folder / "a/model.h5") +
                     " --set evaluation.baselines=false --set evaluation.random_starts=" + std::to_string(starts) +
                     " --out " + quoted(folder / name));
    EXPECT_EQ(outcome.code, 0) << outcome.output;
    for (const char* what : {"by segments ahead", "coverage", "nse", "+-"})
      EXPECT_THAT(outcome.output, HasSubstr(what));
    return nlohmann::json::parse(bytes_of(folder / name / "prediction.json"));
  };
  const auto one_start = figures_of_starts(1, "e1"), all_starts = figures_of_starts(200, "e200");
  EXPECT_EQ(one_start.at("by_step_from_random")[0].at("n"), one_start.at("by_step")[0].at("n"));
  // All segments but each example's first: as many as there are later ones.
  int later = 0;
  for (std::size_t j = 1; j < all_starts.at("by_step").size(); ++j)
    later += all_starts.at("by_step")[j].at("n").get<int>();
  EXPECT_EQ(all_starts.at("by_step_from_random")[0].at("n"), later);
  EXPECT_EQ(all_starts.at("by_step_from_random").size(), all_starts.at("by_step").size() - 1);
  EXPECT_EQ(all_starts.at("by_step"), one_start.at("by_step"));

  // The same examples with other split fractions: the model was trained on most of their test split. Every command that
  // reads it warns, and so it does of a train split on which nobody trained.
  for (const auto& file : list_shards(whole)) {
    Shard shard = read_shard(file);
    shard.header.test_fraction = 0.5;
    std::filesystem::create_directory(folder / "resplit");
    write_shard(folder / "resplit" / file.filename(), shard);
    shard.header.identity = "fedcba9876543210";
    shard.header.seed += 1;
    std::filesystem::create_directory(folder / "other");
    write_shard(folder / "other" / file.filename(), shard);
  }
  const auto warnings = [&](const std::string& what, const std::string& data) {
    const Outcome outcome = weft_command("evaluate " + what + " --quiet --data " + quoted(folder / data) +
                                         " --set predictor.params.model=" + quoted(folder / "a/model.h5") + " --out " +
                                         quoted(folder / ("warned-" + data + what.substr(0, what.find(' ')))));
    EXPECT_EQ(outcome.code, 0) << outcome.output;
    return outcome.output;
  };
  const std::string prediction = "prediction '" + kConfig + "' --set evaluation.baselines=false";
  const std::string estimation = "estimation '" + kConfig +
                                 "' --cases 1 --goals test train --set estimation='{instances: 1, iterations: 1, "
                                 "later_iterations: 1}'";
  EXPECT_THAT(warnings(prediction, "resplit"), HasSubstr("examples of the test split may not be held out"));
  EXPECT_THAT(warnings(prediction, "other"), Not(HasSubstr("warning")));
  EXPECT_THAT(warnings(estimation, "resplit"),
              AllOf(HasSubstr("examples of the test split may not be held out"), Not(HasSubstr("was not trained on"))));
  EXPECT_THAT(warnings(estimation, "other"),
              AllOf(HasSubstr("was not trained on dataset fedcba9876543210"), Not(HasSubstr("may not be held out"))));

  // Even this model is good enough to plan with.
  const Outcome folded = weft_command(
      "run '" WEFT_SOURCE_DIR "/configs/tasks/towel_fold.yaml' --jobs 2 --json --set garment='" WEFT_SOURCE_DIR
      "/configs/garments/towel_coarse.yaml' --set planning.instances=8 --set planning.iterations=40 --set "
      "planning.replan_iterations=10 --set predictor=\"{plugin: emd, params: {model: " +
      quoted(folder / "a/model.h5") + "}}\" --out " + quoted(folder / "r"));
  ASSERT_EQ(folded.code, 0) << folded.output;
  const auto summary = nlohmann::json::parse(folded.output);
  EXPECT_LT(summary.at("error_mm").get<double>(), 0.6 * summary.at("default_error_mm").get<double>());
}

#if WEFT_HAS_TORCH && WEFT_HAS_GLOO
/// A small dataset, and a fit to compare with.
class Ranks : public ::testing::Test {
 protected:
  void SetUp() override {
    const Outcome made = weft_command("generate '" + kConfig + "' --quiet --examples 40 --out " + quoted(data_));
    ASSERT_EQ(made.code, 0) << made.output;
  }
  /// Arguments of the program.
  std::string train(const std::string& name) const {
    return "train '" + kConfig + "' --jobs 1 --data " + quoted(data_) + " --set predictor.params.training.parts=4" +
           " --set predictor.params.training.iterations=" + std::to_string(iterations_) +
           " --set predictor.params.training.evaluate_every=20 --out " + quoted(model(name));
  }
  std::filesystem::path model(const std::string& name) const { return folder_ / name / "model.h5"; }
  void expect_equal(const std::string& name, const Outcome& outcome) const {
    EXPECT_EQ(outcome.code, 0) << outcome.output;
    EXPECT_TRUE(bytes_of(model(name)) == bytes_of(model("alone"))) << name << ": not the same bytes";
    EXPECT_TRUE(bytes_of(folder_ / name / "training.json") == bytes_of(folder_ / "alone/training.json"));
    EXPECT_FALSE(std::filesystem::exists(folder_ / name / "model.checkpoint.h5"));
  }

  const Folder folder_;
  const std::filesystem::path data_ = folder_ / "data";
  int iterations_ = 40;
};

TEST_F(Ranks, OnOneMachineAndUnderLaunchersGiveTheBytesOfOneProcess) {
  ASSERT_EQ(weft_command(train("alone")).code, 0);
  const Outcome four = weft_command(train("four") + " --ranks 4");
  expect_equal("four", four);
  EXPECT_THAT(four.output, AllOf(HasSubstr("4 ranks"), HasSubstr("emd: rank 0 of 4 sent "),
                                 ContainsRegex("an exchange of the gradient took [0-9.]+ ms")));
  const Outcome wrong = weft_command(train("wrong") + " --ranks 3");
  EXPECT_EQ(wrong.code, 2);
  EXPECT_THAT(wrong.output, HasSubstr("divides a batch into 4 parts, which 3 ranks cannot share equally"));
  // On a cluster it is refused before it waits in a queue.
  std::ofstream(folder_ / "three.yaml") << "ranks: 3\n";
  const Outcome job = weft_command(train("job") + " --on slurm:" + (folder_ / "three.yaml").string() + " --dry-run");
  EXPECT_EQ(job.code, 2);
  EXPECT_THAT(job.output, HasSubstr("3 ranks cannot share equally"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "job"));

  // As srun sets its variables, on two nodes: not over loopback, where there is another interface.
  std::string started =
      "unset WEFT_PLUGIN_PATH; export SLURM_JOB_ID=7 SLURM_STEP_ID=0 SLURM_STEP_NUM_TASKS=2 "
      "SLURM_STEP_NUM_NODES=2; SLURM_PROCID=1 '" WEFT_PROGRAM "' " +
      train("slurm") + " & SLURM_PROCID=0 '" WEFT_PROGRAM "' " + train("slurm") +
      "; code=$?; wait $! || code=1; exit $code";
  expect_equal("slurm", test::run_shell(started));

  ASSERT_EQ(test::run_shell("command -v mpirun").code, 0) << "no mpirun (Debian: openmpi-bin)";
  expect_equal(
      "mpi",
      test::run_shell("unset WEFT_PLUGIN_PATH; mpirun --allow-run-as-root --oversubscribe -n 4 '" WEFT_PROGRAM "' " +
                      train("mpi")));
}

TEST_F(Ranks, ARankThatIsKilledEndsAllAndTheSameCommandGoesOn) {
  iterations_ = 200;
  ASSERT_EQ(weft_command(train("alone")).code, 0);
  // The third of four ranks is killed when the first model was written.
  const Outcome killed = test::run_shell(
      "unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + train("killed") +
      " --ranks 4 & pid=$!; for i in $(seq 1200); do test -e " + quoted(model("killed")) +
      " && break; sleep 0.05; done; for process in $(grep -lsz \"^WEFT_RANKS_PARENT=$pid\" /proc/[0-9]*/environ); do "
      "grep -qsz '^WEFT_RANK=2' $process && kill -KILL $(echo $process | tr -dc 0-9); done; wait $pid");
  EXPECT_EQ(killed.code, 1) << killed.output;
  EXPECT_THAT(killed.output, HasSubstr("rank 2 was ended by SIGKILL"));
  EXPECT_THAT(killed.output, HasSubstr("the same command goes on from the checkpoint"));
  ASSERT_TRUE(std::filesystem::exists(folder_ / "killed/model.checkpoint.h5"));
  const Outcome resumed = weft_command(train("killed") + " --ranks 2");
  EXPECT_THAT(resumed.output, HasSubstr("from the checkpoint"));
  expect_equal("killed", resumed);
}
#endif

TEST(Learning, CalibrateWritesAModelAndSaysWhatItFound) {
  const Folder folder;
  const auto known = folder / "known", fresh = folder / "fresh", model = folder / "m/model.h5";
  ASSERT_EQ(weft_command("generate '" + kConfig + "' --quiet --examples 40 --out " + quoted(known)).code, 0);
  ASSERT_EQ(weft_command("generate '" + kConfig + "' --quiet --examples 24 --seed 11 --out " + quoted(fresh)).code, 0);
  const Outcome trained =
      weft_command("train '" + kConfig + "' --quiet --set predictor.params.training.iterations=20 --data " +
                   quoted(known) + " --out " + quoted(model));
  if (WEFT_HAS_TORCH == 0) {
    EXPECT_THAT(trained.output, HasSubstr("made without libtorch"));
    return;
  }
  ASSERT_EQ(trained.code, 0) << trained.output;
  const std::string command = "calibrate '" + kConfig + "' --set predictor.params.model=" + quoted(model) + " ";
  const auto out = folder / "n/new.h5";
  const Outcome done =
      weft_command(command + "--data " + quoted(fresh) + " " + quoted(known) + " --out " + quoted(out));
  ASSERT_EQ(done.code, 0) << done.output;
  EXPECT_THAT(done.output, Not(HasSubstr("warning")));
  for (const char* row : {"from the start, known", "from the start, unknown", "within a session, known",
                          "within a session, unknown", "factor", "added mm"})
    EXPECT_THAT(done.output, HasSubstr(row));
  const auto told = nlohmann::json::parse(bytes_of(folder / "n/new.calibration.json"));
  EXPECT_EQ(told.at("model"), model.string());
  EXPECT_FALSE(told.at("provenance").at("commit").get<std::string>().empty());
  const Dataset first = load_dataset(fresh), second = load_dataset(known);
  ASSERT_EQ(told.at("datasets").size(), 2u);
  EXPECT_EQ(told.at("datasets")[0].at("identity"), first.header.identity);
  EXPECT_EQ(told.at("datasets")[0].at("examples"), 24 - first.select(Split::test).size());
  EXPECT_EQ(told.at("datasets")[1].at("examples"), second.select(Split::validation).size());
  ASSERT_EQ(told.at("rows").size(), 4u);
  for (const auto& row : told.at("rows")) {
    EXPECT_EQ(row.at("factor").size(), row.at("shapes").size());
    EXPECT_EQ(row.at("factor").size(), row.at("added_m").size());
    EXPECT_GT(row.at("predictions"), 0);
    for (const double factor : row.at("factor")) EXPECT_GT(factor, 0.0);
  }
  EXPECT_TRUE(told.at("details").at("sigma_layer").contains("held_out_loss"));
  // The same command again, with JSON output. The model that it began with does not change.
  const std::string before = bytes_of(model), made = bytes_of(out);
  const Outcome again =
      weft_command(command + "--jobs 1 --json --data " + quoted(fresh) + " " + quoted(known) + " --out " + quoted(out));
  ASSERT_EQ(again.code, 0) << again.output;
  EXPECT_EQ(nlohmann::json::parse(again.output).at("rows"), told.at("rows"));
  EXPECT_TRUE(bytes_of(out) == made) << "not the same bytes";
  EXPECT_TRUE(bytes_of(model) == before);

  // The new model works, and its file names the data of its calibration.
  const auto warnings = [&](const std::filesystem::path& of, const std::string& split) {
    const Outcome outcome = weft_command("evaluate prediction '" + kConfig + "' --quiet --data " + quoted(fresh) +
                                         " --set evaluation.baselines=false --set evaluation.split=" + split +
                                         " --set predictor.params.model=" + quoted(of) + " --out " +
                                         quoted(folder / ("e-" + split + "-" + of.stem().string())));
    EXPECT_EQ(outcome.code, 0) << outcome.output;
    return outcome.output;
  };
  EXPECT_THAT(warnings(out, "train"), HasSubstr("its sigma was calibrated on"));
  EXPECT_THAT(warnings(model, "train"), Not(HasSubstr("calibrated on")));
  EXPECT_THAT(warnings(out, "test"), Not(HasSubstr("warning")));
  EXPECT_THAT(warnings(out, "all"), HasSubstr("of the 24 examples may be those that its sigma was calibrated on"));
  EXPECT_THAT(warnings(model, "all"), Not(HasSubstr("warning")));
  const auto every = nlohmann::json::parse(bytes_of(folder / ("e-all-" + model.stem().string()) / "prediction.json"));
  EXPECT_EQ(every.at("by_step")[0].at("n"), 24);
  // All of several datasets are read.
  const Outcome both =
      weft_command("evaluate prediction '" + kConfig + "' --quiet --data " + quoted(fresh) + " " + quoted(known) +
                   " --set evaluation.baselines=false --set evaluation.split=all " +
                   "--set predictor.params.model=" + quoted(model) + " --out " + quoted(folder / "e2"));
  EXPECT_THAT(both.output, HasSubstr("of the 64 examples may not be held out"));
  EXPECT_EQ(nlohmann::json::parse(bytes_of(folder / "e2/prediction.json")).at("by_step")[0].at("n"), 64);
  // The lookup never finds the queried example itself.
  const Outcome baselines = weft_command("evaluate prediction '" + kConfig + "' --quiet --data " + quoted(fresh) +
                                         " --set evaluation.split=all --set predictor.params.model=" + quoted(model) +
                                         " --out " + quoted(folder / "e3"));
  EXPECT_EQ(baselines.code, 0) << baselines.output;
  const auto found = nlohmann::json::parse(bytes_of(folder / "e3/prediction.json")).at("baselines");
  EXPECT_TRUE(found.contains("persistence"));
  EXPECT_FALSE(found.contains("nearest_example"));

  // Bad input gives a message of one line, and no file is written.
  const auto refused = [&](const std::string& arguments) {
    const Outcome outcome = weft_command(arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    const auto at = outcome.output.find("error: ");
    EXPECT_NE(at, std::string::npos) << outcome.output;
    EXPECT_EQ(outcome.output.find('\n', at), outcome.output.size() - 1) << outcome.output;
    return outcome.output;
  };
  const std::string with_fresh = command + "--data " + quoted(fresh);
  EXPECT_THAT(refused(with_fresh), HasSubstr("--out MODEL is required"));
  EXPECT_THAT(refused(with_fresh + " --out " + quoted(folder / "x")), HasSubstr("must end in .h5"));
  EXPECT_THAT(refused(command + "--out " + quoted(folder / "x.h5")), HasSubstr("--data FOLDER is required"));
  EXPECT_THAT(refused(with_fresh + " --out " + quoted(model)), HasSubstr("is the model to calibrate"));
  EXPECT_THAT(refused(with_fresh + " --out " + quoted(model / "x.h5")),
              HasSubstr("its folder cannot be made: it is a file"));
  std::filesystem::create_directory(folder / "folder.h5");
  EXPECT_THAT(refused(with_fresh + " --out " + quoted(folder / "folder.h5")), HasSubstr("is a folder"));
  const std::string to_x = " --out " + quoted(folder / "x.h5");
  EXPECT_THAT(refused(command + "--data " + quoted(folder / "none") + to_x), HasSubstr("is not a folder"));
  EXPECT_THAT(refused(command + "--data " + quoted(fresh) + " " + quoted(fresh) + to_x), HasSubstr("the same one"));
  EXPECT_THAT(refused("calibrate '" + kConfig + "' --data " + quoted(fresh) + to_x), HasSubstr("needs a model file"));
  EXPECT_THAT(
      refused("calibrate '" + kConfig + "' --set predictor.params.model=none.h5 --data " + quoted(fresh) + to_x),
      HasSubstr("none.h5"));
  EXPECT_THAT(refused("calibrate '" + kConfig + "' --set predictor='{plugin: rollout}' --data " + quoted(fresh) + to_x),
              HasSubstr("does not learn"));
  EXPECT_THAT(refused(with_fresh + to_x + " --set garment='" WEFT_SOURCE_DIR "/configs/garments/towel.yaml'"),
              HasSubstr("was trained for the garment"));
  // The data of the training, without the validation split.
  ASSERT_EQ(weft_command("dataset split " + quoted(known) + " --out " + quoted(folder / "s")).code, 0);
  EXPECT_THAT(refused(command + "--data " + quoted(fresh) + " " + quoted(folder / "s/train") + to_x),
              HasSubstr("s/train: outside its test split it holds only examples that the model was trained on"));
  EXPECT_FALSE(std::filesystem::exists(folder / "x.h5"));
  EXPECT_FALSE(std::filesystem::exists(folder / "x.calibration.json"));
}

/// The contents of all files in a folder, by name.
std::map<std::string, std::string> tree_of(const std::filesystem::path& folder) {
  std::map<std::string, std::string> all;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder))
    if (entry.is_regular_file()) all[std::filesystem::relative(entry.path(), folder).string()] = bytes_of(entry.path());
  return all;
}

/// train, calibrate and evaluate prediction of the same names, with other examples: refused by name, and nothing changes.
TEST(Learning, AUsedFolderIsNotContinuedWithOtherExamples) {
  const Folder folder;
  const auto data = folder / "data", calibration = folder / "calibration", model = folder / "m/model.h5";
  const auto generate = [&](const std::filesystem::path& to, int seed) {
    std::filesystem::remove_all(to);
    ASSERT_EQ(weft_command("generate '" + kConfig + "' --quiet --examples 24 --seed " + std::to_string(seed) +
                           " --out " + quoted(to))
                  .code,
              0);
  };
  generate(data, 1);
  generate(calibration, 2);
  const std::string with_model =
      "'" + kConfig + "' --set predictor.params.model=" + quoted(model) + " --data " + quoted(calibration) + " --out ";
  const std::string commands[] = {"train '" + kConfig + "' --set predictor.params.training.iterations=20 --data " +
                                      quoted(data) + " --out " + quoted(model),
                                  "calibrate " + with_model + quoted(folder / "c/model.h5"),
                                  "evaluate prediction " + with_model + quoted(folder / "e")};
  for (const std::string& command : commands) {
    const Outcome done = weft_command(command + " --quiet");
    if (WEFT_HAS_TORCH == 0) {
      EXPECT_THAT(done.output, HasSubstr("made without libtorch"));
      return;
    }
    ASSERT_EQ(done.code, 0) << command << done.output;
  }
  generate(data, 3);
  generate(calibration, 4);
  for (const std::string& command : commands) {
    const auto before = tree_of(folder.path());
    const Outcome refused = weft_command(command + " --quiet");
    EXPECT_EQ(refused.code, 2) << command << refused.output;
    EXPECT_THAT(refused.output, AllOf(HasSubstr("holds results that belong to something else"), HasSubstr("data"),
                                      HasSubstr("--accept-changed")))
        << command;
    EXPECT_TRUE(tree_of(folder.path()) == before) << command << " changed the disk";
  }
}

TEST(Learning, ADatasetOfAnEarlierVersionGoesOnWhereThatIsAccepted) {
  const Folder folder;
  const auto data = folder / "data";
  const std::string generate = "generate '" + kConfig + "' --quiet --out " + quoted(data);
  ASSERT_EQ(weft_command(generate + " --examples 16").code, 0);
  Shard shard = read_shard(data / "shard-00000.h5");
  const std::string added = "    inertia_length_m: 0\n";
  const auto at = shard.header.config.find(added);
  ASSERT_NE(at, std::string::npos);
  const std::string earlier = shard.header.config.erase(at, added.size());
  shard.header.identity = "0123456789abcdef";
  shard.header.provenance = R"({"weft": "0.1.0", "commit": "1906723"})";  // which recorded no identity
  write_shard(data / "shard-00000.h5", shard);
  std::ofstream(data / "config.yaml", std::ios::binary) << earlier;

  const Outcome refused = weft_command(generate + " --examples 18");
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.output, HasSubstr("made by an earlier version of weft"));
  EXPECT_FALSE(std::filesystem::exists(data / "shard-00001.h5"));
  const Outcome more = weft_command(generate + " --examples 18 --accept-changed");
  ASSERT_EQ(more.code, 0) << more.output;
  for (const char* file : {"shard-00000.h5", "shard-00001.h5"})
    EXPECT_EQ(read_shard(data / file).header.identity, "0123456789abcdef") << file;
  EXPECT_THAT(weft_command("dataset info " + quoted(data)).output, HasSubstr("MIXED: 16 examples belong to"));
  EXPECT_EQ(weft_command("dataset check " + quoted(data)).code, 0);
  // Another value makes another dataset, with or without a later default. The folder does not change.
  const Outcome other = weft_command(generate + " --examples 34 --set simulator.params.settle_damping_per_s=7");
  EXPECT_EQ(other.code, 2);
  EXPECT_THAT(other.output, HasSubstr("made by an earlier version of weft"));
  EXPECT_EQ(bytes_of(data / "config.yaml"), earlier);
}

TEST(Learning, WrongUseSaysWhy) {
  const Folder folder;
  const auto refused = [&](const std::string& arguments) {
    const Outcome outcome = weft_command(arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    return outcome.output;
  };
  EXPECT_THAT(refused("generate '" + kConfig + "' --examples 4"), HasSubstr("--out FOLDER is required"));
  EXPECT_THAT(refused("generate '" + kConfig + "' --examples 4 --shard 0/2 --out " + quoted(folder / "d")),
              HasSubstr("--shard = 0/2, must be i/n"));
  EXPECT_THAT(refused("train '" + kConfig + "' --out " + quoted(folder / "m")), HasSubstr("must end in .h5"));
  EXPECT_THAT(
      refused("train '" + kConfig + "' --data " + quoted(folder / "none") + " --out " + quoted(folder / "m.h5")),
      HasSubstr("is not a folder"));
  EXPECT_THAT(
      refused("train '" + kConfig + "' --set predictor='{plugin: rollout}' --data x --out " + quoted(folder / "m.h5")),
      HasSubstr("does not learn"));
  EXPECT_THAT(refused("evaluate prediction '" + kConfig + "' --data x"), HasSubstr("needs a model file"));
}

}  // namespace
}  // namespace weft
