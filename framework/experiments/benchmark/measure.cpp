#include "experiments/benchmark/measure.hpp"

#include <fstream>
#include <sstream>

#include "experiments/benchmark/frames.hpp"
#include "experiments/benchmark/learned.hpp"
#include "experiments/cell_work.hpp"
#include "experiments/experiment_config.hpp"
#include "loader/program_host.hpp"
#include "sdk/located_config.hpp"

namespace weft::benchmark {
namespace {

using nlohmann::ordered_json;

constexpr const char* kKind = "benchmark";

/// Peak of this process's resident memory, MB. getrusage() would count what the process that started it had.
double peak_mb() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (!line.starts_with("VmHWM:")) continue;
    double kilobytes = 0.0;
    std::istringstream(line.substr(6)) >> kilobytes;
    return kilobytes / 1024.0;
  }
  return 0.0;
}

ordered_json measure_row(const Setup& setup, const Row& row, Host& host) {
  const auto part = row.at("part").get<std::string>();
  if (part == "frames") return measure_frames(row, setup.fabrics, host);
  if (part == "folds") return measure_folds(row, setup, host);
  if (part == "training") return measure_training(row, setup, host);
  if (part != "planning") throw ConfigError("'" + part + "' is not a part of the benchmark");
  return row.at("what") == "sessions" ? measure_sessions(row, setup, host) : measure_gradient(row, setup, host);
}

/// Threads of the child's host: one, unless the row is about more.
int threads_of(const Row& row) { return row.value("threads", row.value("processes", 1)); }

}  // namespace

Sample measure_in_child(const std::vector<std::string>& worker, const Setup& setup, const Row& row, double limit_s,
                        const std::function<bool()>& cancelled) {
  const ordered_json request{{"kind", kKind},
                             {"row", row},
                             {"config", located_json(setup.config)},
                             {"fabrics", std::filesystem::absolute(setup.fabrics).string()},
                             {"folder", std::filesystem::absolute(setup.folder).string()},
                             {"plugin_path", setup.plugin_path},
                             {"quick", setup.is_quick}};
  WorkerProcess child(worker);
  const WorkEnd end = child.run(
      request.dump(-1, ' ', true, ordered_json::error_handler_t::replace), [&] { return work_limits(limit_s, 0.0); },
      cancelled);
  Sample sample;
  sample.is_cancelled = end.kind == WorkEnd::Kind::cancelled;
  if (sample.is_cancelled) return sample;
  if (end.kind != WorkEnd::Kind::answered) {
    sample.is_refused = end.kind == WorkEnd::Kind::hung;
    sample.failure = (sample.is_refused ? kTooLong : "") + end.text;
    return sample;
  }
  try {
    const auto json = ordered_json::parse(end.text);
    sample.failure = json.at("failure").get<std::string>();
    const WorkStatus status = work_status_named(json.at("status").get<std::string>());
    sample.is_refused = status == WorkStatus::refused || status == WorkStatus::diverged;
    if (status == WorkStatus::done) sample.numbers = json.at("result");
  } catch (const std::exception& error) {
    sample.failure = std::string("its process answered with nonsense: ") + error.what();
  }
  return sample;
}

bool knows(const std::string& kind) { return kind == kKind; }

std::string answer(const std::string& text, const std::atomic<bool>* cancel) {
  WorkFailure failure{WorkStatus::done, ""};
  ordered_json result;
  try {
    const auto request = ordered_json::parse(text);
    const Row& row = request.at("row");
    Setup setup;
    setup.config = read_located_json(request.at("config").get<std::string>());
    setup.fabrics = request.at("fabrics").get<std::string>();
    setup.folder = request.at("folder").get<std::string>();
    setup.plugin_path = request.at("plugin_path").get<std::string>();
    setup.is_quick = request.at("quick").get<bool>();
    HostOptions options;
    options.threads = threads_of(row);
    options.seed =
        static_cast<std::uint64_t>(place(setup.config, "seed").is_null() ? 1 : setup.config.at("seed").as_int());
    options.cancel = cancel;
    const auto host = make_host(registry_of_request(setup.plugin_path), options);
    result = measure_row(setup, row, *host);
    if (!result.contains("peak_mb")) result["peak_mb"] = peak_mb();
  } catch (...) {
    failure = current_failure();
  }
  return ordered_json{{"status", to_string(failure.status)}, {"failure", failure.message}, {"result", result}}.dump(
      -1, ' ', true, ordered_json::error_handler_t::replace);
}

}  // namespace weft::benchmark
