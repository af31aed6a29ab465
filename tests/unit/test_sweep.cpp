#include "experiments/sweep_rows.hpp"

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "processes/claims.hpp"
#include "test_support.hpp"

namespace weft::test {
namespace {

struct Files {
  Folder folder;
  SweepOptions options(const std::string& name, SweepRunner runner, int jobs = 1) const {
    SweepOptions o;
    o.folder = folder / name;
    o.jobs = jobs;
    o.registry = std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{folder.path()});
    o.runner = std::move(runner);
    return o;
  }
  /// The only row in a sweep's folder.
  std::filesystem::path only_row(const std::string& name) const {
    std::filesystem::path row;
    for (const auto& entry : std::filesystem::directory_iterator(folder / name / "cells"))
      if (!entry.path().string().ends_with(".times.json")) row = entry.path();
    return row;
  }
};

SweepArm arm_of(const std::string& optimiser, int instances) {
  SweepArm arm;
  arm.name = optimiser + ", " + std::to_string(instances);
  arm.levels = {optimiser, std::to_string(instances)};
  arm.config = ConfigNode::parse(
      "{optimiser: " + optimiser + ", planning: {instances: " + std::to_string(instances) + "}}", "test");
  return arm;
}
SweepPlan six_arms() {
  SweepPlan plan;
  plan.factors = {"optimiser", "planning.instances"};
  for (const char* optimiser : {"rprop", "mppi"})
    for (const int instances : {1, 4, 16}) plan.arms.push_back(arm_of(optimiser, instances));
  plan.seeds = {5, 6, 7};
  return plan;
}
/// As a config with this planning.noise has it.
Identity identity_of_noise(const std::string& noise) {
  return Identity::from_json(R"({"schema": "weft identity 1", "weft": "0.1.0", "config": {"planning": {"noise": )" +
                             noise + R"(}}, "plugins": {}})");
}
std::string content_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}
SweepPlan one_arm(std::vector<std::uint64_t> seeds) {
  SweepPlan plan;
  plan.factors = {"optimiser", "planning.instances"};
  plan.arms = {arm_of("rprop", 1)};
  plan.seeds = std::move(seeds);
  return plan;
}

/// Arms differ by known amounts; a cell's number is a function of its config and seed only.
SweepOutcome formula(const ConfigNode& config, Host&) {
  const auto seed = static_cast<double>(config.at("seed").as_int());
  const double instances = config.at("planning").at("instances").as_double();
  const bool sampling = config.at("optimiser").as_string() == "mppi";
  SweepOutcome outcome;
  outcome.metrics = {{"error_mm", 10.0 * seed + (sampling ? 2.0 : 0.0) + 1.0 / instances}, {"loss", 0.5 * instances}};
  outcome.times = {{"plan_seconds", 0.25 * instances}};
  outcome.paired_by = "case" + std::to_string(static_cast<int>(seed));
  return outcome;
}

/// Everything that rows hold.
std::string text_of(const std::vector<SweepRow>& rows) {
  std::string text;
  for (const auto& row : rows) {
    text += std::to_string(row.arm) + " " + std::to_string(row.seed) + " " + row.failure + row.outcome.paired_by;
    for (const auto* part : {&row.outcome.metrics, &row.outcome.times})
      for (const auto& [name, value] : *part) text += " " + name + "=" + std::to_string(value);
    text += " " + row.outcome.payload.schema + row.outcome.payload.json + "\n";
  }
  return text;
}

TEST(Sweep, RowsComeInOrderWhateverTheNumberOfJobs) {
  const Files s;
  const auto plan = six_arms();
  const auto one = run_sweep(plan, s.options("one", formula, 1));
  const auto four = run_sweep(plan, s.options("four", formula, 4));
  ASSERT_EQ(one.size(), 18u);
  EXPECT_EQ(text_of(one), text_of(four));
  for (std::size_t i = 0; i < 18; ++i) {
    EXPECT_EQ(one[i].seed, 5 + i / 6);
    EXPECT_EQ(one[i].arm, i % 6);
  }
}

TEST(Sweep, SessionsGetTheirSeedAndOneThread) {
  const Files s;
  const auto plan = one_arm({9});
  run_sweep(plan, s.options("out", [](const ConfigNode& session, Host& host) {
    EXPECT_EQ(host.seed(), 9u);
    EXPECT_EQ(host.threads(), 1);
    return formula(session, host);
  }));
  auto wide = one_arm({9});
  wide.arms[0].config = wide.arms[0].config.with("threads", ConfigNode::integer(3));
  run_sweep(wide, s.options("wide", [](const ConfigNode& session, Host& host) {
    EXPECT_EQ(host.threads(), 3);
    return formula(session, host);
  }));
}

TEST(Sweep, FailedCellsAreRecordedAndCostOnlyThemselves) {
  const Files s;
  const auto plan = six_arms();
  const SweepRunner runner = [](const ConfigNode& session, Host& host) -> SweepOutcome {
    const auto instances = session.at("planning").at("instances").as_int();
    if (instances == 4 && session.at("seed").as_int() == 6) throw Diverged("frame 12, vertex 3");
    if (instances == 16 && session.at("seed").as_int() == 7) throw 5;
    return formula(session, host);
  };
  const auto rows = run_sweep(plan, s.options("out", runner));
  ASSERT_EQ(rows.size(), 18u);
  int failed = 0;
  for (const auto& row : rows) failed += !row.failure.empty();
  EXPECT_EQ(failed, 4);
  EXPECT_EQ(rows[7].failure, "frame 12, vertex 3");
  // A failure is a result: it is not tried again.
  std::atomic<int> calls{0};
  run_sweep(plan, s.options("out", [&](const ConfigNode& session, Host& host) {
    ++calls;
    return formula(session, host);
  }));
  EXPECT_EQ(calls, 0);
  EXPECT_EQ(rows[7].status, WorkStatus::diverged);
  EXPECT_EQ(rows[14].status, WorkStatus::refused);
  // None of them is an accident.
  auto options = s.options("out", [&](const ConfigNode& session, Host& host) {
    ++calls;
    return formula(session, host);
  });
  options.retry = Retry::accidents;
  run_sweep(plan, options);
  EXPECT_EQ(calls, 0);
  options.retry = Retry::all;
  for (const auto& row : run_sweep(plan, options)) EXPECT_EQ(row.status, WorkStatus::done);
  EXPECT_EQ(calls, 4);
}

TEST(Sweep, FailFastStopsAfterTheFirstFailure) {
  const Files s;
  auto options = s.options("out", [](const ConfigNode& session, Host& host) -> SweepOutcome {
    if (session.at("planning").at("instances").as_int() == 4) throw ConfigError("no");
    return formula(session, host);
  });
  options.fail_fast = true;
  EXPECT_EQ(run_sweep(six_arms(), options).size(), 2u);  // one that is done, and the failed one
}

TEST(Sweep, ProcessesThatShareAFolderRunEachCellOnce) {
  const Files s;
  const auto plan = six_arms();
  const std::string alone = text_of(run_sweep(plan, s.options("alone", formula)));
  std::atomic<int> calls{0};
  std::vector<std::string> texts(4);
  std::vector<std::thread> processes;
  for (auto& text : texts) {
    processes.emplace_back([&] {
      text = text_of(run_sweep(plan, s.options("shared", [&](const ConfigNode& session, Host& host) {
        ++calls;
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
        return formula(session, host);
      })));
    });
  }
  for (auto& one : processes) one.join();
  EXPECT_EQ(calls, 18);
  for (const auto& text : texts) EXPECT_EQ(text, alone);  // each waits for the others' rows
}

TEST(Sweep, ACellWhoseProcessesVanishIsLost) {
  const Files s;
  const auto plan = one_arm({5, 6});
  const auto file = row_file(plan, s.folder / "out", 0, 5);
  std::filesystem::create_directories(s.folder / "out/claims");
  std::ofstream(s.folder / "out/claims" / (file.stem().string() + ".claim"))
      << "weft-claim-1 " << Claims::this_machine() << " host 1 0123456789abcdef 999999999 3 0000000007\n";
  const auto rows = run_sweep(plan, s.options("out", formula));
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows[0].status, WorkStatus::lost);
  EXPECT_EQ(rows[0].failure, "3 processes that ran it have vanished");
  EXPECT_EQ(rows[1].status, WorkStatus::done);
  auto again = s.options("out", formula);
  again.retry = Retry::accidents;
  EXPECT_EQ(run_sweep(plan, again)[0].status, WorkStatus::done);
}

TEST(Sweep, KilledAtAnyMomentItIsFinishedByTheNextRun) {
  const Files s;
  const auto plan = six_arms();
  const std::string whole = text_of(run_sweep(plan, s.options("whole", formula)));
  for (const int after_ms : {5, 40, 75}) {
    const std::string name = "killed" + std::to_string(after_ms);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      try {
        run_sweep(plan, s.options(
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
    const auto rows = run_sweep(plan, s.options(name, [&](const ConfigNode& session, Host& host) {
      ++calls;
      return formula(session, host);
    }));
    EXPECT_EQ(text_of(rows), whole) << calls;
    EXPECT_GT(calls, 0);
  }
}

TEST(Sweep, AShareEndsWhenOthersAreAtWorkOnTheRest) {
  const Files s;
  const auto plan = one_arm({1, 2, 3});
  std::filesystem::create_directories(s.folder / "out/claims");
  const std::string cell = row_file(plan, s.folder / "out", 0, 2).stem().string();
  std::optional<Claims> other(std::in_place, s.folder / "out/claims");
  ASSERT_EQ(other->take(cell), 1);
  auto options = s.options("out", formula);
  options.is_share = true;
  EXPECT_EQ(run_sweep(plan, options).size(), 2u);
  EXPECT_EQ(cells_left(plan, read_sweep(plan, s.folder / "out", false).rows, Retry::none), 1u);
  other.reset();
  EXPECT_EQ(run_sweep(plan, options).size(), 3u);
}

TEST(Sweep, HalfWrittenRowsDoNotCount) {
  const Files s;
  const auto plan = one_arm({1});
  run_sweep(plan, s.options("out", formula));
  const std::filesystem::path row = s.only_row("out");
  std::filesystem::rename(row, row.string() + ".tmp");
  int calls = 0;
  run_sweep(plan, s.options("out", [&](const ConfigNode& session, Host& host) {
    ++calls;
    return formula(session, host);
  }));
  EXPECT_EQ(calls, 1);
  std::ofstream(row) << "{\"schema\": ";
  EXPECT_THAT(message_of<ConfigError>([&] { run_sweep(plan, s.options("out", formula)); }),
              testing::AllOf(testing::HasSubstr(row.filename().string()), testing::HasSubstr("damaged")));
}

TEST(Sweep, AFolderHoldsOneSweep) {
  const Files s;
  auto plan = one_arm({1}), other = plan;
  plan.arms[0].identity = identity_of_noise("0.5");
  other.arms[0].identity = identity_of_noise("0.25");
  run_sweep(plan, s.options("out", formula));
  EXPECT_THAT(message_of<ConfigError>([&] { run_sweep(other, s.options("out", formula)); }),
              testing::AllOf(testing::HasSubstr("planning.noise 0.5 -> 0.25"), testing::HasSubstr("--accept-changed")));
  // More seeds of the same are welcome.
  plan.seeds = {1, 2};
  EXPECT_EQ(run_sweep(plan, s.options("out", formula)).size(), 2u);
}

TEST(Sweep, AcceptedChangesAreRecordedPerRow) {
  const Files s;
  auto plan = one_arm({1, 2});
  plan.arms[0].identity = identity_of_noise("0.5");
  run_sweep(plan, s.options("out", formula));
  auto other = one_arm({1, 2, 3});
  other.arms[0].identity = identity_of_noise("0.25");
  auto options = s.options("out", formula);
  options.accept_changed = true;
  const auto rows = run_sweep(other, options);
  ASSERT_EQ(rows.size(), 3u);
  EXPECT_THAT(rows[1].changes, testing::ElementsAre("planning.noise 0.5 -> 0.25"));
  EXPECT_EQ(rows[1].identity, plan.arms[0].identity.hash());
  EXPECT_THAT(rows[2].changes, testing::IsEmpty());
  EXPECT_EQ(rows[2].identity, other.arms[0].identity.hash());
  EXPECT_THAT(mixed_rows_text(other, rows),
              testing::AllOf(testing::HasSubstr("2 of the 3 rows of rprop, 1 (seeds 1-2)"),
                             testing::HasSubstr("planning.noise 0.5 -> 0.25")));
  // Without the option the mixed folder is refused again, and nothing in it changes.
  EXPECT_THROW(run_sweep(other, s.options("out", formula)), ConfigError);
}

TEST(Sweep, RowsStayWhenTheyAreNoLongerAskedForAndArmsMayMove) {
  const Files s;
  auto plan = six_arms();
  run_sweep(plan, s.options("out", formula));
  std::rotate(plan.arms.begin(), plan.arms.begin() + 2, plan.arms.end());
  plan.arms.resize(3);
  plan.seeds = {6, 7};
  int calls = 0;
  const auto rows = run_sweep(plan, s.options("out", [&](const ConfigNode& session, Host& host) {
    ++calls;
    return formula(session, host);
  }));
  EXPECT_EQ(calls, 0);
  EXPECT_EQ(rows.size(), 6u);
  EXPECT_EQ(read_sweep(plan, s.folder / "out", false).others.size(), 12u);
}

TEST(Sweep, RowsHoldNoTimesSoThatEqualRunsGiveEqualBytes) {
  const Files s;
  double clock = 0.0;
  const SweepRunner runner = [&](const ConfigNode& config, Host& host) {
    auto outcome = formula(config, host);
    outcome.times = {{"plan_seconds", clock += 0.125}};
    return outcome;
  };
  run_sweep(one_arm({1}), s.options("a", runner));
  const auto rows = run_sweep(one_arm({1}), s.options("b", runner));
  EXPECT_EQ(rows[0].metric("plan_seconds"), 0.25);
  EXPECT_EQ(run_sweep(one_arm({1}), s.options("b", runner))[0].metric("plan_seconds"), 0.25);  // read back
  EXPECT_EQ(content_of(s.only_row("a")), content_of(s.only_row("b")));
}

TEST(Sweep, CancelledSessionsLeaveNoRow) {
  const Files s;
  const auto plan = six_arms();
  std::atomic<bool> cancel{false};
  int calls = 0;
  auto options = s.options("out", [&](const ConfigNode& session, Host& host) {
    if (++calls == 4) cancel = true;
    return formula(session, host);
  });
  options.cancel = &cancel;
  EXPECT_EQ(run_sweep(plan, options).size(), 3u);
  cancel = false;
  EXPECT_EQ(run_sweep(plan, options).size(), 18u);
}

TEST(Sweep, MetricsThatAreNoNumbersSurvive) {
  const Files s;
  const auto plan = one_arm({1});
  const SweepRunner runner = [](const ConfigNode&, Host&) {
    return SweepOutcome{{{"a", std::nan("")}, {"b", 0.1}}, "x"};
  };
  run_sweep(plan, s.options("out", runner));
  const auto rows = run_sweep(plan, s.options("out", runner));  // read back
  EXPECT_TRUE(std::isnan(rows[0].outcome.metrics[0].second));
  EXPECT_EQ(rows[0].outcome.metrics[1].second, 0.1);
}

TEST(Sweep, PayloadsReadBackAsTheyWereWritten) {
  const Files s;
  const auto plan = one_arm({1});
  const std::string value = "{\"centre\":[0.1,0.30000000000000004],\"none\":null}";
  const SweepRunner runner = [&](const ConfigNode&, Host&) {
    return SweepOutcome{{{"a", 1.0}}, "x", {"toy 3", value}};
  };
  const auto made = run_sweep(plan, s.options("out", runner));
  const auto read = run_sweep(plan, s.options("out", formula));  // nothing runs
  EXPECT_EQ(text_of(read), text_of(made));
  EXPECT_EQ(read[0].outcome.payload.schema, "toy 3");
  EXPECT_EQ(read[0].outcome.payload.json, value);
  EXPECT_EQ(read[0].file, s.only_row("out"));
}

TEST(Sweep, RowsOfBeforePayloadsAreRead) {
  // As weft wrote it when rows were called those of an ablation; the name of the file holds a hash of the arm's name.
  const Files s;
  s.folder.write("out/cells/seed1-arm0-b4f2b3c9.json", R"({
  "schema": "weft ablation row 1",
  "arm": "rprop, 1",
  "seed": 1,
  "config": "25d7a2c5e213b6e4",
  "status": "done",
  "failure": "",
  "paired_by": "d41d8cd98f00b204",
  "metrics": {
    "error_mm": 12.25,
    "first_plan_loss": null
  }
}
)");
  int calls = 0;
  const auto rows = run_sweep(one_arm({1}), s.options("out", [&](const ConfigNode& config, Host& host) {
    ++calls;
    return formula(config, host);
  }));
  EXPECT_EQ(calls, 0);
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_EQ(rows[0].metric("error_mm"), 12.25);
  EXPECT_TRUE(std::isnan(rows[0].metric("first_plan_loss")));
  EXPECT_EQ(rows[0].outcome.paired_by, "d41d8cd98f00b204");
  EXPECT_EQ(rows[0].outcome.payload.schema, "");
}

TEST(Sweep, RowsOfAnotherFormAreRefused) {
  const Files s;
  const auto plan = one_arm({1});
  run_sweep(plan, s.options("out", formula));
  std::ofstream(s.only_row("out")) << R"({"schema": "weft sweep row 4"})";
  EXPECT_THAT(message_of<ConfigError>([&] { run_sweep(plan, s.options("out", formula)); }),
              testing::HasSubstr("is not a row of a sweep"));
}

TEST(SweepMetrics, ComeInTheOrderOfTheirFirstAppearance) {
  EXPECT_EQ(sweep_metrics({{0, 1, "", {{{"b", 1.0}}, ""}}, {0, 2, "", {{{"a", 1.0}, {"b", 2.0}}, ""}}}),
            (std::vector<std::string>{"b", "a"}));
}

}  // namespace
}  // namespace weft::test
