#include "report/paper_tables.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "sdk/quantile.hpp"
#include "weft/error.hpp"
#include "weft/material.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr int kErrorDigits = PaperColumn::kTwoSignificant;  // of an error beside its bound

/// A number of a result, times a factor; null where it is missing.
ordered_json number_at(const ordered_json& object, const std::string& key, double factor = 1.0) {
  const auto found = object.find(key);
  if (found == object.end() || !found->is_number()) return nullptr;
  if (factor == 1.0) return *found;
  return factor * found->get<double>();
}

ordered_json percent_at(const ordered_json& object, const std::string& key) { return number_at(object, key, 100.0); }

/// [lower, upper]; null where one of them is missing.
ordered_json interval_at(const ordered_json& statistics, const std::string& key) {
  const auto found = statistics.find(key);
  if (found == statistics.end() || found->size() != 2 || !(*found)[0].is_number() || !(*found)[1].is_number())
    return nullptr;
  return *found;
}

std::string fixed_text(double value, int digits) {
  char text[400];  // the largest double has 309 digits before the point
  if (digits < 0)
    std::snprintf(text, sizeof text, "%.*g", digits == PaperColumn::kSignificant ? 4 : 2, value);
  else
    std::snprintf(text, sizeof text, "%.*f", digits, value);
  return text;
}

/// The unit that the name of a metric ends with: "error_mm".
std::string unit_of(const std::string& metric) {
  for (const char* unit : {"mm", "mm2", "seconds"})
    if (metric.ends_with(std::string("_") + unit)) return unit == std::string("seconds") ? "s" : unit;
  return "";
}

/// Digits after the point that show three or four digits of the largest mean, and two of the smallest if one more is enough.
int digits_for(const ordered_json& arms, const std::string& metric) {
  double largest = 0.0, smallest = 0.0;
  for (const auto& arm : arms) {
    const auto& metrics = arm.at("metrics");
    if (!metrics.contains(metric) || !metrics[metric].at("mean").is_number()) continue;
    const double mean = std::abs(metrics[metric]["mean"].get<double>());
    largest = std::max(largest, mean);
    if (mean > 0.0) smallest = smallest == 0.0 ? mean : std::min(smallest, mean);
  }
  if (largest == 0.0) return 2;
  const auto exponent = [](double value) { return static_cast<int>(std::floor(std::log10(value))); };
  const int digits = std::clamp(2 - exponent(largest), 0, 9);
  return std::max(digits, std::min(1 - exponent(smallest), digits + 1));
}

/// What a metric of sessions is, for readers of a caption; empty if its name says it.
std::string meaning_of(const std::string& metric) {
  const std::pair<const char*, const char*> known[] = {
      {"error_mm", "mean vertex distance from the goal after settling"},
      {"default_error_mm", "that of the default control"},
      {"first_plan_loss", "loss of the first plan, mm^2"},
      {"first_plan_predicted_error_mm", "error that the first plan predicts"},
      {"first_plan_evaluations", "points that the first plan evaluated, of all searches"},
      {"evaluations", "points evaluated, of all plans and searches"}};
  for (const auto& [name, meaning] : known)
    if (metric == name) return std::string(" (") + meaning + ")";
  return "";
}

/// What a caption must not hide.
std::string warnings_of(const ordered_json& json) {
  std::string text;
  if (!json.value("complete", true)) text += "; not all cells have run";
  bool mixed = json.contains("mixed"), unpaired = false;
  for (const auto& arm : json.value("arms", ordered_json::array())) {
    mixed = mixed || arm.contains("mixed");
    unpaired = unpaired || arm.value("unpaired", 0) > 0;
  }
  if (mixed) text += "; some rows belong to another identity";
  if (unpaired) text += "; not all seeds could be paired";
  return text;
}

/// With measure: physics, one table of all metrics: the mean of each in every arm.
void add_ablation_summary(const ordered_json& json, const std::vector<std::string>& metrics,
                          std::vector<PaperTable>& tables) {
  PaperTable table{
      "ablation-summary", "Means of all metrics" + warnings_of(json), {{"metric", "metric", "", 0}}, {}, 1};
  for (const auto& arm : json.at("arms")) {
    const std::string name = arm.at("name");
    table.columns.push_back({name, name, "", PaperColumn::kSignificant});
  }
  for (const auto& metric : metrics) {
    std::vector<ordered_json> row = {metric};
    for (const auto& arm : json["arms"])
      row.push_back(number_at(arm.at("metrics").value(metric, ordered_json::object()), "mean"));
    table.rows.push_back(std::move(row));
  }
  tables.push_back(std::move(table));
}

/// With measure: physics, the cases of each test in every arm: how many are within their bounds, and the errors.
void add_ablation_physics(const ordered_json& json, const std::vector<std::string>& metrics,
                          std::vector<PaperTable>& tables) {
  const std::string within = "within bounds", between = ": ";
  const auto factors = json.at("factors").get<std::vector<std::string>>();
  PaperTable table{"ablation-physics",
                   "Cases of the physics suite by their largest error, as the bound counts it; a case that failed was "
                   "refused by the simulator, or ended without a result" +
                       warnings_of(json),
                   {{"test", "test", "", 0}, {"quantity", "quantity", "", 0}},
                   {},
                   2 + factors.size()};
  for (const auto& factor : factors) table.columns.push_back({factor, factor, "", 0});
  for (const char* name : {"cases", "within", "failed"}) table.columns.push_back({name, name, "", 0});
  for (const char* name : {"median", "largest"}) table.columns.push_back({name, name, "", kErrorDigits});
  const auto& cases = json.at("cases");
  for (const auto& metric : metrics) {
    const auto end = metric.find(between);
    const std::string test = metric.substr(0, end);
    if (end == std::string::npos || metric == test + between + within) continue;
    for (const auto& arm : json.at("arms")) {
      const auto& found = arm.at("metrics");
      const ordered_json errors = found.value(metric, ordered_json::object());
      const ordered_json passed = found.value(test + between + within, ordered_json::object());
      const auto ran = passed.value("n", 0);
      const auto failed = std::count_if(arm.at("failed").begin(), arm.at("failed").end(), [&](const auto& one) {
        const auto name = cases.at(one.at("seed").template get<std::size_t>()).template get<std::string>();
        return name == test || name.starts_with(test + ", ");
      });
      if (failed == 0 && number_at(errors, "median").is_null()) continue;  // a quantity of the other arms
      const ordered_json share = number_at(passed, "mean");
      std::vector<ordered_json> row = {test, metric.substr(end + between.size())};
      for (const auto& factor : factors) row.push_back(arm.at("levels").at(factor));
      row.insert(row.end(), {ran + failed,
                             share.is_null() ? ordered_json(0) : ordered_json(std::lround(share.get<double>() * ran)),
                             failed, number_at(errors, "median"), number_at(errors, "largest")});
      table.rows.push_back(std::move(row));
    }
  }
  tables.push_back(std::move(table));
}

/// One table for each metric: mean, median, and the paired difference to the baseline, with 95 % intervals.
void add_ablation(const ordered_json& json, std::vector<PaperTable>& tables) {
  std::vector<std::string> metrics;
  for (const auto& arm : json.at("arms"))
    for (const auto& [name, ignored] : arm.at("metrics").items())
      if (std::find(metrics.begin(), metrics.end(), name) == metrics.end()) metrics.push_back(name);
  const auto factors = json.at("factors").get<std::vector<std::string>>();
  const bool has_target = json.value("has_target", false);
  if (!json.value("cases", ordered_json::array()).empty()) {
    add_ablation_summary(json, metrics, tables);
    add_ablation_physics(json, metrics, tables);
  }
  for (const auto& metric : metrics) {
    PaperTable table;
    table.label = "ablation-" + metric;
    table.caption =
        metric + meaning_of(metric) +
        ": mean and median with the bootstrap's 95 % intervals, and the mean of the paired differences to the baseline, "
        "the row without one" +
        warnings_of(json);
    table.texts = factors.size();
    for (const auto& factor : factors) table.columns.push_back({factor, factor, "", 0});
    const int digits = digits_for(json["arms"], metric);
    const std::string unit = unit_of(metric);
    const auto add = [&](const std::vector<PaperColumn>& some) {
      table.columns.insert(table.columns.end(), some.begin(), some.end());
    };
    add({{"n", "n", "", 0},
         {"failed", "failed", "", 0},
         {"mean", "mean", unit, digits},
         {"mean_95", "95 %", unit, digits},
         {"median", "median", unit, digits},
         {"median_95", "95 %", unit, digits},
         {"difference", "difference", unit, digits},
         {"difference_95", "95 %", unit, digits}});
    if (has_target) {
      table.caption +=
          "; how many times smaller the median is than the baseline's, and the share of the gap to the target";
      add({{"baseline_over_own", "baseline / own", "", 2},
           {"baseline_over_own_95", "95 %", "", 2},
           {"gap_closed", "gap closed", "", 2}});
    }
    for (const auto& arm : json["arms"]) {
      std::vector<ordered_json> row;
      for (const auto& factor : factors) row.push_back(arm.at("levels").at(factor));
      const ordered_json own = arm["metrics"].value(metric, ordered_json::object());
      const ordered_json difference = own.value("difference", ordered_json::object());
      row.insert(row.end(), {number_at(own, "n"), arm.at("failed").size(), number_at(own, "mean"),
                             interval_at(own, "mean_95"), number_at(own, "median"), interval_at(own, "median_95"),
                             number_at(difference, "mean"), interval_at(difference, "mean_95")});
      if (has_target) {
        const ordered_json medians = own.value("medians", ordered_json::object());
        row.insert(row.end(), {number_at(medians, "baseline_over_own"), interval_at(medians, "baseline_over_own_95"),
                               number_at(medians, "gap_closed")});
      }
      table.rows.push_back(std::move(row));
    }
    tables.push_back(std::move(table));
  }
}

void add_planning_column(const ordered_json& column, std::vector<PaperTable>& tables) {
  const std::string goals = column.value("goals", "");
  PaperTable table;
  table.label = "planning-" + goals;
  table.caption =
      "Error of whole sessions in mm, after settling, against the width w of the material knowledge (goals: " + goals +
      ")" + warnings_of(column);
  table.columns = {{"width", "w", "", 2},
                   {"n", "n", "", 0},
                   {"median", "median", "mm", 2},
                   {"median_95", "95 %", "mm", 2},
                   {"mean", "mean", "mm", 2},
                   {"mean_95", "95 %", "mm", 2},
                   {"sd", "SD", "mm", 2},
                   {"q1", "lower quartile", "mm", 2},
                   {"q3", "upper quartile", "mm", 2},
                   {"outliers", "outliers", "", 0},
                   {"iou", "IoU", "", 3},
                   {"within_10", "within 10 mm, %", "%", 0},
                   {"within_20", "within 20 mm, %", "%", 0},
                   {"within_30", "within 30 mm, %", "%", 0}};
  table.texts = 0;
  for (const auto& row : column.at("by_width")) {
    table.rows.push_back({number_at(row, "width"), number_at(row, "n"), number_at(row, "median_mm"),
                          interval_at(row, "median_95_mm"), number_at(row, "mean_mm"), interval_at(row, "mean_95_mm"),
                          number_at(row, "sd_mm"), number_at(row, "q1_mm"), number_at(row, "q3_mm"),
                          number_at(row, "outliers"), number_at(row, "silhouette_iou"), percent_at(row, "success_10mm"),
                          percent_at(row, "success_20mm"), percent_at(row, "success_30mm")});
  }
  tables.push_back(std::move(table));
}

void add_planning(const ordered_json& json, std::vector<PaperTable>& tables) {
  add_planning_column(json, tables);
  const ordered_json others = json.value("columns", ordered_json::object());
  for (const auto& [source, column] : others.items()) add_planning_column(column, tables);
}

/// Fig. 4: the estimates of the first source and method as the segments go by.
void add_estimation_by_segments(const ordered_json& json, std::vector<PaperTable>& tables) {
  struct Found {
    std::vector<double> errors, widths;
    double held = 0.0;
  };
  std::vector<std::array<Found, kPropertyNames.size()>> by_segment;
  for (const auto& one : json.value("cases", ordered_json::array())) {
    const auto knowledge = one.value("knowledge", ordered_json::array());
    if (by_segment.size() < knowledge.size()) by_segment.resize(knowledge.size());
    for (std::size_t s = 0; s < knowledge.size(); ++s) {
      for (std::size_t p = 0; p < kPropertyNames.size(); ++p) {
        constexpr double kShare = 0.8;
        const double error =
            std::abs(knowledge[s].at("centre").at(p).get<double>() - one.at("true_material").at(p).get<double>());
        const double width = knowledge[s].at("width").at(p).get<double>();
        Found& found = by_segment[s][p];
        found.errors.push_back(error);
        found.widths.push_back(width);
        found.held += error <= kShare * width / 2.0 ? 1.0 : 0.0;
      }
    }
  }
  if (by_segment.empty()) return;
  PaperTable table;
  table.label = "estimation-segments";
  table.caption =
      "Median of |c - q| and of w, and how many of the 80 % intervals hold the true value, as the segments go by "
      "(cases: " +
      json.value("goals", "") + ", method: " + json.value("method", "") + ")" + warnings_of(json);
  table.columns = {{"segments", "segments", "", 0}, {"n", "n", "", 0}};
  for (const std::string name : kPropertyNames) {
    table.columns.push_back({name + "_error", name + " |c - q|", "", 3});
    table.columns.push_back({name + "_width", name + " w", "", 3});
    table.columns.push_back({name + "_held_80", name + " held, %", "%", 0});
  }
  table.texts = 0;
  for (std::size_t s = 0; s < by_segment.size(); ++s) {
    std::vector<ordered_json> row = {s, by_segment[s].front().errors.size()};
    for (Found& found : by_segment[s]) {
      std::sort(found.errors.begin(), found.errors.end());
      std::sort(found.widths.begin(), found.widths.end());
      row.insert(row.end(), {quantile(found.errors, 0.5), quantile(found.widths, 0.5),
                             100.0 * found.held / static_cast<double>(found.errors.size())});
    }
    table.rows.push_back(std::move(row));
  }
  tables.push_back(std::move(table));
}

/// The paper's Table 1, for every method.
void add_estimation(const ordered_json& json, std::vector<PaperTable>& tables) {
  for (const auto& [source, methods] : json.at("columns").items()) {
    PaperTable table;
    table.label = "estimation-" + source;
    table.caption = "Material estimates after the last segment (cases: " + source +
                    "); an interval that is held contains the true value" + warnings_of(json);
    table.columns = {{"method", "method", "", 0},
                     {"property", "property", "", 0},
                     {"n", "n", "", 0},
                     {"error_median", "median |c - q|", "", 3},
                     {"error_median_95", "95 %", "", 3},
                     {"error_mean", "mean |c - q|", "", 3},
                     {"error_mean_95", "95 %", "", 3},
                     {"error_sd", "SD", "", 3},
                     {"width_median", "median w", "", 3},
                     {"width_mean", "mean w", "", 3},
                     {"width_sd", "SD", "", 3},
                     {"failures", "failures, %", "%", 0},
                     {"held_50", "50 % held, %", "%", 0},
                     {"held_80", "80 % held, %", "%", 0},
                     {"score", "score", "", 3}};
    table.texts = 2;
    for (const auto& [method, figures] : methods.items()) {
      const ordered_json properties = figures.value("properties", ordered_json::object());
      for (const auto& [property, row] : properties.items()) {
        const auto &error = row.at("abs_error"), &width = row.at("width"), &held = row.at("coverage");
        table.rows.push_back({method, property, number_at(figures, "n"), number_at(error, "median"),
                              interval_at(error, "median_95"), number_at(error, "mean"), interval_at(error, "mean_95"),
                              number_at(error, "sd"), number_at(width, "median"), number_at(width, "mean"),
                              number_at(width, "sd"), percent_at(row, "failure_rate"), percent_at(held, "0.5"),
                              percent_at(held, "0.8"), number_at(row, "interval_score")});
      }
    }
    // Estimates corrected by the simulator that is the world are off by ten-thousandths.
    const bool has_small = std::any_of(table.rows.begin(), table.rows.end(), [](const auto& row) {
      return row[3].is_number() && row[3].template get<double>() < 0.002;
    });
    for (auto& column : table.columns)
      if (has_small && column.name.starts_with("error_")) column.digits = 4;
    tables.push_back(std::move(table));
  }
  add_estimation_by_segments(json, tables);
}

/// Settled shapes, as the start of a session and its middle predict them.
void add_settled_prediction(const ordered_json& settled, std::vector<PaperTable>& tables) {
  PaperTable table{"prediction-settled",
                   "Error of the predicted settled shape; a calibrated prediction has 68 % within sigma and NSE 1",
                   {{"settled", "settled shape", "", 0},
                    {"n", "n", "", 0},
                    {"mean", "mean, mm", "mm", 2},
                    {"median", "median, mm", "mm", 2},
                    {"sigma", "sigma, mm", "mm", 2},
                    {"within_sigma", "within sigma, %", "%", 1},
                    {"nse", "NSE", "", 2},
                    {"nll", "NLL", "", 2}},
                   {},
                   1};
  const std::pair<const char*, const char*> rows[] = {{"from_start", "from the flat start"},
                                                      {"from_random", "from a random segment"},
                                                      {"no_knowledge", "without knowledge of the material"}};
  for (const auto& [key, name] : rows) {
    const ordered_json row = settled.value(key, ordered_json::object());
    table.rows.push_back({name, number_at(row, "n"), number_at(row, "mean_mm"), number_at(row, "median_mm"),
                          number_at(row, "sigma_mm"), percent_at(row, "coverage_1sigma"), number_at(row, "nse"),
                          number_at(row, "nll")});
  }
  tables.push_back(std::move(table));
}

void add_prediction(const ordered_json& json, std::vector<PaperTable>& tables) {
  if (json.contains("settled")) add_settled_prediction(json["settled"], tables);
  const std::pair<const char*, const char*> parts[] = {
      {"by_step", "from the start of a session"},
      {"by_step_from_random", "from within a session"},
      {"by_step_no_knowledge", "from the start of a session, the material unknown"}};
  for (const auto& [key, what] : parts) {
    if (!json.contains(key)) continue;
    PaperTable table;
    table.label = std::string("prediction-") + key;
    table.caption = std::string("Error of the predicted shapes by the number of segments, ") + what;
    table.columns = {{"segments", "segments", "", 0},
                     {"n", "n", "", 0},
                     {"mean", "mean, mm", "mm", 2},
                     {"median", "median, mm", "mm", 2},
                     {"sigma", "sigma, mm", "mm", 2},
                     {"nll", "NLL", "", 3},
                     {"within_sigma", "within sigma, %", "%", 0}};
    table.texts = 0;
    for (const auto& row : json[key]) {
      table.rows.push_back({number_at(row, "steps"), number_at(row, "n"), number_at(row, "mean_mm"),
                            number_at(row, "median_mm"), number_at(row, "sigma_mm"), number_at(row, "nll"),
                            percent_at(row, "coverage_1sigma")});
    }
    tables.push_back(std::move(table));
  }
}

/// The comparisons of each test: those of one quantity and bound in a row.
PaperTable physics_summary(const ordered_json& rows) {
  PaperTable table{"physics-summary",
                   "Tests by the errors of their comparisons, as the bound counts them",
                   {{"test", "test", "", 0},
                    {"quantity", "quantity", "", 0},
                    {"comparisons", "comparisons", "", 0},
                    {"within", "within bound", "", 0},
                    {"median", "median error", "", kErrorDigits},
                    {"largest", "largest error", "", kErrorDigits},
                    {"bound", "bound", "", kErrorDigits}},
                   {},
                   2};
  std::vector<std::vector<double>> errors;
  for (const auto& row : rows) {
    const auto is_of = [&](const std::vector<ordered_json>& one) {
      return one[0] == row.at("test") && one[1] == row.at("quantity") && one[6] == number_at(row, "bound");
    };
    auto found = std::find_if(table.rows.begin(), table.rows.end(), is_of);
    if (found == table.rows.end()) {
      table.rows.push_back({row.at("test"), row.at("quantity"), 0, 0, nullptr, nullptr, number_at(row, "bound")});
      errors.emplace_back();
      found = std::prev(table.rows.end());
    }
    (*found)[2] = (*found)[2].get<int>() + 1;
    (*found)[3] = (*found)[3].get<int>() + (row.at("passed").get<bool>() ? 1 : 0);
    if (const auto error = number_at(row, "error"); !error.is_null())
      errors[found - table.rows.begin()].push_back(error.get<double>());
  }
  for (std::size_t i = 0; i < errors.size(); ++i) {
    if (errors[i].empty()) continue;
    std::sort(errors[i].begin(), errors[i].end());
    table.rows[i][4] = quantile(errors[i], 0.5);
    table.rows[i][5] = errors[i].back();
  }
  return table;
}

/// What the properties of the fabric do to the default fold: no closed form, so the values themselves.
PaperTable physics_properties(const ordered_json& rows) {
  PaperTable table{"physics-properties",
                   "How far the settled default fold moves when one property changes, the others at 0.5",
                   {{"change", "change", "", 0}, {"moves", "moves by, mm", "mm", PaperColumn::kSignificant}},
                   {},
                   1};
  for (const auto& row : rows)
    if (row.at("test") == "properties") table.rows.push_back({row.at("case"), number_at(row, "measured")});
  return table;
}

void add_physics(const ordered_json& json, std::vector<PaperTable>& tables) {
  tables.push_back(physics_summary(json.at("rows")));
  if (auto properties = physics_properties(json.at("rows")); !properties.rows.empty())
    tables.push_back(std::move(properties));
  PaperTable table{"physics", "The simulator against closed forms", {}, {}, 4};
  for (const char* name : {"test", "case", "variant", "quantity"}) table.columns.push_back({name, name, "", 0});
  for (const char* name : {"reference", "measured", "error", "bound"})
    table.columns.push_back({name, name, "", PaperColumn::kSignificant});
  table.columns.push_back({"within", "within", "", 0});
  for (const auto& row : json.at("rows")) {
    table.rows.push_back({row.at("test"), row.at("case"), row.at("variant"), row.at("quantity"),
                          number_at(row, "reference"), number_at(row, "measured"), number_at(row, "error"),
                          number_at(row, "bound"), row.at("passed").get<bool>() ? "yes" : "no"});
  }
  tables.push_back(std::move(table));
}

std::string markdown_cell(const std::string& text) {
  std::string cell;
  for (const char c : text) cell += c == '|' ? std::string("\\|") : std::string(1, c);
  return cell;
}

std::string latex_text(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (std::string_view("#$%&_{}").find(c) != std::string_view::npos)
      escaped += std::string("\\") + c;
    else if (c == '\\')
      escaped += "\\textbackslash{}";
    else if (c == '~' || c == '^')
      escaped += std::string("\\") + c + "{}";
    else if (c == '|' || c == '<' || c == '>')
      escaped += std::string("$") + (c == '|' ? "\\vert" : std::string(1, c)) + "$";
    else
      escaped += c;
  }
  return escaped;
}

/// A cell of numbers: a minus sign, not a hyphen.
std::string latex_number(const std::string& text) {
  std::string number;
  for (const char c : text) number += c == '-' ? std::string("$-$") : latex_text(std::string(1, c));
  return number;
}

/// One line of cells with what stands between and around them.
template <class Cell>
std::string line_of(const std::vector<std::string>& row, const char* begin, const char* between, const char* end,
                    Cell&& cell) {
  std::string line = begin;
  for (std::size_t i = 0; i < row.size(); ++i) line += (i > 0 ? between : "") + cell(row[i], i);
  return line + end;
}

/// The line of a table's heads, or of one of its rows.
std::vector<std::string> heads_of(const PaperTable& table) {
  std::vector<std::string> heads;
  for (const auto& [name, head, unit, digits] : table.columns) {
    const std::string end = unit.empty() ? "" : ", " + unit;
    heads.push_back(head.ends_with(end) ? head : head + end);
  }
  return heads;
}
std::vector<std::string> texts_of(const PaperTable& table, const std::vector<ordered_json>& row) {
  std::vector<std::string> texts;
  for (std::size_t i = 0; i < row.size(); ++i) texts.push_back(cell_text(row[i], table.columns.at(i)));
  return texts;
}

}  // namespace

std::vector<PaperTable> paper_tables(const fs::path& folder) {
  using Add = void (*)(const ordered_json&, std::vector<PaperTable>&);
  const std::pair<const char*, Add> files[] = {{"ablation.json", add_ablation},
                                               {"planning.json", add_planning},
                                               {"estimation.json", add_estimation},
                                               {"prediction.json", add_prediction},
                                               {"physics.json", add_physics}};
  std::vector<PaperTable> tables;
  for (const auto& [name, add] : files) {
    const fs::path file = folder / name;
    if (!fs::exists(file)) continue;
    try {
      add(parse_json(whole_text(file)), tables);
    } catch (const nlohmann::json::exception& error) {
      throw ConfigError(file.string() + ": is damaged: " + error.what());
    }
  }
  return tables;
}

std::string cell_text(const ordered_json& cell, const PaperColumn& column) {
  if (cell.is_null()) return "";
  if (cell.is_string()) return cell.get<std::string>();
  if (!cell.is_array()) return fixed_text(cell.get<double>(), column.digits);
  return "[" + fixed_text(cell.at(0).get<double>(), column.digits) + ", " +
         fixed_text(cell.at(1).get<double>(), column.digits) + "]";
}

std::string markdown_of(const PaperTable& table) {
  const auto cell = [](const std::string& one, std::size_t) { return markdown_cell(one); };
  std::string text = line_of(heads_of(table), "| ", " | ", " |\n|", cell);
  for (std::size_t i = 0; i < table.columns.size(); ++i) text += i < table.texts ? "---|" : "---:|";
  text += "\n";
  for (const auto& row : table.rows) text += line_of(texts_of(table, row), "| ", " | ", " |\n", cell);
  return text;
}

std::string markdown_of(const std::vector<PaperTable>& tables) {
  std::string text;
  for (const auto& table : tables) text += (text.empty() ? "" : "\n") + table.caption + ".\n\n" + markdown_of(table);
  return text;
}

std::string latex_of(const std::vector<PaperTable>& tables) {
  std::string text = "% Tables of weft; they need \\usepackage{booktabs}.\n";
  for (const auto& table : tables) {
    std::string label;
    for (const char c : table.label) label += std::isalnum(static_cast<unsigned char>(c)) != 0 ? c : '-';
    const auto head = [](const std::string& one, std::size_t) { return latex_text(one); };
    const auto cell = [&](const std::string& one, std::size_t i) {
      return i < table.texts ? latex_text(one) : latex_number(one);
    };
    text += "\n\\begin{table}\n  \\centering\n  \\caption{" + latex_text(table.caption) + ".}\n  \\label{tab:" + label +
            "}\n  \\begin{tabular}{" + std::string(table.texts, 'l') +
            std::string(table.columns.size() - table.texts, 'r') + "}\n    \\toprule\n" +
            line_of(heads_of(table), "    ", " & ", " \\\\\n", head) + "    \\midrule\n";
    for (const auto& row : table.rows) text += line_of(texts_of(table, row), "    ", " & ", " \\\\\n", cell);
    text += "    \\bottomrule\n  \\end{tabular}\n\\end{table}\n";
  }
  return text;
}

}  // namespace weft
