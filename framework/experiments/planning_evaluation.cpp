#include "experiments/planning_evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>

#include "experiments/cells.hpp"
#include "experiments/json_numbers.hpp"
#include "experiments/statistics.hpp"
#include "experiments/sweep_rows.hpp"
#include "report/cases_file.hpp"
#include "sdk/files.hpp"
#include "session/session.hpp"
#include "weft/config.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;
namespace fs = std::filesystem;

ConfigNode matrix_node(const Controls& controls) {
  std::vector<ConfigNode> rows;
  for (Index j = 0; j < controls.rows(); ++j) {
    std::vector<ConfigNode> row;
    for (Index c = 0; c < controls.cols(); ++c) row.push_back(ConfigNode::number(controls(j, c)));
    rows.push_back(ConfigNode::sequence(row));
  }
  return ConfigNode::sequence(rows);
}

std::string width_level(double width) { return "w" + text_of(width); }

constexpr const char* kShapeMetrics[] = {"max_error_mm", "grasped_error_mm", "named_error_mm", "silhouette_iou"};

ordered_json planning_column(const EvaluationColumn& column) {
  ordered_json json{{"goals", column.cases.source}};
  json["complete"] = column.rows.size() == column.plan.cells();
  json["cases"] = ordered_json::array();
  json["by_width"] = ordered_json::array();
  for (std::size_t a = 0; a < column.plan.arms.size(); ++a) {
    const double width = column.plan.arms[a].config.at("drawn_width").as_double();
    std::vector<double> errors;
    std::map<std::string, std::vector<double>> shapes;  // by metric
    for (const auto& row : column.rows) {
      if (row.arm != a) continue;
      const auto goal =
          std::find(column.plan.seeds.begin(), column.plan.seeds.end(), row.seed) - column.plan.seeds.begin();
      ordered_json one{{"width", width}, {"goal", goal}, {"seed", row.seed}};
      one["error_mm"] = json_number(row.metric("error_mm"));
      if (!row.failure.empty()) {
        one["error_mm"] = nullptr;
        one["status"] = to_string(row.status);
        one["failed"] = row.failure;
      } else {
        errors.push_back(row.metric("error_mm"));
        for (const char* key : {"default_error_mm", "segments", "released"}) one[key] = json_number(row.metric(key));
        // Rows of earlier versions have none of these.
        for (const char* key : kShapeMetrics) {
          one[key] = json_number(row.metric(key));
          if (std::isfinite(row.metric(key))) shapes[key].push_back(row.metric(key));
        }
      }
      json["cases"].push_back(one);
    }
    const BootstrapStatistics s = bootstrap_statistics(errors, kResamples, kBootstrapKey);
    const double q1 = quantile_of(errors, 0.25), q3 = quantile_of(errors, 0.75), reach = 1.5 * (q3 - q1);
    const auto outliers =
        std::count_if(errors.begin(), errors.end(), [&](double e) { return e < q1 - reach || e > q3 + reach; });
    json["by_width"].push_back({{"width", width},
                                {"n", errors.size()},
                                {"mean_mm", json_number(s.mean)},
                                {"median_mm", json_number(s.median)},
                                {"mean_95_mm", json_interval(s.mean_interval)},
                                {"median_95_mm", json_interval(s.median_interval)},
                                {"sd_mm", json_number(s.sd)},
                                {"q1_mm", json_number(q1)},
                                {"q3_mm", json_number(q3)},
                                {"outliers", outliers}});
    auto& last = json["by_width"].back();
    for (const char* key : kShapeMetrics) last[key] = json_number(spread_of(shapes[key]).mean);
    for (const int limit : kSuccessLimitsMm) {
      const auto count = std::count_if(errors.begin(), errors.end(), [&](double e) { return succeeds(e, limit); });
      last[success_key(limit)] = json_number(static_cast<double>(count) / static_cast<double>(errors.size()));
    }
  }
  add_mixed(json, column.rows, std::nullopt);
  return json;
}

constexpr const char* kTimes[] = {"first_plan_seconds", "plan_seconds"};

/// The times of planning_column(), entry by entry of its cases.
ordered_json planning_column_times(const EvaluationColumn& column) {
  auto cases = ordered_json::array();
  for (std::size_t a = 0; a < column.plan.arms.size(); ++a) {
    for (const auto& row : column.rows) {
      if (row.arm != a) continue;
      ordered_json one = ordered_json::object();
      for (const char* key : kTimes)
        if (row.failure.empty()) one[key] = json_number(row.metric(key));
      cases.push_back(one);
    }
  }
  return {{"cases", cases}};
}

/// One line for each case, with these keys of it.
std::string csv_of(const std::vector<std::pair<std::string, ordered_json>>& columns,
                   const std::vector<std::string>& keys) {
  std::string text = "goals";
  for (const auto& key : keys) text += "," + key;
  text += "\n";
  for (const auto& [source, cases] : columns) {
    for (const auto& one : cases) {
      text += source;
      for (const auto& key : keys)
        text += "," + (one.contains(key) && !one[key].is_null() ? one[key].dump() : std::string());
      text += "\n";
    }
  }
  return text;
}

}  // namespace

SweepPlan planning_evaluation(const ConfigNode& session, const std::vector<double>& widths,
                              const EvaluationCases& cases) {
  SweepPlan plan;
  plan.description = describe(cases, "planning against the width of the knowledge");
  plan.factors = {"drawn_width"};
  plan.seeds = cases.seeds;
  for (const double width : widths) {
    SweepArm arm;
    arm.name = "w = " + text_of(width);
    arm.levels = {text_of(width)};
    arm.config = session.with("description", ConfigNode::quoted(plan.description))
                     .with("knowledge", ConfigNode::quoted("drawn"))
                     .with("drawn_width", ConfigNode::number(width));
    plan.arms.push_back(std::move(arm));
  }
  return plan;
}

SweepRunner planning_runner(const EvaluationCases& cases, const fs::path& folder) {
  return [cases, folder](const ConfigNode& cell, Host& host) {
    const std::uint64_t seed = seed_of(cell);
    ConfigNode config = cell;
    if (const Example* example = cases.example(seed)) {
      std::vector<ConfigNode> q;
      for (Index p = 0; p < 4; ++p) q.push_back(ConfigNode::number(example->q(p)));
      config = config.with("true_material", ConfigNode::sequence(q));
      config = config.with("goal", ConfigNode::mapping({{"controls", matrix_node(example->controls)}}));
    }
    SessionParams params;
    read_params(config, params);
    const SessionResult result = run_configured_session(params, config, host);
    make_folder_for_results(folder / "shapes");
    auto file = Hdf5File::create(shape_file(folder, seed, width_level(params.drawn_width)));
    file.write("/goal", result.goal);
    file.write("/final", result.final_shape);
    file.commit();
    return session_outcome(result);
  };
}

void write_planning_shapes(const EvaluationColumn& column, const Garment& garment, const fs::path& folder,
                           const fs::path& path) {
  std::vector<std::int64_t> goal_of;
  std::vector<bool> has_goal(column.plan.seeds.size());
  std::vector<Positions> goals(column.plan.seeds.size(), garment.positions), finals;
  for (std::size_t a = 0; a < column.plan.arms.size(); ++a) {
    const double width = column.plan.arms[a].config.at("drawn_width").as_double();
    for (const auto& row : column.rows) {
      if (row.arm != a) continue;
      const auto goal = static_cast<std::size_t>(
          std::find(column.plan.seeds.begin(), column.plan.seeds.end(), row.seed) - column.plan.seeds.begin());
      goal_of.push_back(static_cast<std::int64_t>(goal));
      if (!row.failure.empty()) {
        finals.push_back(garment.positions);  // keeps the order of the rows; the page does not show it
        continue;
      }
      const auto file = Hdf5File::open(shape_file(folder, row.seed, width_level(width)));
      finals.push_back(file.read_positions("/final"));
      if (!has_goal[goal]) goals[goal] = file.read_positions("/goal");
      has_goal[goal] = true;
    }
  }
  if (finals.empty()) return;  // stopped before the first case ended
  auto file = create_cases_file(path, garment);
  write_shapes(file, "/planning/goals", goals);
  write_shapes(file, "/planning/finals", finals);
  file.write("/planning/goal_of", {static_cast<Index>(goal_of.size())}, goal_of.data());
  file.commit();
}

std::string planning_evaluation_json(const std::vector<EvaluationColumn>& columns) {
  ordered_json json = planning_column(columns.front());
  json["columns"] = ordered_json::object();
  for (std::size_t i = 1; i < columns.size(); ++i)
    json["columns"][columns[i].cases.source] = planning_column(columns[i]);
  return json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

std::string planning_times_json(const std::vector<EvaluationColumn>& columns) {
  ordered_json json = planning_column_times(columns.front());
  json["columns"] = ordered_json::object();
  for (std::size_t i = 1; i < columns.size(); ++i)
    json["columns"][columns[i].cases.source] = planning_column_times(columns[i]);
  return json.dump(2) + "\n";
}

std::string planning_evaluation_csv(const std::vector<EvaluationColumn>& columns) {
  std::vector<std::pair<std::string, ordered_json>> all;
  for (const auto& column : columns) all.emplace_back(column.cases.source, planning_column(column)["cases"]);
  return csv_of(all, {"width", "goal", "seed", "error_mm", "default_error_mm", "segments", "released", kShapeMetrics[0],
                      kShapeMetrics[1], kShapeMetrics[2], kShapeMetrics[3]});
}

std::string planning_times_csv(const std::vector<EvaluationColumn>& columns) {
  std::vector<std::pair<std::string, ordered_json>> all;
  for (const auto& column : columns) {
    ordered_json cases = planning_column(column)["cases"];
    const ordered_json times = planning_column_times(column)["cases"];
    for (std::size_t i = 0; i < cases.size(); ++i) cases[i].update(times[i]);
    all.emplace_back(column.cases.source, std::move(cases));
  }
  return csv_of(all, {"width", "goal", "seed", kTimes[0], kTimes[1]});
}

std::string planning_evaluation_table(const EvaluationColumn& column) {
  const ordered_json json = planning_column(column);
  std::string text = "goals: " + column.cases.source +
                     "\n    w    n    median      mean        sd  outliers   mm |     IoU   within 10,  20,  30 mm\n";
  for (const auto& row : json["by_width"]) {
    if (row["n"] == 0) continue;
    char line[160];
    const auto percent = [&](int limit) { return 100.0 * row[success_key(limit)].get<double>(); };
    std::snprintf(line, sizeof line,
                  "%5.2f  %3d  %8.2f  %8.2f  %8.2f  %8d      | %7.3f      %3.0f %% %3.0f %% %3.0f %%\n",
                  row["width"].get<double>(), row["n"].get<int>(), row["median_mm"].get<double>(),
                  row["mean_mm"].get<double>(), row["sd_mm"].is_null() ? 0.0 : row["sd_mm"].get<double>(),
                  row["outliers"].get<int>(), number_of(row["silhouette_iou"]), percent(10), percent(20), percent(30));
    text += line;
  }
  return text;
}

}  // namespace weft
