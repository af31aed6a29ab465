#pragma once
#include <string>
#include <vector>

#include "context.hpp"
#include "meshes/mesher.hpp"
#include "options.hpp"
#include "simulation/lay.hpp"

namespace weft::app {

/// Turns the fields of a size struct into options: sleeve_length_m becomes --sleeve-length, in metres.
struct OptionVisitor {
  CLI::App& command;
  void operator()(const char* name, double& value, const Range& allowed, const char* text) const {
    std::string option = name;
    for (const char* unit : {"_kg_per_m2", "_n_per_m", "_n_m", "_per_s", "_deg", "_m", "_s"}) {
      const std::string suffix = unit;
      if (option.size() > suffix.size() && option.compare(option.size() - suffix.size(), suffix.size(), suffix) == 0) {
        option.resize(option.size() - suffix.size());
        break;
      }
    }
    for (char& c : option) c = c == '_' ? '-' : c;
    command.add_option("--" + option, value, std::string(text) + " [" + allowed.unit + "]")
        ->check(within(allowed.lower, allowed.upper))
        ->capture_default_str();
  }
};
/// Adds an option for each field.
template <class Size>
void add_size_options(CLI::App& command, Size& size) {
  OptionVisitor visitor{command};
  size.visit(visitor);
}

/// Lays a garment with a simulator plugin.
LaidGarment lay_with(Context& context, const Garment& garment, const std::string& simulator, const LayParams& params);
/// The garment as it lies: its layers are its start.
Garment laid_garment(const Garment& garment, const LaidGarment& laid);
/// What was done, in a line; and what is wrong with it when it crosses itself.
std::string laid_text(const LaidGarment& laid);
std::string crossing_text(const Garment& drawn, const LaidGarment& laid);

/// Adds --fine, --fine-band, --fine-line and --growth: where edges are shorter.
void add_fine_options(CLI::App& command, MeshSize& size, std::vector<std::string>& fine_lines);

/// Puts the given lines into the size; without any, a fine edge length gets the vertical middle line. @throws
/// ConfigError.
void read_fine_lines(MeshSize& size, const std::vector<std::string>& fine_lines);

/// The command and its options as they were typed, without folders: it makes the same files again.
std::string recorded_command(const CLI::App& command, const std::string& words);

}  // namespace weft::app
