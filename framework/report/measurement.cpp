#include "report/measurement.hpp"

#include <algorithm>
#include <fstream>
#include <iterator>

#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "sdk/listed.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kMadeFrom = "<!-- Made of ";  // of pages, which nobody changes by hand
constexpr const char* kMark = "<!-- measured ";
constexpr const char* kMarkEnd = " -->";
constexpr const char* kBlockEnd = "<!-- end -->";

std::string trimmed(const std::string& text) {
  const auto begin = text.find_first_not_of(" \n"), end = text.find_last_not_of(" \n");
  return begin == std::string::npos ? "" : text.substr(begin, end - begin + 1);
}

/// "71001 to 71050" of a step; empty if it has none.
std::string seeds_text(const ordered_json& step) {
  const auto& seeds = step.at("seeds");
  if (seeds.is_null()) return "";
  const auto first = seeds.at("first").get<std::int64_t>(), count = seeds.at("count").get<std::int64_t>();
  return count == 1 ? std::to_string(first) : std::to_string(first) + " to " + std::to_string(first + count - 1);
}

/// The line that says where the numbers come from.
std::string origin_line(const ordered_json& measurement) {
  std::vector<std::string> models, seeds;
  for (const auto& model : measurement.at("models"))
    models.push_back("`" + model.at("file").get<std::string>() + "` (sha256 " +
                     model.at("sha256").get<std::string>().substr(0, 12) + ")");
  std::int64_t failed = 0;
  for (const auto& step : measurement.at("steps")) {
    failed += step.at("failed").get<std::int64_t>();
    const std::string text = seeds_text(step);
    if (!text.empty() && std::find(seeds.begin(), seeds.end(), text) == seeds.end()) seeds.push_back(text);
  }
  const bool is_one_seed = seeds.size() == 1 && seeds.front().find(' ') == std::string::npos;
  const auto& machine = measurement.at("machine");
  const auto cores = machine.at("cores").get<std::int64_t>();
  std::string line = "Size `" + measurement.at("size").get<std::string>() + "`, commit " +
                     measurement.at("commit").get<std::string>() + ", " +
                     (models.empty() ? "no model" : "model " + listed(models)) + ", " +
                     machine.at("processor").get<std::string>() +
                     (cores > 0 ? ", " + std::to_string(cores) + (cores == 1 ? " core" : " cores") : "") +
                     (seeds.empty() ? "" : (is_one_seed ? ", seed " : ", seeds ") + listed(seeds, " and ")) + ", " +
                     measurement.at("date").get<std::string>() + ".";
  if (failed > 0) line += " " + std::to_string(failed) + (failed == 1 ? " case" : " cases") + " failed.";
  return line;
}

/// The pictures of a step: one below the other, but the stills of a session beside each other in a table.
std::string figures_text(const ordered_json& figures, const std::string& step) {
  std::string alone, stills, session;
  std::size_t columns = 0, stills_of_session = 0;
  for (const auto& figure : figures) {
    if (figure.at("step") != step) continue;
    const std::string picture =
        "![" + figure.at("title").get<std::string>() + "](" + figure.at("file").get<std::string>() + ")";
    const std::string own = figure.value("session", "");
    if (own.empty()) {
      alone += "\n" + picture + "\n";
      continue;
    }
    if (own != session) stills += (stills.empty() ? "" : "\n") + std::string("| ") + own + " |";
    stills_of_session = own == session ? stills_of_session + 1 : 1;
    columns = std::max(columns, stills_of_session);
    session = own;
    stills += " " + picture + " |";
  }
  if (stills.empty()) return alone;
  std::string head = "| session |", line = "|---|";
  for (std::size_t i = 0; i < columns; ++i) {
    head += "  |";
    line += "---|";
  }
  return alone + "\n" + head + "\n" + line + "\n" + stills + "\n";
}

/// The words of a row, or its first number: what ROW of a mark names.
std::string name_of_row(const PaperTable& table, const std::vector<ordered_json>& row) {
  std::vector<std::string> words;
  for (std::size_t i = 0; i < std::max<std::size_t>(1, table.texts) && i < row.size(); ++i)
    words.push_back(cell_text(row[i], table.columns.at(i)));
  return listed(words);
}

/// What a mark asks for. @param mark the words after `measured`. @param fail throws with the place of the mark.
template <class Fail>
std::string measured(const std::string& mark, const Measurements& measurements, const Fail& fail) {
  const auto space = mark.find(' ');
  const std::string name = mark.substr(0, space);
  std::vector<std::string> parts;
  for (std::string rest = space == std::string::npos ? "" : mark.substr(space); !rest.empty();) {
    const auto end = rest.find(';');
    parts.push_back(trimmed(rest.substr(0, end)));
    rest = end == std::string::npos ? "" : rest.substr(end + 1);
  }
  if (parts.size() != 1 && parts.size() != 3) fail("must be NAME TABLE, or NAME TABLE; ROW; COLUMN");
  const auto unknown = [&](const char* what, const std::string& given, const std::vector<std::string>& known) {
    fail(std::string("there is no ") + what + " '" + given + "'" +
         (known.empty() ? "" : ", must be " + one_of(known) + nearest_hint(given, known)));
  };
  const auto found = measurements.find(name);
  if (found == measurements.end()) {
    std::vector<std::string> names;
    for (const auto& [one, ignored] : measurements) names.push_back(one);
    unknown("measurement", name, names);
  }
  std::vector<PaperTable> tables;
  for (const auto& json : found->second.at("tables")) tables.push_back(table_of_json(json));
  std::vector<std::string> labels;
  for (const auto& table : tables) labels.push_back(table.label);
  const auto place = std::find(labels.begin(), labels.end(), parts[0]) - labels.begin();
  if (place == std::ssize(labels)) unknown("table", parts[0], labels);
  const PaperTable& table = tables[place];
  if (parts.size() == 1) return "\n\n" + markdown_of(table) + "\n";
  std::vector<std::string> rows, columns;
  for (const auto& row : table.rows) rows.push_back(name_of_row(table, row));
  for (const auto& column : table.columns) columns.push_back(column.name);
  const auto row = std::find(rows.begin(), rows.end(), parts[1]) - rows.begin();
  if (row == std::ssize(rows)) unknown("row", parts[1], rows);
  const auto column = std::find(columns.begin(), columns.end(), parts[2]) - columns.begin();
  if (column == std::ssize(columns)) unknown("column", parts[2], columns);
  return cell_text(table.rows[row].at(column), table.columns[column]);
}

/// Which characters of a document are code: in fenced blocks and between backticks of one line.
std::vector<bool> code_of(const std::string& document) {
  std::vector<bool> code(document.size());
  bool is_fenced = false;
  for (std::size_t begin = 0; begin < document.size();) {
    const std::size_t end = std::min(document.find('\n', begin), document.size());
    const bool is_fence = document.compare(begin, 3, "```") == 0;
    bool is_quoted = false;
    for (std::size_t i = begin; i < end; ++i) {
      if (document[i] == '`') is_quoted = !is_quoted;
      code[i] = is_fenced || is_fence || is_quoted;
    }
    if (is_fence) is_fenced = !is_fenced;
    begin = end + 1;
  }
  return code;
}

/// The first place at or after `from` where a text stands that is no code.
std::size_t find_text(const std::string& document, const std::vector<bool>& code, const std::string& text,
                      std::size_t from) {
  std::size_t at = document.find(text, from);
  while (at != std::string::npos && code[at]) at = document.find(text, at + 1);
  return at;
}

std::vector<fs::path> files_in(const fs::path& folder, const std::string& extension) {
  std::vector<fs::path> files;
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(folder, none))
    if (entry.is_regular_file() && entry.path().extension() == extension) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace

ordered_json json_of_table(const PaperTable& table) {
  auto columns = ordered_json::array();
  for (const auto& column : table.columns)
    columns.push_back({{"name", column.name}, {"head", column.head}, {"unit", column.unit}, {"digits", column.digits}});
  return {{"label", table.label},
          {"caption", table.caption},
          {"texts", table.texts},
          {"columns", columns},
          {"rows", table.rows}};
}

PaperTable table_of_json(const ordered_json& json) {
  PaperTable table{json.at("label"), json.at("caption"), {}, {}, json.at("texts")};
  for (const auto& column : json.at("columns"))
    table.columns.push_back({column.at("name"), column.at("head"), column.at("unit"), column.at("digits")});
  for (const auto& row : json.at("rows")) {
    table.rows.push_back(row.get<std::vector<ordered_json>>());
    if (row.size() != table.columns.size())
      throw nlohmann::json::other_error::create(501, "a row has another length than the head", nullptr);
  }
  return table;
}

std::string measurement_page(const ordered_json& measurement) {
  const auto name = measurement.at("name").get<std::string>();
  std::string page = "# " + measurement.at("title").get<std::string>() + "\n\n";
  if (const auto about = measurement.at("about").get<std::string>(); !about.empty()) page += about + "\n\n";
  page += origin_line(measurement);
  // What it is for, since nothing else on the page says it.
  if (measurement.at("size") == "quick")
    page += " This size shows that all of it runs; for conclusions it has too few cases.";
  page += "\n\n```sh\n" + measurement.at("command").get<std::string>() + "\n```\n";
  for (const auto& step : measurement.at("steps")) {
    if (const auto title = step.at("title").get<std::string>(); !title.empty()) page += "\n## " + title + "\n";
    page += "\n```sh\n";
    for (const auto& command : step.at("commands")) page += command.get<std::string>() + "\n";
    page += "```\n";
    for (const auto& json : measurement.at("tables")) {
      const PaperTable table = table_of_json(json);
      if (table.label.starts_with(step.at("name").get<std::string>() + "/"))
        page += "\n" + table.caption + ".\n\n" + markdown_of(table);
    }
    page += figures_text(measurement.at("figures"), step.at("name"));
  }
  return page + "\n" + kMadeFrom + name + ".json by `weft reproduce --pages`: change that, not this page. -->\n";
}

Measurements read_measurements(const fs::path& folder) {
  Measurements all;
  for (const auto& file : files_in(folder, ".json")) {
    const auto json = parse_json_if_valid(whole_text(file));
    if (json.is_discarded()) throw ConfigError(file.string() + ": is damaged: it is no JSON");
    const std::string name = file.stem().string();
    const auto schema = json.is_object() ? json.value("schema", ordered_json()) : ordered_json();
    if (schema != kMeasurementSchema) {
      // Another file may lie here, but not in the place of a measurement.
      const bool is_old = schema.is_string() && schema.get<std::string>().starts_with("weft measurement");
      if (!is_old && !fs::exists(folder / (name + ".md"))) continue;
      throw ConfigError(file.string() + ": schema = " + schema.dump() + ", must be \"" + kMeasurementSchema + '"');
    }
    if (json.value("name", ordered_json()) != name)
      throw ConfigError(file.string() + ": is the measurement " + json.value("name", ordered_json()).dump() +
                        ", and must have its name");
    all[name] = json;
  }
  return all;
}

std::string with_measured(const std::string& document, const Measurements& measurements, const std::string& where) {
  const auto code = code_of(document);
  std::string made;
  std::size_t done = 0;
  for (std::size_t at = 0; (at = find_text(document, code, kMark, done)) != std::string::npos;) {
    const std::string place =
        where + ":" + std::to_string(1 + std::count(document.begin(), document.begin() + at, '\n'));
    const std::size_t words = at + std::string(kMark).size(), mark_end = document.find(kMarkEnd, words);
    const std::string mark = mark_end == std::string::npos ? "" : document.substr(words, mark_end - words);
    const auto fail = [&](const std::string& what) {
      throw ConfigError(place + ": <!-- measured " + mark + " -->: " + what);
    };
    if (mark_end == std::string::npos) fail("does not end");
    const std::size_t begin = mark_end + std::string(kMarkEnd).size();
    const std::size_t end = find_text(document, code, kBlockEnd, begin), next = find_text(document, code, kMark, begin);
    if (end == std::string::npos || next < end) fail(std::string("has no ") + kBlockEnd);
    made += document.substr(done, begin - done) + measured(mark, measurements, fail) + kBlockEnd;
    done = end + std::string(kBlockEnd).size();
  }
  return made + document.substr(done);
}

std::vector<StalePage> stale_pages(const fs::path& folder) {
  const Measurements measurements = read_measurements(folder);
  std::vector<StalePage> stale;
  const auto compare = [&](const fs::path& file, const std::string& wanted) {
    if (!fs::exists(file) || whole_text(file) != wanted) stale.push_back({file, wanted});
  };
  for (const auto& file : files_in(folder, ".md")) {
    const bool is_made = whole_text(file).find(kMadeFrom + file.stem().string() + ".json by") != std::string::npos;
    const bool is_measured = measurements.contains(file.stem().string());
    if (is_made && !is_measured)
      throw ConfigError(file.string() + ": was made of " + file.stem().string() + ".json, which is not there");
    if (is_measured && !is_made)
      throw ConfigError(file.string() +
                        ": was written by hand, but a measurement has its name; give the page another one");
  }
  for (const auto& [name, json] : measurements) {
    try {
      compare(folder / (name + ".md"), measurement_page(json));
    } catch (const nlohmann::json::exception& error) {
      throw ConfigError((folder / (name + ".json")).string() + ": is damaged: " + error.what());
    }
  }
  const fs::path whole = fs::absolute(folder).lexically_normal();
  const fs::path documents = (whole.has_filename() ? whole : whole.parent_path()).parent_path();
  std::vector<fs::path> files = files_in(documents, ".md");
  if (const fs::path readme = documents.parent_path() / "README.md"; fs::exists(readme)) files.push_back(readme);
  for (const auto& file : files) {
    const std::string text = whole_text(file), wanted = with_measured(text, measurements, file.string());
    if (text != wanted) stale.push_back({file, wanted});
  }
  return stale;
}

}  // namespace weft
