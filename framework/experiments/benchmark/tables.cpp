#include "experiments/benchmark/tables.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "experiments/json_numbers.hpp"
#include "experiments/statistics.hpp"

namespace weft::benchmark {
namespace {

using nlohmann::ordered_json;

constexpr const char* kMotions[] = {"resting", "hanging", "folding"};

std::string text(const Row& row, const char* key) { return row.at(key).get<std::string>(); }
std::string number_text(const Row& row, const char* key) { return row.at(key).dump(); }

std::vector<double> values_of(const Measured& one, const std::string& number) {
  std::vector<double> values;
  for (const auto& sample : one.samples)
    if (sample.contains(number)) values.push_back(sample.at(number).get<double>());
  return values;
}
/// From the least to the most. @param one with samples.
std::pair<double, double> range_of(const Measured& one, const std::string& number) {
  const auto values = values_of(one, number);
  return {*std::min_element(values.begin(), values.end()), *std::max_element(values.begin(), values.end())};
}
/// The range over the median, %.
double relative_range(const Measured& one, const std::string& number) {
  const auto [least, most] = range_of(one, number);
  return 100.0 * (most - least) / median_of(one, number);
}

// Cells.
ordered_json median(const Measured& one, const std::string& number, double factor = 1.0) {
  return json_number(factor * median_of(one, number));
}
ordered_json range(const Measured& one, const std::string& number, double factor = 1.0) {
  if (one.samples.empty()) return nullptr;
  const auto [least, most] = range_of(one, number);
  return ordered_json::array({factor * least, factor * most});
}

ordered_json column(const std::string& name, const std::string& head, const std::string& unit = "", int digits = 0) {
  return {{"name", name}, {"head", head}, {"unit", unit}, {"digits", digits}};
}
ordered_json word_column(const std::string& name) { return column(name, name); }

/// @param texts the number of columns that are words, the first ones.
ordered_json table(const std::string& label, const std::string& caption, int texts, ordered_json columns) {
  return {{"label", label},
          {"caption", caption},
          {"texts", texts},
          {"columns", std::move(columns)},
          {"rows", ordered_json::array()}};
}

/// The rows of one motion, simulator and fabric, by ascending number of vertices.
struct Refinement {
  std::string motion, simulator, fabric;
  std::map<int, const Measured*> sizes;  ///< by vertices; those that have samples
};

double growth(const std::pair<const int, const Measured*>& coarse, const std::pair<const int, const Measured*>& fine) {
  return std::log(median_of(*fine.second, "cpu_ms") / median_of(*coarse.second, "cpu_ms")) /
         std::log(static_cast<double>(fine.first) / coarse.first);
}

/// Ordered by motion, then as the rows are. @param sizes gets all numbers of vertices, of rows without samples too.
std::vector<Refinement> refinements(const std::vector<Measured>& rows, std::set<int>& sizes) {
  std::vector<Refinement> found;
  for (const char* motion : kMotions)
    for (const Measured& one : rows) {
      if (one.row.at("motion") != motion) continue;
      const std::string simulator = text(one.row, "simulator"), fabric = text(one.row, "fabric");
      auto known = std::find_if(found.begin(), found.end(), [&](const Refinement& r) {
        return r.motion == motion && r.simulator == simulator && r.fabric == fabric;
      });
      if (known == found.end()) known = found.insert(found.end(), Refinement{motion, simulator, fabric, {}});
      sizes.insert(one.row.at("vertices").get<int>());
      if (!one.samples.empty()) known->sizes[one.row.at("vertices").get<int>()] = &one;
    }
  return found;
}

void add_frames(const std::vector<Measured>& rows, ordered_json& tables) {
  std::set<int> sizes;
  const auto lines = refinements(rows, sizes);
  for (const char* motion : kMotions) {
    ordered_json columns{word_column("simulator"), word_column("fabric")};
    for (const int n : sizes) columns.push_back(column(std::to_string(n), std::to_string(n) + " vertices", "ms", 2));
    columns.push_back(column("growth", "growth, exponent", "", 2));
    columns.push_back(column("spread", "spread", "%"));
    columns.push_back(column("wall", "wall / CPU", "", 2));
    auto one_table =
        table(std::string("frames/") + motion,
              std::string("A frame, ") + motion +
                  ": CPU time of one thread, median; growth from the first to the last size; the widest spread "
                  "of a size, its range over its median; median of wall time over CPU time",
              2, columns);
    for (const auto& line : lines) {
      if (line.motion != motion) continue;
      ordered_json cells{line.simulator, line.fabric};
      double widest = kNaN;
      std::vector<double> wall;
      for (const int n : sizes) {
        const auto at = line.sizes.find(n);
        cells.push_back(at == line.sizes.end() ? ordered_json() : median(*at->second, "cpu_ms"));
        if (at == line.sizes.end()) continue;
        widest = std::fmax(widest, relative_range(*at->second, "cpu_ms"));
        wall.push_back(median_of(*at->second, "wall_ms") / median_of(*at->second, "cpu_ms"));
      }
      cells.push_back(line.sizes.size() < 2 ? ordered_json()
                                            : json_number(growth(*line.sizes.begin(), *line.sizes.rbegin())));
      cells.push_back(json_number(widest));
      cells.push_back(json_number(quantile_of(wall, 0.5)));
      one_table["rows"].push_back(cells);
    }
    if (!one_table["rows"].empty()) tables.push_back(one_table);
  }
}

void add_growth(const std::vector<Measured>& rows, ordered_json& tables) {
  std::set<int> sizes;
  const auto lines = refinements(rows, sizes);
  ordered_json columns{word_column("motion"), word_column("simulator"), word_column("fabric")};
  const std::vector<int> steps(sizes.begin(), sizes.end());
  for (std::size_t i = 1; i < steps.size(); ++i) {
    const std::string from = std::to_string(steps[i - 1]), to = std::to_string(steps[i]);
    columns.push_back(column(from + "-" + to, from + " to " + to, "", 2));
  }
  auto one_table =
      table("frames/growth", "Growth: exponent of the CPU time between two numbers of vertices", 3, columns);
  for (const auto& line : lines) {
    ordered_json cells{line.motion, line.simulator, line.fabric};
    for (std::size_t i = 1; i < steps.size(); ++i) {
      const auto from = line.sizes.find(steps[i - 1]), to = line.sizes.find(steps[i]);
      const bool are_both = from != line.sizes.end() && to != line.sizes.end();
      cells.push_back(are_both ? json_number(growth(*from, *to)) : ordered_json());
    }
    if (steps.size() > 1) one_table["rows"].push_back(cells);
  }
  if (!one_table["rows"].empty()) tables.push_back(one_table);
}

void add_folds(const std::vector<Measured>& rows, ordered_json& tables) {
  auto one_table = table("folds/folds", "Random folds, as `weft generate` makes them", 0,
                         {column("processes", "processes"), column("examples", "examples"),
                          column("rate", "examples a second", "", 2), column("rate_range", "range", "", 2),
                          column("cpu", "CPU time of an example", "s", 3), column("cpu_range", "range", "s", 3)});
  for (const Measured& one : rows)
    if (!one.samples.empty())
      one_table["rows"].push_back({one.row.at("processes"), one.row.at("examples"), median(one, "examples_per_s"),
                                   range(one, "examples_per_s"), median(one, "cpu_ms", 1e-3),
                                   range(one, "cpu_ms", 1e-3)});
  if (!one_table["rows"].empty()) tables.push_back(one_table);
}

void add_training(const std::vector<Measured>& rows, ordered_json& tables) {
  auto one_table =
      table("training/step", "An iteration of `weft train`", 0,
            {column("threads", "threads"), column("wall", "wall time", "ms", 1), column("wall_range", "range", "ms", 1),
             column("cpu", "CPU time of all threads", "ms", 1), column("cpu_range", "range", "ms", 1)});
  for (const Measured& one : rows)
    if (!one.samples.empty())
      one_table["rows"].push_back({one.row.at("threads"), median(one, "wall_ms"), range(one, "wall_ms"),
                                   median(one, "cpu_ms"), range(one, "cpu_ms")});
  if (!one_table["rows"].empty()) tables.push_back(one_table);
}

/// Rows that differ in the numeric variant alone.
struct Variants {
  Row row;  ///< without `kernels`
  std::map<std::string, const Measured*> by_kernels;
};

void add_gradients(const std::vector<Measured>& rows, ordered_json& tables) {
  std::vector<std::string> kernels;
  std::vector<Variants> lines;
  for (const Measured& one : rows) {
    if (one.row.at("what") != "gradient" || one.samples.empty()) continue;
    Row rest = one.row;
    rest.erase("kernels");
    const std::string name = text(one.row, "kernels");
    if (std::find(kernels.begin(), kernels.end(), name) == kernels.end()) kernels.push_back(name);
    auto line = std::find_if(lines.begin(), lines.end(), [&](const auto& l) { return l.row == rest; });
    if (line == lines.end()) line = lines.insert(lines.end(), Variants{rest, {}});
    line->by_kernels[name] = &one;
  }
  ordered_json columns{column("vertices", "vertices"), column("instances", "instances"),
                       column("segments", "segments")};
  for (const auto& name : kernels) columns.push_back(column(name, "`" + name + "`", "ms", 2));
  for (const auto& name : kernels) columns.push_back(column(name + "_forward", "forward, `" + name + "`", "ms", 2));
  columns.push_back(column("spread", "spread", "%"));
  auto one_table =
      table("planning/gradient",
            "A batch of plans through a network of random weights, forward and backward: CPU time of one thread "
            "by numeric variant, median; what the forward half takes; the widest spread, range over median",
            0, columns);
  for (const auto& [row, by_kernels] : lines) {
    ordered_json cells{median(*by_kernels.begin()->second, "vertices"), row.at("instances"), row.at("segments")};
    double widest = kNaN;
    for (const char* number : {"cpu_ms", "forward_cpu_ms"})
      for (const auto& name : kernels) {
        const auto at = by_kernels.find(name);
        cells.push_back(at == by_kernels.end() ? ordered_json() : median(*at->second, number));
        if (at != by_kernels.end()) widest = std::fmax(widest, relative_range(*at->second, "cpu_ms"));
      }
    cells.push_back(json_number(widest));
    one_table["rows"].push_back(cells);
  }
  if (!one_table["rows"].empty()) tables.push_back(one_table);
}

void add_sessions(const std::vector<Measured>& rows, ordered_json& tables) {
  auto one_table = table("planning/sessions", "Sessions that estimate the fabric, without corrections: wall times", 1,
                         {word_column("what"), column("threads", "threads"), column("number", "number"),
                          column("median", "median", "ms", 1), column("median_range", "range", "ms", 1),
                          column("p95", "95th percentile", "ms", 1), column("p95_range", "range", "ms", 1)});
  for (const Measured& one : rows) {
    if (one.row.at("what") != "sessions" || one.samples.empty()) continue;
    for (const auto& [name, key] : {std::pair<std::string, std::string>{"first plan", "first_plan"},
                                    {"re-plan", "replan"},
                                    {"estimate", "estimate"}})
      one_table["rows"].push_back({name, one.row.at("threads"), median(one, key + "s"), median(one, key + "_ms"),
                                   range(one, key + "_ms"), median(one, key + "_p95_ms"), range(one, key + "_p95_ms")});
  }
  if (!one_table["rows"].empty()) tables.push_back(one_table);
}

/// What the memory of a row depends on.
std::string memory_name(const Measured& one) {
  const std::string part = text(one.row, "part");
  if (part == "frames")
    return "`" + text(one.row, "simulator") + "`, " + number_text(one.row, "vertices") + " vertices";
  if (part == "folds") return "the largest process, processes " + number_text(one.row, "processes");
  if (part == "training")
    return "threads " + number_text(one.row, "threads") + ", examples " + number_text(one.row, "examples");
  if (one.row.at("what") == "sessions") return "sessions";
  return number_text(one.row, "instances") + " instances of " + number_text(one.row, "segments") + " segments, " +
         ordered_json(static_cast<int>(median_of(one, "vertices"))).dump() + " vertices";
}

void add_memory(const std::string& part, const std::vector<Measured>& rows, ordered_json& tables) {
  std::vector<std::pair<std::string, double>> lines;
  for (const Measured& one : rows) {
    if (one.samples.empty()) continue;
    const std::string name = memory_name(one);
    const double most = range_of(one, "peak_mb").second;
    const auto known = std::find_if(lines.begin(), lines.end(), [&](const auto& line) { return line.first == name; });
    if (known == lines.end())
      lines.emplace_back(name, most);
    else
      known->second = std::max(known->second, most);
  }
  auto one_table = table(part + "/memory", "Peak of the resident memory of a process", 1,
                         {column("row", "of"), column("peak", "peak", "MB")});
  for (const auto& [name, most] : lines) one_table["rows"].push_back(ordered_json::array({name, most}));
  if (!lines.empty()) tables.push_back(one_table);
}

/// "256, 1024": a list with one more entry, unless it has it.
std::string with_entry(const std::string& list, const std::string& entry) {
  if (list.empty() || entry.empty()) return list + entry;
  return (", " + list + ",").find(", " + entry + ",") == std::string::npos ? list + ", " + entry : list;
}

/// Rows that were left out, and what plugins warned of. Rows of one plugin, fabric and remark are one line.
void add_remarks(const std::string& part, const std::vector<Measured>& rows, ordered_json& tables) {
  const bool are_frames = part == "frames";
  ordered_json columns{word_column("row")};
  if (are_frames) columns.insert(columns.end(), {word_column("motions"), word_column("vertices")});
  columns.push_back(word_column("remark"));
  auto one_table = table(part + "/remarks", "Left out, and warnings", static_cast<int>(columns.size()), columns);
  const auto add = [&](const Measured& one, const std::string& remark) {
    std::string name;
    for (const char* key : {"simulator", "fabric", "what", "kernels", "processes", "threads"})
      if (one.row.contains(key))
        name = with_entry(name, one.row[key].is_string() ? text(one.row, key) : key + (" " + one.row[key].dump()));
    ordered_json* line = nullptr;
    for (auto& known : one_table["rows"])
      if (known.front() == name && known.back() == remark) line = &known;
    if (line == nullptr) {
      one_table["rows"].push_back(are_frames ? ordered_json{name, "", "", remark}
                                             : ordered_json::array({name, remark}));
      line = &one_table["rows"].back();
    }
    if (!are_frames) return;
    (*line)[1] = with_entry((*line)[1].get<std::string>(), text(one.row, "motion"));
    (*line)[2] = with_entry((*line)[2].get<std::string>(), number_text(one.row, "vertices"));
  };
  for (const Measured& one : rows) {
    if (!one.left_out.empty()) add(one, one.left_out);
    for (const auto& sample : one.samples)
      if (sample.contains("note")) add(one, text(sample, "note"));
  }
  if (!one_table["rows"].empty()) tables.push_back(one_table);
}

}  // namespace

double median_of(const Measured& one, const std::string& number) { return quantile_of(values_of(one, number), 0.5); }

ordered_json to_json(const std::vector<Measured>& rows) {
  auto list = ordered_json::array();
  for (const Measured& one : rows) {
    if (one.samples.empty() && one.left_out.empty()) continue;
    ordered_json json{{"row", one.row}, {"repeats", one.samples.size()}};
    if (!one.left_out.empty()) json["left_out"] = one.left_out;
    if (!one.samples.empty()) {
      for (const auto& [name, first] : one.samples.front().items()) {
        if (!first.is_number()) continue;
        const auto [least, most] = range_of(one, name);
        json["median"][name] = median_of(one, name);
        json["least"][name] = least;
        json["most"][name] = most;
      }
    }
    json["samples"] = one.samples;
    list.push_back(std::move(json));
  }
  return list;
}

std::vector<Measured> measured_of(const ordered_json& json) {
  std::vector<Measured> rows;
  for (const auto& one : json) {
    Measured measured{one.at("row"), {}, one.value("left_out", "")};
    for (const auto& sample : one.at("samples")) measured.samples.push_back(sample);
    rows.push_back(std::move(measured));
  }
  return rows;
}

ordered_json tables_of(const std::string& part, const std::vector<Measured>& all) {
  std::vector<Measured> rows;
  for (const Measured& one : all)
    if (one.row.at("part") == part) rows.push_back(one);
  auto tables = ordered_json::array();
  if (part == "frames") add_frames(rows, tables), add_growth(rows, tables);
  if (part == "folds") add_folds(rows, tables);
  if (part == "training") add_training(rows, tables);
  if (part == "planning") add_gradients(rows, tables), add_sessions(rows, tables);
  add_memory(part, rows, tables);
  add_remarks(part, rows, tables);
  return tables;
}

}  // namespace weft::benchmark
