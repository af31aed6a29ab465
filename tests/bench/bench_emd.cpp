// The learned predictor on the T-shirt at planning's batch: 16 instances, 25 segments, the last shape, and its
// gradient.
#include <benchmark/benchmark.h>

#include <thread>

#include "predictor/emd/emd.hpp"
#include "trajectory/arc/arc.cpp"
#include "weft/registry.hpp"

namespace {

using namespace weft;

struct Bench {
  explicit Bench(int threads, Index instances, Index segments, bool every_shape)
      : host(make_host(std::make_shared<PluginRegistry>(), {.threads = threads})), predictor(untrained(), *host) {
    task.garment = std::make_shared<const Garment>(read_garment(ConfigNode::parse(
        std::string("{mesh: ") + WEFT_SOURCE_DIR "/configs/garments/tshirt.obj, name: tshirt}", "bench")));
    task.trajectory = std::make_shared<const arc::Arc>(arc::Params{});
    task.material.ranges = {{{0.2, 0.9, false}, {0.5, 2.0, true}, {0.5, 2.0, true}, {0.001, 0.002, false}}};
    task.manipulation.grasp_vertices = {0, 1};
    task.manipulation.grasp_points = task.garment->positions.topRows(2);
    task.manipulation.displacement = {0.4, 0.0};
    predictor.bind(task);
    for (Index i = 0; i < instances; ++i) {
      PredictionCase one;
      one.shape = std::make_shared<const Positions>(task.garment->positions);
      one.state = task.trajectory->initial_state(task.manipulation);
      one.controls = 0.55 * task.trajectory->default_controls(segments);
      for (Index j = every_shape ? 1 : segments; j <= segments; ++j) one.segments.push_back(j);
      cotangents.emplace_back(one.segments.size(),
                              ShapeCotangent{Positions::Ones(task.garment->vertex_count(), 3), Positions(0, 3)});
      cases.push_back(std::move(one));
    }
  }
  static emd::Params untrained() {
    emd::Params params;
    params.untrained = true;
    return params;
  }
  Task task;
  std::unique_ptr<Host> host;
  emd::EmdPredictor predictor;
  std::vector<PredictionCase> cases;
  std::vector<std::vector<ShapeCotangent>> cotangents;
};

/// Arguments: threads, instances, segments, 1: every shape (estimation) or 0: the last one (planning).
void predict_and_pullback(benchmark::State& state) {
  Bench bench(static_cast<int>(state.range(0)), state.range(1), state.range(2), state.range(3) != 0);
  for (auto _ : state) {
    const auto prediction = bench.predictor.predict(bench.cases, {.moments = Moments::mean, .gradients = true});
    benchmark::DoNotOptimize(prediction->pullback(bench.cotangents));
  }
  state.SetItemsProcessed(state.iterations() * state.range(1) * state.range(2));
}
BENCHMARK(predict_and_pullback)
    ->Args({1, 16, 25, 0})
    ->Args({2, 16, 25, 0})
    ->Args({1, 16, 8, 1})
    ->Args({1, 1, 25, 0})
    ->Args({1, 64, 25, 0})
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

void predict_only(benchmark::State& state) {
  Bench bench(static_cast<int>(state.range(0)), state.range(1), state.range(2), false);
  for (auto _ : state) benchmark::DoNotOptimize(bench.predictor.predict(bench.cases, {.moments = Moments::mean}));
}
BENCHMARK(predict_only)->Args({1, 16, 25})->Unit(benchmark::kMillisecond)->UseRealTime();

/// The products alone, without trajectory, copies and results: what the rest is measured against.
void network_alone(benchmark::State& state) {
  Bench bench(1, 1, 1, false);
  const emd::Model model = emd::untrained_model(emd::Architecture{}, bench.task, 1);
  const emd::Network network(model, emd::kernels());
  const Index rows = state.range(0), segments = state.range(1), n = model.dimensions.coordinates();
  emd::Block block;
  block.rows = rows;
  block.steps.assign(static_cast<std::size_t>(rows), segments);
  block.shape.assign(static_cast<std::size_t>(rows * n), 0.1f);
  block.change.assign(block.shape.size(), 0.0f);
  block.inputs.assign(static_cast<std::size_t>(rows * segments * model.dimensions.inputs()), 0.1f);
  for (Index r = 0; r < rows; ++r) block.wanted.push_back({r, segments});
  std::vector<float> mean(block.shape.size()), d_mean(mean.size(), 1.0f), d_inputs(block.inputs.size());
  std::vector<float> d_shape(mean.size()), d_change(mean.size());
  for (auto _ : state) {
    emd::Network::Tape tape;
    network.forward(block, tape, mean.data(), nullptr);
    network.pullback(block, tape, d_mean.data(), nullptr, d_inputs.data(), d_shape.data(), d_change.data());
    benchmark::DoNotOptimize(d_inputs.data());
  }
  state.SetLabel(emd::kernels().name);
}
BENCHMARK(network_alone)->Args({16, 25})->Args({8, 25})->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace

BENCHMARK_MAIN();
