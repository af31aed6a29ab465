#include "garment_options.hpp"

#include <cstdio>

#include "options.hpp"

namespace weft::app {
namespace {

MeshSize::Line parse_line(const std::string& text) {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  int used = 0;
  if (std::sscanf(text.c_str(), "%lf,%lf,%lf,%lf%n", &x0, &y0, &x1, &y1, &used) != 4 ||
      static_cast<std::size_t>(used) != text.size() || !Vec2(x0, y0).allFinite() || !Vec2(x1, y1).allFinite()) {
    throw ConfigError("--fine-line = " + text + ", must be x0,y0,x1,y1 in metres");
  }
  return {Vec2(x0, y0), Vec2(x1, y1)};
}

}  // namespace

void add_fine_options(CLI::App& command, MeshSize& size, std::vector<std::string>& fine_lines) {
  command.add_option("--fine", size.fine_edge_m, "Edge length near the fine lines [m]; 0: uniform")
      ->check(within(0.0, 1.0));
  command.add_option("--fine-band", size.fine_band_m, "Distance to a fine line up to which edges are fine [m]")
      ->check(within(0.0, 10.0));
  command
      .add_option("--fine-line", fine_lines,
                  "x0,y0,x1,y1 [m]: where folds run (repeatable); default the vertical middle line")
      ->allow_extra_args(false);
  command.add_option("--growth", size.growth, "Growth of the edge length away from the band [m per m]")
      ->check(within(0.01, 1.0))
      ->capture_default_str();
}

void read_fine_lines(MeshSize& size, const std::vector<std::string>& fine_lines) {
  for (const auto& line : fine_lines) size.fine_lines.push_back(parse_line(line));
  if (size.fine_edge_m > 0.0 && size.fine_lines.empty()) {
    size.fine_lines.push_back({Vec2(0.0, -10.0), Vec2(0.0, 10.0)});
  }
}

std::string recorded_command(const CLI::App& command, const std::string& words) {
  std::string line = words;
  for (const CLI::Option* option : command.get_options()) {
    if (!option->get_positional()) continue;
    for (const std::string& value : option->results()) line += ' ' + std::filesystem::path(value).filename().string();
  }
  for (const CLI::Option* option : command.get_options()) {
    const std::string name = option->get_name();
    if (option->get_positional() || option->count() == 0 || name == "--help" || name == "--quiet" || name == "--json")
      continue;
    if (option->get_items_expected_max() == 0) {  // a flag
      line += ' ' + name;
      continue;
    }
    const bool one_name = option->get_items_expected_min() > 1;  // --grasp A B; others are repeated with each value
    bool first = true;
    for (const std::string& value : option->results()) {
      if (first || !one_name) line += ' ' + name;
      first = false;
      line += ' ' + (name == "--out" ? std::filesystem::path(value).filename().string() : value);
    }
  }
  return line;
}

}  // namespace weft::app
