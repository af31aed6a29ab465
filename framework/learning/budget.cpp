#include "learning/budget.hpp"

#include <algorithm>
#include <cmath>

namespace weft {
namespace {

constexpr double kIterationsPerExample = 3.0;
constexpr double kCalibrationShare = 0.25, kHeldOutShare = 0.125;  // of the examples of the fit
constexpr std::int64_t kFewestOthers = 64, kMostExamples = 10000, kFewestIterations = 100;

LearnParams with_others(std::int64_t examples) {
  const auto share = [&](double part) {
    return std::max(kFewestOthers, std::lround(part * static_cast<double>(examples)));
  };
  return {examples, share(kCalibrationShare), share(kHeldOutShare)};
}

}  // namespace

double seconds_of(const LearnNumbers& numbers, const LearnRates& rates) {
  const LearnParams& n = numbers.examples;
  const double examples = static_cast<double>(n.examples + n.held_out_examples) +
                          (1.0 + kCalibrationCost) * static_cast<double>(n.calibration_examples);
  return examples / rates.examples_per_s + static_cast<double>(numbers.iterations) / rates.iterations_per_s;
}

LearnNumbers numbers_for(double seconds, const LearnRates& rates, std::int64_t least) {
  // The time of one example of the fit, with its share of all else.
  const double each = (1.0 + (1.0 + kCalibrationCost) * kCalibrationShare + kHeldOutShare) / rates.examples_per_s +
                      kIterationsPerExample / rates.iterations_per_s;
  // Where the others are more than their shares because they are at least so many, fewer are left for the fit.
  std::int64_t examples = std::clamp<std::int64_t>(std::lround(std::min(seconds / each, 1e9)), least, kMostExamples);
  const auto numbers = [&](std::int64_t n) {
    return LearnNumbers{with_others(n), std::max(kFewestIterations, std::lround(kIterationsPerExample * n))};
  };
  while (examples > least && seconds_of(numbers(examples), rates) > seconds)
    examples = std::max(least, examples - std::max<std::int64_t>(1, examples / 64));
  LearnNumbers result = numbers(examples);
  const double left = seconds - seconds_of(result, rates);
  if (examples >= kMostExamples && left > 0.0)
    result.iterations += std::lround(std::min(left * rates.iterations_per_s, 1e9));
  return result;
}

}  // namespace weft
