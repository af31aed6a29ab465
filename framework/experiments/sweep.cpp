#include "experiments/sweep.hpp"

#include <algorithm>
#include <atomic>
#include <fstream>
#include <limits>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "experiments/json_numbers.hpp"
#include "loader/program_host.hpp"
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

/// What decides a cell's numbers; a row with another one belongs to another sweep.
std::string cell_fingerprint(const ConfigNode& config) { return hex_digits(fnv1a(config.to_yaml())); }

void write_row(const SweepPlan& plan, const SweepRow& row, const std::string& fingerprint) {
  ordered_json metrics = ordered_json::object();
  for (const auto& [name, value] : row.outcome.metrics) metrics[name] = json_number(value);
  ordered_json json{{"schema", kRowSchema},
                    {"arm", plan.arms[row.arm].name},
                    {"seed", row.seed},
                    {"config", fingerprint},
                    {"status", row.failure.empty() ? "done" : "failed"},
                    {"failure", row.failure},
                    {"paired_by", row.outcome.paired_by},
                    {"metrics", metrics}};
  const auto& payload = row.outcome.payload;
  if (!payload.schema.empty())
    json["payload"] = {{"schema", payload.schema}, {"value", ordered_json::parse(payload.json)}};
  const fs::path temporary = row.file.string() + ".tmp";
  std::ofstream stream(temporary, std::ios::binary);
  stream << json.dump(2, ' ', false, ordered_json::error_handler_t::replace) << '\n';
  stream.close();
  if (!stream) throw Error(row.file.string() + ": cannot be written");
  fs::rename(temporary, row.file);
}

SweepRow read_row(const fs::path& file, const SweepPlan& plan, std::size_t arm, std::uint64_t seed,
                  const std::string& fingerprint) {
  SweepRow row{arm, seed, "", {}, file};
  try {
    std::ifstream stream(file, std::ios::binary);
    const ordered_json json = ordered_json::parse(stream);
    if (json.at("schema") != kRowSchema && json.at("schema") != kAblationSchema)
      throw ConfigError(file.string() + ": is no row of a sweep");
    if (json.at("arm") != plan.arms[arm].name || json.at("seed") != seed || json.at("config") != fingerprint)
      throw ConfigError(file.string() +
                        ": belongs to a sweep with another config; give another --out, or remove its folder");
    row.failure = json.at("failure").get<std::string>();
    if (json.at("status") != (row.failure.empty() ? "done" : "failed"))
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

std::vector<SweepRow> run_sweep(const SweepPlan& plan, const SweepOptions& options) {
  const fs::path cells = options.folder / "cells";
  std::error_code problem;
  fs::create_directories(cells, problem);
  if (!fs::is_directory(cells)) throw Error(cells.string() + ": cannot be made: " + problem.message());

  // Seed by seed, so that what an unfinished run leaves can be compared already.
  struct Cell {
    std::size_t arm;
    std::uint64_t seed;
    ConfigNode config;
    std::string fingerprint;
    fs::path file;
  };
  std::vector<Cell> todo;
  std::vector<SweepRow> rows;
  for (const std::uint64_t seed : plan.seeds) {
    for (std::size_t arm = 0; arm < plan.arms.size(); ++arm) {
      Cell cell{arm, seed, plan.arms[arm].config.with("seed", ConfigNode::integer(static_cast<std::int64_t>(seed))), "",
                cells / cell_name(plan, arm, seed)};
      cell.fingerprint = cell_fingerprint(cell.config);
      if (fs::exists(cell.file))
        rows.push_back(read_row(cell.file, plan, arm, seed, cell.fingerprint));
      else
        todo.push_back(std::move(cell));
    }
  }

  const std::size_t total = rows.size() + todo.size();
  std::atomic<std::size_t> next{0};
  std::mutex mutex;
  std::exception_ptr error;  // of writing rows: nothing else stops the others
  const auto cancelled = [&] { return options.cancel != nullptr && *options.cancel; };
  const auto work = [&] {
    for (std::size_t i = next++; i < todo.size(); i = next++) {
      const Cell& cell = todo[i];
      SweepRow row{cell.arm, cell.seed, "", {}, cell.file};
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
        row.failure = "threw something that is no std::exception";
      }
      if (cancelled()) return;  // a cell that was told to end early is no result
      const std::lock_guard lock(mutex);
      if (error) return;
      try {
        write_row(plan, row, cell.fingerprint);
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
