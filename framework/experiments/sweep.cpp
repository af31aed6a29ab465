#include "experiments/sweep.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "experiments/cpu_time.hpp"
#include "experiments/physics/suite.hpp"
#include "loader/program_host.hpp"
#include "session/session.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr const char* kRowSchema = "weft ablation row 1";

std::uint64_t fnv(const void* data, std::size_t bytes, std::uint64_t hash = 14695981039346656037ull) {
  for (std::size_t i = 0; i < bytes; ++i) hash = (hash ^ static_cast<const unsigned char*>(data)[i]) * 1099511628211ull;
  return hash;
}
std::uint64_t fnv(const std::string& text) { return fnv(text.data(), text.size()); }

std::string hex(std::uint64_t value) {
  char text[20];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(value));
  return text;
}

/// A level: what it is called and what it changes.
struct Level {
  std::string name;
  std::vector<std::pair<std::string, ConfigNode>> changes;  // dotted keys
};
struct Factor {
  std::string name;
  std::vector<Level> levels;
};

std::string level_name(const ConfigNode& value) {
  if (value.is_scalar()) return value.as_string();
  std::string text = value.to_json();
  text.erase(std::remove_if(text.begin(), text.end(), [](char c) { return c == '\n' || c == '"'; }), text.end());
  return text;
}

using Changes = std::vector<std::pair<std::string, ConfigNode>>;

/// {planning: {noise: 1}} is {planning.noise: 1}; a plugin slot is replaced as a whole, with its parameters.
void add_changes(const ConfigNode& node, const std::string& prefix, Changes& changes) {
  for (const auto& key : node.keys()) {
    const ConfigNode value = node.at(key);
    if (value.is_mapping() && value.size() > 0 && !value.has("plugin"))
      add_changes(value, prefix + key + ".", changes);
    else
      changes.emplace_back(prefix + key, value);
  }
}

Changes read_changes(const ConfigNode& node) {
  Changes changes;
  if (node.is_null()) return changes;
  if (!node.is_mapping()) node.fail("must be a mapping of session keys to values");
  add_changes(node, "", changes);
  return changes;
}

std::vector<Factor> read_factors(const ConfigNode& node) {
  std::vector<Factor> factors;
  if (!node.is_mapping() || node.size() == 0) node.fail("must be a mapping of at least one factor to its levels");
  for (const auto& name : node.keys()) {
    const ConfigNode levels = node.at(name);
    Factor factor{name, {}};
    if (levels.is_sequence()) {
      for (std::size_t i = 0; i < levels.size(); ++i)
        factor.levels.push_back({level_name(levels[i]), {{name, levels[i]}}});
    } else if (levels.is_mapping()) {
      for (const auto& level : levels.keys()) factor.levels.push_back({level, read_changes(levels.at(level))});
    }
    if (factor.levels.empty()) levels.fail("must be a list of values, or a mapping of levels, and not empty");
    for (std::size_t i = 0; i < factor.levels.size(); ++i)
      for (std::size_t k = 0; k < i; ++k)
        if (factor.levels[i].name == factor.levels[k].name)
          levels.fail("names the level '" + factor.levels[i].name + "' twice");
    factors.push_back(std::move(factor));
  }
  return factors;
}

std::vector<std::uint64_t> read_seeds(const ConfigNode& node, const std::uint64_t* first_seed) {
  std::vector<std::uint64_t> seeds;
  const auto add = [&](const ConfigNode& from, std::int64_t seed) {
    if (seed < 0) from.fail("= " + std::to_string(seed) + ", must be >= 0");
    if (std::find(seeds.begin(), seeds.end(), static_cast<std::uint64_t>(seed)) != seeds.end())
      from.fail("names the seed " + std::to_string(seed) + " twice");
    seeds.push_back(static_cast<std::uint64_t>(seed));
  };
  if (node.is_sequence() && node.size() > 0) {
    if (first_seed != nullptr) node.fail("is a list; --seed needs {first, count}");
    for (std::size_t i = 0; i < node.size(); ++i) add(node[i], node[i].as_int());
    return seeds;
  }
  if (!node.is_mapping() || node.is_null()) node.fail("must be a list of seeds, or {first: 1, count: 10}");
  node.refuse_unknown_keys({"first", "count"});
  const std::int64_t first = first_seed != nullptr ? static_cast<std::int64_t>(*first_seed)
                             : node.has("first")   ? node.at("first").as_int()
                                                   : 1;
  const std::int64_t count = node.at("count").as_int();
  if (count < 1 || count > 1000000) node.at("count").fail("= " + std::to_string(count) + ", must be in [1, 1000000]");
  for (std::int64_t i = 0; i < count; ++i) add(node, first + i);
  return seeds;
}

/// Index of a level in each factor; -1: as the arm itself.
std::vector<int> read_baseline(const ConfigNode& node, const std::vector<Factor>& factors) {
  std::vector<int> levels(factors.size(), -1);
  if (node.is_null()) {
    levels[0] = 0;
    return levels;
  }
  const auto find = [](const ConfigNode& from, const Factor& factor) {
    std::vector<std::string> names;
    for (const auto& level : factor.levels) names.push_back(level.name);
    const std::string wanted = level_name(from);
    const auto found = std::find(names.begin(), names.end(), wanted);
    if (found == names.end()) from.fail("= " + wanted + " is no level of " + factor.name + nearest_hint(wanted, names));
    return static_cast<int>(found - names.begin());
  };
  if (node.is_scalar()) {
    if (factors.size() > 1) node.fail("must say {factor: level}, since there are several factors");
    levels[0] = find(node, factors[0]);
    return levels;
  }
  std::vector<std::string> names;
  for (const auto& factor : factors) names.push_back(factor.name);
  node.refuse_unknown_keys(names);
  if (node.size() == 0) node.fail("names no factor");
  for (std::size_t f = 0; f < factors.size(); ++f)
    if (node.has(factors[f].name)) levels[f] = find(node.at(factors[f].name), factors[f]);
  return levels;
}

std::string cell_name(const AblationPlan& plan, std::size_t arm, std::uint64_t seed) {
  return "seed" + std::to_string(seed) + "-arm" + std::to_string(arm) + "-" +
         hex(fnv(plan.arms[arm].name)).substr(0, 8) + ".json";
}

/// What decides a cell's numbers; a row with another one belongs to another ablation.
std::string cell_fingerprint(const ConfigNode& session) { return hex(fnv(session.to_yaml())); }

ordered_json number(double value) { return std::isfinite(value) ? ordered_json(value) : ordered_json(nullptr); }

void write_row(const fs::path& file, const AblationPlan& plan, const AblationRow& row, const std::string& fingerprint) {
  ordered_json metrics = ordered_json::object();
  for (const auto& [name, value] : row.outcome.metrics) metrics[name] = number(value);
  const ordered_json json{{"schema", kRowSchema},
                          {"arm", plan.arms[row.arm].name},
                          {"seed", row.seed},
                          {"config", fingerprint},
                          {"status", row.failure.empty() ? "done" : "failed"},
                          {"failure", row.failure},
                          {"paired_by", row.outcome.paired_by},
                          {"metrics", metrics}};
  const fs::path temporary = file.string() + ".tmp";
  std::ofstream stream(temporary, std::ios::binary);
  stream << json.dump(2, ' ', false, ordered_json::error_handler_t::replace) << '\n';
  stream.close();
  if (!stream) throw Error(file.string() + ": cannot be written");
  fs::rename(temporary, file);
}

AblationRow read_row(const fs::path& file, const AblationPlan& plan, std::size_t arm, std::uint64_t seed,
                     const std::string& fingerprint) {
  AblationRow row{arm, seed, "", {}};
  try {
    std::ifstream stream(file, std::ios::binary);
    const ordered_json json = ordered_json::parse(stream);
    if (json.at("schema") != kRowSchema) throw ConfigError(file.string() + ": is no row of an ablation");
    if (json.at("arm") != plan.arms[arm].name || json.at("seed") != seed || json.at("config") != fingerprint)
      throw ConfigError(file.string() +
                        ": belongs to an ablation with another config; give another --out, or remove its folder");
    row.failure = json.at("failure").get<std::string>();
    if (json.at("status") != (row.failure.empty() ? "done" : "failed"))
      throw ConfigError(file.string() + ": is damaged: status and failure disagree");
    row.outcome.paired_by = json.at("paired_by").get<std::string>();
    for (const auto& [name, value] : json.at("metrics").items())
      row.outcome.metrics.emplace_back(name, value.is_null() ? kNaN : value.get<double>());
  } catch (const nlohmann::json::exception& error) {
    throw ConfigError(file.string() + ": is damaged: " + error.what() + "; remove it to run its cell again");
  }
  return row;
}

double quantile(const std::vector<double>& sorted, double q) {
  const double at = q * static_cast<double>(sorted.size() - 1);
  const auto low = static_cast<std::size_t>(at);
  const std::size_t high = std::min(low + 1, sorted.size() - 1);
  return sorted[low] + (at - static_cast<double>(low)) * (sorted[high] - sorted[low]);
}

double mean_of(const std::vector<double>& values) {
  double sum = 0.0;
  for (double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

double metric_of(const AblationRow& row, const std::string& name) {
  for (const auto& [key, value] : row.outcome.metrics)
    if (key == name) return value;
  return kNaN;
}

/// Rows by arm and seed, for looking up pairs.
struct Table {
  explicit Table(const std::vector<AblationRow>& rows) {
    for (const auto& row : rows) cells[{row.arm, row.seed}] = &row;
  }
  /// nullptr: missing or failed.
  const AblationRow* find(std::size_t arm, std::uint64_t seed) const {
    const auto found = cells.find({arm, seed});
    return found == cells.end() || !found->second->failure.empty() ? nullptr : found->second;
  }
  std::map<std::pair<std::size_t, std::uint64_t>, const AblationRow*> cells;
};

struct Comparison {
  AblationStatistics own, difference;
  std::size_t unpaired = 0;  ///< seeds that both arms ran, but not on the same case
};

Comparison compare(const AblationPlan& plan, const Table& table, std::size_t arm, const std::string& metric) {
  Comparison result;
  std::vector<double> own, difference;
  for (const std::uint64_t seed : plan.seeds) {
    const AblationRow* here = table.find(arm, seed);
    if (here == nullptr) continue;
    const double value = metric_of(*here, metric);
    if (std::isfinite(value)) own.push_back(value);
    const AblationRow* there = table.find(plan.arms[arm].baseline, seed);
    if (there == nullptr) continue;
    if (there->outcome.paired_by != here->outcome.paired_by) {
      ++result.unpaired;
      continue;
    }
    const double change = value - metric_of(*there, metric);
    if (std::isfinite(change)) difference.push_back(change);
  }
  const std::uint64_t key = fnv(metric);
  result.own = ablation_statistics(own, plan.resamples, key);
  result.difference = ablation_statistics(difference, plan.resamples, key + 1);
  return result;
}

ordered_json statistics_json(const AblationStatistics& s) {
  return {{"n", s.n},
          {"mean", number(s.mean)},
          {"median", number(s.median)},
          {"sd", number(s.sd)},
          {"mean_95", {number(s.mean_interval.first), number(s.mean_interval.second)}},
          {"median_95", {number(s.median_interval.first), number(s.median_interval.second)}}};
}

std::string csv_field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + '"';
}

std::string csv_number(double value) {
  if (!std::isfinite(value)) return "";
  char text[40];
  std::snprintf(text, sizeof text, "%.17g", value);
  double back = 0.0;
  for (int digits = 6; digits < 17; ++digits) {
    char shorter[40];
    std::snprintf(shorter, sizeof shorter, "%.*g", digits, value);
    if (std::sscanf(shorter, "%lf", &back) == 1 && back == value) return shorter;
  }
  return text;
}

std::vector<std::string> physics_case_names(const ConfigNode& config) {
  PhysicsExperimentParams params;
  read_params(config, params);
  std::vector<std::string> names;
  for (const auto& one : physics_cases(params.physics, std::make_shared<const Task>(), config))
    names.push_back(one.test + (one.name.empty() ? "" : ", " + one.name));
  return names;
}

}  // namespace

AblationPlan read_ablation(const ConfigNode& config, const std::uint64_t* first_seed) {
  AblationParams params;
  read_params(config, params);
  if (params.task.empty()) config.fail("task is missing; name the session config that the arms start from");
  if (params.factors.is_null()) config.fail("factors is missing");
  const bool physics = params.measure == "physics";
  if (!physics && params.seeds.is_null()) config.fail("seeds is missing; such as {first: 1, count: 10}");
  if (physics && (!params.seeds.is_null() || first_seed != nullptr))
    config.fail("has seeds, but measure: physics runs the cases of the suite; physics.folds.first_seed is the folds'");
  ConfigNode base = ConfigNode::load(params.task).without("seed");
  for (const auto& [key, value] : read_changes(params.set)) base = base.with(key, value);
  const auto factors = read_factors(params.factors);
  const auto baseline = read_baseline(params.baseline, factors);

  AblationPlan plan;
  plan.description = params.description;
  plan.measure = params.measure;
  plan.resamples = params.resamples;
  if (!physics) plan.seeds = read_seeds(params.seeds, first_seed);
  std::size_t count = 1;
  for (const auto& factor : factors) {
    plan.factors.push_back(factor.name);
    count *= factor.levels.size();
    if (count > 100000) params.factors.fail("make more than 100000 arms");
  }
  for (std::size_t a = 0; a < count; ++a) {
    AblationArm arm;
    arm.config = base;
    // The last factor runs fastest.
    std::size_t rest = a, stride = count;
    for (std::size_t f = 0; f < factors.size(); ++f) {
      stride /= factors[f].levels.size();
      const std::size_t level = rest / stride;
      rest %= stride;
      arm.levels.push_back(factors[f].levels[level].name);
      arm.name += (f > 0 ? ", " : "") + factors[f].levels[level].name;
      for (const auto& [key, value] : factors[f].levels[level].changes) arm.config = arm.config.with(key, value);
      arm.baseline += stride * (baseline[f] >= 0 ? static_cast<std::size_t>(baseline[f]) : level);
    }
    if (arm.config.has("seed")) config.fail("sets `seed` of the sessions; `seeds` does that");
    // A wrong key of a session shows here, before any work.
    if (physics) {
      const auto cases = physics_case_names(arm.config);
      if (a == 0) plan.cases = cases;
      if (cases != plan.cases) config.fail("has arms with different cases; factors must not change them");
    } else {
      SessionParams session;
      read_params(arm.config, session);
    }
    plan.arms.push_back(std::move(arm));
  }
  for (std::size_t i = 0; i < plan.cases.size(); ++i) plan.seeds.push_back(i);
  return plan;
}

AblationOutcome run_session_cell(const ConfigNode& config, Host& host) {
  SessionParams params;
  read_params(config, params);
  const double cpu_before = thread_cpu_seconds();
  const SessionResult result = run_session(params, config, host);
  // With one thread everything but the solvers' own arithmetic runs here, so that others on the machine do not count.
  const double cpu_seconds = host.threads() == 1 ? thread_cpu_seconds() - cpu_before : kNaN;
  AblationOutcome outcome = session_outcome(result);
  outcome.metrics.emplace_back("cpu_seconds", cpu_seconds);
  return outcome;
}

AblationOutcome run_physics_cell(const ConfigNode& config, Host& host) {
  PhysicsExperimentParams params;
  read_params(config, params);
  const auto task = std::make_shared<const Task>(make_task(params.task, config, host));
  const auto cases = physics_cases(params.physics, task, config);
  const PhysicsCase& one = cases.at(static_cast<std::size_t>(params.seed));
  std::vector<SimulatorVariant> variants{simulator_variant("arm", host, task->simulator)};
  const bool against_itself = task->simulator.to_yaml() == params.other.to_yaml();
  if (one.test == "paired folds" && !params.other.is_null() && !against_itself)
    variants.push_back(simulator_variant("other", host, params.other));

  AblationOutcome outcome;
  const auto worst = [&](const std::string& name, double value) {
    for (auto& [known, largest] : outcome.metrics)
      if (known == name) return void(largest = std::max(largest, value));
    outcome.metrics.emplace_back(name, value);
  };
  double within = 1.0;
  for (const PhysicsRow& row : one.run(variants)) {
    if (row.variant != "arm") continue;
    worst(row.test + ": " + row.quantity + (row.reference == 0.0 ? "" : ", error"), row.error);
    if (row.cpu_ms_per_frame > 0.0) worst(row.test + ": CPU ms per frame", row.cpu_ms_per_frame);
    if (!row.passed) within = 0.0;
  }
  outcome.metrics.emplace_back(one.test + ": within bounds", within);
  outcome.paired_by = one.test + ", " + one.name;
  return outcome;
}

AblationOutcome session_outcome(const SessionResult& result) {
  AblationOutcome outcome;
  std::uint64_t hash = fnv(result.goal.data(), sizeof(double) * static_cast<std::size_t>(result.goal.size()));
  hash = fnv(result.start.data(), sizeof(double) * static_cast<std::size_t>(result.start.size()), hash);
  hash = fnv(result.true_material.data(), sizeof(double) * 4, hash);
  outcome.paired_by = hex(hash);
  double evaluations = 0, iterations = 0, seconds = 0, estimate_seconds = 0, refinement_seconds = 0;
  for (const auto& round : result.rounds) {
    evaluations += static_cast<double>(round.plan.evaluations);
    iterations += static_cast<double>(round.plan.iterations);
    seconds += round.plan.seconds;
    refinement_seconds += round.refinement_seconds;
  }
  for (const auto& estimate : result.estimates) estimate_seconds += estimate.seconds;
  const bool planned = !result.rounds.empty();
  const Plan first = planned ? result.rounds.front().plan : Plan();
  outcome.metrics = {
      {"error_mm", result.error_mm},
      {"default_error_mm", result.default_error_mm},
      {"released", result.released ? 1.0 : 0.0},
      {"segments", static_cast<double>(result.rounds.size())},
      {"first_plan_loss", planned ? first.loss : kNaN},
      {"first_plan_predicted_error_mm", planned ? first.predicted_error_mm : kNaN},
      {"first_plan_evaluations", planned ? static_cast<double>(first.evaluations) : kNaN},
      {"first_plan_seconds", planned ? first.seconds : kNaN},
      {"evaluations", evaluations},
      {"iterations", iterations},
      {"plan_seconds", seconds},
      {"estimate_seconds", estimate_seconds},
      {"refinement_seconds", refinement_seconds},
      {"simulate_seconds", result.simulate_seconds},
  };
  return outcome;
}

std::vector<AblationRow> run_ablation(const AblationPlan& plan, const AblationOptions& options) {
  const fs::path cells = options.folder / "cells";
  std::error_code problem;
  fs::create_directories(cells, problem);
  if (!fs::is_directory(cells)) throw Error(cells.string() + ": cannot be made: " + problem.message());

  // Seed by seed, so that what an unfinished run leaves can be compared already.
  struct Cell {
    std::size_t arm;
    std::uint64_t seed;
    ConfigNode session;
    std::string fingerprint;
    fs::path file;
  };
  std::vector<Cell> todo;
  std::vector<AblationRow> rows;
  for (const std::uint64_t seed : plan.seeds) {
    for (std::size_t arm = 0; arm < plan.arms.size(); ++arm) {
      Cell cell{arm, seed, plan.arms[arm].config.with("seed", ConfigNode::integer(static_cast<std::int64_t>(seed))), "",
                cells / cell_name(plan, arm, seed)};
      cell.fingerprint = cell_fingerprint(cell.session);
      if (fs::exists(cell.file))
        rows.push_back(read_row(cell.file, plan, arm, seed, cell.fingerprint));
      else
        todo.push_back(std::move(cell));
    }
  }

  const std::size_t total = rows.size() + todo.size();
  std::atomic<std::size_t> next{0};
  std::mutex mutex;
  std::exception_ptr error;  // of writing rows: nothing else stops the others
  const auto cancelled = [&] { return options.cancel != nullptr && *options.cancel; };
  const auto work = [&] {
    for (std::size_t i = next++; i < todo.size(); i = next++) {
      const Cell& cell = todo[i];
      AblationRow row{cell.arm, cell.seed, "", {}};
      if (cancelled()) return;
      try {
        const auto threads = cell.session.find("threads");
        HostOptions host_options;
        host_options.threads = std::max(1, threads ? static_cast<int>(threads->as_int()) : 1);
        host_options.seed = cell.seed;
        host_options.cancel = options.cancel;
        const auto host = make_host(options.registry, host_options);
        row.outcome = options.runner(cell.session, *host);
      } catch (const std::exception& failure) {
        row.failure = failure.what();
        if (row.failure.empty()) row.failure = "failed without a message";
      } catch (...) {
        row.failure = "threw something that is no std::exception";
      }
      if (cancelled()) return;  // a session that was told to end early is no result
      const std::lock_guard lock(mutex);
      if (error) return;
      try {
        write_row(cell.file, plan, row, cell.fingerprint);
        rows.push_back(row);
        if (options.progress) options.progress(row, rows.size(), total);
      } catch (...) {
        error = std::current_exception();
      }
    }
  };
  const auto jobs = std::min<std::size_t>(todo.size(), static_cast<std::size_t>(std::max(1, options.jobs)));
  std::vector<std::thread> threads;
  for (std::size_t i = 1; i < jobs; ++i) threads.emplace_back(work);
  work();
  for (auto& thread : threads) thread.join();
  if (error) std::rethrow_exception(error);

  const auto order = [&](const AblationRow& row) {
    return std::pair(std::find(plan.seeds.begin(), plan.seeds.end(), row.seed) - plan.seeds.begin(), row.arm);
  };
  std::sort(rows.begin(), rows.end(), [&](const auto& a, const auto& b) { return order(a) < order(b); });
  return rows;
}

AblationStatistics ablation_statistics(const std::vector<double>& values, std::int64_t resamples, std::uint64_t key) {
  AblationStatistics s{values.size(), kNaN, kNaN, kNaN, {kNaN, kNaN}, {kNaN, kNaN}};
  if (values.empty()) return s;
  s.mean = mean_of(values);
  std::vector<double> sorted = values;
  std::sort(sorted.begin(), sorted.end());
  s.median = quantile(sorted, 0.5);
  if (values.size() < 2) return s;
  double square = 0.0;
  for (double v : values) square += (v - s.mean) * (v - s.mean);
  s.sd = std::sqrt(square / static_cast<double>(values.size() - 1));
  RandomStream random(0x626f6f74ull, key);
  std::vector<double> means, medians, sample(values.size());
  for (std::int64_t r = 0; r < resamples; ++r) {
    for (double& v : sample) v = values[random.below(values.size())];
    means.push_back(mean_of(sample));
    std::sort(sample.begin(), sample.end());
    medians.push_back(quantile(sample, 0.5));
  }
  std::sort(means.begin(), means.end());
  std::sort(medians.begin(), medians.end());
  s.mean_interval = {quantile(means, 0.025), quantile(means, 0.975)};
  s.median_interval = {quantile(medians, 0.025), quantile(medians, 0.975)};
  return s;
}

std::vector<std::string> ablation_metrics(const std::vector<AblationRow>& rows) {
  std::vector<std::string> names;
  for (const auto& row : rows)
    for (const auto& [name, value] : row.outcome.metrics)
      if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  return names;
}

std::string ablation_csv(const AblationPlan& plan, const std::vector<AblationRow>& rows) {
  const auto names = ablation_metrics(rows);
  std::string text;
  for (const auto& factor : plan.factors) text += csv_field(factor) + ",";
  text += plan.cases.empty() ? "seed,status" : "seed,case,status";
  for (const auto& name : names) text += "," + csv_field(name);
  text += ",failure\n";
  for (const auto& row : rows) {
    for (const auto& level : plan.arms[row.arm].levels) text += csv_field(level) + ",";
    text += std::to_string(row.seed) + ",";
    if (!plan.cases.empty()) text += csv_field(plan.cases.at(row.seed)) + ",";
    text += (row.failure.empty() ? "done" : "failed");
    for (const auto& name : names) text += "," + csv_number(metric_of(row, name));
    text += "," + csv_field(row.failure) + "\n";
  }
  return text;
}

std::string ablation_json(const AblationPlan& plan, const std::vector<AblationRow>& rows) {
  const auto names = ablation_metrics(rows);
  const Table table(rows);
  ordered_json json{{"description", plan.description}, {"factors", plan.factors}, {"seeds", plan.seeds}};
  if (!plan.cases.empty()) json["cases"] = plan.cases;
  json["complete"] = rows.size() == plan.seeds.size() * plan.arms.size();
  json["arms"] = ordered_json::array();
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    const auto& arm = plan.arms[a];
    ordered_json levels = ordered_json::object(), metrics = ordered_json::object(), failures = ordered_json::array();
    for (std::size_t f = 0; f < plan.factors.size(); ++f) levels[plan.factors[f]] = arm.levels[f];
    std::size_t done = 0, unpaired = 0;
    for (const auto& row : rows) {
      if (row.arm != a) continue;
      if (row.failure.empty())
        ++done;
      else
        failures.push_back({{"seed", row.seed}, {"failure", row.failure}});
    }
    for (const auto& name : names) {
      const Comparison c = compare(plan, table, a, name);
      ordered_json one = statistics_json(c.own);
      if (arm.baseline != a) one["difference"] = statistics_json(c.difference);
      unpaired = c.unpaired;
      metrics[name] = one;
    }
    ordered_json one{{"name", arm.name}, {"levels", levels}, {"done", done}, {"failed", failures}};
    one["baseline"] = arm.baseline == a ? ordered_json(nullptr) : ordered_json(plan.arms[arm.baseline].name);
    one["unpaired"] = unpaired;
    one["metrics"] = metrics;
    json["arms"].push_back(one);
  }
  return json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

std::string ablation_table(const AblationPlan& plan, const std::vector<AblationRow>& rows, const std::string& metric) {
  const Table table(rows);
  std::size_t width = 4;
  for (const auto& arm : plan.arms) width = std::max(width, arm.name.size() + 1);
  const auto line = [&](const std::string& name, const std::string& rest) {
    return name + std::string(width - std::min(width, name.size()), ' ') + rest + "\n";
  };
  std::string text =
      metric + "\n" +
      line("", "   n  failed    median      mean                  95 %  difference                    95 %");
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    const Comparison c = compare(plan, table, a, metric);
    std::size_t failed = 0;
    for (const auto& row : rows) failed += row.arm == a && !row.failure.empty();
    char numbers[200];
    int used = std::snprintf(numbers, sizeof numbers, "%4zu  %6zu  %8.4g  %8.4g  [%8.4g, %8.4g]", c.own.n, failed,
                             c.own.median, c.own.mean, c.own.mean_interval.first, c.own.mean_interval.second);
    if (plan.arms[a].baseline != a)
      std::snprintf(numbers + used, sizeof numbers - static_cast<std::size_t>(used), "  %+9.4g  [%+9.4g, %+9.4g]%s",
                    c.difference.mean, c.difference.mean_interval.first, c.difference.mean_interval.second,
                    c.unpaired > 0 ? "  NOT ALL PAIRED" : "");
    text += line(plan.arms[a].name, numbers);
  }
  return text;
}

}  // namespace weft
