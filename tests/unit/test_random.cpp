#include <array>
#include <cmath>
#include <set>
#include <vector>

#include "sdk/philox.hpp"
#include "unit/test_support.hpp"
#include "weft/error.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

using Block = std::array<std::uint32_t, 4>;

Block philox_block(std::uint64_t key, std::uint64_t stream, std::uint64_t counter) {
  Block out;
  philox(key, stream, counter, out.data());
  return out;
}

// Known answers of philox4x32-10 from the Random123 distribution, file kat_vectors. Counter words 0 and 1 are ours
// `counter`, words 2 and 3 `stream`.
TEST(Random, PhiloxKnownAnswers) {
  EXPECT_EQ(philox_block(0, 0, 0), (Block{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  EXPECT_EQ(philox_block(~0ull, ~0ull, ~0ull), (Block{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox_block(0x299f31d0a4093822ull, 0x0370734413198a2eull, 0x85a308d3243f6a88ull),
            (Block{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(Random, SameSeedAndKeysSameNumbers) {
  RandomStream a(7, 1, 2), b(7, 1, 2);
  for (int i = 0; i < 100; ++i) EXPECT_EQ(a.bits64(), b.bits64());
  RandomStream copy = a;
  EXPECT_EQ(copy.normal(), a.normal());
  EXPECT_EQ(copy.normal(), a.normal());
}

TEST(Random, StreamsOfOtherSeedsKeysAndChildrenDiffer) {
  std::set<std::uint64_t> first;
  std::size_t streams = 0;
  const auto add = [&](RandomStream stream) {
    first.insert(stream.bits64());
    ++streams;
  };
  for (std::uint64_t seed = 0; seed < 8; ++seed) {
    for (std::uint64_t a = 0; a < 8; ++a) {
      for (std::uint64_t b = 0; b < 8; ++b) {
        add(RandomStream(seed, a, b));
        add(RandomStream(seed, a, b).child(0));
        add(RandomStream(seed, a, b).child(1));
        add(RandomStream(seed, a, b).child(0).child(1));
        add(RandomStream(seed, a, b).child(1).child(0));
      }
    }
  }
  EXPECT_EQ(first.size(), streams);
}

TEST(Random, AChildDoesNotDependOnWhatItsParentDrew) {
  RandomStream drawn(3), fresh(3);
  drawn.bits();
  drawn.normal();
  RandomStream a = drawn.child(5), b = fresh.child(5);
  for (int i = 0; i < 10; ++i) EXPECT_EQ(a.normal(), b.normal());
  fresh.bits();
  fresh.normal();
  EXPECT_EQ(drawn.bits64(), fresh.bits64());  // and making one draws nothing from the parent
}

TEST(Random, ChildrenAreUncorrelated) {
  constexpr int kDraws = 20000;
  RandomStream parent(11), a = parent.child(0), b = parent.child(1);
  double ab = 0, ap = 0;
  for (int i = 0; i < kDraws; ++i) {
    const double x = a.normal();
    ab += x * b.normal();
    ap += x * parent.normal();
  }
  // The mean of a product of independent standard normals has sd 1 / sqrt(n); 5 sd.
  EXPECT_NEAR(ab / kDraws, 0.0, 5.0 / std::sqrt(kDraws));
  EXPECT_NEAR(ap / kDraws, 0.0, 5.0 / std::sqrt(kDraws));
}

TEST(Random, UniformFillsItsInterval) {
  constexpr int kDraws = 100000;
  RandomStream stream(1);
  double sum = 0, squares = 0;
  std::array<int, 10> bins{};
  for (int i = 0; i < kDraws; ++i) {
    const double u = stream.uniform();
    ASSERT_GE(u, 0.0);
    ASSERT_LT(u, 1.0);
    sum += u;
    squares += u * u;
    ++bins[u * 10];
  }
  EXPECT_NEAR(sum / kDraws, 0.5, 5 * std::sqrt(1.0 / 12 / kDraws));
  EXPECT_NEAR(squares / kDraws, 1.0 / 3, 0.005);
  for (const int n : bins) EXPECT_NEAR(n, kDraws / 10, 5 * std::sqrt(kDraws * 0.09));
  for (int i = 0; i < 1000; ++i) {
    const double u = stream.uniform(-2, 3);
    EXPECT_GE(u, -2);
    EXPECT_LT(u, 3);
  }
}

TEST(Random, NormalHasTheMomentsOfOne) {
  constexpr int kDraws = 100000;
  RandomStream stream(2);
  double m1 = 0, m2 = 0, m3 = 0, m4 = 0;
  for (int i = 0; i < kDraws; ++i) {
    const double x = stream.normal();
    ASSERT_TRUE(std::isfinite(x));
    m1 += x;
    m2 += x * x;
    m3 += x * x * x;
    m4 += x * x * x * x;
  }
  const double root = std::sqrt(kDraws);
  EXPECT_NEAR(m1 / kDraws, 0.0, 5 / root);
  EXPECT_NEAR(m2 / kDraws, 1.0, 5 * std::sqrt(2.0) / root);
  EXPECT_NEAR(m3 / kDraws, 0.0, 5 * std::sqrt(15.0) / root);
  EXPECT_NEAR(m4 / kDraws, 3.0, 5 * std::sqrt(96.0) / root);
}

TEST(Random, BelowIsUniformAndRefusesZero) {
  constexpr int kDraws = 60000;
  RandomStream stream(4);
  std::array<int, 6> bins{};
  for (int i = 0; i < kDraws; ++i) ++bins.at(stream.below(6));
  for (const int n : bins) EXPECT_NEAR(n, kDraws / 6, 5 * std::sqrt(kDraws * 5.0 / 36));
  EXPECT_EQ(stream.below(1), 0u);
  EXPECT_LT(stream.below(~0ull), ~0ull);
  EXPECT_THROW(stream.below(0), Error);
}

}  // namespace
}  // namespace weft
