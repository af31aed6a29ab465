#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <nlohmann/json.hpp>
#include <optional>
#include <string_view>

#include "commands.hpp"
#include "experiments/benchmark/measure.hpp"
#include "experiments/cell_work.hpp"
#include "experiments/evaluation_work.hpp"
#include "experiments/experiment_config.hpp"
#include "learning/example_bytes.hpp"
#include "loader/processors.hpp"
#include "loader/program_host.hpp"
#include "loader/where.hpp"
#include "processes/child_process.hpp"
#include "processes/crash_report.hpp"
#include "processes/worker_process.hpp"
#include "sdk/located_config.hpp"
#include "simulation/task_config.hpp"

namespace weft::app {
namespace {

std::atomic<bool> worker_cancelled = false;  // set in a signal handler

/// Makes examples. Task and simulator stay from one request to the next.
class ExampleServer {
 public:
  /// @param request from example_requests().
  std::string answer(std::string_view request) try {
    request.remove_prefix(kExample.size());
    std::int64_t index = 0;
    const char* const end = std::from_chars(request.data(), request.data() + request.size(), index).ptr;
    request.remove_prefix(end - request.data());
    if (!simulator_ || request != setup_) set_up(request);
    return example_to_hex(
        make_example(*simulator_, *task_, params_.data, static_cast<std::uint64_t>(params_.seed), index));
  } catch (...) {
    return no_example_line(current_failure());
  }

 private:
  void set_up(std::string_view text) {
    simulator_.reset();
    const auto setup = nlohmann::ordered_json::parse(text);
    const ConfigNode config = read_located_json(setup.at("config").get<std::string>());
    params_ = ExperimentParams();
    read_params(config, params_);
    HostOptions options;
    options.threads = 1;
    options.seed = static_cast<std::uint64_t>(params_.seed);
    options.cancel = &worker_cancelled;
    host_ = make_host(registry_of_request(setup.at("plugin_path").get<std::string>()), options);
    task_ = make_task(params_.task, config, *host_);
    simulator_ = host_->create<Simulator>(task_->simulator);
    setup_ = text;
  }

  std::string setup_;
  ExperimentParams params_;
  std::unique_ptr<Host> host_;
  std::optional<Task> task_;
  std::shared_ptr<Simulator> simulator_;
};

/// A process that ablate, evaluate, generate and benchmark start for their cells, examples and rows.
int work() {
  install_crash_report(kCrashReportFile, write_where);
  CellServer cells(&worker_cancelled);
  ExampleServer examples;
  EvaluationServer evaluations(&worker_cancelled);
  // What one cell or example may take is all that the task was given: one that asks for more fails alone, with this reason,
  // instead of the whole task.
  if (const auto granted = memory_of_slurm_mb()) {
    rlimit limit{};
    getrlimit(RLIMIT_DATA, &limit);
    limit.rlim_cur = std::min(limit.rlim_max, static_cast<rlim_t>(*granted) << 20);
    setrlimit(RLIMIT_DATA, &limit);
  }
  serve_work(
      [&](const std::string& text) {
        if (text.starts_with(kExample)) return examples.answer(text);
        const auto request = nlohmann::ordered_json::parse(text);
        const auto kind = request.at("kind").get<std::string>();
        if (EvaluationServer::knows(kind)) return evaluations.answer(text);
        if (benchmark::knows(kind)) return benchmark::answer(text, &worker_cancelled);
        return cells.answer(text);
      },
      worker_cancelled);
  return 0;
}

}  // namespace

void register_worker(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("worker", "Does the work of another weft process, which starts it");
  command->group("");  // not for people: it reads requests from stdin
  command->callback([&context] { context.action = [] { return work(); }; });
}

}  // namespace weft::app
