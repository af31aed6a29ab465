#include "experiments/statistics.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

#include "sdk/quantile.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kBootstrapSeed = 0x626f6f74;  // "boot"

/// The values of some cases, in a row. @param cases indices.
double median_of_cases(const std::vector<double>& values, const std::vector<std::size_t>& cases) {
  std::vector<double> chosen;
  for (const std::size_t one : cases) chosen.push_back(values[one]);
  return quantile_of(std::move(chosen), 0.5);
}

double finite_ratio(double above, double below) {
  const double ratio = above / below;
  return std::isfinite(ratio) ? ratio : kNaN;
}

std::pair<double, double> interval_of(std::vector<double> resampled) {
  std::erase_if(resampled, [](double value) { return std::isnan(value); });
  if (resampled.empty()) return {kNaN, kNaN};
  std::sort(resampled.begin(), resampled.end());
  return {quantile(resampled, 0.025), quantile(resampled, 0.975)};
}

}  // namespace

double mean_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double quantile_of(std::vector<double> values, double at) {
  if (values.empty()) return kNaN;
  std::sort(values.begin(), values.end());
  return quantile(values, at);
}

Spread spread_of(const std::vector<double>& values) {
  if (values.empty()) return {};
  const double mean = mean_of(values);
  double square = 0.0;
  for (const double v : values) square += (v - mean) * (v - mean);
  const double sd = values.size() > 1 ? std::sqrt(square / static_cast<double>(values.size() - 1)) : kNaN;
  return {mean, sd, quantile_of(values, 0.5), quantile_of(values, 1.0)};
}

BootstrapStatistics bootstrap_statistics(const std::vector<double>& values, std::int64_t resamples, std::uint64_t key) {
  BootstrapStatistics s{spread_of(values), values.size()};
  if (values.size() < 2) return s;
  RandomStream random(kBootstrapSeed, key);
  std::vector<double> means, medians, sample(values.size());
  for (std::int64_t r = 0; r < resamples; ++r) {
    for (double& v : sample) v = values[random.below(values.size())];
    means.push_back(mean_of(sample));
    std::sort(sample.begin(), sample.end());
    medians.push_back(quantile(sample, 0.5));
  }
  s.mean_interval = interval_of(std::move(means));
  s.median_interval = interval_of(std::move(medians));
  return s;
}

MedianComparison compare_medians(const std::vector<double>& own, const std::vector<double>& baseline,
                                 const std::vector<double>& target, std::int64_t resamples, std::uint64_t key) {
  MedianComparison result;
  result.n = own.size();
  if (own.empty()) return result;
  const auto compared = [&](const std::vector<std::size_t>& cases) {
    const double here = median_of_cases(own, cases), there = median_of_cases(baseline, cases);
    const double gap = target.empty() ? kNaN : there - median_of_cases(target, cases);
    return std::pair(finite_ratio(there, here), finite_ratio(there - here, gap));
  };
  std::vector<std::size_t> cases(own.size());
  std::iota(cases.begin(), cases.end(), std::size_t{0});
  std::tie(result.ratio, result.gap_closed) = compared(cases);
  if (own.size() < 2) return result;
  RandomStream random(kBootstrapSeed, key);
  std::vector<double> ratios, gaps;
  for (std::int64_t r = 0; r < resamples; ++r) {
    for (std::size_t& one : cases) one = random.below(own.size());
    const auto [ratio, gap] = compared(cases);
    ratios.push_back(ratio);
    gaps.push_back(gap);
  }
  result.ratio_interval = interval_of(std::move(ratios));
  result.gap_interval = interval_of(std::move(gaps));
  return result;
}

}  // namespace weft
