#include <atomic>
#include <mutex>
#include <numeric>
#include <stdexcept>
#include <thread>
#include <vector>

#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

using test::message_of;

std::unique_ptr<Host> host_with(int threads, HostOptions options = {}) {
  options.threads = threads;
  return make_host(std::make_shared<PluginRegistry>(), options);
}

class HostThreads : public ::testing::TestWithParam<int> {};

TEST_P(HostThreads, RunsEveryIndexOnce) {
  const auto host = host_with(GetParam());
  EXPECT_EQ(host->threads(), GetParam());
  for (const std::int64_t count : {0, 1, 2, 7, 1000}) {
    std::vector<std::atomic<int>> runs(count);
    host->parallel_for(count, [&](std::int64_t i) { ++runs[i]; });
    for (const auto& n : runs) EXPECT_EQ(n, 1);
  }
  host->parallel_for(-3, [](std::int64_t) { FAIL(); });
}

TEST_P(HostThreads, ManyLoopsInARow) {
  const auto host = host_with(GetParam());
  std::atomic<std::int64_t> sum = 0;
  for (int round = 0; round < 2000; ++round) host->parallel_for(3, [&](std::int64_t i) { sum += i; });
  EXPECT_EQ(sum, 2000 * 3);
}

TEST_P(HostThreads, RethrowsTheErrorOfTheLowestIndex) {
  const auto host = host_with(GetParam());
  for (int round = 0; round < 20; ++round) {
    std::atomic<int> runs = 0;
    EXPECT_EQ(message_of<std::runtime_error>([&] {
                host->parallel_for(50, [&](std::int64_t i) {
                  ++runs;
                  if (i % 10 == 3) throw std::runtime_error(std::to_string(i));
                });
              }),
              "3");
    EXPECT_EQ(runs, 50);  // the others ran, too, with any number of threads
  }
  std::atomic<int> runs = 0;
  host->parallel_for(5, [&](std::int64_t) { ++runs; });
  EXPECT_EQ(runs, 5);  // and the pool still works
}

TEST_P(HostThreads, NestedLoopsRunOnTheCallingThread) {
  const auto host = host_with(GetParam());
  for (const std::int64_t outer : {1, 6}) {
    std::atomic<int> runs = 0, elsewhere = 0;
    host->parallel_for(outer, [&](std::int64_t) {
      const auto me = std::this_thread::get_id();
      host->parallel_for(5, [&](std::int64_t) {
        ++runs;
        if (std::this_thread::get_id() != me) ++elsewhere;
      });
      // Still so after the first nested loop.
      host->parallel_for(5, [&](std::int64_t) {
        if (std::this_thread::get_id() != me) ++elsewhere;
      });
    });
    EXPECT_EQ(runs, 5 * outer);
    EXPECT_EQ(elsewhere, 0);
  }
}

TEST_P(HostThreads, NestedErrorsComeOut) {
  const auto host = host_with(GetParam());
  EXPECT_EQ(message_of<std::runtime_error>([&] {
              host->parallel_for(4, [&](std::int64_t i) {
                host->parallel_for(4, [&](std::int64_t j) {
                  if (i >= 1 && j >= 2) throw std::runtime_error(std::to_string(i * 10 + j));
                });
              });
            }),
            "12");
}

TEST_P(HostThreads, TwoThreadsMayLoopAtTheSameTime) {
  const auto host = host_with(GetParam());
  std::atomic<std::int64_t> sums[2] = {0, 0};
  const auto loop = [&](int which) {
    for (int round = 0; round < 300; ++round) {
      host->parallel_for(20, [&](std::int64_t i) { sums[which] += i; });
    }
  };
  std::thread other(loop, 1);
  loop(0);
  other.join();
  EXPECT_EQ(sums[0], 300 * 190);
  EXPECT_EQ(sums[1], 300 * 190);
}

INSTANTIATE_TEST_SUITE_P(Threads, HostThreads, ::testing::Values(1, 2, 5));

TEST(Host, ZeroThreadsMeansAllCores) {
  EXPECT_EQ(host_with(0)->threads(), std::max(1, static_cast<int>(std::thread::hardware_concurrency())));
}

TEST(Host, SeedReachesTheRandomStreams) {
  HostOptions options;
  options.seed = 9;
  const auto host = host_with(1, options);
  EXPECT_EQ(host->seed(), 9u);
  EXPECT_EQ(host->random(3).bits64(), RandomStream(9, 3).bits64());
}

TEST(Host, CancelledFollowsTheFlag) {
  std::atomic<bool> cancel = false;
  HostOptions options;
  options.cancel = &cancel;
  const auto host = host_with(1, options);
  EXPECT_FALSE(host->cancelled());
  cancel = true;
  EXPECT_TRUE(host->cancelled());
  EXPECT_FALSE(host_with(1)->cancelled());
}

TEST(Host, LogLinesFromManyThreadsArriveWhole) {
  std::vector<std::string> lines;
  HostOptions options;
  options.log = [&](LogLevel, const std::string& line) { lines.push_back(line); };
  const auto host = host_with(4, options);
  host->parallel_for(200, [&](std::int64_t i) { host->log(LogLevel::info, std::to_string(i)); });
  EXPECT_EQ(lines.size(), 200u);
  host_with(1)->log(LogLevel::error, "nobody listens");
}

}  // namespace
}  // namespace weft
