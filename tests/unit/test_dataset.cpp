// Examples: made from (seed, index) alone, files whole or refused, the same bytes in any order and on any threads.
#include <sys/file.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <thread>

#include "learning/dataset_files.hpp"
#include "learning/generate.hpp"
#include "learning/held_out.hpp"
#include "sdk/machine_failure.hpp"
#include "simulation/fold.hpp"
#include "simulation/hand_limits.hpp"
#include "toy_trajectory.hpp"
#include "unit/test_support.hpp"
#include "weft/dataset.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

using test::Folder;
using test::message_of;
using ::testing::HasSubstr;

/// Every vertex goes a share of the way to its hand; the share depends on the fabric. Diverges above a height.
class ToySimulator final : public Simulator {
 public:
  explicit ToySimulator(double diverge_above) : diverge_above_(diverge_above) {}
  SimulatorCapabilities capabilities() const override { return {}; }
  void reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene&) override {
    positions_ = garment->positions;
    share_ = 0.05 * fabric.friction;
  }
  void set_state(const Positions& positions, const Positions&, std::span<const Index>) override {
    positions_ = positions;
  }
  void grasp(std::span<const Index>) override {}
  std::vector<Index> grasped() const override { return {0, 1}; }
  void step(const Positions& targets) override {
    if (targets(0, 2) > diverge_above_) throw Diverged("toy: frame 7: not finite");
    for (Index v = 0; v < positions_.rows(); ++v)
      positions_.row(v) += share_ * (targets.row(v % 2) - positions_.row(v));
  }
  void release(std::span<const Index>) override {}
  void release() override {}
  SettleResult settle(const SettleCriterion&) override {
    positions_.col(2) *= 0.1;
    return {.frames = 3, .max_speed = 0.001, .settled = true};
  }
  const Positions& positions() const override { return positions_; }
  const Positions& velocities() const override { return positions_; }
  Index frame() const override { return 0; }
  SimulatorDiagnostics diagnostics() const override { return {}; }

 private:
  double diverge_above_, share_ = 0.0;
  Positions positions_;
};

class ToyHost final : public Host {
 public:
  explicit ToyHost(int threads, double diverge_above = 1e9) : threads_(threads), diverge_above_(diverge_above) {}
  int threads() const override { return threads_; }
  void parallel_for(std::int64_t count, const std::function<void(std::int64_t)>& body) override {
    std::atomic<std::int64_t> next{0};
    std::vector<std::thread> workers;
    for (int t = 0; t < threads_; ++t) {
      workers.emplace_back([&] {
        for (std::int64_t i = next++; i < count; i = next++) body(i);
      });
    }
    for (auto& worker : workers) worker.join();
  }
  bool cancelled() const override { return stop_after_ >= 0 && made_.load() > stop_after_; }
  void log(LogLevel, const std::string& message) override { messages_ += message + "\n"; }
  std::uint64_t seed() const override { return 5; }
  std::string messages_;
  int stop_after_ = -1;

 protected:
  std::shared_ptr<void> create_erased(const std::string&, const ConfigNode&) override {
    ++made_;
    return std::make_shared<ToySimulator>(diverge_above_);
  }

 private:
  int threads_;
  double diverge_above_;
  std::atomic<int> made_{0};
};

Task toy_task() {
  Task task;
  Mesh mesh;
  mesh.positions.resize(4, 3);
  mesh.positions << 0, 0, 0, 0.1, 0, 0, 0, 0.1, 0, 0.1, 0.1, 0;
  mesh.faces.resize(2, 3);
  mesh.faces << 0, 1, 2, 1, 3, 2;
  task.garment = std::make_shared<const Garment>(make_garment(mesh, "patch"));
  task.trajectory = std::make_shared<const test::ToyTrajectory>();
  task.manipulation.grasp_vertices = {0, 1};
  task.manipulation.grasp_points = mesh.positions.topRows(2);
  task.manipulation.displacement = {0.1, 0.0};
  task.material.ranges = {{{0.2, 0.9, false}, {0.5, 2.0, true}, {0.5, 2.0, true}, {0.001, 0.002, false}}};
  return task;
}

DataParams small_shards() {
  DataParams params;
  params.shard_examples = 8;
  params.test_fraction = 0.3;
  params.validation_fraction = 0.2;
  params.max_segments = 12;
  return params;
}

DatasetHeader header_of(const Task& task, const DataParams& params, std::uint64_t seed = 5) {
  return make_dataset_header(task, params, seed, ConfigNode::parse("{a: 1}", "test"), "{}");
}

GenerateReport generate(const std::filesystem::path& folder, std::int64_t examples, Host& host, std::int64_t shard = 0,
                        std::int64_t shards = 1) {
  const Task task = toy_task();
  const DataParams params = small_shards();
  GenerateOptions options;
  options.examples = examples;
  options.folder = folder;
  options.shard_index = shard;
  options.shard_count = shards;
  return generate_dataset(task, params, header_of(task, params), options, host);
}

std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}
std::map<std::string, std::string> contents(const std::filesystem::path& folder) {
  std::map<std::string, std::string> all;
  for (const auto& file : list_shards(folder)) all[file.filename().string()] = bytes_of(file);
  return all;
}

TEST(Dataset, BytesDoNotDependOnThreadsPartsOrInterruptions) {
  const Folder folder;
  ToyHost one(1), four(4);
  EXPECT_EQ(generate(folder / "whole", 37, one).made, 37);
  const auto whole = contents(folder / "whole");
  ASSERT_EQ(whole.size(), 5u);
  generate(folder / "threads", 37, four);
  EXPECT_EQ(contents(folder / "threads"), whole);

  generate(folder / "parts", 37, four, 2, 3);
  generate(folder / "parts", 37, four, 0, 3);
  generate(folder / "parts", 37, one, 1, 3);
  EXPECT_EQ(contents(folder / "parts"), whole);

  // A file missing, one cut short, one with a wrong byte, one of a smaller run, and the leavings of a killed one.
  auto broken = bytes_of(folder / "parts" / shard_name(1));
  std::ofstream(folder / "parts" / shard_name(1), std::ios::binary) << broken.substr(0, broken.size() / 2);
  broken = bytes_of(folder / "parts" / shard_name(3));
  broken[broken.size() * 3 / 4] ^= 1;
  std::ofstream(folder / "parts" / shard_name(3), std::ios::binary) << broken;
  std::filesystem::remove(folder / "parts" / shard_name(0));
  std::ofstream(folder / "parts" / "shard-00000.h5.tmp99") << "half";
  const GenerateReport repaired = generate(folder / "parts", 37, one);
  EXPECT_EQ(repaired.refused, 2) << "each damaged file is reported once";
  EXPECT_EQ(contents(folder / "parts"), whole);
  EXPECT_FALSE(std::filesystem::exists(folder / "parts" / "shard-00000.h5.tmp99"));

  generate(folder / "grown", 20, four);
  const GenerateReport grown = generate(folder / "grown", 37, four);
  EXPECT_EQ(grown.kept, 16);
  EXPECT_EQ(contents(folder / "grown"), whole);
}

TEST(Dataset, AFileThatCannotBeReadNowIsNotMadeAgain) {
  const Folder folder;
  ToyHost host(1);
  generate(folder.path(), 8, host);
  const auto file = folder / shard_name(0);
  const auto whole = contents(folder.path());
  FILE* held = fopen(file.c_str(), "r+");
  ASSERT_NE(held, nullptr);
  ASSERT_EQ(flock(fileno(held), LOCK_EX | LOCK_NB), 0);
  EXPECT_THAT(message_of<ReadError>([&] { generate(folder.path(), 16, host); }), HasSubstr("is locked"));
  fclose(held);
  EXPECT_EQ(contents(folder.path()), whole);
  std::ofstream(file, std::ios::binary) << "version https://git-lfs.github.com/spec/v1\n";
  EXPECT_THAT(message_of<ReadError>([&] { generate(folder.path(), 16, host); }), HasSubstr("git lfs pull"));
  std::ofstream(file, std::ios::binary) << whole.begin()->second;
  EXPECT_EQ(generate(folder.path(), 16, host).kept, 8);
}

TEST(Dataset, AnotherSeedOrConfigInTheFolderIsRefused) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "d", 10, host);
  const Task task = toy_task();
  GenerateOptions options;
  options.examples = 10;
  options.folder = folder / "d";
  const auto message = message_of<ConfigError>(
      [&] { generate_dataset(task, small_shards(), header_of(task, small_shards(), 6), options, host); });
  EXPECT_THAT(message, HasSubstr("belongs to another dataset"));
}

TEST(Dataset, LoadsWhatWasSimulated) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "d", 20, host);
  const Dataset data = load_dataset(folder / "d");
  const Task task = toy_task();
  data.require_task(task);
  ASSERT_EQ(data.examples.size(), 20u);
  ToySimulator simulator(1e9);
  for (std::size_t i = 0; i < data.examples.size(); ++i) {
    const Example& got = data.examples[i];
    const Example made = make_example(simulator, task, small_shards(), 5, static_cast<std::int64_t>(i));
    EXPECT_EQ(got.index, static_cast<std::int64_t>(i));
    EXPECT_EQ(got.q, made.q);
    EXPECT_EQ(got.controls, made.controls);
    EXPECT_EQ(got.states, made.states);
    EXPECT_EQ(got.targets, made.targets);
    EXPECT_EQ(got.shapes, made.shapes);
    EXPECT_EQ(got.released, made.released);
    EXPECT_EQ(got.states.rows(), got.segments() + 1);
    EXPECT_EQ(got.shapes.size(), static_cast<std::size_t>((got.segments() + 1) * 12));
    const FoldResult fold = simulate_fold(simulator, task, got.q, got.controls);
    EXPECT_LT((data.shape(i, got.segments()) - fold.shapes.back()).cwiseAbs().maxCoeff(), 1e-7);
  }
  EXPECT_EQ(load_dataset(folder / "d", 3).examples.size(), 3u);
  EXPECT_THROW(data.shape(0, 100), ShapeError);
}

TEST(Dataset, ExamplesKeepTheLimitsOfTheHands) {
  Task task = toy_task();
  ToySimulator simulator(1e9);
  Index exceeding = 0;
  for (const double limit : {HandLimits::kNone, 0.6}) {
    task.hands.speed = limit;
    for (std::int64_t i = 0; i < 20; ++i) {
      const Example made = make_example(simulator, task, small_shards(), 5, i);
      HandMotionMeter meter(task.hands, task.manipulation.grasp_points, {});
      Vector state = made.states.row(0).transpose();
      for (Index j = 0; j < made.segments(); ++j) {
        const SegmentPath path = task.trajectory->segment(task.manipulation, state, made.controls.row(j).transpose());
        for (const auto& targets : path.targets) meter.add(targets);
        state = path.end_state;
      }
      if (limit == HandLimits::kNone)
        exceeding += meter.motion().speed > 0.6;
      else
        EXPECT_LE(meter.motion().speed, 0.6 * 1.001) << i;
    }
  }
  EXPECT_GT(exceeding, 5) << "the limit is so wide that the test shows little";
}

TEST(Dataset, ShapesCanStayInTheFiles) {
  const Folder folder;
  ToyHost host(2, 0.9);  // some fail
  generate(folder / "d", 24, host);
  const Dataset memory = load_dataset(folder / "d"), files = load_dataset(folder / "d", 0, ShapesIn::files);
  const auto has_failed = [](const Example& e) { return e.failed(); };
  EXPECT_TRUE(std::any_of(memory.examples.begin(), memory.examples.end(), has_failed));
  ASSERT_EQ(files.examples.size(), memory.examples.size());
  files.require_task(toy_task());
  for (std::size_t i = 0; i < memory.examples.size(); ++i) {
    const Example &there = memory.examples[i], &e = files.examples[i];
    ASSERT_TRUE(e.failed() || e.stored.file != nullptr);
    EXPECT_TRUE(e.shapes.empty());
    EXPECT_EQ(e.read_shapes(4), there.shapes);
    EXPECT_EQ(there.read_shapes(4), there.shapes);
    EXPECT_EQ(e.q, there.q);
    EXPECT_EQ(e.controls, there.controls);
    if (e.failed()) continue;
    EXPECT_EQ(files.shape(i, e.segments()), memory.shape(i, e.segments()));
  }
  Dataset both = load_dataset(folder / "d", 0, ShapesIn::files), other = files;
  other.header.identity = "another";
  append_dataset(both, std::move(other));
  EXPECT_EQ(both.examples[24 + 5].read_shapes(4), memory.examples[5].shapes);
  write_shard(folder / "again.h5", {files.header, {files.examples.begin(), files.examples.begin() + 8}});
  EXPECT_EQ(bytes_of(folder / "again.h5"), bytes_of(folder / "d" / shard_name(0)));
}

TEST(Dataset, WhatChangedInAFileIsFoundWhenItIsUsed) {
  const Folder folder;
  ToyHost host(1);
  generate(folder / "d", 8, host);
  const auto file = folder / "d" / shard_name(0);
  const std::string whole = bytes_of(file);
  const auto problem = [&](const std::string& bytes, std::size_t example) {
    const Dataset files = load_dataset(folder / "d", 0, ShapesIn::files);
    std::ofstream(file, std::ios::binary) << bytes;
    const auto message = message_of<ConfigError>([&] { files.examples[example].read_shapes(4); });
    std::ofstream(file, std::ios::binary) << whole;
    return message;
  };
  const auto at = load_dataset(folder / "d", 0, ShapesIn::files).examples[3].stored.at;
  auto changed = whole;
  changed[at + 5] ^= 1;
  EXPECT_THAT(problem(changed, 3), HasSubstr("example 3 is damaged"));
  EXPECT_THAT(problem(whole.substr(0, at), 3), HasSubstr("example 3 is missing: the file was cut short"));
  std::ofstream(file, std::ios::binary) << changed;
  const Dataset files = load_dataset(folder / "d", 0, ShapesIn::files);
  EXPECT_NO_THROW(files.examples[2].read_shapes(4));  // the others are as they were
  std::ofstream(file, std::ios::binary) << whole;
  // The checksum is of the whole example, not of its shapes alone.
  Example other = load_dataset(folder / "d", 0, ShapesIn::files).examples[3];
  other.q[0] += 0.25;
  EXPECT_THAT(message_of<ConfigError>([&] { other.read_shapes(4); }), HasSubstr("is damaged"));
}

TEST(Dataset, FilesOfSchema1AreRead) {
  const Folder folder;
  const std::filesystem::path old = WEFT_SOURCE_DIR "/tests/unit/dataset_1.h5";
  ASSERT_EQ(Hdf5File::open(old).read_text("/schema"), "weft dataset 1");
  const Shard shard = read_shard(old), files = read_shard(old, ShapesIn::files);
  ASSERT_EQ(shard.examples.size(), 3u);
  EXPECT_EQ(files.examples[1].shapes, shard.examples[1].shapes);  // compressed: they must be in memory
  std::filesystem::create_directory(folder / "d");
  std::filesystem::copy_file(old, folder / "d" / shard_name(0));
  merge_datasets({folder / "d"}, folder / "new");  // writes the schema of today
  const Dataset now = load_dataset(folder / "new", 0, ShapesIn::files);
  EXPECT_TRUE(now.examples[2].shapes.empty());
  EXPECT_EQ(now.examples[2].read_shapes(now.header.vertices), shard.examples[2].shapes);
}

TEST(Dataset, AFailedSimulationIsRecorded) {
  const Folder folder;
  ToyHost host(2, 0.9);
  const GenerateReport report = generate(folder / "d", 24, host);
  EXPECT_GT(report.failed(), 0);
  EXPECT_LT(report.failed(), 24);
  const Dataset data = load_dataset(folder / "d");
  std::int64_t failed = 0;
  for (const auto& e : data.examples) {
    failed += e.failed();
    if (!e.failed()) continue;
    EXPECT_THAT(e.failure, HasSubstr("frame 7"));
    EXPECT_EQ(e.segments(), 0);
    EXPECT_TRUE(e.q.allFinite());
  }
  EXPECT_EQ(failed, report.failed());
  EXPECT_FALSE(report.acceptable());  // more than one in a hundred
  std::size_t selected = 0;
  for (const Split split : {Split::train, Split::validation, Split::test}) selected += data.select(split).size();
  EXPECT_EQ(selected, 24u - static_cast<std::size_t>(failed));
}

TEST(Dataset, OnlyFewDivergedExamplesAreData) {
  GenerateReport report;
  report.made = 150;
  report.kept = 50;
  EXPECT_TRUE(report.acceptable());
  report.failures = {WorkStatus::diverged, WorkStatus::diverged};
  EXPECT_TRUE(report.acceptable());
  report.failures.push_back(WorkStatus::diverged);
  EXPECT_FALSE(report.acceptable());
  report.failures = {WorkStatus::crashed};
  EXPECT_FALSE(report.acceptable());
}

TEST(Dataset, AFailureSaysItsStatus) {
  Example example;
  EXPECT_EQ(failure_of(example).status, WorkStatus::done);
  example.failure = "crashed: SIGSEGV in plugin simulator mine";
  EXPECT_EQ(failure_of(example).status, WorkStatus::crashed);
  EXPECT_EQ(failure_of(example).message, "SIGSEGV in plugin simulator mine");
  example.failure = "mine: diverged in frame 7";
  EXPECT_EQ(failure_of(example).status, WorkStatus::diverged);
  EXPECT_EQ(failure_of(example).message, "mine: diverged in frame 7");
}

TEST(Dataset, SplitsByIndexAndMergesBackToTheSameBytes) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "d", 37, host);
  const auto counts = split_dataset(folder / "d", folder / "s");
  EXPECT_EQ(counts[0] + counts[1] + counts[2], 37);
  for (const auto count : counts) EXPECT_GT(count, 0);
  const Dataset part = load_dataset(folder / "s" / "test");
  for (const auto& e : part.examples) EXPECT_EQ(part.header.split(e.index), Split::test);
  merge_datasets({folder / "s" / "validation", folder / "s" / "train", folder / "s" / "test"}, folder / "m");
  EXPECT_EQ(contents(folder / "m"), contents(folder / "d"));
  EXPECT_THROW(merge_datasets({folder / "d"}, folder / "m"), ConfigError);
  EXPECT_THROW(merge_datasets({folder / "none"}, folder / "n"), ConfigError);
}

TEST(Dataset, AMergeIsWholeOrAbsent) {
  const Folder folder;
  ToyHost host(1);
  generate(folder / "a", 20, host, 0, 2);
  generate(folder / "b", 20, host, 1, 2);
  // One that was killed left a part of its files.
  std::filesystem::create_directories(folder / "to" / ".weft-unfinished");
  std::ofstream(folder / "to" / ".weft-unfinished" / shard_name(1)) << "half";
  EXPECT_EQ(merge_datasets({folder / "a", folder / "b"}, folder / "to"), 3);
  generate(folder / "whole", 20, host);
  EXPECT_EQ(contents(folder / "to"), contents(folder / "whole"));
  EXPECT_FALSE(std::filesystem::exists(folder / "to" / ".weft-unfinished"));
  EXPECT_THAT(message_of<ConfigError>([&] { merge_datasets({folder / "a"}, folder / "to"); }),
              HasSubstr("holds a dataset already; merge into an empty folder"));
  // One that is refused in its last file leaves none.
  Shard other = read_shard(folder / "a" / shard_name(2));
  ASSERT_FALSE(other.examples.empty());
  other.examples.back().shapes.back() += 1.0f;
  std::filesystem::create_directories(folder / "c");
  write_shard(folder / "c" / shard_name(2), other);
  EXPECT_THAT(message_of<ConfigError>([&] {
                merge_datasets({folder / "a", folder / "c"}, folder / "new");
              }),
              HasSubstr("differs from the one of the same number"));
  EXPECT_FALSE(std::filesystem::exists(folder / "new"));
}

TEST(Dataset, AMergeOrSplitThatIsStoppedAtAnyFileLeavesNothing) {
  const Folder folder;
  ToyHost host(1);
  generate(folder / "a", 20, host);
  const auto files_before_the_end = [&](const std::filesystem::path& made, const auto& work) {
    for (int files = 0;; ++files) {
      int asked = 0;
      try {
        work([&] { return asked++ == files; });
        return files;
      } catch (const Interrupted& error) {
        EXPECT_THAT(error.what(), HasSubstr("no dataset was written"));
      }
      EXPECT_FALSE(std::filesystem::exists(made)) << files;
    }
  };
  const auto merge = [&](const auto& asked) { merge_datasets({folder / "a"}, folder / "to", asked); };
  EXPECT_EQ(files_before_the_end(folder / "to", merge), 6);  // reads each of the three files twice
  EXPECT_EQ(contents(folder / "to"), contents(folder / "a"));
  const auto split = [&](const auto& asked) { split_dataset(folder / "a", folder / "three", asked); };
  EXPECT_EQ(files_before_the_end(folder / "three" / "train", split), 3);
}

TEST(Dataset, AMergeThatIsKilledWhileItsFilesAreMovedIsNoDatasetAndCanBeRepeated) {
  const Folder folder;
  ToyHost host(1);
  generate(folder / "a", 20, host);
  std::filesystem::create_directories(folder / "to" / ".weft-moving");
  std::filesystem::copy_file(folder / "a" / shard_name(0), folder / "to" / shard_name(0));
  std::filesystem::copy_file(folder / "a" / shard_name(1), folder / "to" / ".weft-moving" / shard_name(1));
  EXPECT_THAT(message_of<ConfigError>([&] { load_dataset(folder / "to"); }), HasSubstr("holds a part of a dataset"));
  merge_datasets({folder / "a"}, folder / "to");
  EXPECT_EQ(contents(folder / "to"), contents(folder / "a"));
  EXPECT_FALSE(std::filesystem::exists(folder / "to" / ".weft-moving"));
}

TEST(Dataset, ASplitThatIsKilledBetweenItsPartsIsMadeAgainAsAWhole) {
  const Folder folder;
  ToyHost host(1);
  generate(folder / "a", 20, host);
  split_dataset(folder / "a", folder / "whole");
  split_dataset(folder / "a", folder / "to");
  std::filesystem::create_directories(folder / "to" / "validation" / ".weft-moving");
  EXPECT_THAT(message_of<ConfigError>([&] { load_dataset(folder / "to" / "validation"); }),
              HasSubstr("a part of a dataset"));
  split_dataset(folder / "a", folder / "to");
  for (const char* part : {"train", "validation", "test"})
    EXPECT_EQ(contents(folder / "to" / part), contents(folder / "whole" / part)) << part;
  EXPECT_THAT(message_of<ConfigError>([&] { split_dataset(folder / "a", folder / "to"); }),
              HasSubstr("holds a dataset already"));
}

TEST(Dataset, AppendsAnotherDatasetOfTheSameTaskAndKeepsEachSplit) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "a", 20, host);
  Dataset both = load_dataset(folder / "a"), other = both;
  for (auto& e : other.examples) e.q.setConstant(0.25);
  other.header.identity = "of another distribution";
  const auto own = both.select(Split::train);
  append_dataset(both, other);
  const auto all = both.select(Split::train);
  ASSERT_EQ(all.size(), 2 * own.size());
  for (std::size_t i = 0; i < own.size(); ++i) {
    EXPECT_EQ(both.examples[all[i]].index, both.examples[all[own.size() + i]].index);
    EXPECT_TRUE(both.examples[all[own.size() + i]].q.isConstant(0.25));
  }
  EXPECT_NE(both.header.identity, other.header.identity);

  Dataset again = other;
  EXPECT_THAT(message_of<ConfigError>([&] { append_dataset(again, other); }), HasSubstr("the same one"));
  const auto refused = [&](auto change) {
    Dataset wrong = load_dataset(folder / "a");
    change(wrong.header);
    return message_of<ConfigError>([&] {
      Dataset target = other;
      append_dataset(target, wrong);
    });
  };
  EXPECT_THAT(refused([](auto& h) { h.garment_hash ^= 1; }), HasSubstr("garments differ"));
  EXPECT_THAT(refused([](auto& h) { h.control_names.push_back("x"); }), HasSubstr("trajectories differ"));
  EXPECT_THAT(refused([](auto& h) { h.test_fraction *= 0.5; }), HasSubstr("test_fraction"));
}

TEST(Dataset, SaysWhenASplitIsNotWhatAModelTookItFor) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "d", 40, host);
  const Dataset data = load_dataset(folder / "d");
  const DatasetOrigin own = data.header.origin();
  const auto warnings = [&](const std::vector<DatasetOrigin>& trained_on) {
    std::string all;
    for (const Split split : {Split::train, Split::validation, Split::test})
      all += held_out_warning(data, split, trained_on);
    return all;
  };
  EXPECT_EQ(warnings({}), "");  // an older model does not say
  EXPECT_EQ(warnings({own}), "");
  const DatasetOrigin other{"of another seed", own.seed + 1, 0.5, 0.0};
  EXPECT_EQ(warnings({other, own}), "");
  Dataset both = data, second = data;
  second.header.identity = other.identity;
  second.header.seed = other.seed;
  append_dataset(both, second);
  ASSERT_EQ(both.origins().size(), 2u);
  EXPECT_EQ(both.origins()[0].identity, own.identity);
  EXPECT_EQ(both.origins()[1].seed, other.seed);
  EXPECT_EQ(warnings(both.origins()), "");

  // Another seed has no example in common, so its train split is not training data.
  EXPECT_THAT(held_out_warning(data, Split::train, {other}), HasSubstr("was not trained on dataset " + own.identity));
  EXPECT_EQ(held_out_warning(data, Split::test, {other}), "");
  // The same examples, otherwise split: those that were trained on are counted.
  DatasetOrigin resplit = own;
  resplit.test_fraction = 0.5 * own.test_fraction;
  resplit.validation_fraction = 0.0;
  const auto test = data.select(Split::test);
  const auto used = std::count_if(test.begin(), test.end(),
                                  [&](std::size_t i) { return resplit.split(data.examples[i].index) == Split::train; });
  ASSERT_GT(used, 0);
  ASSERT_LT(used, static_cast<std::ptrdiff_t>(test.size()));
  EXPECT_THAT(
      held_out_warning(data, Split::test, {other, resplit}),
      HasSubstr(std::to_string(used) + " of the " + std::to_string(test.size()) + " examples of the test split"));
  const std::string all = std::to_string(data.select(Split::validation).size());
  EXPECT_THAT(held_out_warning(data, Split::validation, {resplit}), HasSubstr(all + " of the " + all));
  EXPECT_THAT(message_of<ConfigError>([] { split_named("tset"); }), HasSubstr("'tset'"));
}

TEST(Dataset, UnseenAreTheExamplesThatNeitherAFitNorATestHasAClaimTo) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "d", 40, host);
  Dataset data = load_dataset(folder / "d");
  const DatasetOrigin own = data.header.origin();
  const auto train = data.select(Split::train), validation = data.select(Split::validation);
  ASSERT_GT(validation.size(), 1u);
  const auto joined = [](std::vector<std::size_t> a, const std::vector<std::size_t>& b) {
    a.insert(a.end(), b.begin(), b.end());
    std::sort(a.begin(), a.end());
    return a;
  };
  const DatasetOrigin other{"of another seed", own.seed + 1, 0.5, 0.0};
  EXPECT_EQ(unseen_examples(data, {own}), validation);
  EXPECT_EQ(unseen_examples(data, {other}), joined(train, validation));
  EXPECT_EQ(unseen_examples(data, {other, own}), validation);
  EXPECT_EQ(unseen_examples(data, {}), validation);  // who knows
  // The same numbers of the same seed under another config: much the same examples.
  DatasetOrigin similar = own;
  similar.identity = "of another distribution";
  EXPECT_EQ(unseen_examples(data, {similar}), validation);
  // ... and split otherwise: examples tested there must not be used here, nor those that are tested here.
  similar.test_fraction = 0.5 * own.test_fraction;
  similar.validation_fraction = 1.0 - similar.test_fraction;
  std::vector<std::size_t> wanted;
  for (const auto i : joined(train, validation)) {
    if (similar.split(data.examples[i].index) == Split::validation) wanted.push_back(i);
  }
  EXPECT_EQ(unseen_examples(data, {similar}), wanted);
  similar.validation_fraction = 0.0;
  EXPECT_TRUE(unseen_examples(data, {similar}).empty());

  // Each of several datasets is judged by its own record; a failed example never counts.
  Dataset both = data, second = data, third = data;
  second.header.identity = other.identity;
  second.header.seed = other.seed;
  second.examples[train.front()].failure = "diverged";
  third.header.identity = "a third";
  third.header.seed = own.seed + 2;
  append_dataset(second, third);
  append_dataset(both, second);
  EXPECT_EQ(both.begins, (std::vector<std::size_t>{0, 40, 80}));
  EXPECT_EQ(both.source(0), 0u);
  EXPECT_EQ(both.source(39), 0u);
  EXPECT_EQ(both.source(40), 1u);
  EXPECT_EQ(both.source(119), 2u);
  EXPECT_EQ(data.source(39), 0u);
  std::vector<std::size_t> chosen = validation;
  for (const auto i : joined(train, validation)) {
    if (i != train.front()) chosen.push_back(40 + i);
  }
  for (const auto i : joined(train, validation)) chosen.push_back(80 + i);
  EXPECT_EQ(unseen_examples(both, {own}), chosen);
}

TEST(Dataset, SaysWhenSigmaWasCalibratedOnASplit) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "d", 40, host);
  const Dataset data = load_dataset(folder / "d");
  const DatasetOrigin own = data.header.origin(), other{"of another seed", own.seed + 1, 0.2, 0.3};
  const auto all_of = [&](Split split, const std::vector<DatasetOrigin>& trained_on) {
    const std::string n = std::to_string(data.select(split).size());
    const std::string warning = held_out_warning(data, split, trained_on, {own});
    return warning.find(n + " of the " + n) != std::string::npos &&
           warning.find("its sigma was calibrated on") != std::string::npos;
  };
  EXPECT_TRUE(all_of(Split::train, {other}));
  EXPECT_TRUE(all_of(Split::validation, {other}));
  EXPECT_EQ(held_out_warning(data, Split::test, {other}, {own}), "");
  // Trained on the same: the validation split alone was calibrated on, see unseen().
  EXPECT_EQ(held_out_warning(data, Split::train, {own}, {own}), "");
  EXPECT_TRUE(all_of(Split::validation, {own}));
  EXPECT_EQ(held_out_warning(data, Split::validation, {own}, {other}), "");

  // Each of several datasets is judged by its own record.
  Dataset both = data, second = data;
  second.header.identity = other.identity;
  second.header.seed = other.seed;
  append_dataset(both, second);
  const DatasetOrigin next = second.header.origin();
  const std::string n = std::to_string(data.select(Split::train).size()),
                    all = std::to_string(both.select(Split::train).size());
  EXPECT_NE(held_out_warning(both, Split::train, {own}, {next}).find(n + " of the " + all), std::string::npos);
  const std::string untrained = held_out_warning(both, Split::train, {own}, {});
  EXPECT_NE(untrained.find("was not trained on dataset " + other.identity), std::string::npos);
  EXPECT_EQ(untrained.find("was not trained on dataset " + own.identity), std::string::npos);

  // All examples are to be held out as test examples are.
  const std::size_t known = data.select(Split::train).size() + data.select(Split::validation).size();
  ASSERT_EQ(both.select({}).size(), both.examples.size());
  EXPECT_NE(held_out_warning(both, {}, {own})
                .find(std::to_string(known) + " of the " + std::to_string(both.examples.size()) +
                      " examples may not be held"),
            std::string::npos);
  EXPECT_EQ(held_out_warning(data, {}, {other}), "");
}

TEST(Dataset, ADamagedFileIsRefusedWholeAndNeverCrashes) {
  const Folder folder;
  ToyHost host(2);
  generate(folder / "d", 5, host);
  const auto file = folder / "d" / shard_name(0);
  const std::string good = bytes_of(file);
  const Shard truth = read_shard(file);
  RandomStream random(3);
  int refused = 0;
  for (int trial = 0; trial < 150; ++trial) {
    std::string bad = good;
    if (trial % 3 == 0) {
      bad.resize(random.below(bad.size()));
    } else {
      for (int k = 0; k < 1 + trial % 4; ++k) bad[random.below(bad.size())] ^= static_cast<char>(1 + random.below(255));
    }
    const auto place = folder / "bad.h5";
    std::ofstream(place, std::ios::binary) << bad;
    try {
      const Shard read = read_shard(place);
      // Only bytes without a meaning (padding, unused tables, texts that no number depends on) may change unnoticed.
      ASSERT_EQ(read.examples.size(), truth.examples.size());
      for (std::size_t i = 0; i < truth.examples.size(); ++i) {
        EXPECT_EQ(read.examples[i].shapes, truth.examples[i].shapes);
        EXPECT_EQ(read.examples[i].controls, truth.examples[i].controls);
        EXPECT_EQ(read.examples[i].q, truth.examples[i].q);
      }
    } catch (const Error& error) {
      ++refused;
      EXPECT_THAT(error.what(), HasSubstr("bad.h5"));
    }
  }
  EXPECT_GT(refused, 60);
  EXPECT_THROW(load_dataset(folder / "nothing"), ConfigError);
}

TEST(Dataset, ExamplesOfAnotherTaskAreRefusedWithTheReason) {
  const Folder folder;
  ToyHost host(1);
  generate(folder / "d", 5, host);
  const Dataset data = load_dataset(folder / "d");
  Task other = toy_task();
  other.manipulation.grasp_points(0, 0) += 0.01;
  EXPECT_THAT(message_of<ConfigError>([&] { data.require_task(other); }), HasSubstr("another manipulation"));
  other = toy_task();
  other.manipulation.opens_at = Vector(Eigen::Vector2d(0.5, 1.0));
  EXPECT_THAT(message_of<ConfigError>([&] { data.require_task(other); }), HasSubstr("manipulation.opens_at differs"));
  Dataset opening = data;
  opening.header.config = "manipulation: {opens_at: [0.5, 1]}\n";
  opening.require_task(other);
  auto garment = std::make_shared<Garment>(*toy_task().garment);
  garment->hash ^= 1;
  other = toy_task();
  other.garment = garment;
  EXPECT_THAT(message_of<ConfigError>([&] { data.require_task(other); }), HasSubstr("garment 'patch'"));
}

TEST(Hdf5File, HalfPrecisionIsExactForHalves) {
  const Folder folder;
  const std::vector<float> halves = {0.0f, 1.0f, -2.5f, 65504.0f, 0.0999755859375f, 5.9604645e-8f, -0.333251953125f};
  auto file = Hdf5File::create(folder / "h.h5");
  file.write_half("/x", {7}, halves.data());
  file.commit();
  EXPECT_EQ(Hdf5File::open(folder / "h.h5").read_float("/x"), halves);
}

}  // namespace
}  // namespace weft
