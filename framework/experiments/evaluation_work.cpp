#include "experiments/evaluation_work.hpp"

#include <algorithm>
#include <limits>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>

#include "experiments/cell_work.hpp"
#include "experiments/experiment_config.hpp"
#include "experiments/json_numbers.hpp"
#include "experiments/physics/suite.hpp"
#include "learning/dataset_files.hpp"
#include "loader/program_host.hpp"
#include "sdk/located_config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kPhysics = "physics case";
constexpr const char* kPrediction = "prediction";

std::string line_of(const ordered_json& json) {
  return json.dump(-1, ' ', true, ordered_json::error_handler_t::replace);
}

ordered_json to_json(const ScoredPrediction& one) {
  auto steps = ordered_json::array();
  for (const auto& s : one.steps)
    steps.push_back({exact(s.error_mm), exact(s.nll), exact(s.inside), exact(s.square), exact(s.sigma_mm)});
  ordered_json json{{"failure", one.failure}, {"steps", steps}, {"settled_sigma_mm", exact(one.settled_sigma_mm)}};
  json["settled"] = std::vector<double>(one.settled.data(), one.settled.data() + one.settled.size());
  return json;
}
ScoredPrediction scored_of(const ordered_json& json) {
  ScoredPrediction one;
  one.failure = json.at("failure").get<std::string>();
  for (const auto& s : json.at("steps"))
    one.steps.push_back(
        {exact_of(s.at(0)), exact_of(s.at(1)), exact_of(s.at(2)), exact_of(s.at(3)), exact_of(s.at(4))});
  one.settled_sigma_mm = exact_of(json.at("settled_sigma_mm"));
  const auto settled = json.at("settled").get<std::vector<double>>();
  one.settled = Eigen::Map<const Positions>(settled.data(), std::ssize(settled) / 3, 3);
  return one;
}

/// What became of a unit. @param read reads the answer of one that was done.
WorkFailure read_end(const WorkEnd& end, const std::function<void(const ordered_json&)>& read) {
  if (end.kind != WorkEnd::Kind::answered) return failure_of(end);
  try {
    const auto json = ordered_json::parse(end.text);
    WorkFailure failure{work_status_named(json.at("status").get<std::string>()), json.at("failure").get<std::string>()};
    if (failure.status == WorkStatus::done) read(json.at("result"));
    return failure;
  } catch (const std::exception& error) {
    return {WorkStatus::crashed, std::string("its process answered with nonsense: ") + error.what()};
  }
}

/// The shards of the last requests.
class ShardCache {
 public:
  const Example& example(const std::string& file, std::int64_t index) {
    auto found = std::find_if(shards_.begin(), shards_.end(), [&](const auto& one) { return one.first == file; });
    if (found == shards_.end()) {
      constexpr std::size_t kMost = 3;
      if (shards_.size() == kMost) shards_.erase(shards_.begin());
      shards_.emplace_back(file, read_shard(file));
      found = std::prev(shards_.end());
    }
    for (const auto& example : found->second.examples)
      if (example.index == index) return example;
    throw ConfigError(file + ": does not hold example " + std::to_string(index));
  }

 private:
  std::vector<std::pair<std::string, Shard>> shards_;
};

}  // namespace

std::vector<PhysicsRow> run_physics_case_of(const PhysicsExperimentParams& params, const PhysicsCase& one,
                                            const Task& task, Host& host) {
  std::vector<SimulatorVariant> variants{simulator_variant("default", host, task.simulator)};
  const bool is_paired = one.test == "paired folds";
  const ConfigNode& second = is_paired ? params.other : params.finer;
  if (!second.is_null()) variants.push_back(simulator_variant(is_paired ? "other" : "finer", host, second));
  return run_physics_case(one, variants);
}

std::vector<PhysicsRow> run_physics_cases(const EvaluationWorkers& workers, const ConfigNode& config,
                                          const std::vector<PhysicsCase>& cases, const PluginRegistry& registry,
                                          Host& host, PhysicsCheckpoint& checkpoint,
                                          const std::function<void(const std::vector<PhysicsRow>&)>& done) {
  ordered_json request{
      {"kind", kPhysics}, {"config", located_json(config)}, {"plugin_path", searched_folders(registry)}};
  SlowestUnit slowest(workers.limit_s);
  std::vector<std::vector<PhysicsRow>> results(cases.size());
  std::atomic<std::size_t> next = 0;
  std::mutex mutex;
  host.parallel_for(host.threads(), [&](std::int64_t) {
    WorkerProcess child(workers.command);
    ordered_json mine = request;
    for (std::size_t i; (i = next++) < cases.size() && !workers.cancelled();) {
      if (const auto* rows = checkpoint.rows(i)) {
        results[i] = *rows;
        continue;
      }
      mine["case"] = i;
      const WorkEnd end = child.run(
          line_of(mine), [&] { return slowest.limits(); }, workers.cancelled);
      if (end.kind == WorkEnd::Kind::cancelled) return;
      if (end.kind == WorkEnd::Kind::answered) slowest.add(end.cpu_seconds);
      const WorkFailure failure = read_end(end, [&](const ordered_json& rows) {
        for (const auto& row : rows) results[i].push_back(exact_physics_row(row));
      });
      if (failure.status == WorkStatus::done)
        checkpoint.add(i, results[i]);
      else
        results[i] = {physics::row(cases[i].test, {"default", {}}, cases[i].name, to_string(failure.status), 0.0, 0.0,
                                   std::numeric_limits<double>::infinity(), 0.0, failure.message)};
      const std::lock_guard lock(mutex);
      done(results[i]);
    }
  });
  std::vector<PhysicsRow> rows;
  for (auto& some : results) std::move(some.begin(), some.end(), std::back_inserter(rows));
  return rows;
}

PredictBatch predict_in_child(const EvaluationWorkers& workers, const ConfigNode& config, const Dataset& dataset,
                              const std::vector<std::string>& folders, const PluginRegistry& registry, Host& host) {
  std::vector<std::int64_t> shard_examples;  // of each folder
  for (const auto& folder : folders)
    shard_examples.push_back(read_shard_header(list_shards(folder).front()).shard_examples);
  const auto shard_of = [&dataset, &folders, shard_examples](std::size_t example) {
    const std::size_t source = dataset.source(example);
    const auto number = dataset.examples[example].index / shard_examples.at(source);
    return fs::absolute(fs::path(folders.at(source)) / shard_name(number)).string();
  };
  const ordered_json request{{"kind", kPrediction},
                             {"config", located_json(config)},
                             {"plugin_path", searched_folders(registry)},
                             {"threads", host.threads()}};
  const auto child = std::make_shared<WorkerProcess>(workers.command);
  const auto slowest = std::make_shared<SlowestUnit>(workers.limit_s);
  return [=, &workers, &dataset](const PredictionBatch& batch) {
    ordered_json mine = request;
    mine["has_knowledge"] = batch.has_knowledge;
    mine["wants_shapes"] = batch.wants_shapes;
    mine["starts"] = ordered_json::array();
    for (const auto& start : batch.starts)
      mine["starts"].push_back({shard_of(start.example), dataset.examples[start.example].index, start.segment});
    const WorkEnd end = child->run(
        line_of(mine), [&] { return slowest->limits(); }, workers.cancelled);
    if (end.kind == WorkEnd::Kind::answered) slowest->add(end.cpu_seconds);
    ScoredBatch scored;
    scored.failure = read_end(end, [&](const ordered_json& result) {
      scored.seconds = result.at("seconds").get<double>();
      for (const auto& one : result.at("cases")) scored.cases.push_back(scored_of(one));
      if (scored.cases.size() != batch.starts.size()) throw ConfigError("it has another number of cases");
    });
    return scored;
  };
}

/// Task and plugins stay from one request to the next.
struct EvaluationServer::State {
  const std::atomic<bool>* cancel;
  std::string setup;
  std::unique_ptr<Host> host;
  PhysicsExperimentParams physics;
  std::shared_ptr<const Task> task;
  std::vector<PhysicsCase> cases;
  std::shared_ptr<Predictor> predictor;
  ShardCache shards;

  void prepare(const ordered_json& request) {
    const auto kind = request.at("kind").get<std::string>(), text = request.at("config").get<std::string>(),
               folders = request.at("plugin_path").get<std::string>();
    if (!setup.empty() && setup == kind + text + folders) return;
    predictor.reset();
    const ConfigNode config = read_located_json(text);
    HostOptions options;
    options.threads = request.value("threads", 1);
    options.cancel = cancel;
    if (kind == kPhysics) {
      physics = PhysicsExperimentParams();
      read_params(config, physics);
      options.seed = static_cast<std::uint64_t>(physics.seed);
      host = make_host(registry_of_request(folders), options);
      task = std::make_shared<const Task>(make_task(physics.task, config, *host));
      cases = physics_cases(physics.physics, task, config);
    } else {
      ExperimentParams params;
      read_params(config, params);
      options.seed = static_cast<std::uint64_t>(params.seed);
      host = make_host(registry_of_request(folders), options);
      task = std::make_shared<const Task>(make_task(params.task, config, *host));
      predictor = bound_predictor(config.at("predictor"), *task, *host);
    }
    setup = kind + text + folders;
  }

  ordered_json physics_result(const ordered_json& request) {
    auto rows = ordered_json::array();
    for (const auto& row : run_physics_case_of(physics, cases.at(request.at("case").get<std::size_t>()), *task, *host))
      rows.push_back(exact_json(row));
    return rows;
  }

  ordered_json prediction_result(const ordered_json& request) {
    Dataset dataset;
    dataset.header.vertices = task->garment->vertex_count();
    PredictionBatch batch{{}, request.at("has_knowledge").get<bool>(), request.at("wants_shapes").get<bool>()};
    for (const auto& start : request.at("starts")) {
      dataset.examples.push_back(shards.example(start.at(0).get<std::string>(), start.at(1).get<std::int64_t>()));
      batch.starts.push_back({dataset.examples.size() - 1, start.at(2).get<Index>()});
    }
    const ScoredBatch scored = predict_batch(*predictor, dataset, batch);
    auto list = ordered_json::array();
    for (const auto& one : scored.cases) list.push_back(to_json(one));
    return {{"seconds", scored.seconds}, {"cases", list}};
  }
};

EvaluationServer::EvaluationServer(const std::atomic<bool>* cancel) : state_(std::make_unique<State>()) {
  state_->cancel = cancel;
}
EvaluationServer::~EvaluationServer() = default;

bool EvaluationServer::knows(const std::string& kind) { return kind == kPhysics || kind == kPrediction; }

std::string EvaluationServer::answer(const std::string& text) {
  WorkFailure failure{WorkStatus::done, ""};
  ordered_json result;
  try {
    const auto request = ordered_json::parse(text);
    state_->prepare(request);
    result = request.at("kind") == kPhysics ? state_->physics_result(request) : state_->prediction_result(request);
  } catch (...) {
    failure = current_failure();
  }
  return line_of({{"status", to_string(failure.status)}, {"failure", failure.message}, {"result", result}});
}

}  // namespace weft
