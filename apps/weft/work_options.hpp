#pragma once
#include <string>
#include <vector>

#include "cluster_run.hpp"
#include "context.hpp"
#include "experiments/sweep.hpp"
#include "processes/claims.hpp"
#include "processes/work_status.hpp"

namespace weft::app {

/// The options of the commands that do many units of work: cells of a sweep, examples of a dataset.
struct WorkOptions {
  std::string retry_failed;  ///< "accidents" for the bare option, or all
  bool fail_fast = false;
  double cell_limit_s = 0.0;
  bool in_process = false;
  bool share = false;  ///< --share
  ClusterOptions cluster;

  Retry retry() const;
  /// Sets what they say in the options of a sweep, and that child processes run its cells.
  void apply(SweepOptions& sweep) const;
  /// The command of the child processes that do the work; empty: this process does it.
  std::vector<std::string> worker() const;
};
/// @param unit "cell" or "example".
void add_work_options(CLI::App& command, const std::string& unit, WorkOptions& options);
/// Those of them that say how child processes work, for commands that keep no rows. @param unit "case" or "batch".
void add_process_options(CLI::App& command, const std::string& unit, WorkOptions& options);

/// The work of a folder that one process does at a time, while this lives. Another one waits, and says so.
class FolderTurn {
 public:
  /// @param work names it. @throws Interrupted if the user asks to stop while it waits.
  FolderTurn(Context& context, const std::filesystem::path& folder, const std::string& work);

 private:
  Claims claims_;
};

/// The cells of a sweep as work for a cluster. @param folders of rows, from the results' folder.
ClusterWork sweep_work(const std::string& command, const std::filesystem::path& results,
                       std::vector<std::string> folders, std::size_t cells, std::size_t left);

/// "crashed: SIGSEGV in plugin ...".
std::string failure_text(const SweepRow& row);

/// The exit code of a command that did a share of its sweeps.
/// @param rows that are there. @param cells asked for.
int share_exit_code(const Context& context, std::size_t rows, std::size_t cells);
/// The exit code of a command after its sweeps: 1 unless all cells are there and done. Says what is not.
/// @param cells asked for.
int sweep_exit_code(const Context& context, const std::vector<std::vector<SweepRow>>& sweeps, std::size_t cells);

/// One line on stderr, also with --quiet: how many failed, how, and what to do. Nothing if none did.
/// @param what "cells", "examples".
void warn_of_failures(const std::vector<WorkStatus>& statuses, std::size_t total, const std::string& what);

}  // namespace weft::app
