#pragma once
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

/// times.json: what a clock or the machine gave. It lies beside the results, so that these are the same bytes in two
/// equal runs.
namespace weft {

/// The text of times.json: threads, cores, and the times of every result file as a JSON object of that file's form.
std::string times_json(int threads, const std::vector<std::pair<std::string, std::string>>& by_file);

/// A result with its times again: objects are joined key by key, lists entry by entry.
std::string with_times(const std::string& json, const std::string& times);
/// The same with the times that folder/times.json has for a result file of this name; without them the result as it is.
/// @throws ConfigError if times.json is damaged.
std::string with_times_of(const std::string& json, const std::filesystem::path& folder, const std::string& name);

/// A provenance with threads and cores again.
std::string with_machine_of(const std::string& provenance, const std::filesystem::path& folder);

}  // namespace weft
