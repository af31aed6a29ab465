#include "report/paper_tables.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "sdk/json_text.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

/// A number with so many digits after the point; empty for null and for a key that is not there.
std::string fixed_text(const ordered_json& object, const std::string& key, int digits, double factor = 1.0) {
  const auto found = object.find(key);
  if (found == object.end() || !found->is_number()) return "";
  char text[400];  // the largest double has 309 digits before the point
  std::snprintf(text, sizeof text, "%.*f", digits, factor * found->get<double>());
  return text;
}

std::string percent_text(const ordered_json& object, const std::string& key) {
  return fixed_text(object, key, 0, 100.0);
}

std::string interval_text(const ordered_json& statistics, const std::string& key, int digits) {
  const auto found = statistics.find(key);
  if (found == statistics.end() || found->size() != 2) return "";
  const std::string low = fixed_text({{"end", (*found)[0]}}, "end", digits),
                    high = fixed_text({{"end", (*found)[1]}}, "end", digits);
  return low.empty() || high.empty() ? "" : "[" + low + ", " + high + "]";
}

/// Digits after the point that show three or four digits of the largest mean.
int digits_for(const ordered_json& arms, const std::string& metric) {
  double largest = 0.0;
  for (const auto& arm : arms)
    if (const auto& metrics = arm.at("metrics"); metrics.contains(metric) && metrics[metric].at("mean").is_number())
      largest = std::max(largest, std::abs(metrics[metric]["mean"].get<double>()));
  if (largest == 0.0) return 2;
  return std::clamp(2 - static_cast<int>(std::floor(std::log10(largest))), 0, 9);
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

/// One table for each metric: mean, median, and the paired difference to the baseline, with 95 % intervals.
void add_ablation(const ordered_json& json, std::vector<PaperTable>& tables) {
  std::vector<std::string> metrics;
  for (const auto& arm : json.at("arms"))
    for (const auto& [name, ignored] : arm.at("metrics").items())
      if (std::find(metrics.begin(), metrics.end(), name) == metrics.end()) metrics.push_back(name);
  const auto factors = json.at("factors").get<std::vector<std::string>>();
  const bool has_target = json.value("has_target", false);
  for (const auto& metric : metrics) {
    PaperTable table;
    table.label = "ablation-" + metric;
    table.caption =
        metric +
        ": mean and median with the bootstrap's 95 % intervals, and the mean of the paired differences to the baseline" +
        warnings_of(json);
    table.head = factors;
    table.texts = factors.size();
    for (const char* name : {"n", "failed", "mean", "95 %", "median", "95 %", "difference", "95 %"})
      table.head.emplace_back(name);
    const int digits = digits_for(json["arms"], metric);
    if (has_target) {
      table.caption +=
          "; how many times smaller the median is than the baseline's, and the share of the gap to the target";
      for (const char* name : {"baseline / own", "95 %", "gap closed"}) table.head.emplace_back(name);
    }
    for (const auto& arm : json["arms"]) {
      std::vector<std::string> row;
      for (const auto& factor : factors) row.push_back(arm.at("levels").at(factor).get<std::string>());
      const ordered_json own = arm["metrics"].value(metric, ordered_json::object());
      const ordered_json difference = own.value("difference", ordered_json::object());
      row.push_back(fixed_text(own, "n", 0));
      row.push_back(std::to_string(arm.at("failed").size()));
      row.push_back(fixed_text(own, "mean", digits));
      row.push_back(interval_text(own, "mean_95", digits));
      row.push_back(fixed_text(own, "median", digits));
      row.push_back(interval_text(own, "median_95", digits));
      row.push_back(fixed_text(difference, "mean", digits));
      row.push_back(interval_text(difference, "mean_95", digits));
      if (has_target) {
        const ordered_json medians = own.value("medians", ordered_json::object());
        for (const auto& cell :
             {fixed_text(medians, "baseline_over_own", 2), interval_text(medians, "baseline_over_own_95", 2),
              fixed_text(medians, "gap_closed", 2)})
          row.push_back(cell);
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
  table.head = {"w",
                "n",
                "median",
                "mean",
                "SD",
                "lower quartile",
                "upper quartile",
                "outliers",
                "IoU",
                "within 10 mm, %",
                "within 20 mm, %",
                "within 30 mm, %"};
  table.texts = 0;
  for (const auto& row : column.at("by_width")) {
    table.rows.push_back({fixed_text(row, "width", 2), fixed_text(row, "n", 0), fixed_text(row, "median_mm", 2),
                          fixed_text(row, "mean_mm", 2), fixed_text(row, "sd_mm", 2), fixed_text(row, "q1_mm", 2),
                          fixed_text(row, "q3_mm", 2), fixed_text(row, "outliers", 0),
                          fixed_text(row, "silhouette_iou", 3), percent_text(row, "success_10mm"),
                          percent_text(row, "success_20mm"), percent_text(row, "success_30mm")});
  }
  tables.push_back(std::move(table));
}

void add_planning(const ordered_json& json, std::vector<PaperTable>& tables) {
  add_planning_column(json, tables);
  const ordered_json others = json.value("columns", ordered_json::object());
  for (const auto& [source, column] : others.items()) add_planning_column(column, tables);
}

/// The paper's Table 1, for every method.
void add_estimation(const ordered_json& json, std::vector<PaperTable>& tables) {
  for (const auto& [source, methods] : json.at("columns").items()) {
    PaperTable table;
    table.label = "estimation-" + source;
    table.caption = "Material estimates after the last segment (cases: " + source +
                    "); an interval that is held contains the true value" + warnings_of(json);
    table.head = {"method",       "property",     "n",        "median |c - q|",
                  "mean |c - q|", "SD",           "median w", "failures, %",
                  "50 % held, %", "80 % held, %", "score"};
    table.texts = 2;
    for (const auto& [method, figures] : methods.items()) {
      const ordered_json properties = figures.value("properties", ordered_json::object());
      for (const auto& [property, row] : properties.items()) {
        const auto& error = row.at("abs_error");
        const auto& held = row.at("coverage");
        table.rows.push_back({method, property, fixed_text(figures, "n", 0), fixed_text(error, "median", 3),
                              fixed_text(error, "mean", 3), fixed_text(error, "sd", 3),
                              fixed_text(row.at("width"), "median", 3), percent_text(row, "failure_rate"),
                              percent_text(held, "0.5"), percent_text(held, "0.8"),
                              fixed_text(row, "interval_score", 3)});
      }
    }
    tables.push_back(std::move(table));
  }
}

void add_prediction(const ordered_json& json, std::vector<PaperTable>& tables) {
  const std::pair<const char*, const char*> parts[] = {
      {"by_step", "from the start of a session"},
      {"by_step_from_random", "from within a session"},
      {"by_step_no_knowledge", "from the start of a session, the material unknown"}};
  for (const auto& [key, what] : parts) {
    if (!json.contains(key)) continue;
    PaperTable table;
    table.label = std::string("prediction-") + key;
    table.caption = std::string("Error of the predicted shapes by the number of segments, ") + what;
    table.head = {"segments", "n", "mean, mm", "median, mm", "sigma, mm", "NLL", "within sigma, %"};
    table.texts = 0;
    for (const auto& row : json[key]) {
      table.rows.push_back({fixed_text(row, "steps", 0), fixed_text(row, "n", 0), fixed_text(row, "mean_mm", 2),
                            fixed_text(row, "median_mm", 2), fixed_text(row, "sigma_mm", 2), fixed_text(row, "nll", 3),
                            percent_text(row, "coverage_1sigma")});
    }
    tables.push_back(std::move(table));
  }
}

void add_physics(const ordered_json& json, std::vector<PaperTable>& tables) {
  PaperTable table{"physics",
                   "The simulator against closed forms",
                   {"test", "case", "quantity", "reference", "measured", "error", "bound", "within"},
                   {},
                   3};
  const auto number = [](const ordered_json& value) -> std::string {
    if (!value.is_number()) return "";
    char text[40];
    std::snprintf(text, sizeof text, "%.4g", value.get<double>());
    return text;
  };
  for (const auto& row : json.at("rows")) {
    table.rows.push_back({row.at("test"), row.at("case"), row.at("quantity"), number(row.at("reference")),
                          number(row.at("measured")), number(row.at("error")), number(row.at("bound")),
                          row.at("passed").get<bool>() ? "yes" : "no"});
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

std::string whole_text(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(stream), {}};
  if (!stream) throw ConfigError(file.string() + ": cannot be read");
  return text;
}

/// One line of cells with what stands between and around them.
template <class Cell>
std::string line_of(const std::vector<std::string>& row, const char* begin, const char* between, const char* end,
                    Cell&& cell) {
  std::string line = begin;
  for (std::size_t i = 0; i < row.size(); ++i) line += (i > 0 ? between : "") + cell(row[i], i);
  return line + end;
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

std::string markdown_of(const std::vector<PaperTable>& tables) {
  std::string text;
  for (const auto& table : tables) {
    const auto cell = [](const std::string& one, std::size_t) { return markdown_cell(one); };
    text += (text.empty() ? "" : "\n") + table.caption + ".\n\n" + line_of(table.head, "| ", " | ", " |\n|", cell);
    for (std::size_t i = 0; i < table.head.size(); ++i) text += i < table.texts ? "---|" : "---:|";
    text += "\n";
    for (const auto& row : table.rows) text += line_of(row, "| ", " | ", " |\n", cell);
  }
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
            std::string(table.head.size() - table.texts, 'r') + "}\n    \\toprule\n" +
            line_of(table.head, "    ", " & ", " \\\\\n", head) + "    \\midrule\n";
    for (const auto& row : table.rows) text += line_of(row, "    ", " & ", " \\\\\n", cell);
    text += "    \\bottomrule\n  \\end{tabular}\n\\end{table}\n";
  }
  return text;
}

}  // namespace weft
