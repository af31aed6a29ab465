#include "experiments/benchmark/rows.hpp"

#include <algorithm>

namespace weft::benchmark {
namespace {

/// 1, 2, 4, ... and `most`.
std::vector<int> processor_counts(int most) {
  std::vector<int> counts;
  for (int n = 1; n < most; n *= 2) counts.push_back(n);
  counts.push_back(most);
  return counts;
}

void add_frames(const Plan& plan, std::vector<Row>& rows) {
  // Squares of 16, 32, 64, 128 and 256.
  const std::vector<int> vertices =
      plan.is_quick ? std::vector<int>{64, 256} : std::vector<int>{256, 1024, 4096, 16384, 65536};
  for (const int n : vertices)
    for (const char* motion : {"resting", "hanging", "folding"})
      for (const auto& fabric : fabric_names())
        for (const auto& simulator : plan.simulators)
          rows.push_back(
              {{"part", "frames"}, {"motion", motion}, {"simulator", simulator}, {"fabric", fabric}, {"vertices", n}});
}

void add_folds(const Plan& plan, std::vector<Row>& rows) {
  // The same examples for every number of processes, and so many that the end, when some processes have no work, is short.
  const int examples = plan.is_quick ? 4 : std::max(64, 8 * plan.processors);
  for (const int n : processor_counts(plan.processors))
    rows.push_back({{"part", "folds"}, {"processes", n}, {"examples", examples}});
}

void add_training(const Plan& plan, std::vector<Row>& rows) {
  std::vector<int> threads{1};
  if (plan.processors > 1) threads.push_back(plan.processors);
  for (const int n : threads)
    rows.push_back({{"part", "training"},
                    {"threads", n},
                    {"iterations", plan.is_quick ? 2 : 40},
                    {"examples", plan.is_quick ? 16 : 64}});
}

void add_planning(const Plan& plan, std::vector<Row>& rows) {
  const auto add = [&](int edge_mm, int instances, int segments) {
    for (const auto& kernels : plan.kernels)
      rows.push_back({{"part", "planning"},
                      {"what", "gradient"},
                      {"edge_mm", edge_mm},
                      {"instances", instances},
                      {"segments", segments},
                      {"kernels", kernels}});
  };
  if (plan.is_quick) {
    add(0, 2, 5);
    add(100, 2, 5);
  } else {
    for (const int instances : {4, 16, 64})
      for (const int segments : {5, 15, 25}) add(0, instances, segments);
    for (const int edge_mm : {40, 10, 5}) add(edge_mm, 16, 25);
  }
  // The seeds of the README's table.
  const std::vector<int> seeds =
      plan.is_quick ? std::vector<int>{5001} : std::vector<int>{5001, 5002, 5003, 5004, 5005};
  rows.push_back({{"part", "planning"}, {"what", "sessions"}, {"threads", plan.processors}, {"seeds", seeds}});
}

}  // namespace

const std::vector<std::string>& part_names() {
  static const std::vector<std::string> names{"frames", "folds", "training", "planning"};
  return names;
}

const std::vector<std::string>& fabric_names() {
  static const std::vector<std::string> names{"basic", "cotton_plain", "denim"};
  return names;
}

std::vector<Row> rows_of(const Plan& plan) {
  std::vector<Row> rows;
  const auto wants = [&](const char* part) {
    return std::find(plan.parts.begin(), plan.parts.end(), part) != plan.parts.end();
  };
  if (wants("frames")) add_frames(plan, rows);
  if (wants("folds")) add_folds(plan, rows);
  if (wants("training")) add_training(plan, rows);
  if (wants("planning")) add_planning(plan, rows);
  return rows;
}

std::vector<std::string> variants_of(const PluginRegistry& registry, const ConfigNode& predictor) {
  for (const auto& info : registry.params(registry.entry("predictor", predictor))) {
    if (!info.is_variant) continue;
    std::vector<std::string> names = info.choices;
    std::erase(names, "auto");
    return names;
  }
  return {};
}

}  // namespace weft::benchmark
