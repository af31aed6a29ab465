#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "context.hpp"

namespace weft::app {

/// What a command writes for papers besides its results.
struct PaperOptions {
  std::vector<std::string> tables;   ///< markdown, latex
  std::vector<std::string> figures;  ///< svg, pdf
};
/// Adds --table and --figures. A figure that cannot be drawn here, because a program is missing, is refused at once.
void add_paper_options(CLI::App& command, PaperOptions& options);
/// --figures alone. @param formats svg, pdf.
void add_figures_option(CLI::App& command, std::vector<std::string>& formats);

/// Writes folder/tables.md, tables.tex and figures/ from the results in the folder, as far as they are wanted, and says so.
/// @throws Error if the figures cannot be drawn.
void write_paper(const Context& context, const std::filesystem::path& folder, const PaperOptions& options);

}  // namespace weft::app
