#pragma once
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

namespace weft {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

double mean_of(const std::vector<double>& values);
/// Linear between the sorted values; NaN if there is none. @param at in [0, 1].
double quantile_of(std::vector<double> values, double at);

/// NaN where there are too few values.
struct Spread {
  double mean = kNaN, sd = kNaN, median = kNaN;
};
Spread spread_of(const std::vector<double>& values);

/// A spread with 95 % intervals of mean and median by the percentile bootstrap [Efron 1979].
struct BootstrapStatistics : Spread {
  std::size_t n = 0;
  std::pair<double, double> mean_interval{kNaN, kNaN}, median_interval{kNaN, kNaN};
};
/// @param key of the bootstrap's random stream: same values, same key, same bits.
BootstrapStatistics bootstrap_statistics(const std::vector<double>& values, std::int64_t resamples, std::uint64_t key);

}  // namespace weft
