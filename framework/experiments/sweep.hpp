#pragma once
#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "identity/identity.hpp"
#include "loader/registry.hpp"
#include "processes/work_status.hpp"
#include "weft/config.hpp"
#include "weft/host.hpp"

/// A sweep runs every arm with every seed, several cells at a time. It keeps a file per cell, so that the same call
/// continues an interrupted sweep. `weft ablate`, `evaluate planning` and `evaluate estimation` are sweeps.
namespace weft {

/// One setting of the factors of a sweep.
struct SweepArm {
  std::string name;                 ///< levels, comma-separated
  std::vector<std::string> levels;  ///< one per factor
  ConfigNode config;                ///< of its cells, without a seed
  Identity identity;                ///< of its cells, without a seed
};

struct SweepPlan {
  std::string description;
  std::vector<std::string> factors;
  std::vector<SweepArm> arms;
  std::vector<std::uint64_t> seeds;

  std::size_t cells() const { return arms.size() * seeds.size(); }
};

using SweepMetrics = std::vector<std::pair<std::string, double>>;

/// The result of a cell besides its metrics. The runner chooses its type and has the functions that write and read it
/// (such as to_payload and estimation_case of estimation_evaluation.hpp).
struct SweepPayload {
  std::string schema;  ///< name and version of the format; empty: no payload
  std::string json;    ///< the value in this format
};

/// The result of one cell.
struct SweepOutcome {
  SweepMetrics metrics;
  std::string paired_by;  ///< fingerprint of what must be the same in all arms: goal, start and true material
  SweepPayload payload = {};
  SweepMetrics times = {};  ///< what a clock measured, such as plan_seconds: it differs between equal runs
};

/// One arm with one seed.
struct SweepRow {
  std::size_t arm = 0;
  std::uint64_t seed = 0;
  std::string failure;  ///< empty: the cell is done
  SweepOutcome outcome;
  std::filesystem::path file = {};        ///< the row's file
  std::string identity = {};              ///< hash of the identity that it belongs to; empty: unknown
  std::vector<std::string> changes = {};  ///< how its arm's identity differs from that one
  WorkStatus status = WorkStatus::done;

  /// A metric or a time; NaN if there is none of this name.
  double metric(const std::string& name) const;
};
/// Names of all metrics, in the order of first appearance.
std::vector<std::string> sweep_metrics(const std::vector<SweepRow>& rows);
/// The same of all times.
std::vector<std::string> sweep_times(const std::vector<SweepRow>& rows);

/// Runs a cell. @param config of the cell's arm, with `seed`. An exception becomes the row's failure.
using SweepRunner = std::function<SweepOutcome(const ConfigNode& config, Host& host)>;

struct SweepOptions {
  std::filesystem::path folder;  ///< rows go into folder/cells
  bool accept_changed = false;   ///< go on where earlier rows belong to another identity
  int jobs = 1;                  ///< cells that this process runs at a time
  std::shared_ptr<const PluginRegistry> registry;
  const std::atomic<bool>* cancel = nullptr;
  /// Command of the child processes that run the cells, and the request that one of them understands (cell_work.hpp).
  /// Empty: `runner` runs them in threads of this process, and a crash of one ends them all.
  std::vector<std::string> worker = {};
  std::function<std::string(const ConfigNode& config)> request = {};
  SweepRunner runner = {};
  Retry retry = Retry::none;  ///< which failed cells of earlier runs are run again
  bool fail_fast = false;     ///< stop after the first cell that fails
  bool is_share = false;      ///< return when the missing cells are those that other living processes run
  double cell_limit_s = 0.0;  ///< CPU time of a cell after which it hangs; 0: 20 times the slowest, at least 600
  /// Called after every row, one call at a time. `done` includes the rows of earlier runs.
  std::function<void(const SweepRow& row, std::size_t done, std::size_t total)> progress = {};
};

/// The host of a cell: with the config's `threads` (0: one thread) and its seed.
std::unique_ptr<Host> make_cell_host(std::shared_ptr<const PluginRegistry> registry, const ConfigNode& cell,
                                     const std::atomic<bool>* cancel);

/// Makes the folder of a sweep, with what its cells belong to and without the rows that are to be run again. run_sweep() does
/// so, too; a cluster's tasks, which start on their own, find it done.
void prepare_sweep(const SweepPlan& plan, const SweepOptions& options);
/// Cells that have no row yet, or one that is to be run again. @param earlier the rows that are there.
std::size_t cells_left(const SweepPlan& plan, const std::vector<SweepRow>& earlier, Retry retry);

/// Runs all cells that have no row yet, seed by seed, several in parallel. A row's file is whole or absent, so the next
/// run finishes a killed one. A cell that fails, crashes or hangs gets a row that says so; the other cells continue.
/// Several processes may run one sweep: each claims the cells that it runs, and the call returns when all rows are there.
/// @return all rows, [seeds * arms]; fewer if cancelled, or stopped by fail_fast, or if `is_share` is set.
/// @throws ConfigError if earlier rows belong to another identity and that is not accepted, or for a damaged row.
std::vector<SweepRow> run_sweep(const SweepPlan& plan, const SweepOptions& options);

}  // namespace weft
