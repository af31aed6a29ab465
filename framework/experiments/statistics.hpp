#pragma once
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

namespace weft {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

double mean_of(const std::vector<double>& values);
/// Linear between the sorted values; NaN without values. @param at in [0, 1].
double quantile_of(std::vector<double> values, double at);

/// An entry is NaN if there are too few values for it.
struct Spread {
  double mean = kNaN, sd = kNaN, median = kNaN, largest = kNaN;
};
Spread spread_of(const std::vector<double>& values);

/// A spread with 95 % intervals of mean and median by the percentile bootstrap [Efron 1979].
struct BootstrapStatistics : Spread {
  std::size_t n = 0;
  std::pair<double, double> mean_interval{kNaN, kNaN}, median_interval{kNaN, kNaN};
};
/// The bootstrap of the evaluations, whose results name no number of resamples and no stream.
constexpr std::int64_t kResamples = 10000;
constexpr std::uint64_t kBootstrapKey = 1;
/// @param key of the bootstrap's random stream. The same values and key give the same bits.
BootstrapStatistics bootstrap_statistics(const std::vector<double>& values, std::int64_t resamples, std::uint64_t key);

/// Medians of the same cases under three settings, with 95 % intervals by the percentile bootstrap over the cases. NaN:
/// too few cases, or a divisor of 0.
struct MedianComparison {
  std::size_t n = 0;
  double ratio = kNaN;       ///< median of the baseline over the own median
  double gap_closed = kNaN;  ///< (baseline - own) / (baseline - target), of the medians
  std::pair<double, double> ratio_interval{kNaN, kNaN}, gap_interval{kNaN, kNaN};
};
/// @param own, baseline, target [n], case by case. An empty target: no gap.
MedianComparison compare_medians(const std::vector<double>& own, const std::vector<double>& baseline,
                                 const std::vector<double>& target, std::int64_t resamples, std::uint64_t key);

}  // namespace weft
