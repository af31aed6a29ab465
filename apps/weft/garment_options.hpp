#pragma once
#include <string>
#include <vector>

#include "context.hpp"
#include "meshes/mesher.hpp"

namespace weft::app {

/// Adds --fine, --fine-band, --fine-line and --growth: where edges are shorter.
void add_fine_options(CLI::App& command, MeshSize& size, std::vector<std::string>& fine_lines);

/// Puts the given lines into the size; without any, a fine edge length gets the vertical middle line. @throws
/// ConfigError.
void read_fine_lines(MeshSize& size, const std::vector<std::string>& fine_lines);

/// The command and its options as they were typed, without folders: it makes the same files again.
std::string recorded_command(const CLI::App& command, const std::string& words);

}  // namespace weft::app
