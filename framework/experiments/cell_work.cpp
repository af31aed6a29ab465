#include "experiments/cell_work.hpp"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>

#include "experiments/cells.hpp"
#include "experiments/estimation_evaluation.hpp"
#include "experiments/json_numbers.hpp"
#include "experiments/planning_evaluation.hpp"
#include "learning/dataset_files.hpp"
#include "loader/program_host.hpp"
#include "sdk/files.hpp"
#include "sdk/located_config.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kUnwritten = "unwritten";  // in the place of a status: see WriteError

constexpr auto kReplace = ordered_json::error_handler_t::replace;

/// Numbers as they are: JSON has none that are not finite.
ordered_json exact_numbers(const SweepMetrics& numbers) {
  auto list = ordered_json::array();
  for (const auto& [name, value] : numbers) list.push_back({name, json_number(value)});
  return list;
}
SweepMetrics read_exact_numbers(const ordered_json& list) {
  SweepMetrics numbers;
  for (const auto& one : list) numbers.emplace_back(one.at(0).get<std::string>(), number_of(one.at(1)));
  return numbers;
}

/// Cases with the one example that a request is about, read from its file.
EvaluationCases cases_of(const ordered_json& request, std::uint64_t seed) {
  EvaluationCases cases;
  cases.source = request.at("source").get<std::string>();
  cases.seeds = {seed};
  if (!request.contains("shard")) return cases;
  const fs::path file = request.at("shard").get<std::string>();
  const auto index = request.at("example").get<std::int64_t>();
  Shard shard = read_shard(file);
  const auto found = std::find_if(shard.examples.begin(), shard.examples.end(),
                                  [&](const Example& example) { return example.index == index; });
  if (found == shard.examples.end())
    throw ConfigError(file.string() + ": does not hold example " + std::to_string(index));
  auto dataset = std::make_shared<Dataset>();
  dataset->header = std::move(shard.header);
  dataset->examples.push_back(std::move(*found));
  cases.dataset = std::move(dataset);
  cases.examples[seed] = 0;
  return cases;
}

SweepOutcome run_cell(const ordered_json& request, const ConfigNode& cell, Host& host) {
  const auto kind = request.at("kind").get<std::string>();
  if (kind == "session") return run_session_cell(cell, host);
  if (kind == "physics") return run_physics_cell(cell, host);
  const EvaluationCases cases = cases_of(request, seed_of(cell));
  const fs::path folder = request.at("folder").get<std::string>();
  if (kind == "planning") return planning_runner(cases, folder)(cell, host);
  if (kind != "estimation") throw ConfigError("'" + kind + "' is not a kind of cell");
  DataParams data;
  read_params(read_located_json(request.at("data").get<std::string>()), data);
  return estimation_runner(cases, data, folder)(cell, host);
}

}  // namespace

std::string searched_folders(const PluginRegistry& registry) {
  auto folders = ordered_json::array();
  for (const auto& folder : registry.search_path()) folders.push_back(fs::absolute(folder).string());
  return folders.dump(-1, ' ', true, kReplace);
}

std::shared_ptr<const PluginRegistry> registry_of_request(const std::string& text) {
  static auto& kept = *new std::map<std::string, std::shared_ptr<const PluginRegistry>>();
  auto& registry = kept[text];
  if (registry == nullptr) {
    std::vector<fs::path> folders;
    for (const auto& folder : ordered_json::parse(text)) folders.emplace_back(folder.get<std::string>());
    registry = std::make_shared<const PluginRegistry>(std::move(folders));
  }
  return registry;
}

std::string cell_request(const CellWork& work, const ConfigNode& cell, const PluginRegistry& registry) {
  ordered_json request{{"kind", work.kind}, {"config", located_json(cell)}};
  request["plugin_path"] = searched_folders(registry);
  if (work.kind == "planning" || work.kind == "estimation") {
    request["folder"] = fs::absolute(work.folder).string();
    request["source"] = work.cases.source;
    request["data"] = located_json(work.data);
    if (const Example* example = work.cases.example(seed_of(cell))) {
      const auto number = example->index / work.cases.dataset->header.shard_examples;
      request["shard"] = fs::absolute(work.dataset / shard_name(number)).string();
      request["example"] = example->index;
    }
  }
  return request.dump(-1, ' ', true, kReplace);
}

std::function<std::string(std::int64_t)> example_requests(const ConfigNode& config, const std::string& folders) {
  const std::string setup =
      ordered_json{{"config", located_json(config)}, {"plugin_path", folders}}.dump(-1, ' ', true, kReplace);
  return [setup](std::int64_t index) { return kExample + std::to_string(index) + " " + setup; };
}

void read_cell_end(const WorkEnd& end, SweepRow& row) {
  if (end.kind != WorkEnd::Kind::answered) {
    const WorkFailure failure = failure_of(end);
    row.status = failure.status;
    row.failure = failure.message;
    return;
  }
  try {
    const auto json = ordered_json::parse(end.text);
    row.failure = json.at("failure").get<std::string>();
    const auto status = json.at("status").get<std::string>();
    if (status == kUnwritten) throw WriteError(row.failure);
    row.status = work_status_named(status);
    if (row.status != WorkStatus::done) return;
    row.outcome.metrics = read_exact_numbers(json.at("metrics"));
    row.outcome.times = read_exact_numbers(json.at("times"));
    row.outcome.paired_by = json.at("paired_by").get<std::string>();
    row.outcome.payload = {json.at("schema").get<std::string>(), json.at("payload").get<std::string>()};
  } catch (const WriteError&) {
    throw;
  } catch (const std::exception& error) {
    row.status = WorkStatus::crashed;
    row.failure = std::string("its process answered with nonsense: ") + error.what();
  }
}

std::string CellServer::answer(const std::string& text) {
  WorkFailure failure{WorkStatus::done, ""};
  SweepOutcome outcome;
  try {
    const auto request = ordered_json::parse(text);
    const ConfigNode cell = read_located_json(request.at("config").get<std::string>());
    const auto host = make_cell_host(registry_of_request(request.at("plugin_path").get<std::string>()), cell, cancel_);
    outcome = run_cell(request, cell, *host);
  } catch (const WriteError& error) {
    return ordered_json{{"status", kUnwritten}, {"failure", error.what()}}.dump(-1, ' ', true, kReplace);
  } catch (...) {
    failure = current_failure();
  }
  return ordered_json{{"status", to_string(failure.status)},
                      {"failure", failure.message},
                      {"metrics", exact_numbers(outcome.metrics)},
                      {"times", exact_numbers(outcome.times)},
                      {"paired_by", outcome.paired_by},
                      {"schema", outcome.payload.schema},
                      {"payload", outcome.payload.json}}
      .dump(-1, ' ', true, kReplace);
}

}  // namespace weft
