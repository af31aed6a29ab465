#include "work_options.hpp"

#include <algorithm>
#include <cstdio>

#include "cluster/job_scripts.hpp"
#include "options.hpp"
#include "processes/worker_process.hpp"

namespace weft::app {

Retry WorkOptions::retry() const {
  if (retry_failed.empty()) return Retry::none;
  return retry_failed == "all" ? Retry::all : Retry::accidents;
}

std::vector<std::string> WorkOptions::worker() const {
  return in_process ? std::vector<std::string>() : this_program({"worker"});
}

void WorkOptions::apply(SweepOptions& sweep) const {
  sweep.worker = worker();
  sweep.retry = retry();
  sweep.fail_fast = fail_fast;
  sweep.cell_limit_s = cell_limit_s;
  sweep.is_share = share;
}

ClusterWork sweep_work(const std::string& command, const std::filesystem::path& results,
                       std::vector<std::string> folders, std::size_t cells, std::size_t left) {
  ClusterWork work;
  work.command = work.label = command;
  std::replace(work.label.begin(), work.label.end(), ' ', '-');
  work.results = results;
  work.files = {"cells", std::move(folders), "seed", ".json", ".times.json", {}};
  work.total = static_cast<std::int64_t>(cells);
  work.left = static_cast<std::int64_t>(left);
  return work;
}

std::string failure_text(const SweepRow& row) { return std::string(to_string(row.status)) + ": " + row.failure; }

int share_exit_code(const Context& context, std::size_t rows, std::size_t cells) {
  if (rows == cells) return 0;
  if (*context.cancel_flag()) {
    context.say("interrupted; run the same command again to finish it");
    return 1;
  }
  context.say("did a share; other processes are at work on the " + std::to_string(cells - rows) +
              " cells that are left");
  return kOthersAtWork;
}

int sweep_exit_code(const Context& context, const std::vector<std::vector<SweepRow>>& sweeps, std::size_t cells) {
  std::vector<WorkStatus> statuses;
  for (const auto& rows : sweeps)
    for (const auto& row : rows) statuses.push_back(row.status);
  warn_of_failures(statuses, cells, "cells");
  const bool complete = statuses.size() == cells;
  if (!complete) context.say("interrupted; run the same command again to finish it");
  return complete && failures_text(statuses).empty() ? 0 : 1;
}

void add_work_options(CLI::App& command, const std::string& unit, WorkOptions& options) {
  const std::string units = unit + "s";
  command
      .add_flag("--retry-failed{accidents}", options.retry_failed,
                "Try " + units +
                    " again that crashed, hung or were lost; --retry-failed=all: also those that were refused or "
                    "diverged")
      ->check(CLI::IsMember({"accidents", "all"}));
  command.add_flag("--fail-fast", options.fail_fast, "Stop after the first " + unit + " that fails");
  command.add_flag(
      "--share", options.share,
      "Do a share: " + units +
          " that no other process has claimed, and no tables; exit code 3 when others are at work on the rest");
  add_process_options(command, unit, options);
}

void add_process_options(CLI::App& command, const std::string& unit, WorkOptions& options) {
  command
      .add_option(
          "--cell-limit", options.cell_limit_s,
          "CPU seconds after which one " + unit +
              " counts as hung; default: 20 times the slowest that has ended, and at least 600; a day while none has")
      ->check(within(0.0, 1e9))
      ->type_name("S");
  command.add_flag("--in-process", options.in_process,
                   "Work in threads of this process, for a debugger: a crash ends everything");
  add_cluster_options(command, options.cluster);
}

FolderTurn::FolderTurn(Context& context, const std::filesystem::path& folder, const std::string& work)
    : claims_(folder / "claims") {
  const auto waiting = [&] {
    context.say("another process is at work in " + folder.string() + "; waiting for its results");
  };
  if (!take_in_turn(claims_, work, waiting, [&] { return context.cancel_flag()->load(); }))
    throw Interrupted("interrupted; run the same command again");
}

void warn_of_failures(const std::vector<WorkStatus>& statuses, std::size_t total, const std::string& what) {
  const std::string failures = failures_text(statuses);
  if (failures.empty()) return;
  const auto failed = std::count_if(statuses.begin(), statuses.end(), [](auto s) { return s != WorkStatus::done; });
  const auto accidents =
      std::count_if(statuses.begin(), statuses.end(), [](auto s) { return tries_again(Retry::accidents, s); });
  std::string remedy = "--retry-failed tries them again";
  if (accidents == 0)
    remedy = "--retry-failed=all tries them again";
  else if (accidents < failed)
    remedy =
        "--retry-failed tries " + std::to_string(accidents) + " of them again, --retry-failed=all tries all of them";
  std::fprintf(stderr, "warning: %td of %zu %s failed: %s; %s\n", failed, total, what.c_str(), failures.c_str(),
               remedy.c_str());
}

}  // namespace weft::app
