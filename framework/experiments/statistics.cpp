#include "experiments/statistics.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "sdk/quantile.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kBootstrapSeed = 0x626f6f74;  // "boot"

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
  return {mean, sd, quantile_of(values, 0.5)};
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
  std::sort(means.begin(), means.end());
  std::sort(medians.begin(), medians.end());
  s.mean_interval = {quantile(means, 0.025), quantile(means, 0.975)};
  s.median_interval = {quantile(medians, 0.025), quantile(medians, 0.975)};
  return s;
}

}  // namespace weft
