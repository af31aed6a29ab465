#pragma once
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

/// Tables for papers, as Markdown and LaTeX, from the results that a folder holds.
namespace weft {

struct PaperColumn {
  static constexpr int kSignificant = -1;     ///< four significant digits
  static constexpr int kTwoSignificant = -2;  ///< two

  std::string name;  ///< "median_95": unique in its table
  std::string head;  ///< "95 %": what the table shows; the unit comes after it
  std::string unit;  ///< of the numbers; empty: none
  int digits = 0;    ///< after the point, or one of the constants
};

struct PaperTable {
  std::string label;    ///< "ablation-error_mm": unique among the tables of a folder
  std::string caption;  ///< plain text
  std::vector<PaperColumn> columns;
  /// As many cells as columns. A cell is a text, a number with all its digits, an interval [lower, upper], or null: nothing
  /// to show.
  std::vector<std::vector<nlohmann::ordered_json>> rows;
  std::size_t texts = 1;  ///< the first columns, which are words; the others are numbers
};

/// The tables of ablation.json, planning.json, estimation.json, prediction.json and physics.json, as far as the folder has
/// them. @throws ConfigError for damaged files.
std::vector<PaperTable> paper_tables(const std::filesystem::path& folder);

/// A cell as the tables show it. @throws nlohmann::json::exception for what is no cell.
std::string cell_text(const nlohmann::ordered_json& cell, const PaperColumn& column);

/// Head and rows.
std::string markdown_of(const PaperTable& table);
/// The same of several, each under its caption.
std::string markdown_of(const std::vector<PaperTable>& tables);
/// With the rules of the package booktabs.
std::string latex_of(const std::vector<PaperTable>& tables);

}  // namespace weft
