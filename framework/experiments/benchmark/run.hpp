#pragma once
#include <functional>
#include <string>
#include <vector>

#include "experiments/benchmark/tables.hpp"

namespace weft::benchmark {

struct RunOptions {
  int repeats = 5;
  double limit_s = 600.0;                ///< CPU time that one measurement may take, s
  std::vector<std::string> worker = {};  ///< see measure_in_child()
  std::function<bool()> cancelled = {};
  /// Called after every measurement: the row with it, how many are done, how many there are.
  std::function<void(const Measured&, std::size_t done, std::size_t total)> done = {};
};
/// Measures rows until each has as many samples as repeats, or is left out. Repeats are taken in rounds, each row once a
/// round, so that a slow minute of the machine hits one sample of many rows and not many of one. The first round begins with
/// small sizes: what they took tells which larger ones would exceed the limit, and these are left out. The others are shuffled.
/// @param rows with the samples that an earlier run took. @return texts about rows whose process crashed; they are left out as well.
std::vector<std::string> measure_all(std::vector<Measured>& rows, const Setup& setup, const RunOptions& options);

/// CPU time that a measurement of `row` will take by what rows took that differ in a smaller number of vertices alone, s;
/// 0: there are none. Infinity: a smaller one was left out because it took too long.
double expected_seconds(const Row& row, const std::vector<Measured>& rows);

/// A row in words: "frames, resting, cloth, basic, vertices 1024".
std::string name_of(const Row& row);

}  // namespace weft::benchmark
