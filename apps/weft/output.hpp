#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "context.hpp"
#include "sdk/files.hpp"
#include "simulation/task_config.hpp"

namespace weft::app {

/// The folder of a result: what --out names, or results/<name>. Made here. @throws ConfigError if it
/// cannot be made or written to.
std::filesystem::path output_folder(const Context& context, const std::string& name);

/// session.h5 of the path that a user gives: the file, or the folder of a run. @throws ConfigError when there is none.
std::filesystem::path session_file(const std::string& given);

/// Version, commit, plugins used, threads and machine: enough, with the resolved config, to repeat a run exactly.
std::string provenance_json(const PluginRegistry& registry, const Host& host, std::uint64_t seed);

/// Makes the resolved config of a task independent of where its files lie: the garment goes into the folder as
/// garment.obj, the material space into the config itself, every plugin slot gets every default.
/// @param params the config's keys: describe_params<...>().
ConfigNode self_contained(const ConfigNode& resolved, const std::vector<ParamInfo>& params, const Task& task,
                          const PluginRegistry& registry, const std::filesystem::path& folder);
/// The same without the garment's file, which write_garment() writes.
ConfigNode self_contained(const ConfigNode& resolved, const std::vector<ParamInfo>& params, const Task& task,
                          const PluginRegistry& registry);
/// Writes the task's garment as folder/garment.obj.
void write_garment(const Task& task, const std::filesystem::path& folder);

/// Writes folder/report.html from the results in the folder. Says where the page is, or why there is none.
void write_page(const Context& context, const std::filesystem::path& folder);

}  // namespace weft::app
