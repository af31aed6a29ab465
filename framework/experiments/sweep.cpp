#include "experiments/sweep.hpp"

#include <algorithm>
#include <atomic>
#include <limits>
#include <mutex>
#include <set>
#include <thread>

#include "experiments/sweep_rows.hpp"
#include "loader/program_host.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> names_in(const std::vector<SweepRow>& rows, SweepMetrics SweepOutcome::*part) {
  std::vector<std::string> names;
  for (const auto& row : rows)
    for (const auto& [name, value] : row.outcome.*part)
      if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  return names;
}

}  // namespace

double SweepRow::metric(const std::string& name) const {
  for (const auto* part : {&outcome.metrics, &outcome.times})
    for (const auto& [key, value] : *part)
      if (key == name) return value;
  return std::numeric_limits<double>::quiet_NaN();
}

std::vector<std::string> sweep_metrics(const std::vector<SweepRow>& rows) {
  return names_in(rows, &SweepOutcome::metrics);
}
std::vector<std::string> sweep_times(const std::vector<SweepRow>& rows) { return names_in(rows, &SweepOutcome::times); }

std::vector<SweepRow> run_sweep(const SweepPlan& plan, const SweepOptions& options) {
  std::vector<SweepRow> rows = read_sweep(plan, options.folder, options.accept_changed).rows;
  const fs::path cells = options.folder / "cells";
  std::error_code problem;
  fs::create_directories(cells, problem);
  if (!fs::is_directory(cells)) throw Error(cells.string() + ": cannot be made: " + problem.message());
  write_identities(plan, options.folder);

  // Seed by seed, so that the rows of an unfinished run can be compared.
  struct Cell {
    std::size_t arm;
    std::uint64_t seed;
    ConfigNode config;
  };
  std::set<std::pair<std::size_t, std::uint64_t>> there;
  for (const auto& row : rows) there.insert({row.arm, row.seed});
  std::vector<Cell> todo;
  for (const std::uint64_t seed : plan.seeds) {
    for (std::size_t arm = 0; arm < plan.arms.size(); ++arm) {
      if (there.contains({arm, seed})) continue;
      const auto number = ConfigNode::integer(static_cast<std::int64_t>(seed));
      todo.push_back({arm, seed, plan.arms[arm].config.with("seed", number)});
    }
  }

  const std::size_t total = rows.size() + todo.size();
  std::atomic<std::size_t> next{0};
  std::mutex mutex;
  std::exception_ptr error;  // from writing a row; only this stops the other cells
  const auto cancelled = [&] { return options.cancel != nullptr && *options.cancel; };
  const auto work = [&] {
    for (std::size_t i = next++; i < todo.size(); i = next++) {
      const Cell& cell = todo[i];
      SweepRow row{cell.arm, cell.seed, "", {}, row_file(plan, options.folder, cell.arm, cell.seed)};
      row.identity = plan.arms[cell.arm].identity.hash();
      if (cancelled()) return;
      try {
        const auto threads = cell.config.find("threads");
        HostOptions host_options;
        host_options.threads = std::max(1, threads ? static_cast<int>(threads->as_int()) : 1);
        host_options.seed = cell.seed;
        host_options.cancel = options.cancel;
        const auto host = make_host(options.registry, host_options);
        row.outcome = options.runner(cell.config, *host);
      } catch (const std::exception& failure) {
        row.failure = failure.what();
        if (row.failure.empty()) row.failure = "failed without a message";
      } catch (...) {
        row.failure = "threw something that is not a std::exception";
      }
      if (cancelled()) return;  // a cell that ended early has no valid result
      const std::lock_guard lock(mutex);
      if (error) return;
      try {
        write_row(plan, row);
        rows.push_back(row);
        if (options.progress) options.progress(row, rows.size(), total);
      } catch (...) {
        error = std::current_exception();
      }
    }
  };
  const auto jobs = std::min<std::size_t>(todo.size(), static_cast<std::size_t>(std::max(1, options.jobs)));
  std::vector<std::thread> threads;
  for (std::size_t i = 1; i < jobs; ++i) threads.emplace_back(work);
  work();
  for (auto& thread : threads) thread.join();
  if (error) std::rethrow_exception(error);

  const auto order = [&](const SweepRow& row) {
    return std::pair(std::find(plan.seeds.begin(), plan.seeds.end(), row.seed) - plan.seeds.begin(), row.arm);
  };
  std::sort(rows.begin(), rows.end(), [&](const auto& a, const auto& b) { return order(a) < order(b); });
  return rows;
}

}  // namespace weft
