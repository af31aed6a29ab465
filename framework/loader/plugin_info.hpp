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

/// Why a file can be no plugin library, from its first bytes and its size; empty if it can. An empty file, a pointer of Git
/// LFS and a library that was cut short have reasons of their own.
std::string no_library(const std::filesystem::path& file);

/// Why a library that cannot be loaded is built for another weft, from the bytes of its file; empty if it is not, or holds no
/// info. Other types have other names, so such a library lacks symbols, which says nothing to its author.
std::string other_abi_in(const std::filesystem::path& file);

}  // namespace weft
