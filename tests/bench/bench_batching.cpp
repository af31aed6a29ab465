// The cost of the meeting of the threads: evaluations of an objective that takes no time, by one thread in a loop and
// by a thread per instance. Time per iteration of the benchmark = time per batch; items = points.
#include <benchmark/benchmark.h>

#include "weft/batching.hpp"

namespace {

using namespace weft;

class Bowl final : public Objective {
 public:
  explicit Bowl(Index dim) : dim_(dim) {}
  Index dim() const override { return dim_; }
  ObjectiveCapabilities capabilities() const override { return {true, 0}; }
  Evaluation evaluate(ConstMatrix x, const std::vector<Index>&, const EvaluationRequest&) override {
    Evaluation e;
    e.costs = 0.5 * x.colwise().squaredNorm().transpose();
    e.gradients = x;
    return e;
  }

 private:
  Index dim_;
};

constexpr Index kDim = 125;       // 25 segments of 5 controls
constexpr Index kBatches = 2000;  // per search, so that starting threads counts as little as it does in a plan

void direct(benchmark::State& state) {
  const Index instances = state.range(0);
  Bowl f(kDim);
  const Matrix x = Matrix::Ones(kDim, instances);
  std::vector<Index> numbers;
  for (Index i = 0; i < instances; ++i) numbers.push_back(i);
  for (auto _ : state) benchmark::DoNotOptimize(f.evaluate(x, numbers, {.gradients = true}));
  state.SetItemsProcessed(state.iterations() * instances);
}
BENCHMARK(direct)->Arg(1)->Arg(4)->Arg(16)->Arg(64);

void batched(benchmark::State& state) {
  const Index instances = state.range(0);
  Bowl f(kDim);
  const Matrix starts = Matrix::Ones(kDim, instances);
  const Box box{Vector::Constant(kDim, -2.0), Vector::Constant(kDim, 2.0)};
  for (auto _ : state) {
    benchmark::DoNotOptimize(minimise_pointwise(
        "bench", f, starts, box, Vector::Ones(kDim), {}, nullptr, [](PointwiseSearch& search, const Vector& start) {
          for (Index k = 0; k < kBatches; ++k) benchmark::DoNotOptimize(search.evaluate(start, {.gradients = true}));
          return SolverOutcome{};
        }));
  }
  state.SetItemsProcessed(state.iterations() * kBatches * instances);
  state.counters["us_per_batch"] = benchmark::Counter(1e-6 * static_cast<double>(state.iterations() * kBatches),
                                                      benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}
BENCHMARK(batched)->Arg(1)->Arg(4)->Arg(16)->Arg(64)->Unit(benchmark::kMillisecond)->UseRealTime();

/// A search of one evaluation per instance: starting and joining the threads.
void started(benchmark::State& state) {
  const Index instances = state.range(0);
  Bowl f(kDim);
  const Matrix starts = Matrix::Ones(kDim, instances);
  const Box box{Vector::Constant(kDim, -2.0), Vector::Constant(kDim, 2.0)};
  for (auto _ : state) {
    benchmark::DoNotOptimize(minimise_pointwise("bench", f, starts, box, Vector::Ones(kDim), {}, nullptr,
                                                [](PointwiseSearch& search, const Vector& start) {
                                                  search.evaluate(start, {.gradients = true});
                                                  return SolverOutcome{};
                                                }));
  }
}
BENCHMARK(started)->Arg(1)->Arg(16)->Arg(64)->Unit(benchmark::kMicrosecond)->UseRealTime();

}  // namespace

BENCHMARK_MAIN();
