#pragma once
#include <atomic>
#include <filesystem>
#include <string>

#include "experiments/benchmark/rows.hpp"
#include "processes/worker_process.hpp"

namespace weft::benchmark {

/// What the rows of one benchmark share.
struct Setup {
  ConfigNode config;  ///< with the keys of ExperimentParams: folds, training and planning are those of its task
  std::filesystem::path fabrics;  ///< folder with the files of fabric_names()
  std::filesystem::path folder;   ///< where the part `training` keeps its examples
  std::string plugin_path;        ///< searched_folders()
  bool is_quick = false;
};

/// How the reason begins for which a row is left out that exceeds its limit.
inline constexpr const char* kTooLong = "takes too long: ";
/// The same of a row whose process crashed or was lost.
inline constexpr const char* kCrashed = "crashed: ";

/// One measurement of a row.
struct Sample {
  std::string failure;      ///< why there are no numbers; empty: there are
  bool is_refused = false;  ///< a plugin cannot do it: the row is left out, and nothing has gone wrong
  bool is_cancelled = false;
  /// Numbers by name: cpu_ms, wall_ms, peak_mb, ... of what the row is about; `note`: a warning of the plugin.
  nlohmann::ordered_json numbers = nlohmann::ordered_json::object();
};

/// Measures a row once, in a child process of its own, whose peak of memory is then the row's.
/// @param worker command of a program that answers with answer(). @param limit_s CPU time after which the row is given up.
Sample measure_in_child(const std::vector<std::string>& worker, const Setup& setup, const Row& row, double limit_s,
                        const std::function<bool()>& cancelled);

/// The other side: whether a request is one of measure_in_child(), and its answer, one line.
bool knows(const std::string& kind);
std::string answer(const std::string& request, const std::atomic<bool>* cancel);

}  // namespace weft::benchmark
