#include "experiments/benchmark/run.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <random>

#include "sdk/formatted.hpp"

namespace weft::benchmark {
namespace {

/// CPU time of a measurement of frames that has samples, s.
double seconds_of_run(const Measured& one) {
  return 1e-3 * (median_of(one, "cpu_ms") * median_of(one, "frames") + median_of(one, "reset_cpu_ms"));
}

}  // namespace

double expected_seconds(const Row& row, const std::vector<Measured>& rows) {
  if (!row.contains("vertices")) return 0.0;
  const auto rest = [](Row one) {
    one.erase("vertices");
    return one;
  };
  const double size = row.at("vertices").get<double>();
  std::vector<std::pair<double, double>> smaller;  // size, s
  for (const Measured& one : rows) {
    if (rest(one.row) != rest(row) || one.row.at("vertices").get<double>() >= size) continue;
    if (one.left_out.starts_with(kTooLong)) return std::numeric_limits<double>::infinity();
    if (!one.samples.empty()) smaller.emplace_back(one.row.at("vertices").get<double>(), seconds_of_run(one));
  }
  if (smaller.empty()) return 0.0;
  std::sort(smaller.begin(), smaller.end());
  const auto [fine_size, fine_s] = smaller.back();
  double exponent = 1.5;
  if (smaller.size() > 1) {
    const auto [coarse_size, coarse_s] = smaller[smaller.size() - 2];
    exponent = std::max(1.0, std::log(fine_s / coarse_s) / std::log(fine_size / coarse_size));
  }
  return fine_s * std::pow(size / fine_size, exponent);
}

std::string name_of(const Row& row) {
  std::string name;
  for (const auto& [key, value] : row.items()) {
    if (!name.empty()) name += ", ";
    name += value.is_string() ? value.get<std::string>() : key + " " + value.dump();
  }
  return name;
}

std::vector<std::string> measure_all(std::vector<Measured>& rows, const Setup& setup, const RunOptions& options) {
  std::vector<std::string> crashes;
  const auto wanted = static_cast<std::size_t>(options.repeats);
  const auto left = [&] {
    std::size_t count = 0;
    for (const Measured& one : rows)
      if (one.left_out.empty()) count += wanted - std::min(wanted, one.samples.size());
    return count;
  };
  std::size_t done = 0;
  std::vector<std::size_t> order(rows.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  for (std::size_t round = 0; round < wanted; ++round) {
    if (round > 0) std::shuffle(order.begin(), order.end(), std::mt19937_64(round));
    for (const std::size_t i : order) {
      Measured& one = rows[i];
      if (!one.left_out.empty() || one.samples.size() > round) continue;
      const double expected = one.samples.empty() ? expected_seconds(one.row, rows) : 0.0;
      Sample sample;
      if (expected > options.limit_s) {
        sample.failure =
            kTooLong +
            (std::isfinite(expected)
                 ? formatted("a run would take some %.0f s of CPU time by the growth of smaller ones", expected)
                 : std::string("a smaller one does"));
        sample.is_refused = true;
      } else {
        sample = measure_in_child(options.worker, setup, one.row, options.limit_s, options.cancelled);
      }
      if (sample.is_cancelled || options.cancelled()) return crashes;
      ++done;
      if (sample.failure.empty()) {
        one.samples.push_back(sample.numbers);
      } else {
        if (!sample.is_refused) crashes.push_back(name_of(one.row) + ": " + sample.failure);
        one.samples.clear();
        one.left_out = (sample.is_refused ? "" : kCrashed) + sample.failure;
      }
      if (options.done) options.done(one, done, done + left());
    }
  }
  return crashes;
}

}  // namespace weft::benchmark
