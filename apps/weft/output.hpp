#pragma once
#include <filesystem>
#include <string>

#include "context.hpp"
#include "simulation/task_config.hpp"

namespace weft::app {

/// The folder of a result: what --out names, or results/<name>. Made here. @throws ConfigError if it is a file.
std::filesystem::path output_folder(const Context& context, const std::string& name);

/// session.h5 of what a user names: the file, or the folder of a run. @throws ConfigError when there is none.
std::filesystem::path session_file(const std::string& given);

/// Version, commit, plugins used, threads and machine: enough, with the resolved config, to repeat a run exactly.
std::string provenance_json(const PluginRegistry& registry, const Host& host, std::uint64_t seed);

/// Makes the resolved config of a task independent of where its files lie: the garment goes into the folder as
/// garment.obj, the material space into the config itself, plugin slots get every default.
ConfigNode self_contained(const ConfigNode& resolved, const Task& task, const PluginRegistry& registry,
                          const std::filesystem::path& folder);

/// Writes text to a file whole or not at all. @throws Error.
void write_text(const std::filesystem::path& file, const std::string& text);

}  // namespace weft::app
