#include "experiments/benchmark/learned.hpp"

#include <sys/resource.h>

#include "experiments/benchmark/clock.hpp"
#include "experiments/cell_work.hpp"
#include "experiments/experiment_config.hpp"
#include "experiments/statistics.hpp"
#include "learning/dataset_files.hpp"
#include "learning/generate.hpp"
#include "meshes/mesher.hpp"
#include "session/session.hpp"
#include "weft/trainable.hpp"

namespace weft::benchmark {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

/// The setup's experiment.
struct Experiment {
  Experiment(const Setup& setup, Host& host) : config(setup.config) {
    resolved = read_params(config, params);
    task = make_task(params.task, config, host);
  }
  ConfigNode config, resolved;
  ExperimentParams params;
  Task task;
};

/// Makes the examples that a folder lacks, in as many child processes as the host has threads.
GenerateReport make_examples(const Experiment& given, const Setup& setup, const fs::path& folder, std::int64_t examples,
                             Host& host) {
  GenerateOptions options;
  options.examples = examples;
  options.folder = folder;
  options.worker = this_program({"worker"});
  options.request = example_requests(given.config, setup.plugin_path);
  const auto header = make_dataset_header(given.task, given.params.data, static_cast<std::uint64_t>(given.params.seed),
                                          given.resolved, "{}");
  GenerateReport report = generate_dataset(given.task, given.params.data, header, options, host);
  if (report.cancelled) throw Error("cancelled");
  return report;
}

/// CPU time of the child processes that have ended, ms.
double children_cpu_ms() {
  rusage usage{};
  getrusage(RUSAGE_CHILDREN, &usage);
  const auto ms = [](const timeval& t) {
    return 1e3 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_usec);
  };
  return ms(usage.ru_utime) + ms(usage.ru_stime);
}
double largest_child_mb() {
  rusage usage{};
  getrusage(RUSAGE_CHILDREN, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

}  // namespace

ordered_json measure_folds(const Row& row, const Setup& setup, Host& host) {
  Experiment given(setup, host);
  const auto examples = row.at("examples").get<std::int64_t>();
  given.params.data.shard_examples = examples;
  const fs::path folder = setup.folder / "folds";
  fs::remove_all(folder);
  const double children_before = children_cpu_ms();
  const Clock clock;
  const GenerateReport report = make_examples(given, setup, folder, examples, host);
  const double cpu_ms = clock.cpu_ms() + children_cpu_ms() - children_before, wall_ms = clock.wall_ms();
  fs::remove_all(folder);
  const auto made = static_cast<double>(report.made);
  ordered_json numbers{
      {"cpu_ms", cpu_ms / made}, {"wall_ms", wall_ms / made}, {"examples_per_s", 1e3 * made / wall_ms}};
  numbers["peak_mb"] = largest_child_mb();
  if (report.failed() > 0) numbers["note"] = std::to_string(report.failed()) + " of the examples failed";
  return numbers;
}

ordered_json measure_training(const Row& row, const Setup& setup, Host& host) {
  Experiment given(setup, host);
  const auto iterations = row.at("iterations").get<std::int64_t>();
  given.params.data.shard_examples = 16;
  given.params.data.validation_fraction = 0.2;  // so that few examples have some of each split
  const fs::path folder = setup.folder / "examples";
  make_examples(given, setup, folder, row.at("examples").get<std::int64_t>(), host);
  // The first half of the fit, with all that is done once, does not count. An evaluation of one case ends each half.
  ConfigNode config = given.config;
  const auto set = [&](const char* key, const ConfigNode& value) {
    config = config.with(std::string("predictor.params.training.") + key, value);
  };
  set("iterations", ConfigNode::integer(2 * iterations));
  set("evaluate_every", ConfigNode::integer(iterations));
  set("evaluation_cases", ConfigNode::integer(1));
  set("calibrate", ConfigNode::boolean(false));
  const auto predictor = host.create<Predictor>(config.at("predictor"));
  TrainablePredictor* trainable = predictor->trainable();
  if (trainable == nullptr) throw Unsupported("the predictor does not learn");
  Clock clock;
  double cpu_ms = 0.0, wall_ms = 0.0;
  const FitReport report =
      trainable->fit(load_dataset(folder), given.task, {.seed = host.seed()}, [&](const FitProgress& progress) {
        if (progress.iteration == iterations) clock.restart();
        cpu_ms = clock.cpu_ms(), wall_ms = clock.wall_ms();
        return !host.cancelled();
      });
  if (!report.finished) throw Error("cancelled");
  const auto counted = static_cast<double>(iterations);
  return {{"cpu_ms", cpu_ms / counted}, {"wall_ms", wall_ms / counted}};
}

ordered_json measure_gradient(const Row& row, const Setup& setup, Host& host) {
  Experiment given(setup, host);
  Task& task = given.task;
  if (const auto edge_mm = row.at("edge_mm").get<double>(); edge_mm > 0.0) {
    const GeneratedMesh mesh = generate_mesh(shirt_outline({}), {.edge_m = 1e-3 * edge_mm});
    task.garment = std::make_shared<const Garment>(make_garment(mesh.mesh, "shirt", mesh.vertices));
    for (Index hand = 0; hand < std::ssize(task.manipulation.grasp_vertices); ++hand) {
      task.manipulation.grasp_vertices[hand] = hand;
      task.manipulation.grasp_points.row(hand).head<2>() = task.garment->positions.row(hand).head<2>();
    }
  }
  const auto predictor = host.create<Predictor>(ConfigNode::parse(
      "{plugin: emd, params: {untrained: true, kernels: " + row.at("kernels").get<std::string>() + "}}",
      "weft benchmark"));
  predictor->bind(task);
  std::vector<PredictionCase> cases(row.at("instances").get<std::size_t>());
  for (PredictionCase& one : cases) {
    const auto segments = row.at("segments").get<Index>();
    one.shape = std::make_shared<const Positions>(task.garment->positions);
    one.state = task.trajectory->initial_state(task.manipulation);
    one.controls = 0.55 * task.trajectory->default_controls(segments);
    one.segments = {segments};
  }
  const Index vertices = task.garment->vertex_count();
  const std::vector<std::vector<ShapeCotangent>> cotangents(cases.size(),
                                                            {{Positions::Ones(vertices, 3), Positions(0, 3)}});
  double forward_ms = 0.0;
  const auto once = [&] {
    const Clock clock;
    const auto prediction = predictor->predict(cases, {.moments = Moments::mean, .gradients = true});
    forward_ms += clock.cpu_ms();
    prediction->pullback(cotangents);
  };
  once();  // allocates
  forward_ms = 0.0;
  const double least_ms = setup.is_quick ? 20.0 : 500.0;
  const Clock clock;
  double times = 0.0;
  for (; clock.cpu_ms() < least_ms && !host.cancelled(); ++times) once();
  if (times == 0.0) throw Error("cancelled");
  return {{"cpu_ms", clock.cpu_ms() / times},
          {"wall_ms", clock.wall_ms() / times},
          {"forward_cpu_ms", forward_ms / times},
          {"vertices", vertices}};
}

ordered_json measure_sessions(const Row& row, const Setup& setup, Host& host) {
  std::vector<double> first, later, estimates;
  const Clock clock;
  const auto seeds = row.at("seeds").get<std::vector<std::int64_t>>();
  for (const std::int64_t seed : seeds) {
    const ConfigNode config =
        setup.config.with("seed", ConfigNode::integer(seed)).with("knowledge", ConfigNode::quoted("estimate"));
    ExperimentParams params;
    read_params(config, params);
    const SessionResult result = run_configured_session(params, config, host);
    if (host.cancelled()) throw Error("cancelled");
    for (std::size_t i = 0; i < result.rounds.size(); ++i)
      (i == 0 ? first : later).push_back(1e3 * result.rounds[i].plan.seconds);
    for (const Estimate& estimate : result.estimates) estimates.push_back(1e3 * estimate.seconds);
  }
  ordered_json numbers{{"cpu_ms", clock.cpu_ms() / static_cast<double>(seeds.size())},
                       {"wall_ms", clock.wall_ms() / static_cast<double>(seeds.size())}};
  for (const auto& [name, times] : {std::pair{"first_plan", &first}, {"replan", &later}, {"estimate", &estimates}}) {
    if (times->empty()) throw Error(std::string("no session had a ") + name);
    numbers[std::string(name) + "s"] = times->size();
    numbers[std::string(name) + "_ms"] = quantile_of(*times, 0.5);
    numbers[std::string(name) + "_p95_ms"] = quantile_of(*times, 0.95);
  }
  return numbers;
}

}  // namespace weft::benchmark
