#pragma once
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "loader/registry.hpp"

namespace weft {

struct WeftPluginInfo;

/// simulator, predictor, trajectory, optimiser.
const std::vector<std::string>& plugin_kinds();

/// The kind and name in libweft_KIND_NAME.so, the file that weft_add_plugin() makes; two empty strings for all others.
std::pair<std::string, std::string> named_by(const std::filesystem::path& file);

/// The entry of a library with this info. Reads nothing but the struct, whose bytes may be anything.
/// @throws PluginError with the reason, both sides and the remedy.
PluginEntry checked_plugin_info(const WeftPluginInfo& info, const std::filesystem::path& file);

}  // namespace weft
