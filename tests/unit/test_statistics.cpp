#include "experiments/statistics.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "experiments/csv.hpp"
#include "weft/random.hpp"

namespace weft::test {
namespace {

TEST(Quantile, IsLinearBetweenTheSortedValues) {
  EXPECT_EQ(quantile_of({4.0, 1.0, 2.0}, 0.0), 1.0);
  EXPECT_EQ(quantile_of({4.0, 1.0, 2.0}, 0.5), 2.0);
  EXPECT_EQ(quantile_of({4.0, 1.0, 2.0}, 0.75), 3.0);
  EXPECT_EQ(quantile_of({4.0, 1.0, 2.0}, 1.0), 4.0);
  EXPECT_EQ(quantile_of({7.0}, 0.3), 7.0);
  EXPECT_TRUE(std::isnan(quantile_of({}, 0.5)));
}

TEST(SpreadOf, NeedsTwoValuesForADeviation) {
  const Spread two = spread_of({1.0, 3.0});
  EXPECT_EQ(two.mean, 2.0);
  EXPECT_EQ(two.sd, std::sqrt(2.0));
  EXPECT_EQ(two.median, 2.0);
  EXPECT_EQ(spread_of({5.0}).median, 5.0);
  EXPECT_TRUE(std::isnan(spread_of({5.0}).sd));
  EXPECT_TRUE(std::isnan(spread_of({}).mean));
}

TEST(Csv, QuotesWhatHoldsCommasQuotesOrLineBreaks) {
  EXPECT_EQ(csv_field("rprop 4"), "rprop 4");
  EXPECT_EQ(csv_field("a, b"), "\"a, b\"");
  EXPECT_EQ(csv_field("a \"b\""), "\"a \"\"b\"\"\"");
  EXPECT_EQ(csv_field("a\nb"), "\"a\nb\"");
  EXPECT_EQ(csv_quoted("a"), "\"a\"");
}

TEST(Csv, NumbersReadBackToTheSameBits) {
  EXPECT_EQ(csv_number(0.1), "0.1");
  EXPECT_EQ(csv_number(std::nan("")), "");
  for (const double value : {1.0 / 3.0, 1e-300, 123456789.0, -2.5, 0.1 + 0.2})
    EXPECT_EQ(std::stod(csv_number(value)), value);
}

TEST(BootstrapStatistics, OfFewValues) {
  const auto none = bootstrap_statistics({}, 1000, 1);
  EXPECT_EQ(none.n, 0u);
  EXPECT_TRUE(std::isnan(none.mean));
  const auto one = bootstrap_statistics({3.0}, 1000, 1);
  EXPECT_EQ(one.mean, 3.0);
  EXPECT_EQ(one.median, 3.0);
  EXPECT_TRUE(std::isnan(one.mean_interval.first));
  const auto four = bootstrap_statistics({4.0, 1.0, 2.0, 10.0}, 1000, 1);
  EXPECT_EQ(four.median, 3.0);
  EXPECT_EQ(four.mean, 4.25);
  EXPECT_NEAR(four.sd, std::sqrt((0.0625 + 10.5625 + 5.0625 + 33.0625) / 3.0), 1e-12);
}

TEST(BootstrapStatistics, BootstrapIntervalsCoverTheMean) {
  // 95 % intervals of the mean of 30 normal values hold 0 in about 94 % of the cases (the percentile bootstrap's slight
  // lack).
  RandomStream random(8);
  int covered = 0;
  constexpr int trials = 400;
  for (int t = 0; t < trials; ++t) {
    std::vector<double> values(30);
    for (double& v : values) v = random.normal();
    const auto s = bootstrap_statistics(values, 400, 1);
    covered += s.mean_interval.first <= 0.0 && 0.0 <= s.mean_interval.second;
    EXPECT_LE(s.mean_interval.first, s.mean);
    EXPECT_GE(s.mean_interval.second, s.mean);
  }
  EXPECT_NEAR(static_cast<double>(covered) / trials, 0.94, 0.035);
}

}  // namespace
}  // namespace weft::test
