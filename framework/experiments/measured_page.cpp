#include "experiments/measured_page.hpp"

#include "sdk/formatted.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;

std::string number_text(double value, int digits) { return formatted("%.*f", digits, value); }

std::string text_of_cell(const ordered_json& cell, int digits) {
  if (cell.is_null()) return "";
  if (cell.is_string()) return cell.get<std::string>();
  if (!cell.is_array()) return number_text(cell.get<double>(), digits);
  return number_text(cell.at(0).get<double>(), digits) + " to " + number_text(cell.at(1).get<double>(), digits);
}

std::string origin_line(const ordered_json& json) {
  const auto cores = json.at("machine").at("cores").get<std::int64_t>();
  std::string line =
      "Size `" + json.at("size").get<std::string>() + "`, commit " + json.at("commit").get<std::string>();
  for (const auto& model : json.at("models"))
    line += ", model `" + model.at("file").get<std::string>() + "` (sha256 " +
            model.at("sha256").get<std::string>().substr(0, 12) + ")";
  line += ", " + json.at("machine").at("processor").get<std::string>() + ", " + std::to_string(cores) +
          (cores == 1 ? " core" : " cores");
  return line + ", " + json.at("date").get<std::string>() + ".";
}

std::string table_text(const ordered_json& table) {
  const auto& columns = table.at("columns");
  std::string text = table.at("caption").get<std::string>() + ".\n\n|";
  for (const auto& column : columns) {
    const auto unit = column.at("unit").get<std::string>();
    text += " " + column.at("head").get<std::string>() + (unit.empty() ? "" : ", " + unit) + " |";
  }
  text += "\n|";
  for (std::size_t i = 0; i < columns.size(); ++i) text += i < table.at("texts").get<std::size_t>() ? "---|" : "---:|";
  text += "\n";
  for (const auto& row : table.at("rows")) {
    text += "|";
    for (std::size_t i = 0; i < row.size(); ++i)
      text += " " + text_of_cell(row[i], columns.at(i).at("digits").get<int>()) + " |";
    text += "\n";
  }
  return text;
}

}  // namespace

std::string measured_markdown(const ordered_json& json) {
  std::string page = "# " + json.at("title").get<std::string>() + "\n\n";
  if (const auto about = json.at("about").get<std::string>(); !about.empty()) page += about + "\n\n";
  page += origin_line(json) + "\n";
  for (const auto& step : json.at("steps")) {
    page += "\n## " + step.at("title").get<std::string>() + "\n\n```sh\n";
    for (const auto& command : step.at("commands")) page += command.get<std::string>() + "\n";
    page += "```\n";
    for (const auto& table : json.at("tables"))
      if (table.at("label").get<std::string>().starts_with(step.at("name").get<std::string>() + "/"))
        page += "\n" + table_text(table);
  }
  return page;
}

}  // namespace weft
