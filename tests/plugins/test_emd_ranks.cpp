// Training over ranks, and from shapes in files: the bits of one process with all in memory. Ranks are threads here, each
// with a predictor of its own, and talk over loopback; tests/apps/test_learning.cpp has processes.
#include <cmath>
#include <cstdlib>
#include <optional>
#include <set>

#include "plugins/emd_fixture.hpp"
#include "weft/error.hpp"

namespace weft::emd {
namespace {

#if WEFT_HAS_TORCH && WEFT_HAS_GLOO

/// One thread, which breaks after some calls: as if its process had died.
class MortalHost final : public Host {
 public:
  explicit MortalHost(int calls) : left_(calls) {}
  int threads() const override { return 1; }
  void parallel_for(std::int64_t count, const std::function<void(std::int64_t)>& body) override {
    if (--left_ < 0) throw std::runtime_error("dies");
    for (std::int64_t i = 0; i < count; ++i) body(i);
  }
  bool cancelled() const override { return false; }
  void log(LogLevel, const std::string&) override {}
  std::uint64_t seed() const override { return 3; }

 protected:
  std::shared_ptr<void> create_erased(const std::string&, const ConfigNode&) override { throw Error("makes nothing"); }

 private:
  int left_;
};

struct RankEnd {
  std::optional<FitReport> report;
  std::string error, log;
};

class EmdRanks : public ::testing::Test {
 protected:
  /// Fits over so many ranks to files NAME.h5 and NAME.checkpoint.h5.
  /// @param stop_at the observer stops the fit after so many iterations.
  std::vector<RankEnd> fit(const std::string& name, int ranks, std::int64_t stop_at = 1000000) {
    std::vector<RankEnd> ends(ranks);
    std::vector<std::thread> threads;
    for (int r = 0; r < ranks; ++r) {
      threads.emplace_back([&, r] {
        RankEnd& end = ends[r];
        try {
          Params own = params_;
          if (r == odd_rank_) own.training.rate *= 2.0;
          TestHost host(1);
          MortalHost mortal(dies_after_);
          EmdPredictor predictor(own, r == mortal_rank_ ? static_cast<Host&>(mortal) : host);
          FitOptions options{
              .seed = 4, .model = folder_ / (name + ".h5"), .checkpoint = folder_ / (name + ".checkpoint.h5")};
          options.ranks = {r, ranks, folder_ / ("." + name + ".ranks"), true, ""};
          end.report =
              predictor.fit(data_, task_, options, [&](const FitProgress& p) { return p.iteration < stop_at; });
          end.log = host.messages_;
        } catch (const std::exception& error) {
          end.error = error.what();
        }
      });
    }
    for (auto& thread : threads) thread.join();
    return ends;
  }
  std::string model(const std::string& name) const { return bytes_of(folder_ / (name + ".h5")); }

  const Folder folder_;
  const Task task_ = patch_task();
  Dataset data_ = toy_dataset(task_, 40);
  Params params_ = small_and_quick();
  int odd_rank_ = -1, mortal_rank_ = -1, dies_after_ = 0;
};

TEST_F(EmdRanks, AFitHasTheBitsOfOneProcess) {
  struct Case {
    const char *optimiser, *vote;
    std::int64_t parts;
    std::vector<int> ranks;
  };
  std::set<std::string> models;
  for (const Case& c : std::vector<Case>{
           {"adam", "sign", 4, {1, 2, 4}}, {"signsgd", "sign", 4, {1, 2, 4}}, {"signsgd", "one_bit", 3, {1, 3}}}) {
    auto& t = params_.training;
    t.optimiser = c.optimiser;
    t.vote = c.vote;
    t.parts = t.votes = c.parts;
    t.rate = t.optimiser == "adam" ? 3e-3 : 1e-3;
    const std::string name = t.optimiser + "_" + t.vote + "_";
    for (const int ranks : c.ranks) {
      const auto ends = fit(name + std::to_string(ranks), ranks);
      for (const auto& end : ends) {
        ASSERT_TRUE(end.report) << end.error;
        EXPECT_TRUE(end.report->finished);
        EXPECT_EQ(end.report->iterations, t.iterations);
      }
      EXPECT_EQ(ends[0].report->json.empty(), false);
      EXPECT_TRUE(model(name + std::to_string(ranks)) == model(name + "1")) << name << ranks;
      EXPECT_FALSE(std::filesystem::exists(folder_ / ("." + name + std::to_string(ranks) + ".ranks")));
    }
    models.insert(model(name + "1"));
  }
  EXPECT_EQ(models.size(), 3u);
}

TEST_F(EmdRanks, AVoteOfOneBitSendsABitForEachWeight) {
  auto& t = params_.training;
  t.parts = t.votes = 3;
  const auto sent_bytes = [&](const std::string& name) {
    const auto ends = fit(name, 3);
    const auto at = ends[1].log.find("rank 1 of 3 sent ");
    EXPECT_NE(at, std::string::npos) << ends[1].error << ends[1].log;
    return at == std::string::npos ? std::nan("") : 1e6 * std::atof(ends[1].log.c_str() + at + 17);
  };
  const double whole = sent_bytes("adam");
  t.optimiser = "signsgd";
  const double sign = sent_bytes("sign");
  t.vote = "one_bit";
  const double bit = sent_bytes("bit");
  EXPECT_NEAR(whole / sign, 4.0, 0.1);
  EXPECT_NEAR(sign / bit, 8.0, 0.4);  // slices are rounded to whole bytes, and megabytes to three places
}

TEST_F(EmdRanks, AnyNumberOfRanksGoesOnWhereOthersStopped) {
  params_.training.parts = 4;
  fit("whole", 1);
  for (const auto& end : fit("changing", 4, 20)) {
    ASSERT_TRUE(end.report) << end.error;
    EXPECT_FALSE(end.report->finished);
    EXPECT_EQ(end.report->iterations, 20);
  }
  EXPECT_EQ(fit("changing", 2, 40)[1].report->resumed, true);
  EXPECT_EQ(fit("changing", 1)[0].report->finished, true);
  EXPECT_TRUE(model("changing") == model("whole"));
}

TEST_F(EmdRanks, WhenARankDiesTheOthersEndAndTheCheckpointGoesOn) {
  params_.training.parts = 4;
  params_.training.checkpoint_every = 1000;  // only the death makes one
  fit("whole", 1);
  mortal_rank_ = 2;
  dies_after_ = 90;
  const auto ends = fit("broken", 4);
  for (std::size_t r = 0; r < ends.size(); ++r) {
    EXPECT_FALSE(ends[r].report) << r;
    EXPECT_THAT(ends[r].error,
                r == 2 ? HasSubstr("dies") : HasSubstr("rank " + std::to_string(r) + " of 4 cannot reach"));
  }
  ASSERT_TRUE(std::filesystem::exists(folder_ / "broken.checkpoint.h5"));
  mortal_rank_ = -1;
  const auto resumed = fit("broken", 2);
  ASSERT_TRUE(resumed[0].report) << resumed[0].error;
  EXPECT_TRUE(resumed[0].report->resumed);
  EXPECT_TRUE(model("broken") == model("whole"));
}

TEST_F(EmdRanks, AFileOfDeadRanksKeepsNobodyFromMeeting) {
  params_.training.parts = 2;
  params_.training.iterations = 2;
  std::ofstream(folder_ / ".again.ranks") << "127.0.0.1 9\n";  // nobody answers there
  const auto ends = fit("again", 2);
  EXPECT_TRUE(ends[0].report) << ends[0].error;
  EXPECT_TRUE(ends[1].report) << ends[1].error;
}

TEST_F(EmdRanks, RefusesWhatCannotBeDivided) {
  params_.training.parts = 2;
  for (const auto& end : fit("a", 4)) EXPECT_THAT(end.error, HasSubstr("training.parts = 2, must be a multiple"));
  params_.training.optimiser = "signsgd";
  params_.training.vote = "one_bit";
  params_.training.votes = 4;
  for (const auto& end : fit("b", 1)) EXPECT_THAT(end.error, HasSubstr("training.votes = 4, must be odd"));
  params_.training.votes = 3;
  odd_rank_ = 1;
  for (const auto& end : fit("c", 3)) EXPECT_THAT(end.error, HasSubstr("rank 1 fits something else than rank 0"));
}

TEST_F(EmdRanks, ShapesInFilesGiveTheBitsOfShapesInMemory) {
  Shard shard{data_.header, {}};
  std::filesystem::create_directory(folder_ / "d");
  shard.header.shard_examples = 16;
  for (std::size_t i = 0; i < data_.examples.size(); ++i) {
    shard.examples.push_back(data_.examples[i]);
    if (i % 16 != 15 && i + 1 != data_.examples.size()) continue;
    write_shard(folder_ / "d" / shard_name(static_cast<std::int64_t>(i) / 16), shard);
    shard.examples.clear();
  }
  data_ = load_dataset(folder_ / "d");
  fit("memory", 1);
  data_ = load_dataset(folder_ / "d", 0, ShapesIn::files);
  for (const auto& e : data_.examples) ASSERT_TRUE(e.shapes.empty());
  fit("files", 1);
  EXPECT_TRUE(model("files") == model("memory"));
  for (const auto& end : fit("ranks", 2)) ASSERT_TRUE(end.report) << end.error;
  EXPECT_TRUE(model("ranks") == model("memory"));

  // What has changed since it was listed is found when it is used.
  auto bytes = bytes_of(folder_ / "d" / shard_name(1));
  bytes[data_.examples[20].stored.at + 100] ^= 1;
  std::ofstream(folder_ / "d" / shard_name(1), std::ios::binary) << bytes;
  const auto damaged = fit("damaged", 1);
  EXPECT_THAT(damaged[0].error, HasSubstr(shard_name(1) + ": example 20 is damaged"));
}

#elif WEFT_HAS_TORCH

TEST(EmdRanks, SaysWhatIsMissing) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host(1);
  FitOptions options;
  options.ranks = {0, 2, folder / "meeting", true, ""};
  const Params params = small_and_quick();
  EXPECT_THAT(
      message_of<Unsupported>([&] { EmdPredictor(params, host).fit(toy_dataset(task, 40), task, options, {}); }),
      HasSubstr("without Gloo"));
}

#endif

}  // namespace
}  // namespace weft::emd
