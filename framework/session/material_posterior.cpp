#include "session/material_posterior.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "sdk/quantile.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr int kBurnIn = 50;
constexpr double kLeastPrecision = 1e-4;  // sd of 100 boxes: in effect uniform

/// Standard normal given low <= z <= high [Robert 1995, "Simulation of truncated normal variables"].
double truncated_normal(double low, double high, RandomStream& random) {
  if (high <= low) return low;
  if (high < 0.0) return -truncated_normal(-high, -low, random);
  if (low <= 0.0) {
    if (high - low > 2.5) {
      for (;;) {
        const double z = random.normal();
        if (z >= low && z <= high) return z;
      }
    }
    for (;;) {
      const double z = random.uniform(low, high);
      if (random.uniform() <= std::exp(-0.5 * z * z)) return z;
    }
  }
  const double rate = 0.5 * (low + std::sqrt(low * low + 4.0));
  if (high - low > 1.0 / rate) {
    for (;;) {
      const double z = low - std::log1p(-random.uniform()) / rate;
      if (z <= high && random.uniform() <= std::exp(-0.5 * (z - rate) * (z - rate))) return z;
    }
  }
  for (;;) {
    const double z = random.uniform(low, high);
    if (random.uniform() <= std::exp(0.5 * (low * low - z * z))) return z;
  }
}

}  // namespace

MaterialPosterior MaterialPosterior::widened(const PropertyVector& factor) const {
  MaterialPosterior wide = *this;
  for (Index p = 0; p < 4; ++p) {
    // Gradient and precision belong to the same log-likelihood, so both are scaled.
    wide.gradient(p) /= factor(p) * factor(p);
    for (Index r = 0; r < 4; ++r) wide.precision(p, r) /= factor(p) * factor(r);
  }
  return wide;
}

MaterialKnowledge interval_of(const MaterialPosterior& posterior, int sweeps) {
  const auto& precision = posterior.precision;
  PropertyVector sd;
  for (Index p = 0; p < 4; ++p) sd(p) = 1.0 / std::sqrt(std::max(precision(p, p), kLeastPrecision));
  std::array<std::vector<double>, 4> samples;
  for (auto& list : samples) list.reserve(sweeps);
  RandomStream random(stream_key("post"));
  PropertyVector q = posterior.mode;
  for (int sweep = -kBurnIn; sweep < sweeps; ++sweep) {
    for (Index p = 0; p < 4; ++p) {
      double slope = posterior.gradient(p);
      for (Index r = 0; r < 4; ++r) {
        if (r != p) slope += precision(p, r) * (q(r) - posterior.mode(r));
      }
      const double mean = posterior.mode(p) - slope * sd(p) * sd(p);
      q(p) = mean + sd(p) * truncated_normal(-mean / sd(p), (1.0 - mean) / sd(p), random);
      q(p) = std::clamp(q(p), 0.0, 1.0);
      if (sweep >= 0) samples[p].push_back(q(p));
    }
  }
  MaterialKnowledge knowledge;
  for (Index p = 0; p < 4; ++p) {
    auto& list = samples[p];
    std::sort(list.begin(), list.end());
    const double low50 = quantile(list, 0.25), high50 = quantile(list, 0.75);
    const double low80 = quantile(list, 0.1), high80 = quantile(list, 0.9);
    knowledge.centre(p) = 0.25 * (low50 + high50 + low80 + high80);
    knowledge.width(p) = std::min(1.0, 0.5 * ((high50 - low50) / 0.5 + (high80 - low80) / 0.8));
  }
  return knowledge;
}

}  // namespace weft
