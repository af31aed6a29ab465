// The learned predictor on the T-shirt at planning's batch: 16 instances, 25 segments, the last shape, and its
// gradient, with threads and for estimation; what searches add. `weft benchmark planning` has other sizes.
#include <benchmark/benchmark.h>

#include <chrono>
#include <ctime>
#include <thread>

#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "predictor/emd/emd.hpp"
#include "trajectory/arc/arc.cpp"
#include "weft/batching.hpp"

namespace {

using namespace weft;

struct Bench {
  explicit Bench(int threads, Index instances, Index segments, bool every_shape)
      : host(make_host(std::make_shared<PluginRegistry>(), {.threads = threads})), predictor(untrained(), *host) {
    task.garment = std::make_shared<const Garment>(garment());
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
  static Garment garment() {
    return read_garment(ConfigNode::parse(
        std::string("{mesh: ") + WEFT_SOURCE_DIR "/configs/garments/tshirt.obj, name: tshirt}", "bench"));
  }
  static emd::Params untrained() {
    emd::Params params;
    params.untrained = true;
    return params;
  }
  void predict_and_pull(bool all_gradients = false) const {
    const auto prediction = predictor.predict(cases, {.moments = Moments::mean,
                                                      .gradients = true,
                                                      .state_gradients = all_gradients,
                                                      .shape_gradients = all_gradients});
    benchmark::DoNotOptimize(prediction->pullback(cotangents));
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
  for (auto _ : state) bench.predict_and_pull();
  state.SetItemsProcessed(state.iterations() * state.range(1) * state.range(2));
}
BENCHMARK(predict_and_pullback)
    ->Args({1, 16, 25, 0})
    ->Args({2, 16, 25, 0})
    ->Args({1, 16, 8, 1})
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

/// Planning's gradient on one thread. Argument: 1: with state and shape gradients, which planning does not ask for.
void unasked_gradients(benchmark::State& state) {
  Bench bench(1, 16, 25, false);
  for (auto _ : state) bench.predict_and_pull(state.range(0) != 0);
}
BENCHMARK(unasked_gradients)->Arg(0)->Arg(1)->Unit(benchmark::kMillisecond);

void predict_only(benchmark::State& state) {
  Bench bench(static_cast<int>(state.range(0)), state.range(1), state.range(2), false);
  for (auto _ : state) benchmark::DoNotOptimize(bench.predictor.predict(bench.cases, {.moments = Moments::mean}));
}
BENCHMARK(predict_only)->Args({1, 16, 25})->Unit(benchmark::kMillisecond)->UseRealTime();

/// Predictions and gradients as a search asks for them, with the time that they take.
class Timed final : public Objective {
 public:
  explicit Timed(Bench& bench) : bench_(bench), controls_(bench.cases.front().controls) {}
  static double cpu() {
    timespec now{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  }
  static double wall() {
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  }
  Index dim() const override { return controls_.size(); }
  ObjectiveCapabilities capabilities() const override { return {true, 0}; }
  Evaluation evaluate(ConstMatrix x, const std::vector<Index>&, const EvaluationRequest&) override {
    const double cpu_before = cpu(), wall_before = wall();
    Evaluation e;
    e.costs = Vector::Zero(x.cols());
    e.gradients.resize(dim(), x.cols());
    std::vector<PredictionCase> cases(bench_.cases.begin(), bench_.cases.begin() + x.cols());
    for (Index i = 0; i < x.cols(); ++i)
      cases[i].controls = Eigen::Map<const Controls>(x.col(i).data(), controls_.rows(), controls_.cols());
    const auto prediction = bench_.predictor.predict(cases, {.moments = Moments::mean, .gradients = true});
    const auto gradients = prediction->pullback(bench_.cotangents);
    for (Index i = 0; i < x.cols(); ++i)
      e.gradients.col(i) = Eigen::Map<const Vector>(gradients[i].controls.data(), dim());
    cpu_seconds += cpu() - cpu_before;
    wall_seconds += wall() - wall_before;
    return e;
  }
  double cpu_seconds = 0.0, wall_seconds = 0.0;

 private:
  Bench& bench_;
  Controls controls_;
};

/// Time that the threads of a search and their meetings add to its predictions, percent of them; 16 instances, 25
/// segments.
/// Read the CPU time on a machine that does other work as well.
void batching_overhead(benchmark::State& state) {
  constexpr Index instances = 16, batches = 20;
  Bench bench(1, instances, 25, false);
  Timed objective(bench);
  const Vector x = Eigen::Map<const Vector>(bench.cases.front().controls.data(), objective.dim());
  const Box box{(x.array() - 1.0).matrix(), (x.array() + 1.0).matrix()};
  double cpu = 0.0, wall = 0.0;
  for (auto _ : state) {
    const double cpu_before = Timed::cpu(), wall_before = Timed::wall();
    benchmark::DoNotOptimize(
        minimise_pointwise("bench", objective, x.replicate(1, instances), box, Vector::Ones(x.size()), {}, nullptr,
                           [&](PointwiseSearch& search, const Vector& start) {
                             for (Index k = 0; k < batches; ++k)
                               benchmark::DoNotOptimize(search.evaluate(start, {.gradients = true}));
                             return SolverOutcome{};
                           }));
    cpu += Timed::cpu() - cpu_before;
    wall += Timed::wall() - wall_before;
  }
  state.counters["batch_cpu_ms"] = 1e3 * objective.cpu_seconds / static_cast<double>(state.iterations() * batches);
  state.counters["overhead_cpu_percent"] = 100.0 * (cpu / objective.cpu_seconds - 1.0);
  state.counters["overhead_wall_percent"] = 100.0 * (wall / objective.wall_seconds - 1.0);
}
BENCHMARK(batching_overhead)->Unit(benchmark::kMillisecond)->UseRealTime();

/// The products alone, without trajectory, copies and results: the reference for the other benchmarks.
/// Arguments: rows, segments, numeric variant.
void network_alone(benchmark::State& state) {
  static const std::vector<std::string> variants = emd::kernels_here();
  const emd::Kernels& kernels = emd::kernels(variants[static_cast<std::size_t>(state.range(2)) % variants.size()]);
  Bench bench(1, 1, 1, false);
  const emd::Model model = emd::untrained_model(emd::Architecture{}, bench.task, 1);
  const emd::Network network(model, kernels);
  const Index rows = state.range(0), segments = state.range(1), n = model.dimensions.coordinates();
  emd::Block block;
  block.rows = rows;
  block.steps.assign(rows, segments);
  block.shape.assign(rows * n, 0.1f);
  block.change.assign(block.shape.size(), 0.0f);
  block.inputs.assign(rows * segments * model.dimensions.inputs(), 0.1f);
  for (Index r = 0; r < rows; ++r) block.wanted.push_back({r, segments});
  std::vector<float> mean(block.shape.size()), d_mean(mean.size(), 1.0f), d_inputs(block.inputs.size());
  std::vector<float> d_shape(mean.size()), d_change(mean.size());
  for (auto _ : state) {
    emd::Network::Tape tape;
    network.forward(block, tape, mean.data(), nullptr);
    network.pullback(block, tape, d_mean.data(), nullptr, d_inputs.data(), d_shape.data(), d_change.data());
    benchmark::DoNotOptimize(d_inputs.data());
  }
  state.SetLabel(kernels.name);
}
BENCHMARK(network_alone)->ArgsProduct({{16, 8}, {25}, {2, 3}})->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace

BENCHMARK_MAIN();
