#include "experiments/sweep.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <deque>
#include <limits>
#include <mutex>
#include <optional>
#include <set>
#include <thread>

#include "experiments/cell_work.hpp"
#include "experiments/sweep_rows.hpp"
#include "loader/program_host.hpp"
#include "processes/claims.hpp"
#include "processes/worker_process.hpp"
#include "sdk/files.hpp"
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

namespace {

/// One process's part of a sweep.
class Sweep {
 public:
  Sweep(const SweepPlan& plan, const SweepOptions& options)
      : plan_(plan),
        options_(options),
        leftovers_(options.folder / "cells"),
        claims_(options.folder / "claims"),
        slowest_(options.cell_limit_s) {}

  /// @param earlier the rows that were there.
  std::vector<SweepRow> run(const std::vector<SweepRow>& earlier) {
    find_cells(earlier);
    const auto jobs = std::min<std::size_t>(todo_.size(), static_cast<std::size_t>(std::max(1, options_.jobs)));
    std::vector<std::thread> threads;
    for (std::size_t i = 1; i < jobs; ++i) threads.emplace_back([this] { work(); });
    work();
    for (auto& thread : threads) thread.join();
    if (error_) std::rethrow_exception(error_);
    return rows();
  }

 private:
  struct Cell {
    std::size_t arm;
    std::uint64_t seed;
    ConfigNode config;
    fs::path file;
    int attempt = 1;
  };

  bool cancelled() const { return options_.cancel != nullptr && *options_.cancel; }
  bool over() const { return stopping_ || cancelled(); }

  /// Seed by seed, so that the rows of an unfinished run can be compared.
  void find_cells(const std::vector<SweepRow>& earlier) {
    std::set<std::pair<std::size_t, std::uint64_t>> there;
    for (const auto& row : earlier) {
      if (tries_again(options_.retry, row.status))
        fs::remove(row.file);
      else
        there.insert({row.arm, row.seed});
    }
    for (const std::uint64_t seed : plan_.seeds) {
      for (std::size_t arm = 0; arm < plan_.arms.size(); ++arm) {
        ++total_;
        if (there.contains({arm, seed})) continue;
        const auto number = ConfigNode::integer(static_cast<std::int64_t>(seed));
        todo_.push_back(
            {arm, seed, plan_.arms[arm].config.with("seed", number), row_file(plan_, options_.folder, arm, seed)});
      }
    }
  }

  void work() {
    try {
      std::optional<WorkerProcess> child;
      if (!options_.worker.empty()) child.emplace(options_.worker);
      while (const auto cell = next()) {
        SweepRow row{cell->arm, cell->seed, "", {}, cell->file};
        row.identity = plan_.arms[cell->arm].identity.hash();
        if (cell->attempt > kMostAttempts) {
          row.status = WorkStatus::lost;
          row.failure = std::to_string(cell->attempt - 1) + " processes that ran it have vanished";
        } else if (child) {
          const WorkEnd end = child->run(
              options_.request(cell->config), [&] { return slowest_.limits(); }, [&] { return over(); });
          if (end.kind == WorkEnd::Kind::cancelled) return;
          if (end.kind == WorkEnd::Kind::answered) slowest_.add(end.cpu_seconds);
          read_cell_end(end, row);
        } else {
          run_here(*cell, row);
        }
        if (cancelled()) return;  // a cell that ended early has no valid result
        finish(*cell, row);
      }
    } catch (...) {
      const std::lock_guard lock(mutex_);
      if (!error_) error_ = std::current_exception();
      stopping_ = true;
    }
  }

  void run_here(const Cell& cell, SweepRow& row) const {
    try {
      const auto host = make_cell_host(options_.registry, cell.config, options_.cancel);
      row.outcome = options_.runner(cell.config, *host);
    } catch (const WriteError&) {
      throw;  // not the cell's failure
    } catch (...) {
      const WorkFailure failure = current_failure();
      row.status = failure.status;
      row.failure = failure.message;
    }
  }

  /// Claims the next cell. Waits while the missing ones are other processes'. @return nothing: there are no more.
  std::optional<Cell> next() {
    while (!over()) {
      {
        const std::lock_guard lock(mutex_);
        if (auto cell = claim()) return cell;
        if (todo_.empty() || (options_.is_share && others_are_at_work())) return std::nullopt;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
    }
    return std::nullopt;
  }

  bool others_are_at_work() {
    return std::all_of(todo_.begin(), todo_.end(),
                       [&](const Cell& cell) { return claims_.is_held(cell.file.stem().string()); });
  }

  std::optional<Cell> claim() {
    for (auto cell = todo_.begin(); cell != todo_.end();) {
      if (fs::exists(cell->file)) {  // another process has run it
        cell = todo_.erase(cell);
        continue;
      }
      const std::string name = cell->file.stem().string();
      const auto attempt = claims_.take(name);
      if (!attempt) {
        ++cell;
        continue;
      }
      leftovers_.remove(cell->file);
      leftovers_.remove(times_file(cell->file));
      Cell mine = std::move(*cell);
      cell = todo_.erase(cell);
      if (fs::exists(mine.file)) {  // whoever had the claim before has run it
        claims_.release(name);
        continue;
      }
      mine.attempt = *attempt;
      ++at_work_;
      return mine;
    }
    return std::nullopt;
  }

  void finish(const Cell& cell, const SweepRow& row) {
    const std::lock_guard lock(mutex_);
    write_row(plan_, row);
    claims_.release(cell.file.stem().string());
    --at_work_;
    if (options_.progress) options_.progress(row, total_ - todo_.size() - at_work_, total_);
    if (row.status != WorkStatus::done && options_.fail_fast) stopping_ = true;
  }

  std::vector<SweepRow> rows() const {
    std::vector<SweepRow> rows = read_sweep(plan_, options_.folder, options_.accept_changed).rows;
    const auto order = [&](const SweepRow& row) {
      return std::pair(std::find(plan_.seeds.begin(), plan_.seeds.end(), row.seed) - plan_.seeds.begin(), row.arm);
    };
    std::sort(rows.begin(), rows.end(), [&](const auto& a, const auto& b) { return order(a) < order(b); });
    return rows;
  }

  const SweepPlan& plan_;
  const SweepOptions& options_;
  Leftovers leftovers_;
  Claims claims_;
  SlowestUnit slowest_;
  std::atomic<bool> stopping_ = false;
  std::mutex mutex_;  ///< for what follows
  std::exception_ptr error_;
  std::size_t total_ = 0, at_work_ = 0;
  std::deque<Cell> todo_;  ///< cells without a row that no thread of this process has claimed
};

}  // namespace

std::unique_ptr<Host> make_cell_host(std::shared_ptr<const PluginRegistry> registry, const ConfigNode& cell,
                                     const std::atomic<bool>* cancel) {
  const auto threads = cell.find("threads");
  HostOptions options;
  options.threads = std::max(1, threads ? static_cast<int>(threads->as_int()) : 1);
  options.seed = static_cast<std::uint64_t>(cell.at("seed").as_int());
  options.cancel = cancel;
  return make_host(std::move(registry), options);
}

void prepare_sweep(const SweepPlan& plan, const SweepOptions& options) {
  const auto earlier = read_sweep(plan, options.folder, options.accept_changed).rows;
  make_writable_folder(options.folder / "cells");
  write_identities(plan, options.folder);
  for (const auto& row : earlier)
    if (tries_again(options.retry, row.status)) fs::remove(row.file);
}

std::size_t cells_left(const SweepPlan& plan, const std::vector<SweepRow>& earlier, Retry retry) {
  const auto stay = std::count_if(earlier.begin(), earlier.end(),
                                  [&](const SweepRow& row) { return !tries_again(retry, row.status); });
  return plan.cells() - static_cast<std::size_t>(stay);
}

std::vector<SweepRow> run_sweep(const SweepPlan& plan, const SweepOptions& options) {
  const auto earlier =
      read_sweep(plan, options.folder, options.accept_changed).rows;  // refuses before anything changes
  make_writable_folder(options.folder / "cells");
  write_identities(plan, options.folder);
  return Sweep(plan, options).run(earlier);
}

}  // namespace weft
