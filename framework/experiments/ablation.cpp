#include "experiments/ablation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "experiments/csv.hpp"
#include "experiments/json_numbers.hpp"
#include "experiments/physics/suite.hpp"
#include "experiments/statistics.hpp"
#include "experiments/sweep_rows.hpp"
#include "sdk/fingerprint.hpp"
#include "session/session.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;

/// A level: its name and its changes.
struct Level {
  std::string name;
  std::vector<std::pair<std::string, ConfigNode>> changes;  // dotted keys
  ConfigNode base = {};                                     // of the factor `task`: what the changes begin from
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

/// {planning: {noise: 1}} becomes {planning.noise: 1}. A plugin slot is replaced as a whole, with its parameters.
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
    std::set<std::string> names;
    for (const auto& level : factor.levels)
      if (!names.insert(level.name).second) levels.fail("names the level '" + level.name + "' twice");
    factors.push_back(std::move(factor));
  }
  return factors;
}

std::vector<std::uint64_t> read_seeds(const ConfigNode& node, const std::uint64_t* first_seed) {
  std::vector<std::uint64_t> seeds;
  std::set<std::uint64_t> known;
  const auto add = [&](const ConfigNode& from, std::int64_t seed) {
    if (seed < 0) from.fail("= " + std::to_string(seed) + ", must be >= 0");
    if (!known.insert(static_cast<std::uint64_t>(seed)).second)
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
  if (first < 0 || first > std::numeric_limits<std::int64_t>::max() - count)
    node.fail("has seeds from " + std::to_string(first) + " on, must be in [0, 9e18]");
  for (std::int64_t i = 0; i < count; ++i) add(node, first + i);
  return seeds;
}

/// The factor `task`, whose levels are session configs.
Factor read_tasks(const ConfigNode& node) {
  Factor factor{"task", {}};
  if (!node.is_sequence() || node.size() == 0) node.fail("must be a list of session configs, and not empty");
  for (std::size_t i = 0; i < node.size(); ++i) {
    const std::filesystem::path file = node[i].as_path();
    for (const auto& level : factor.levels)
      if (level.name == file.stem()) node[i].fail("is the second task called '" + level.name + "'");
    factor.levels.push_back({file.stem().string(), {}, ConfigNode::load(file).without("seed")});
  }
  return factor;
}

/// Index of a level in each factor; nothing: the arm's own level.
using Levels = std::vector<std::optional<std::size_t>>;
Levels read_levels(const ConfigNode& node, const std::vector<Factor>& factors) {
  Levels levels(factors.size());
  const auto find = [](const ConfigNode& from, const Factor& factor) {
    std::vector<std::string> names;
    for (const auto& level : factor.levels) names.push_back(level.name);
    const std::string wanted = level_name(from);
    const auto found = std::find(names.begin(), names.end(), wanted);
    if (found == names.end())
      from.fail("= " + wanted + " is not a level of " + factor.name + nearest_hint(wanted, names));
    return static_cast<std::size_t>(found - names.begin());
  };
  if (node.is_null()) return levels;
  if (node.is_scalar()) {
    // With `tasks` a single other factor is the one that is meant.
    const std::size_t own = factors.front().levels.front().base.is_null() ? 0 : 1;
    if (factors.size() > own + 1) node.fail("must say {factor: level}, since there are several factors");
    levels[own] = find(node, factors[own]);
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

/// Rows by arm and seed, for looking up pairs.
struct Table {
  explicit Table(const std::vector<SweepRow>& rows) {
    for (const auto& row : rows) cells[{row.arm, row.seed}] = &row;
  }
  /// nullptr: missing or failed.
  const SweepRow* find(std::size_t arm, std::uint64_t seed) const {
    const auto found = cells.find({arm, seed});
    return found == cells.end() || !found->second->failure.empty() ? nullptr : found->second;
  }
  std::map<std::pair<std::size_t, std::uint64_t>, const SweepRow*> cells;
};

struct Comparison {
  BootstrapStatistics own, difference;
  MedianComparison medians;  ///< over the seeds that the arm, its baseline and its target completed
  std::size_t unpaired = 0;  ///< seeds that both arms completed with different cases
};

Comparison compare(const AblationPlan& plan, const Table& table, std::size_t arm, const std::string& metric) {
  Comparison result;
  std::vector<double> own, difference, paired, baseline, target;
  for (const std::uint64_t seed : plan.seeds) {
    const SweepRow* here = table.find(arm, seed);
    if (here == nullptr) continue;
    const double value = here->metric(metric);
    if (std::isfinite(value)) own.push_back(value);
    const SweepRow* there = table.find(plan.baseline[arm], seed);
    if (there == nullptr) continue;
    if (there->outcome.paired_by != here->outcome.paired_by) {
      ++result.unpaired;
      continue;
    }
    const double change = value - there->metric(metric);
    if (!std::isfinite(change)) continue;
    difference.push_back(change);
    const SweepRow* reached = plan.target.empty() ? there : table.find(plan.target[arm], seed);
    if (reached == nullptr || reached->outcome.paired_by != here->outcome.paired_by ||
        !std::isfinite(reached->metric(metric)))
      continue;
    paired.push_back(value);
    baseline.push_back(there->metric(metric));
    if (!plan.target.empty()) target.push_back(reached->metric(metric));
  }
  const std::uint64_t key = fnv1a(metric);
  if (plan.baseline[arm] != arm) result.medians = compare_medians(paired, baseline, target, plan.resamples, key + 2);
  result.own = bootstrap_statistics(own, plan.resamples, key);
  result.difference = bootstrap_statistics(difference, plan.resamples, key + 1);
  return result;
}

ordered_json statistics_json(const BootstrapStatistics& s) {
  return {{"n", s.n},
          {"mean", json_number(s.mean)},
          {"median", json_number(s.median)},
          {"sd", json_number(s.sd)},
          {"largest", json_number(s.largest)},
          {"mean_95", json_interval(s.mean_interval)},
          {"median_95", json_interval(s.median_interval)}};
}

ordered_json medians_json(const MedianComparison& c, bool has_target) {
  ordered_json json{{"n", c.n},
                    {"baseline_over_own", json_number(c.ratio)},
                    {"baseline_over_own_95", json_interval(c.ratio_interval)}};
  if (has_target) {
    json["gap_closed"] = json_number(c.gap_closed);
    json["gap_closed_95"] = json_interval(c.gap_interval);
  }
  return json;
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
  const bool has_tasks = !params.tasks.is_null();
  if (params.task.empty() && !has_tasks)
    config.fail("task is missing; name the session config that the arms start from");
  if (!params.task.empty() && has_tasks) params.tasks.fail("must be left out with `task`, whose place it takes");
  if (params.factors.is_null()) config.fail("factors is missing");
  const bool physics = params.measure == "physics";
  if (!physics && params.seeds.is_null()) config.fail("seeds is missing; such as {first: 1, count: 10}");
  if (physics && (!params.seeds.is_null() || first_seed != nullptr))
    config.fail("has seeds, but measure: physics runs the cases of the suite; physics.folds.first_seed is the folds'");
  auto factors = read_factors(params.factors);
  for (const auto& factor : factors)
    if (factor.name == "task" && has_tasks)
      params.factors.fail("must not name a factor 'task', since there are `tasks`");
  if (has_tasks) factors.insert(factors.begin(), read_tasks(params.tasks));
  const ConfigNode base = has_tasks ? ConfigNode() : ConfigNode::load(params.task).without("seed");
  const Changes set = read_changes(params.set);
  Levels baseline = read_levels(params.baseline, factors);
  if (params.baseline.is_null()) baseline[has_tasks ? 1 : 0] = 0;
  const Levels target = read_levels(params.target, factors);

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
    SweepArm arm;
    arm.config = has_tasks ? factors.front().levels[a / (count / factors.front().levels.size())].base : base;
    for (const auto& [key, value] : set) arm.config = arm.config.with(key, value);
    plan.baseline.push_back(0);
    plan.target.push_back(0);
    // The last factor varies fastest.
    std::size_t rest = a, stride = count;
    for (std::size_t f = 0; f < factors.size(); ++f) {
      stride /= factors[f].levels.size();
      const std::size_t level = rest / stride;
      rest %= stride;
      arm.levels.push_back(factors[f].levels[level].name);
      arm.name += (f > 0 ? ", " : "") + factors[f].levels[level].name;
      for (const auto& [key, value] : factors[f].levels[level].changes) arm.config = arm.config.with(key, value);
      plan.baseline[a] += stride * baseline[f].value_or(level);
      plan.target[a] += stride * target[f].value_or(level);
    }
    if (arm.config.has("seed")) config.fail("sets `seed` of the sessions; `seeds` does that");
    // Refuses wrong keys of a session before any work.
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
  if (params.target.is_null()) plan.target.clear();
  for (std::size_t i = 0; i < plan.cases.size(); ++i) plan.seeds.push_back(i);
  return plan;
}

namespace {

/// The columns that say which cell a line is about.
std::string cell_head(const AblationPlan& plan) {
  std::string text;
  for (const auto& factor : plan.factors) text += csv_field(factor) + ",";
  return text + (plan.cases.empty() ? "seed,status" : "seed,case,status");
}
std::string cell_fields(const AblationPlan& plan, const SweepRow& row) {
  std::string text;
  for (const auto& level : plan.arms[row.arm].levels) text += csv_field(level) + ",";
  text += std::to_string(row.seed) + ",";
  if (!plan.cases.empty()) text += csv_field(plan.cases.at(row.seed)) + ",";
  return text + to_string(row.status);
}

/// Statistics of these metrics or times of an arm. @param unpaired out: seeds that were not compared.
ordered_json statistics_of(const AblationPlan& plan, const Table& table, std::size_t arm,
                           const std::vector<std::string>& names, std::size_t& unpaired) {
  ordered_json metrics = ordered_json::object();
  for (const auto& name : names) {
    const Comparison c = compare(plan, table, arm, name);
    ordered_json one = statistics_json(c.own);
    if (plan.baseline[arm] != arm) {
      one["difference"] = statistics_json(c.difference);
      one["medians"] = medians_json(c.medians, !plan.target.empty());
    }
    unpaired = c.unpaired;
    metrics[name] = one;
  }
  return metrics;
}

}  // namespace

std::string ablation_csv(const AblationPlan& plan, const std::vector<SweepRow>& rows) {
  const auto names = sweep_metrics(rows);
  std::string text = cell_head(plan);
  for (const auto& name : names) text += "," + csv_field(name);
  text += ",failure,identity\n";
  for (const auto& row : rows) {
    text += cell_fields(plan, row);
    for (const auto& name : names) text += "," + csv_number(row.metric(name));
    text += "," + csv_field(row.failure) + "," + row.identity + "\n";
  }
  return text;
}

std::string ablation_times_csv(const AblationPlan& plan, const std::vector<SweepRow>& rows) {
  const auto names = sweep_times(rows);
  std::string text = cell_head(plan);
  for (const auto& name : names) text += "," + csv_field(name);
  text += "\n";
  for (const auto& row : rows) {
    text += cell_fields(plan, row);
    for (const auto& name : names) text += "," + csv_number(row.metric(name));
    text += "\n";
  }
  return text;
}

std::string ablation_json(const AblationPlan& plan, const std::vector<SweepRow>& rows) {
  const auto names = sweep_metrics(rows);
  const Table table(rows);
  ordered_json json{{"description", plan.description}, {"factors", plan.factors}, {"seeds", plan.seeds}};
  if (!plan.cases.empty()) json["cases"] = plan.cases;
  if (!plan.target.empty()) json["has_target"] = true;
  json["complete"] = rows.size() == plan.cells();
  json["arms"] = ordered_json::array();
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    const auto& arm = plan.arms[a];
    ordered_json levels = ordered_json::object(), failures = ordered_json::array();
    for (std::size_t f = 0; f < plan.factors.size(); ++f) levels[plan.factors[f]] = arm.levels[f];
    std::size_t done = 0, unpaired = 0;
    for (const auto& row : rows) {
      if (row.arm != a) continue;
      if (row.failure.empty())
        ++done;
      else
        failures.push_back({{"seed", row.seed}, {"status", to_string(row.status)}, {"failure", row.failure}});
    }
    const ordered_json metrics = statistics_of(plan, table, a, names, unpaired);
    ordered_json one{{"name", arm.name}, {"levels", levels}, {"done", done}, {"failed", failures}};
    one["baseline"] = plan.baseline[a] == a ? ordered_json(nullptr) : ordered_json(plan.arms[plan.baseline[a]].name);
    one["unpaired"] = unpaired;
    one["metrics"] = metrics;
    add_mixed(one, rows, a);
    json["arms"].push_back(one);
  }
  return text_of_json(json);
}

std::string ablation_times_json(const AblationPlan& plan, const std::vector<SweepRow>& rows) {
  const auto names = sweep_times(rows);
  const Table table(rows);
  ordered_json json{{"arms", ordered_json::array()}};
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    std::size_t unpaired = 0;
    json["arms"].push_back({{"metrics", statistics_of(plan, table, a, names, unpaired)}});
  }
  return text_of_json(json);
}

std::string ablation_table(const AblationPlan& plan, const std::vector<SweepRow>& rows, const std::string& metric) {
  const Table table(rows);
  std::size_t width = 4;
  for (const auto& arm : plan.arms) width = std::max(width, arm.name.size() + 1);
  const auto line = [&](const std::string& name, const std::string& rest) {
    return name + std::string(width - std::min(width, name.size()), ' ') + rest + "\n";
  };
  std::string head = "   n  failed    median      mean                  95 %  difference                    95 %";
  if (!plan.target.empty()) head += "   base/own              95 %   gap closed";
  std::string text = metric + "\n" + line("", head);
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    const Comparison c = compare(plan, table, a, metric);
    std::size_t failed = 0;
    for (const auto& row : rows) failed += row.arm == a && !row.failure.empty();
    std::string numbers;
    const auto add = [&](const char* format, auto... values) {
      char piece[120];
      std::snprintf(piece, sizeof piece, format, values...);
      numbers += piece;
    };
    add("%4zu  %6zu  %8.4g  %8.4g  [%8.4g, %8.4g]", c.own.n, failed, c.own.median, c.own.mean,
        c.own.mean_interval.first, c.own.mean_interval.second);
    if (plan.baseline[a] != a) {
      add("  %+9.4g  [%+9.4g, %+9.4g]", c.difference.mean, c.difference.mean_interval.first,
          c.difference.mean_interval.second);
      if (!plan.target.empty())
        add("   %8.3g  [%6.3g, %6.3g]      %5.0f %%", c.medians.ratio, c.medians.ratio_interval.first,
            c.medians.ratio_interval.second, 100.0 * c.medians.gap_closed);
    }
    if (c.unpaired > 0) numbers += "  NOT ALL PAIRED";
    text += line(plan.arms[a].name, numbers);
  }
  return text;
}

}  // namespace weft
