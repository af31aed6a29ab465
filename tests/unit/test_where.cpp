// What a thread is doing, as messages and crashes name it.
#include "loader/where.hpp"

#include <gtest/gtest.h>

#include <array>
#include <thread>

#include "loader/program_host.hpp"

namespace weft {
namespace {

TEST(Where, NamesTheInnermostCallAndEveryStep) {
  EXPECT_EQ(where_text(), "");
  const Step segment("segment", 3);
  const Step planning("planning");
  const PluginCall search("optimiser adam", "minimise()");
  EXPECT_EQ(where_text(), "optimiser adam, planning, segment 3");
  {
    const ProgramCall objective;
    EXPECT_EQ(where_text(), "weft, planning, segment 3");
    const PluginCall predict("predictor emd", "predict()");
    std::array<char, 200> buffer;
    const auto length = write_where(buffer.data(), buffer.size());
    EXPECT_EQ(std::string(buffer.data(), length), "predictor emd, predict(), planning, segment 3");
  }
  EXPECT_EQ(where_text(), "optimiser adam, planning, segment 3");
}

TEST(Where, NamesTheCallIfThereIsNoStep) {
  const PluginCall bind("predictor emd", "bind()");
  EXPECT_EQ(where_text(), "predictor emd, bind()");
}

TEST(Where, IsCutToTheBuffer) {
  const Step step("segment", 1234567890123456789);
  std::array<char, 8> buffer;
  EXPECT_EQ(write_where(buffer.data(), buffer.size()), 7u);
  EXPECT_STREQ(buffer.data(), "segment");
  EXPECT_EQ(write_where(nullptr, 0), 0u);
  EXPECT_EQ(where_text(), "segment 1234567890123456789");
}

TEST(Where, ThreadsOfThePoolWorkOnBehalfOfTheirCaller) {
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 4});
  const Step step("planning");
  std::array<std::string, 64> texts;
  host->parallel_for(texts.size(), [&](std::int64_t i) { texts[i] = where_text(); });
  for (const auto& text : texts) EXPECT_EQ(text, "planning");
  std::string other;
  std::thread([&] { other = where_text(); }).join();
  EXPECT_EQ(other, "");
}

}  // namespace
}  // namespace weft
