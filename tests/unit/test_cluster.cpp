#include <sys/stat.h>

#include "cluster/job_scripts.hpp"
#include "cluster/job_states.hpp"
#include "cluster/profile.hpp"
#include "cluster/submission.hpp"
#include "sdk/files.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/config.hpp"

// What needs no Slurm. tests/cluster has the rest, with a real one.

namespace weft {
namespace {

using test::Folder;
using test::message_of;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

TEST(ClusterProfile, IsLookedForInFoldersInOrder) {
  const Folder folder;
  folder.write("first/short.yaml", "time_limit_min: 5\n");
  folder.write("second/short.yaml", "time_limit_min: 6\n");
  folder.write("second/long.yaml", "time_limit_min: 7\n");
  const std::vector<std::filesystem::path> folders = {folder / "none", folder / "first", folder / "second"};
  EXPECT_EQ(read_cluster_choice("slurm:short", folders).profile.time_limit_min, 5);
  EXPECT_EQ(read_cluster_choice("slurm:long", folders).profile.time_limit_min, 7);
  EXPECT_EQ(read_cluster_choice("slurm:" + (folder / "second/short.yaml").string(), folders).profile.time_limit_min, 6);
  EXPECT_EQ(read_cluster_choice("slurm", folders).profile.time_limit_min, 0);  // no default.yaml: all defaults
  folder.write("second/default.yaml", "cpus: 8\n");
  EXPECT_EQ(read_cluster_choice("slurm", folders).profile.cpus, 8);
  EXPECT_THAT(message_of<ConfigError>([&] { read_cluster_choice("slurm:shrot", folders); }),
              AllOf(HasSubstr("no profile is called shrot"), HasSubstr("there are: default, long, short"),
                    HasSubstr("nearest: short")));
  EXPECT_THAT(message_of<ConfigError>([&] { read_cluster_choice("pbs", folders); }), HasSubstr("must be slurm"));
  EXPECT_THAT(message_of<ConfigError>([&] { read_cluster_choice("slurm:", folders); }), HasSubstr("after the colon"));
}

TEST(ClusterProfile, WrongKeysAreRefusedWithTheirLine) {
  const Folder folder;
  const auto refused = [&](const std::string& text) {
    folder.write("p.yaml", text);
    return message_of<ConfigError>([&] { read_cluster_choice("slurm:p", {folder.path()}); });
  };
  EXPECT_THAT(refused("cpus: 4\npartiton: short\n"), AllOf(HasSubstr("p.yaml:2"), HasSubstr("nearest: partition")));
  EXPECT_THAT(refused("cpus: 0\n"), HasSubstr("must be in [1, 1024]"));
  EXPECT_THAT(refused("sbatch: [exclusive]\n"), AllOf(HasSubstr("sbatch.0"), HasSubstr("an option of sbatch")));
  EXPECT_THAT(refused("environment: [OMP_NUM_THREADS]\n"), HasSubstr("NAME=VALUE"));
  EXPECT_THAT(refused("environment: ['1A=b']\n"), HasSubstr("NAME=VALUE"));
  EXPECT_THAT(refused("account: \"a\\n#SBATCH --mem=0\"\n"), HasSubstr("one line"));
  EXPECT_THAT(refused("time_limit_min: 1\ngrace_s: 60\n"), HasSubstr("must be less than time_limit_min"));
}

TEST(ClusterProfile, ThoseThatShipAreRead) {
  const std::filesystem::path folder = WEFT_SOURCE_DIR "/configs/slurm";
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    EXPECT_FALSE(read_cluster_choice("slurm:" + entry.path().string(), {}).profile.description.empty()) << entry.path();
}

ClusterWork sweep_of(const std::filesystem::path& results, std::int64_t total, std::int64_t left) {
  ClusterWork work;
  work.command = work.label = "ablate";
  work.results = results;
  work.arguments = {"ablate", "it's here.yaml", "--out", results.string()};
  work.files = {"cells", {"cells"}, "seed", ".json", ".times.json", {}};
  work.total = total;
  work.left = left;
  return work;
}

TEST(JobScripts, SayWhatTheProfileSays) {
  const Folder folder;
  ClusterChoice choice;
  ClusterProfile& p = choice.profile;
  p.partition = "short";
  p.time_limit_min = 30;
  p.memory_mb = 4000;
  p.cpus = 4;
  p.tasks = 8;
  p.tasks_at_a_time = 3;
  p.sbatch = {"--exclude=n7"};
  p.modules = {"gcc/12"};
  p.environment = {"NOTE=a b"};
  p.setup = {"ulimit -c 0"};
  p.container = "apptainer exec weft.sif";
  p.program = "weft";
  const Submission submission(sweep_of(folder / "100%", 20, 20), choice, "/opt/weft");
  EXPECT_EQ(submission.tasks, 8);
  const std::string task = submission.scripts.text(JobKind::task, submission.tasks);
  EXPECT_THAT(task,
              AllOf(HasSubstr("#SBATCH --partition=short\n"), HasSubstr("#SBATCH --time=30\n"),
                    HasSubstr("#SBATCH --mem=4000\n"), HasSubstr("#SBATCH --cpus-per-task=4\n"),
                    HasSubstr("#SBATCH --array=1-8%3\n"), HasSubstr("#SBATCH --exclude=n7\n"),
                    HasSubstr("#SBATCH --signal=B:TERM@60\n"), HasSubstr("/100%%/slurm/ablate/logs/task-%A_%a.log")));
  EXPECT_THAT(task, AllOf(HasSubstr("module load gcc/12 || fail 'module load gcc/12 failed'\n"),
                          HasSubstr("export NOTE='a b'\n"), HasSubstr("ulimit -c 0\n"),
                          HasSubstr("apptainer exec weft.sif weft ablate 'it'\\''s here.yaml' --out"),
                          HasSubstr(" --share; }")));
  EXPECT_THAT(submission.scripts.text(JobKind::merge), AllOf(Not(HasSubstr("--share")), Not(HasSubstr("--array"))));
  EXPECT_THAT(submission.scripts.text(JobKind::report),
              AllOf(HasSubstr("#SBATCH --time=10\n"), HasSubstr("weft status "), Not(HasSubstr("--signal"))));
  // Never more tasks than units of work.
  EXPECT_EQ(Submission(sweep_of(folder / "100%", 20, 3), choice, "/opt/weft").tasks, 3);
}

TEST(JobScripts, RanksAreStartedBySrun) {
  const Folder folder;
  ClusterChoice choice;
  choice.profile.ranks = 4;
  ClusterWork work;
  work.command = work.label = "train";
  work.results = folder.path();
  work.arguments = {"train", "x.yaml"};
  work.files.result = folder / "model.h5";
  work.has_ranks = true;
  EXPECT_THAT(Submission(work, choice, "/opt/weft").scripts.text(JobKind::task),
              AllOf(HasSubstr("#SBATCH --ntasks=4\n"), HasSubstr("exec srun /opt/weft train x.yaml; }"),
                    HasSubstr("export SRUN_CPUS_PER_TASK=${SLURM_CPUS_PER_TASK:-1}\n"),
                    HasSubstr("scancel --quiet --signal=TERM \"$id\"")));
  work.has_ranks = false;
  EXPECT_THAT(Submission(work, choice, "/opt/weft").scripts.text(JobKind::task),
              AllOf(HasSubstr("#SBATCH --ntasks=1\n"), HasSubstr("exec /opt/weft train x.yaml; }"),
                    Not(HasSubstr("SRUN_CPUS_PER_TASK"))));
}

/// Runs the script of a task in which weft is a shell script, and Slurm's commands write down how they were called.
class TaskScript {
 public:
  explicit TaskScript(const std::string& weft, ClusterProfile profile = {}) {
    executable("bin/weft", weft);
    executable("bin/scontrol", "echo scontrol \"$@\" >>" + (folder_ / "calls").string() + "; exit 0\n");
    executable("bin/squeue", "echo ${STATE-RUNNING}\n");
    // It signals the processes of a step, and not the script.
    executable("bin/scancel", "echo scancel \"$@\" >>" + (folder_ / "calls").string() +
                                  "\ncase \"$*\" in *--signal=TERM*) kill -TERM $(cat " +
                                  (folder_ / "weft.pid").string() + ");; esac\n");
    executable("bin/srun", "echo $$ >" + (folder_ / "weft.pid").string() +
                               "\ntrap 'kill -KILL $child; exit 137' TERM\n\"$@\" & child=$!\necho $child >" +
                               (folder_ / "weft.pid").string() + "\nwait $child\n");
    executable("bin/sleep", "exit 0\n");
    ClusterChoice choice;
    choice.profile = std::move(profile);
    choice.profile.restarts = 2;
    const Submission submission(sweep_of(folder_ / "out", 4, 4), choice, (folder_ / "bin/weft").string());
    std::filesystem::create_directories(folder_ / "out/slurm/ablate/tasks");
    folder_.write("array.sh", submission.scripts.text(JobKind::task, 4));
  }
  test::Outcome run(const std::string& variables = "") const {
    return test::run_shell("export PATH='" + (folder_ / "bin").string() +
                           "':\"$PATH\" SLURM_ARRAY_JOB_ID=12 SLURM_ARRAY_TASK_ID=3 SLURMD_NODENAME=n2 " + variables +
                           "; bash '" + (folder_ / "array.sh").string() + "'");
  }
  /// The script waits between the start of weft and the next line.
  test::Outcome run_slowly() const {
    folder_.write("slow.sh", "trap 'case $BASH_COMMAND in child=*!) /bin/sleep 0.5;; esac' DEBUG\n");
    return run("BASH_ENV='" + (folder_ / "slow.sh").string() + "'");
  }
  std::string calls() const { return text("calls"); }
  std::string record() const { return text("out/slurm/ablate/tasks/12_3.txt"); }

 private:
  void executable(const std::string& name, const std::string& text) const {
    chmod(folder_.write(name, "#!/bin/bash\n" + text).c_str(), 0755);
  }
  std::string text(const std::string& name) const {
    std::ifstream stream(folder_ / name);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  Folder folder_;
};

TEST(TaskScript, EndsAsWeftEnds) {
  const TaskScript done("exit 0\n");
  EXPECT_EQ(done.run().code, 0);
  EXPECT_EQ(done.calls(), "scancel --quiet --state=PENDING 12\n");
  EXPECT_EQ(done.record(), "began restart=0 node=n2\nended code=0 stops=0 node=n2\n");
  const TaskScript others("exit 3\n");
  EXPECT_EQ(others.run().code, 0);
  EXPECT_THAT(others.calls(), IsEmpty());
  const TaskScript failed("exit 2\n");
  EXPECT_EQ(failed.run().code, 2);
  EXPECT_THAT(failed.calls(), IsEmpty());
}

TEST(TaskScript, PassesTheSignalOnAndGoesBackToTheQueue) {
  const TaskScript stopped(
      "trap 'echo stopping; exit 75' TERM\nkill -TERM $PPID\nfor i in $(seq 500); do /bin/sleep 0.02; done\n");
  const auto outcome = stopped.run();
  EXPECT_EQ(outcome.code, 75) << outcome.output;  // Slurm would have ended it
  EXPECT_THAT(outcome.output, HasSubstr("stopping"));
  EXPECT_THAT(stopped.calls(), HasSubstr("scontrol requeue 12_3\n"));
  EXPECT_THAT(stopped.record(), HasSubstr("ended code=75 stops=1 node=n2\nrequeued node=n2\n"));
  // scancel sends the same signal.
  const TaskScript cancelled("exit 75\n");
  EXPECT_EQ(cancelled.run("STATE=COMPLETING").code, 75);
  EXPECT_THAT(cancelled.calls(), IsEmpty());
  EXPECT_THAT(cancelled.record(), Not(HasSubstr("requeued")));
  const TaskScript tired("exit 75\n");
  EXPECT_EQ(tired.run("SLURM_RESTART_COUNT=2").code, 1);
  EXPECT_THAT(tired.calls(), IsEmpty());
  EXPECT_THAT(tired.record(), HasSubstr("gave-up restarts=2"));
}

TEST(TaskScript, DoesNotForgetASignalThatComesWhileWeftStarts) {
  const TaskScript stopped(
      "trap 'echo stopping; exit 75' TERM\nkill -TERM $PPID\nfor i in $(seq 500); do /bin/sleep 0.02; done\n");
  const auto outcome = stopped.run_slowly();
  EXPECT_EQ(outcome.code, 75) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("stopping"));
}

TEST(TaskScript, AsksTheProcessesOfSrunToEndAndDoesNotKillThem) {
  ClusterProfile profile;
  profile.launcher = "srun";
  // PPID is srun, whose parent is the script.
  const TaskScript stopped(
      "trap 'echo stopping; exit 75' TERM\nkill -TERM $(ps -o ppid= -p $PPID)\nfor i in $(seq 500); do /bin/sleep 0.02; "
      "done\n",
      profile);
  const auto outcome = stopped.run();
  EXPECT_EQ(outcome.code, 75) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("stopping"));
  EXPECT_THAT(stopped.calls(), HasSubstr("scancel --quiet --signal=TERM 12_3\nscontrol requeue 12_3\n"));
  EXPECT_THAT(stopped.record(), HasSubstr("ended code=75 stops=1 node=n2\nrequeued node=n2\n"));
}

TEST(TaskScript, ModulesAndLinesOfTheProfile) {
  ClusterProfile profile;
  profile.setup = {"if [ -z \"$NEVER_SET\" ]; then export FOUND=it; fi"};  // as conda's scripts do
  const TaskScript good("[ \"$FOUND\" = it ]\n", profile);
  EXPECT_EQ(good.run().code, 0);
  profile.modules = {"no-such-module/0"};
  const TaskScript bad("exit 0\n", profile);
  const auto outcome = bad.run();
  EXPECT_EQ(outcome.code, 1);
  EXPECT_THAT(outcome.output, HasSubstr("error: module load no-such-module/0 failed"));
  EXPECT_THAT(bad.record(), HasSubstr("ended code=1 stops=0 node=n2\n"));
}

TEST(TaskScript, TheTemporaryFolderIsThatOfTheJob) {
  const Folder scratch;
  const TaskScript task("echo \"TMPDIR=$TMPDIR\"\n");
  EXPECT_THAT(task.run("SLURM_TMPDIR='" + scratch.path().string() + "'").output,
              HasSubstr("TMPDIR=" + scratch.path().string()));
  EXPECT_THAT(task.run("SLURM_TMPDIR= TMPDIR=/not/there").output, HasSubstr("TMPDIR=/tmp"));
}

TEST(TaskScript, StartsWeftAgainWhenItWasKilled) {
  const TaskScript once("if [ -e \"$0.again\" ]; then exit 0; fi\ntouch \"$0.again\"\nkill -KILL $$\n");
  EXPECT_EQ(once.run().code, 0);
  EXPECT_THAT(once.record(), HasSubstr("killed signal=9 node=n2\nended code=0"));
  const TaskScript always("kill -KILL $$\n");
  EXPECT_EQ(always.run().code, 137);
  EXPECT_THAT(always.record(),
              HasSubstr("killed signal=9 node=n2\nkilled signal=9 node=n2\nkilled signal=9 node=n2\nended code=137"));
}

TEST(Slurm, OutputOfSqueue) {
  const auto jobs =
      parse_squeue("12_3|weft-a|NODE_FAIL|n2|None\n13|weft-a-merge|PENDING||Nodes down|drained\nnonsense\n");
  ASSERT_EQ(jobs.size(), 2u);
  EXPECT_EQ(jobs[0].job(), "12");
  EXPECT_EQ(jobs[0].task(), 3);
  EXPECT_TRUE(jobs[0].has_ended());
  EXPECT_EQ(slurm_failure_text(jobs[0]), "its node failed");
  EXPECT_FALSE(jobs[1].has_ended());
  EXPECT_EQ(jobs[1].reason, "Nodes down|drained");
  EXPECT_EQ(slurm_failure_text(jobs[1]), "");
}

/// A submission of four tasks, and what they and Slurm say.
class JobStatesTest : public testing::Test {
 protected:
  JobStatesTest() : submission_(sweep_of(folder_ / "out", 8, 8), ClusterChoice{}, "/opt/weft") {
    submission_.tasks = 4;
    submission_.array = "12";
    submission_.merge = "13";
    submission_.report = "14";
  }
  void record(const std::string& id, const std::string& text) const {
    folder_.write("out/slurm/ablate/tasks/" + id + ".txt", text);
  }
  void cells(int count) const {
    for (int i = 0; i < count; ++i) {
      folder_.write("out/cells/seed" + std::to_string(i) + "-0.json", "");
      folder_.write("out/cells/seed" + std::to_string(i) + "-0.times.json", "");
    }
  }
  Folder folder_;
  Submission submission_;
};

TEST_F(JobStatesTest, CountUnitsAndTasks) {
  cells(5);
  record("12_1", "began restart=0 node=n1\n");
  record("12_2", "began restart=0 node=n2\nended code=3 stops=0 node=n2\n");
  const auto states =
      job_states(submission_, parse_squeue("12_1|a|RUNNING|n1|None\n12_2|a|COMPLETED|n2|None\n"
                                           "12_3|a|PENDING||Resources\n12_4|a|PENDING||JobHeldAdmin\n"
                                           "13|a-merge|PENDING||Dependency\n14|a-report|PENDING||Dependency\n"));
  EXPECT_EQ(progress_text(states), "5 of 8 cells; tasks: 1 running, 2 waiting (JobHeldAdmin), 1 ended; merge waiting");
  EXPECT_FALSE(states.is_over);
  EXPECT_THAT(states.troubles, ElementsAre("task 4 does not start: JobHeldAdmin"));
}

TEST_F(JobStatesTest, SayWhichTaskFailedWhereAndWhy) {
  cells(8);
  record("12_1", "began restart=0 node=n1\nended code=1 stops=0 node=n1\n");
  folder_.write("out/slurm/ablate/logs/task-12_1.log",
                "something\nerror: cells/x.json: cannot be written: the disk is full\n");
  record("12_2", "began restart=0 node=n2\n");
  record("12_3", "began restart=0 node=n3\nbegan restart=1 node=n1\nended code=0 stops=0 node=n1\n");
  record("13", "began restart=0 node=n1\nended code=0 stops=0 node=n1\n");
  const auto states = job_states(submission_, parse_squeue("12_4|a|OUT_OF_MEMORY|n4|None\n"));
  EXPECT_TRUE(states.is_over);
  EXPECT_TRUE(states.is_done());  // the merge has done what they left
  EXPECT_THAT(states.troubles,
              ElementsAre(AllOf(HasSubstr("task 1 failed on n1: weft ended with exit code 1\n    error: cells/x.json"),
                                HasSubstr("task-12_1.log")),
                          HasSubstr("task 2 failed on n2: it ended without a word"),
                          HasSubstr("task 4 failed on n4: it used more memory")));
  EXPECT_THAT(states.notes,
              ElementsAre("task 3 was started 2 times (n3, n1): 1 x after it ended without a word: its node "
                          "failed, or it was requeued"));
}

TEST_F(JobStatesTest, ATaskThatWasCancelledIsSaidToBe) {
  record("12_1", "began restart=0 node=n1\nended code=75 stops=1 node=n1\n");
  record("12_2", "began restart=0 node=n2\nended code=143 stops=1 node=n2\n");
  record("12_3", "began restart=0 node=n3\nended code=1 stops=0 node=n3\n");
  const auto states = job_states(submission_, parse_squeue("12_1|a|CANCELLED|n1|None\n12_2|a|CANCELLED|n2|None\n"
                                                           "12_3|a|CANCELLED|n3|None\n12_4|a|CANCELLED||Resources\n"
                                                           "13|a-merge|PENDING||Dependency\n"));
  EXPECT_THAT(states.troubles,
              ElementsAre("task 1 failed on n1: it was cancelled", "task 2 failed on n2: it was cancelled",
                          "task 3 failed on n3: weft ended with exit code 1", "task 4 failed: it was cancelled"));
}

TEST_F(JobStatesTest, ALauncherMayHaveItsOwnExitCodeWhenItWasAskedToEnd) {
  record("12_1",
         "began restart=0 node=n1\nended code=143 stops=1 node=n1\nrequeued node=n1\nbegan restart=1 node=n2\n");
  EXPECT_THAT(
      job_states(submission_, parse_squeue("12_1|a|RUNNING|n2|None\n")).notes,
      ElementsAre("task 1 was started 2 times (n1, n2): 1 x after Slurm asked it to end, as before a time limit"));
}

TEST_F(JobStatesTest, TasksWaitWhileSlurmDoesNotAnswer) {
  record("12_1", "began restart=0 node=n1\n");
  record("12_2", "began restart=0 node=n2\nended code=75 stops=1 node=n2\nrequeued node=n2\n");
  record("12_3", "began restart=0 node=n2\nended code=1 stops=0 node=n2\n");
  const auto states = job_states(submission_, std::nullopt);
  EXPECT_EQ(progress_text(states), "0 of 8 cells; tasks: 1 running, 2 waiting, 1 failed; merge waiting");
  EXPECT_THAT(states.troubles, ElementsAre(HasSubstr("task 3 failed on n2: weft ended with exit code 1")));
  EXPECT_FALSE(states.is_over);
}

TEST_F(JobStatesTest, ACancelledMergeIsNotDone) {
  cells(8);
  submission_.is_cancelled = true;
  for (const char* id : {"12_1", "12_2", "12_3", "12_4"})
    record(id, "began restart=0 node=n1\nended code=0 stops=0 node=n1\n");
  const auto states = job_states(submission_, parse_squeue("13|a-merge|CANCELLED||None\n"));
  EXPECT_EQ(states.merge, "cancelled");
  EXPECT_TRUE(states.is_over);
  EXPECT_FALSE(states.is_done());
}

/// Work that is one unit, such as a fit: a job without a merge.
class OneJob : public JobStatesTest {
 protected:
  OneJob() {
    ClusterWork work;
    work.command = "train";
    work.label = "train-a,b|c";
    work.results = folder_ / "fit";
    work.files.result = folder_ / "fit/model.h5";
    fit_ = Submission(work, ClusterChoice{}, "/opt/weft");
    fit_.array = "12";
    fit_.report = "13";
  }
  JobStates states_of(const std::string& text, const std::string& queue) const {
    folder_.write("fit/slurm/train-a,b|c/tasks/12_1.txt", text);
    return job_states(fit_, parse_squeue(queue));
  }
  Submission fit_;
};

TEST_F(OneJob, IsDoneWhenItEndedWellAndNotBecauseAModelIsThere) {
  folder_.write("fit/model.h5", "as an evaluation of a fit leaves it, or an earlier fit");
  EXPECT_FALSE(states_of("", "12_1|a|PENDING||Resources\n").is_done());
  EXPECT_FALSE(states_of("began restart=0 node=n1\n", "12_1|a|RUNNING|n1|None\n").is_done());
  fit_.is_cancelled = true;
  const auto cancelled =
      states_of("began restart=0 node=n1\nended code=75 stops=1 node=n1\n", "12_1|a|CANCELLED|n1|None\n");
  EXPECT_TRUE(cancelled.is_over);
  EXPECT_FALSE(cancelled.is_done());
  EXPECT_THAT(status_text(fit_, cancelled), HasSubstr("it was cancelled; the same command goes on"));
  fit_.is_cancelled = false;
  EXPECT_TRUE(states_of("began restart=0 node=n1\nended code=0 stops=0 node=n1\n", "").is_done());
  std::filesystem::remove(folder_ / "fit/model.h5");
  EXPECT_FALSE(states_of("began restart=0 node=n1\nended code=0 stops=0 node=n1\n", "").is_done());
}

TEST_F(OneJob, HasANameThatSqueueCanBeAskedFor) {
  EXPECT_THAT(fit_.names().front(), testing::MatchesRegex("weft-train-a_b_c-[0-9a-f]{8}"));
  ClusterWork other = fit_.work;
  other.label = "train-a_b_c";  // another model
  EXPECT_NE(Submission(other, ClusterChoice{}, "/opt/weft").names(), fit_.names());
}

TEST_F(JobStatesTest, RememberWhatSlurmForgets) {
  keep_ended_jobs(submission_, parse_squeue("12_4|a|TIMEOUT|n4|TimeLimit\n"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "out"));  // without its folder there is nothing to write to
  std::filesystem::create_directories(submission_.scripts.folder);
  keep_ended_jobs(submission_, parse_squeue("12_4|a|TIMEOUT|n4|TimeLimit\n"));
  const auto states = job_states(submission_, parse_squeue(""));
  EXPECT_THAT(states.troubles, testing::Contains(HasSubstr("task 4 failed on n4: it reached its time limit")));
}

TEST_F(JobStatesTest, TasksThatWereNotNeededHaveNotFailed) {
  cells(8);
  record("12_1", "began restart=0 node=n1\nended code=0 stops=0 node=n1\n");
  record("12_2", "began restart=0 node=n2\n");  // its node failed, and it waited when all was done
  record("12_3", "began restart=0 node=n3\n");  // its script was killed
  folder_.write("out/slurm/ablate/tasks/12.all-done", "");
  const auto states =
      job_states(submission_, parse_squeue("12_2|a|CANCELLED||None\n12_3|a|FAILED|n3|RaisedSignal:9(Killed)\n"
                                           "12_4|a|CANCELLED||None\n"));
  EXPECT_THAT(states.troubles, testing::Contains("task 3 failed on n3: it failed (RaisedSignal:9(Killed))"));
  EXPECT_EQ(states.failed, 1);
  EXPECT_EQ(states.ended, 3);
  EXPECT_THAT(states.notes, ElementsAre("task 2 ended without a word on n2; the others did its work"));
}

TEST(Submission, HasOneNameByWhateverPath) {
  const Folder folder;
  std::filesystem::create_directories(folder / "real");
  std::filesystem::create_directory_symlink(folder / "real", folder / "link");
  const Submission one(sweep_of(folder / "real/out", 8, 8), ClusterChoice{}, "/opt/weft");
  EXPECT_EQ(Submission(sweep_of(folder / "link/out", 8, 8), ClusterChoice{}, "/opt/weft").names(), one.names());
  EXPECT_NE(Submission(sweep_of(folder / "real/other", 8, 8), ClusterChoice{}, "/opt/weft").names(), one.names());
}

TEST(Submission, RefusesAFolderThatSlurmCannotWriteLogsTo) {
  const Folder folder;
  for (const std::string name : {"back\\slash", "new\nline"})
    EXPECT_THAT(
        message_of<ConfigError>([&] { Submission(sweep_of(folder / name, 8, 8), ClusterChoice{}, "/opt/weft"); }),
        HasSubstr("Slurm cannot write logs"))
        << name;
}

TEST(Submission, AClaimThatADeadMachineLeftIsTakenOver) {
  const Folder folder;
  folder.write("claims/submit.claim", "weft-claim-1 another-boot n7 12345 token 4242 1 0000000001\n");
  Claims::Options quick;
  quick.dead_after_s = 0.5;
  Claims claims(folder / "claims", quick);
  claim_submission(claims, folder / "x", nullptr);
  // A living process on another machine, which touches it.
  Claims::Options elsewhere;
  elsewhere.machine = "another-boot";
  elsewhere.touch_every_s = 0.05;
  const Folder busy;
  Claims theirs(busy / "claims", elsewhere);
  ASSERT_TRUE(theirs.take("submit"));
  Claims ours(busy / "claims");
  EXPECT_THAT(message_of<ConfigError>([&] { claim_submission(ours, busy / "x", nullptr); }),
              HasSubstr("another weft is submitting"));
  const std::atomic<bool> stop{true};
  folder.write("old/submit.claim", "weft-claim-1 another-boot n7 12345 token 4242 1 0000000001\n");
  Claims waiting(folder / "old");
  EXPECT_THAT(message_of<Error>([&] { claim_submission(waiting, folder / "x", &stop); }), HasSubstr("stopped"));
}

TEST(Submission, IsReadAsItWasSaved) {
  const Folder folder;
  Submission one(sweep_of(folder / "out", 8, 5), ClusterChoice{}, "/opt/weft");
  one.array = "12";
  std::filesystem::create_directories(one.scripts.folder);
  one.save();
  const auto all = read_submissions(folder / "out");
  ASSERT_EQ(all.size(), 1u);
  EXPECT_EQ(all[0].array, "12");
  EXPECT_EQ(all[0].work.arguments, one.work.arguments);
  EXPECT_EQ(all[0].scripts.name, one.scripts.name);
  EXPECT_EQ(all[0].units_there(), 3);
  folder.write("out/slurm/ablate/submission.json", "{\"schema\": 1}");
  EXPECT_THAT(message_of<ConfigError>([&] { read_submissions(folder / "out"); }), HasSubstr("submission.json"));
}

}  // namespace
}  // namespace weft
