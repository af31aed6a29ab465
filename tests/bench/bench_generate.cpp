// `weft generate`: whole manipulation examples of the T-shirt, simulated to the settled shape, on one thread.
#include <benchmark/benchmark.h>

#include "experiments/experiment_config.hpp"
#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "simulation/task_config.hpp"
#include "weft/dataset.hpp"

namespace {

using namespace weft;

void make_examples(benchmark::State& state) {
  const auto config = ConfigNode::load(WEFT_SOURCE_DIR "/configs/experiments/tshirt.yaml");
  ExperimentParams params;
  read_params(config, params);
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  const Task task = make_task(params.task, config, *host);
  const auto simulator = host->create<Simulator>(task.simulator);
  std::int64_t index = 0, segments = 0;
  for (auto _ : state) {
    const Example example = make_example(*simulator, task, params.data, 1, index++);
    if (example.failed()) state.SkipWithError(example.failure.c_str());
    segments += example.segments();
  }
  state.SetItemsProcessed(index);  // items_per_second: examples per second and thread
  state.counters["segments"] = benchmark::Counter(static_cast<double>(segments), benchmark::Counter::kAvgIterations);
}
BENCHMARK(make_examples)->Iterations(16)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
