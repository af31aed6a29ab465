#pragma once
#include <filesystem>
#include <string>
#include <vector>

/// Tables for papers, as Markdown and LaTeX, from the results that a folder holds.
namespace weft {

struct PaperTable {
  std::string label;    ///< "ablation-error_mm": unique among the tables of a folder
  std::string caption;  ///< plain text
  std::vector<std::string> head;
  std::vector<std::vector<std::string>> rows;  ///< each as long as the head; "": nothing to show
  std::size_t texts = 1;                       ///< the first columns, which are words; the others are numbers
};

/// The tables of ablation.json, planning.json, estimation.json, prediction.json and physics.json, as far as the folder has
/// them. @throws ConfigError for damaged files.
std::vector<PaperTable> paper_tables(const std::filesystem::path& folder);

std::string markdown_of(const std::vector<PaperTable>& tables);
/// With the rules of the package booktabs.
std::string latex_of(const std::vector<PaperTable>& tables);

}  // namespace weft
