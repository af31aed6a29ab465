#include "learning_rate.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace weft::emd {

double cosine_rate(const Training& t, std::int64_t iteration, double time_used) {
  const double n = static_cast<double>(iteration) + 1.0;
  const double warm = t.warmup > 0 ? std::min(1.0, n / t.warmup) : 1.0;
  double done = static_cast<double>(iteration) / t.iterations;
  if (t.time_limit_s > 0) done = std::max(done, time_used);
  return warm *
         (t.final_rate + 0.5 * (t.rate - t.final_rate) * (1.0 + std::cos(std::numbers::pi * std::min(1.0, done))));
}

double rate_without_best(const Training& t, double rate, std::int64_t without_best) {
  return without_best % t.patience == 0 ? 0.5 * rate : rate;
}

}  // namespace weft::emd
