#include "paper_options.hpp"

#include <unistd.h>

#include <cstdlib>
#include <sstream>

#include "output.hpp"
#include "processes/child_process.hpp"
#include "report/paper_tables.hpp"
#include "sdk/files.hpp"

namespace weft::app {
namespace {

/// A program of PATH by one of its names; empty if there is none.
std::string program_in_path(const std::vector<std::string>& names) {
  const char* path = std::getenv("PATH");
  for (const auto& name : names) {
    std::istringstream folders(path != nullptr ? path : "");
    for (std::string folder; std::getline(folders, folder, ':');)
      if (const std::string file = folder + "/" + name; !folder.empty() && access(file.c_str(), X_OK) == 0) return file;
  }
  return "";
}

std::string node() { return program_in_path({"node", "nodejs"}); }
/// The page's figures as a program for node, which the build makes with the page.
std::filesystem::path figures_program() { return tree_of_weft() / "share" / "weft" / "report" / "figures.mjs"; }

/// Why figures of this format cannot be drawn here; empty if they can.
std::string why_no_figures(const std::string& format) {
  if (format != "svg" && format != "pdf") return format + " not in {svg,pdf}";
  if (node().empty()) return format + ": figures need node, which is not in PATH (Debian: nodejs)";
  if (!std::filesystem::exists(figures_program()))
    return format + ": this build of weft has no figures, as it has no page (docs/report.md)";
  if (format == "pdf" && program_in_path({"rsvg-convert"}).empty())
    return "pdf: needs rsvg-convert, which is not in PATH (Debian: librsvg2-bin)";
  return "";
}

void draw_figures(const std::filesystem::path& folder, const std::vector<std::string>& formats) {
  ChildOptions options;
  options.command = {node(), figures_program().string(), folder.string()};
  options.command.insert(options.command.end(), formats.begin(), formats.end());
  options.keep_errors = true;
  ChildProcess child(options);
  child.close_input();
  const MonotonicTime deadline = seconds_from_now(600.0);
  std::string line;
  while (child.read_line(line, deadline) == ChildProcess::Outcome::done) continue;
  const auto end = child.wait_until(deadline);
  if (!end || end->exit_code != 0)
    throw Error("the figures could not be drawn: node " + (end ? end->text() : "did not end within 10 minutes") + "\n" +
                child.errors());
}

}  // namespace

void add_paper_options(CLI::App& command, PaperOptions& options) {
  command
      .add_option(
          "--table", options.tables,
          "Also write the results as tables for papers: markdown (tables.md), latex (tables.tex), or both with a comma")
      ->delimiter(',')
      ->check(CLI::IsMember({"markdown", "latex"}))
      ->allow_extra_args(false);
  add_figures_option(command, options.figures);
}

void add_figures_option(CLI::App& command, std::vector<std::string>& formats) {
  command
      .add_option("--figures", formats,
                  "Also draw the page's figures for papers: svg, pdf, or both with a comma, and their data as CSV")
      ->delimiter(',')
      ->check(CLI::Validator(why_no_figures, "{svg,pdf}"))
      ->allow_extra_args(false);
}

void write_paper(const Context& context, const std::filesystem::path& folder, const PaperOptions& options) {
  if (!options.tables.empty()) {
    const auto tables = paper_tables(folder);
    for (const auto& format : options.tables) {
      const bool latex = format == "latex";
      const auto file = folder / (latex ? "tables.tex" : "tables.md");
      write_text(file, latex ? latex_of(tables) : markdown_of(tables));
      context.say("tables: " + file.string());
    }
  }
  if (!options.figures.empty()) {
    draw_figures(folder, options.figures);
    if (std::filesystem::exists(folder / "figures")) context.say("figures: " + (folder / "figures").string());
  }
}

}  // namespace weft::app
