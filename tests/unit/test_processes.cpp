// Child processes, what becomes of them, and the claims with which several of them share a folder.
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <new>
#include <system_error>
#include <thread>

#include "processes/child_process.hpp"
#include "processes/claims.hpp"
#include "processes/crash_report.hpp"
#include "processes/work_status.hpp"
#include "processes/worker_process.hpp"
#include "sdk/machine_failure.hpp"
#include "sdk/wrong_result.hpp"
#include "test_support.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

using test::Folder;
using test::message_of;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;
using Outcome = ChildProcess::Outcome;

std::vector<std::string> shell(const std::string& script) { return {"sh", "-c", script}; }
void sleep_s(double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); }

TEST(ChildProcess, AnswersLinesAndEnds) {
  ChildProcess child({.command = shell("while read x; do echo \"$NAME got $x\"; done; exit 3"),
                      .environment = {{"NAME", "child"}, {"HOME", "/"}}});
  std::string line;
  for (const std::string word : {"one", "two"}) {
    ASSERT_EQ(child.write(word + "\n", seconds_from_now(10)), Outcome::done);
    ASSERT_EQ(child.read_line(line, seconds_from_now(10)), Outcome::done);
    EXPECT_EQ(line, "child got " + word);
  }
  EXPECT_EQ(child.read_line(line, seconds_from_now(0.05)), Outcome::late);
  EXPECT_FALSE(child.wait_until(seconds_from_now(0)));
  child.close_input();
  EXPECT_EQ(child.read_line(line, seconds_from_now(10)), Outcome::ended);
  const auto end = child.wait_until(seconds_from_now(10));
  ASSERT_TRUE(end);
  EXPECT_EQ(end->text(), "ended with exit code 3");
  EXPECT_EQ(child.cpu_seconds(), 0.0);
}

TEST(ChildProcess, KeepsTheEndOfWhatItPrintsAndSaysWhichSignalEndedIt) {
  // More than a pipe holds: the child must not wait for this process to read it.
  ChildProcess child({.command = shell("i=0; while [ $i -lt 3000 ]; do echo \"line $i of many, many words\" >&2; "
                                       "i=$((i+1)); done; echo out; kill -SEGV $$"),
                      .keep_errors = true});
  std::string line;
  ASSERT_EQ(child.read_line(line, seconds_from_now(60)), Outcome::done);
  EXPECT_EQ(line, "out");
  const auto end = child.wait_until(seconds_from_now(10));
  ASSERT_TRUE(end);
  EXPECT_EQ(end->text(), "was ended by SIGSEGV (Segmentation fault)");
  EXPECT_THAT(child.errors(), HasSubstr("line 2999 of"));
  EXPECT_LE(child.errors().size(), 8192u);
}

TEST(ChildProcess, RefusesWhatCannotBeRun) {
  EXPECT_EQ(message_of<ConfigError>([] { ChildProcess({.command = {"/no/such/program"}}); }),
            "cannot be run: No such file or directory");
}

TEST(ChildProcess, CountsTheCpuTimeOfItsChildrenToo) {
  ChildProcess child({.command = shell("sh -c 'while :; do :; done' & wait"), .own_group = true});
  const auto deadline = seconds_from_now(60);
  while (child.cpu_seconds() < 0.1 && std::chrono::steady_clock::now() < deadline) sleep_s(0.05);
  EXPECT_GE(child.cpu_seconds(), 0.1);
  child.kill(SIGKILL);
  EXPECT_EQ(child.wait_until(seconds_from_now(10)).value().signal, SIGKILL);
}

TEST(HangWatch, TellsTheIdleFromTheGreedyFromTheBusy) {
  HangWatch greedy(10.0, 60.0);
  greedy.start(5.0);
  EXPECT_EQ(greedy.check(15.0), "");
  EXPECT_EQ(greedy.check(15.1), "used 10 s of CPU time");
  HangWatch idle(10.0, 0.1), busy(10.0, 0.1);
  idle.start(5.0);
  busy.start(5.0);
  std::string why;
  for (int i = 1; i <= 10; ++i) {
    sleep_s(0.03);
    if (why.empty()) why = idle.check(5.0);
    EXPECT_EQ(busy.check(5.0 + 0.02 * i), "");
  }
  EXPECT_EQ(why, "used no CPU time for 0.1 s");
}

TEST(Worker, AnswersAndIsStartedAgainAfterItDied) {
  WorkerProcess worker(
      shell("while read x; do case $x in die) kill -SEGV $$;; leave) echo gone >&2; exit 0;; *) echo "
            "\"$$ $x\";; esac; done"));
  const auto limits = [] { return WorkLimits(); };
  const auto never = [] { return false; };
  const WorkEnd first = worker.run("a", limits, never), second = worker.run("b", limits, never);
  EXPECT_EQ(first.kind, WorkEnd::Kind::answered);
  EXPECT_EQ(first.text.substr(0, first.text.find(' ')), second.text.substr(0, second.text.find(' ')));  // one process
  const WorkEnd died = worker.run("die", limits, never);
  EXPECT_EQ(died.kind, WorkEnd::Kind::crashed);
  EXPECT_EQ(died.text, "its process was ended by SIGSEGV (Segmentation fault)");
  const WorkEnd left = worker.run("leave", limits, never);
  EXPECT_EQ(left.kind, WorkEnd::Kind::crashed);
  EXPECT_EQ(left.text, "its process ended with exit code 0; its last words: gone");
  EXPECT_THAT(worker.run("c", limits, never).text, HasSubstr(" c"));
}

TEST(Worker, IsLostWhenItIsKilledThreeTimesButNotBefore) {
  const Folder folder;
  const std::string count = (folder / "count").string();
  const auto killed_until = [&](int times) {
    std::filesystem::remove(count);
    return shell("while read x; do echo >> '" + count + "'; [ $(wc -l < '" + count + "') -gt " + std::to_string(times) +
                 " ] || kill -9 $$; echo survived; done");
  };
  const auto limits = [] { return WorkLimits(); };
  WorkerProcess twice(killed_until(2));
  EXPECT_EQ(twice.run("x", limits, [] { return false; }).text, "survived");
  WorkerProcess thrice(killed_until(3));
  const WorkEnd end = thrice.run("x", limits, [] { return false; });
  EXPECT_EQ(end.kind, WorkEnd::Kind::lost);
  EXPECT_THAT(end.text, AllOf(HasSubstr("SIGKILL"), HasSubstr("memory full"), HasSubstr("3 times")));
}

TEST(Worker, ThatFindsNoMemoryForItsRequestIsLost) {
  WorkerProcess worker(shell("read x; echo 'no memory'"));
  const WorkEnd end = worker.run(
      "x", [] { return WorkLimits(); }, [] { return false; });
  EXPECT_EQ(end.kind, WorkEnd::Kind::lost);
  EXPECT_THAT(end.text, AllOf(HasSubstr("there was not enough memory"), HasSubstr("3 times")));
}

TEST(Worker, ThatHangsIsEnded) {
  WorkerProcess sleeper(shell("read x; sleep 1000"));
  const WorkEnd idle = sleeper.run(
      "x",
      [] {
        return WorkLimits{0.0, 0.3};
      },
      [] { return false; });
  EXPECT_EQ(idle.kind, WorkEnd::Kind::hung);
  EXPECT_THAT(idle.text, StartsWith("used no CPU time for 0.3 s"));
  WorkerProcess spinner(shell("read x; while :; do :; done"));
  const WorkEnd greedy = spinner.run(
      "x",
      [] {
        return WorkLimits{0.1, 60.0};
      },
      [] { return false; });
  EXPECT_EQ(greedy.kind, WorkEnd::Kind::hung);
  EXPECT_THAT(greedy.text, StartsWith("used 0.1 s of CPU time"));
}

TEST(Worker, StopsWhenTheUserAsks) {
  WorkerProcess worker(shell("read x; sleep 1000"));
  EXPECT_EQ(worker
                .run(
                    "x", [] { return WorkLimits(); }, [] { return true; })
                .kind,
            WorkEnd::Kind::cancelled);
}

TEST(Worker, LimitsFollowTheSlowestUnit) {
  EXPECT_EQ(work_limits(0.0, 0.0).cpu_s, 86400.0);  // nothing to compare with
  EXPECT_EQ(work_limits(0.0, 0.5).cpu_s, 600.0);
  EXPECT_EQ(work_limits(0.0, 100.0).cpu_s, 2000.0);
  EXPECT_EQ(work_limits(7.0, 100.0).cpu_s, 7.0);
  SlowestUnit slowest(0.0);
  EXPECT_EQ(slowest.limits().cpu_s, 86400.0);
  slowest.add(0.0);
  EXPECT_EQ(slowest.limits().cpu_s, 600.0);
  slowest.add(50.0);
  slowest.add(40.0);
  EXPECT_EQ(slowest.limits().cpu_s, 1000.0);
}

TEST(CrashReport, IsReadBackAndRefusesOtherBytes) {
  CrashReport report{};
  EXPECT_FALSE(read_crash_report("", report));
  EXPECT_FALSE(read_crash_report(std::string(sizeof(report), 'x'), report));
}

TEST(WorkStatus, NamesGoBothWays) {
  for (const auto status : {WorkStatus::done, WorkStatus::refused, WorkStatus::diverged, WorkStatus::crashed,
                            WorkStatus::hung, WorkStatus::lost})
    EXPECT_EQ(work_status_named(to_string(status)), status);
  EXPECT_EQ(work_status_named("failed"), WorkStatus::refused);
  EXPECT_EQ(message_of<ConfigError>([] { work_status_named("fine"); }), "'fine' is not a status of a cell");
  EXPECT_EQ(failures_text({WorkStatus::done, WorkStatus::lost, WorkStatus::crashed, WorkStatus::lost}),
            "1 crashed, 2 lost");
  EXPECT_TRUE(tries_again(Retry::accidents, WorkStatus::hung));
  EXPECT_FALSE(tries_again(Retry::accidents, WorkStatus::diverged));
  EXPECT_TRUE(tries_again(Retry::all, WorkStatus::refused));
  EXPECT_FALSE(tries_again(Retry::all, WorkStatus::done));
}

TEST(WorkStatus, IsThatOfTheException) {
  const auto status_of = [](const auto& thrower) {
    try {
      thrower();
    } catch (...) {
      return current_failure();
    }
    return WorkFailure{WorkStatus::done, ""};
  };
  EXPECT_EQ(status_of([] { throw ConfigError("no"); }).status, WorkStatus::refused);
  EXPECT_EQ(status_of([] { throw Diverged("nan"); }).status, WorkStatus::diverged);
  EXPECT_EQ(status_of([] { throw NotFinite("simulator mine: a position after step() is not finite"); }).status,
            WorkStatus::diverged);
  EXPECT_EQ(status_of([] { throw WrongResult("x has size 0"); }).status, WorkStatus::refused);
  EXPECT_EQ(status_of([] { throw 42; }).status, WorkStatus::refused);
  // What the machine refused is tried again.
  EXPECT_EQ(status_of([] { throw std::bad_alloc(); }).status, WorkStatus::lost);
  EXPECT_EQ(status_of([] { throw OutOfMemory("predictor emd: no memory"); }).status, WorkStatus::lost);
  EXPECT_EQ(status_of([] { throw ReadError("model.h5: is locked"); }).status, WorkStatus::lost);
  EXPECT_EQ(status_of([] { throw std::system_error(EAGAIN, std::generic_category()); }).status, WorkStatus::lost);
  EXPECT_EQ(status_of([] { throw 42; }).message, "threw something that is not a std::exception");
  EXPECT_EQ(status_of([] { throw Error(""); }).message, "failed without a message");
}

std::string text_in(const std::filesystem::path& file) {
  std::ifstream stream(file);
  return {std::istreambuf_iterator<char>(stream), {}};
}

TEST(Claims, OneProcessGetsIt) {
  const Folder folder;
  Claims here(folder / "claims"), there(folder / "claims");
  EXPECT_EQ(here.take("a"), 1);
  EXPECT_EQ(here.take("a"), std::nullopt);
  EXPECT_EQ(there.take("a"), std::nullopt);
  EXPECT_EQ(there.take("b"), 1);
  there.release("a");  // not its own
  EXPECT_TRUE(std::filesystem::exists(folder / "claims/a.claim"));
  here.release("a");
  EXPECT_FALSE(std::filesystem::exists(folder / "claims/a.claim"));
  EXPECT_EQ(there.take("a"), 1);
}

TEST(Claims, LeaveNothingBehind) {
  const Folder folder;
  {
    Claims claims(folder / "claims");
    claims.take("a");
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "claims"));
}

TEST(Claims, OfAnEndedProcessOfThisMachineAreTakenAtOnce) {
  const Folder folder;
  pid_t ended = 0;
  {
    ChildProcess child({.command = {"true"}});
    ended = child.id();
    child.wait_until(seconds_from_now(10));
  }
  std::filesystem::create_directory(folder / "claims");
  const auto write = [&](const std::string& machine, const std::string& start) {
    std::ofstream(folder / "claims/a.claim")
        << "weft-claim-1 " << machine << " host " << start << " 0123456789abcdef " << ended << " 2 0000000007\n";
  };
  Claims claims(folder / "claims");
  write("another", "1");
  EXPECT_EQ(claims.take("a"), std::nullopt);
  write(Claims::this_machine(), "unknown");  // of a process that could not read /proc
  EXPECT_EQ(claims.take("a"), std::nullopt);
  write(Claims::this_machine(), "1");
  EXPECT_EQ(claims.take("a"), 3);
}

TEST(Claims, OfAZombieAreTakenAtOnce) {
  const Folder folder;
  const pid_t zombie = fork();
  if (zombie == 0) {
    auto* const claims = new Claims(folder / "claims");  // without an end, which would give the claim back
    _exit(claims->take("a").value_or(0));
  }
  siginfo_t ended;
  waitid(P_PID, static_cast<id_t>(zombie), &ended, WEXITED | WNOWAIT);
  ASSERT_EQ(ended.si_status, 1);
  EXPECT_EQ(Claims(folder / "claims").take("a"), 2);
  waitpid(zombie, nullptr, 0);
}

TEST(Claims, OfAnotherMachineAreTakenWhenTheyAreNotTouched) {
  const Folder folder;
  Claims living(folder / "claims", {.touch_every_s = 0.02, .machine = "one"});
  Claims stuck(folder / "claims", {.touch_every_s = 1000.0, .machine = "two"});
  Claims watcher(folder / "claims", {.dead_after_s = 0.4, .machine = "three"});
  ASSERT_EQ(living.take("living"), 1);
  ASSERT_EQ(stuck.take("stuck"), 1);
  EXPECT_EQ(watcher.take("stuck"), std::nullopt);  // sees it for the first time
  std::optional<int> taken;
  const auto deadline = seconds_from_now(30);
  while (!taken && std::chrono::steady_clock::now() < deadline) {
    sleep_s(0.1);
    EXPECT_EQ(watcher.take("living"), std::nullopt);
    taken = watcher.take("stuck");
  }
  EXPECT_EQ(taken, 2);
  const std::string after = text_in(folder / "claims/stuck.claim");
  stuck.release("stuck");  // it only slept; what was its claim is the other's now
  EXPECT_EQ(text_in(folder / "claims/stuck.claim"), after);
}

TEST(Claims, AreKnownToBeHeldOnceTheirProcessShowsThatItLives) {
  const Folder folder;
  Claims living(folder / "claims", {.touch_every_s = 0.02, .machine = "one"});
  Claims stuck(folder / "claims", {.touch_every_s = 1000.0, .machine = "two"});
  Claims neighbour(folder / "claims"), watcher(folder / "claims");  // both of this machine
  ASSERT_EQ(living.take("living"), 1);
  ASSERT_EQ(stuck.take("stuck"), 1);
  ASSERT_EQ(neighbour.take("near"), 1);
  EXPECT_TRUE(watcher.is_held("near"));
  EXPECT_FALSE(watcher.is_held("nobody's"));
  const auto deadline = seconds_from_now(30);
  while (!watcher.is_held("living") && std::chrono::steady_clock::now() < deadline) sleep_s(0.02);
  EXPECT_TRUE(watcher.is_held("living"));
  EXPECT_FALSE(watcher.is_held("stuck"));
  neighbour.release("near");
  EXPECT_FALSE(watcher.is_held("near"));
}

TEST(Claims, HalfWrittenOnesDieToo) {
  const Folder folder;
  std::filesystem::create_directory(folder / "claims");
  std::ofstream(folder / "claims/a.claim") << "";
  Claims claims(folder / "claims", {.dead_after_s = 0.1});
  EXPECT_EQ(claims.take("a"), std::nullopt);
  sleep_s(0.15);
  EXPECT_EQ(claims.take("a"), 2);
}

TEST(Claims, ManyThreadsOfManyProcessesShareTheWorkOnceEach) {
  const Folder folder;
  constexpr int kUnits = 200;
  std::vector<std::atomic<int>> done(kUnits);
  std::vector<std::thread> threads;
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&] {
      Claims claims(folder / "claims");
      for (int i = 0; i < kUnits; ++i)
        if (claims.take(std::to_string(i))) ++done[static_cast<std::size_t>(i)];
      sleep_s(0.5);  // all hold what they have until nobody asks any more
    });
  }
  for (auto& thread : threads) thread.join();
  for (const auto& times : done) EXPECT_EQ(times, 1);
}

TEST(Leftovers, GoWithTheClaimOnTheirFile) {
  const Folder folder;
  for (const char* name : {"a.h5.tmp1", "a.h5.tmp0123456789abcdef", "b.h5.tmp2", "a.h5"})
    std::ofstream(folder / name) << "x";
  Leftovers leftovers(folder / "");
  std::ofstream(folder / "a.h5.tmp3") << "of a process that lives";
  leftovers.remove(folder / "a.h5");
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "")) names.push_back(entry.path().filename());
  EXPECT_THAT(names, ::testing::UnorderedElementsAre("a.h5", "a.h5.tmp3", "b.h5.tmp2"));
}

}  // namespace
}  // namespace weft
