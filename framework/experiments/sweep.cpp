#include "experiments/sweep.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <deque>
#include <fstream>
#include <limits>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "experiments/cell_work.hpp"
#include "experiments/json_numbers.hpp"
#include "loader/program_host.hpp"
#include "processes/claims.hpp"
#include "processes/worker_process.hpp"
#include "sdk/files.hpp"
#include "sdk/fingerprint.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kRowSchema = "weft sweep row 2";
constexpr const char* kAblationSchema = "weft ablation row 1";  // the same without a payload; read, not written

std::string cell_name(const SweepPlan& plan, std::size_t arm, std::uint64_t seed) {
  return "seed" + std::to_string(seed) + "-arm" + std::to_string(arm) + "-" +
         hex_digits(fnv1a(plan.arms[arm].name)).substr(0, 8) + ".json";
}

/// A hash of all that decides a cell's numbers. A row with another hash belongs to another sweep.
std::string cell_fingerprint(const ConfigNode& config) { return hex_digits(fnv1a(config.to_yaml())); }

void write_row(const SweepPlan& plan, const SweepRow& row, const std::string& fingerprint) {
  ordered_json metrics = ordered_json::object();
  for (const auto& [name, value] : row.outcome.metrics) metrics[name] = json_number(value);
  ordered_json json{{"schema", kRowSchema},
                    {"arm", plan.arms[row.arm].name},
                    {"seed", row.seed},
                    {"config", fingerprint},
                    {"status", to_string(row.status)},
                    {"failure", row.failure},
                    {"paired_by", row.outcome.paired_by},
                    {"metrics", metrics}};
  const auto& payload = row.outcome.payload;
  if (!payload.schema.empty())
    json["payload"] = {{"schema", payload.schema}, {"value", ordered_json::parse(payload.json)}};
  write_text(row.file, json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n");
}

SweepRow read_row(const fs::path& file, const SweepPlan& plan, std::size_t arm, std::uint64_t seed,
                  const std::string& fingerprint) {
  SweepRow row{arm, seed, "", {}, file};
  try {
    std::ifstream stream(file, std::ios::binary);
    const ordered_json json = ordered_json::parse(stream);
    if (json.at("schema") != kRowSchema && json.at("schema") != kAblationSchema)
      throw ConfigError(file.string() + ": is not a row of a sweep");
    if (json.at("arm") != plan.arms[arm].name || json.at("seed") != seed || json.at("config") != fingerprint)
      throw ConfigError(file.string() +
                        ": belongs to a sweep with another config; give another --out, or remove its folder");
    row.failure = json.at("failure").get<std::string>();
    row.status = work_status_named(json.at("status").get<std::string>());
    if ((row.status == WorkStatus::done) != row.failure.empty())
      throw ConfigError(file.string() + ": is damaged: status and failure disagree");
    row.outcome.paired_by = json.at("paired_by").get<std::string>();
    for (const auto& [name, value] : json.at("metrics").items())
      row.outcome.metrics.emplace_back(name, number_of(value));
    if (const auto payload = json.find("payload"); payload != json.end())
      row.outcome.payload = {payload->at("schema").get<std::string>(), payload->at("value").dump()};
  } catch (const nlohmann::json::exception& error) {
    throw ConfigError(file.string() + ": is damaged: " + error.what() + "; remove it to run its cell again");
  }
  return row;
}

}  // namespace

double SweepRow::metric(const std::string& name) const {
  for (const auto& [key, value] : outcome.metrics)
    if (key == name) return value;
  return std::numeric_limits<double>::quiet_NaN();
}

std::vector<std::string> sweep_metrics(const std::vector<SweepRow>& rows) {
  std::vector<std::string> names;
  for (const auto& row : rows)
    for (const auto& [name, value] : row.outcome.metrics)
      if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  return names;
}

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

  std::vector<SweepRow> run() {
    find_cells();
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
    std::string fingerprint;
    fs::path file;
    int attempt = 1;
  };

  bool cancelled() const { return options_.cancel != nullptr && *options_.cancel; }
  bool over() const { return stopping_ || cancelled(); }

  /// Seed by seed, so that the rows of an unfinished run can be compared.
  std::vector<Cell> all_cells() const {
    std::vector<Cell> cells;
    for (const std::uint64_t seed : plan_.seeds) {
      for (std::size_t arm = 0; arm < plan_.arms.size(); ++arm) {
        const auto number = ConfigNode::integer(static_cast<std::int64_t>(seed));
        Cell cell{arm, seed, plan_.arms[arm].config.with("seed", number), "",
                  options_.folder / "cells" / cell_name(plan_, arm, seed)};
        cell.fingerprint = cell_fingerprint(cell.config);
        cells.push_back(std::move(cell));
      }
    }
    return cells;
  }
  SweepRow read(const Cell& cell) const { return read_row(cell.file, plan_, cell.arm, cell.seed, cell.fingerprint); }

  void find_cells() {
    auto cells = all_cells();
    total_ = cells.size();
    std::vector<fs::path> again;
    for (auto& cell : cells) {
      if (fs::exists(cell.file)) {
        if (!tries_again(options_.retry, read(cell).status)) continue;
        again.push_back(cell.file);
      }
      todo_.push_back(std::move(cell));
    }
    for (const auto& file : again) fs::remove(file);
  }

  void work() {
    try {
      std::optional<WorkerProcess> child;
      if (!options_.worker.empty()) child.emplace(options_.worker);
      while (const auto cell = next()) {
        SweepRow row{cell->arm, cell->seed, "", {}, cell->file};
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
        if (todo_.empty()) return std::nullopt;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
    }
    return std::nullopt;
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
    write_row(plan_, row, cell.fingerprint);
    claims_.release(cell.file.stem().string());
    --at_work_;
    if (options_.progress) options_.progress(row, total_ - todo_.size() - at_work_, total_);
    if (row.status != WorkStatus::done && options_.fail_fast) stopping_ = true;
  }

  std::vector<SweepRow> rows() const {
    std::vector<SweepRow> rows;
    for (const auto& cell : all_cells())
      if (fs::exists(cell.file)) rows.push_back(read(cell));
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

std::vector<SweepRow> run_sweep(const SweepPlan& plan, const SweepOptions& options) {
  const fs::path cells = options.folder / "cells";
  std::error_code problem;
  fs::create_directories(cells, problem);
  if (!fs::is_directory(cells)) throw Error(cells.string() + ": cannot be made: " + problem.message());
  return Sweep(plan, options).run();
}

}  // namespace weft
