#pragma once
#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "loader/registry.hpp"
#include "weft/config.hpp"
#include "weft/host.hpp"

/// A sweep runs every arm with every seed, several cells at a time, and keeps a file per cell: when it is interrupted,
/// the same call goes on. `weft ablate`, `evaluate planning` and `evaluate estimation` are sweeps.
namespace weft {

/// One setting of what a sweep varies.
struct SweepArm {
  std::string name;                 ///< levels, comma-separated
  std::vector<std::string> levels;  ///< one per factor
  ConfigNode config;                ///< of its cells, without a seed
};

struct SweepPlan {
  std::string description;
  std::vector<std::string> factors;
  std::vector<SweepArm> arms;
  std::vector<std::uint64_t> seeds;

  std::size_t cells() const { return arms.size() * seeds.size(); }
};

using SweepMetrics = std::vector<std::pair<std::string, double>>;

/// What a cell found that is more than single numbers, of whatever type its runner chooses: the runner's own functions
/// write and read it (such as to_payload and estimation_case of estimation_evaluation.hpp).
struct SweepPayload {
  std::string schema;  ///< name of the form, with a number that rises when it changes; empty: no payload
  std::string json;    ///< the value in this form
};

/// What one cell measured.
struct SweepOutcome {
  SweepMetrics metrics;
  std::string paired_by;  ///< fingerprint of what must be the same in all arms: goal, start and true material
  SweepPayload payload = {};
};

/// One arm with one seed.
struct SweepRow {
  std::size_t arm = 0;
  std::uint64_t seed = 0;
  std::string failure;  ///< empty: it ran
  SweepOutcome outcome;
  std::filesystem::path file = {};  ///< that keeps the row

  double metric(const std::string& name) const;  ///< NaN if it has none of that name
};
/// Names of all metrics, in the order of first appearance.
std::vector<std::string> sweep_metrics(const std::vector<SweepRow>& rows);

/// Runs a cell. @param config of its arm, with `seed`. What it throws is the row's failure.
using SweepRunner = std::function<SweepOutcome(const ConfigNode& config, Host& host)>;

struct SweepOptions {
  std::filesystem::path folder;  ///< rows go into folder/cells
  int jobs = 1;                  ///< cells at a time
  std::shared_ptr<const PluginRegistry> registry;
  const std::atomic<bool>* cancel = nullptr;
  SweepRunner runner;
  /// Called after every row, one call at a time; done counts rows that were there already.
  std::function<void(const SweepRow& row, std::size_t done, std::size_t total)> progress;
};

/// Runs all cells that have no row yet, seed by seed, several at a time; every cell gets a host of its own with the
/// config's `threads` (0: one thread). A cell writes its row whole or not at all, so a run killed at any moment is
/// finished by the next one. What a cell throws is its row's failure; the others go on.
/// @return all rows, [seeds * arms]; fewer when cancelled.
/// @throws ConfigError when the folder holds rows of another sweep, or a damaged row.
std::vector<SweepRow> run_sweep(const SweepPlan& plan, const SweepOptions& options);

}  // namespace weft
