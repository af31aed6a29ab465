#pragma once
#include "experiments/benchmark/measure.hpp"
#include "weft/host.hpp"

/// The parts of the benchmark about a task's examples and its network. All throw what their work throws: ConfigError and
/// PluginError for what this build or config lacks, Error when they are cancelled.
namespace weft::benchmark {

/// Examples of the task's random folds, as `weft generate` makes them: in child processes, and with the files written.
/// @param row {processes, examples}. @return wall_ms and cpu_ms of an example, examples_per_s; peak_mb of one process.
nlohmann::ordered_json measure_folds(const Row& row, const Setup& setup, Host& host);

/// Iterations of `weft train`. The examples are made when setup.folder lacks them; that time does not count.
/// @param row {threads, iterations, examples}. @return wall_ms and cpu_ms (all threads) of an iteration.
nlohmann::ordered_json measure_training(const Row& row, const Setup& setup, Host& host);

/// A batch of plans through a network of random weights: prediction of the last shape, and its gradient.
/// @param row {edge_mm, instances, segments, kernels}; edge_mm 0: the task's garment, else a shirt with edges of this length.
/// @return cpu_ms and wall_ms of both, forward_cpu_ms, vertices.
nlohmann::ordered_json measure_gradient(const Row& row, const Setup& setup, Host& host);

/// Whole sessions with `knowledge: estimate`. @param row {seeds, threads}.
/// @return medians and 95th percentiles of wall times: first_plan_ms, first_plan_p95_ms, replan_ms, estimate_ms, ...; the
/// cpu_ms of a session, goal included.
nlohmann::ordered_json measure_sessions(const Row& row, const Setup& setup, Host& host);

}  // namespace weft::benchmark
