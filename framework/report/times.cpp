#include "report/times.hpp"

#include <nlohmann/json.hpp>
#include <thread>

#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;

void join(ordered_json& result, const ordered_json& times) {
  if (result.is_object() && times.is_object()) {
    for (const auto& [name, value] : times.items()) {
      if (result.contains(name))
        join(result[name], value);
      else
        result[name] = value;
    }
  } else if (result.is_array() && times.is_array()) {
    for (std::size_t i = 0; i < std::min(result.size(), times.size()); ++i) join(result[i], times[i]);
  }
}

std::string saved_text(const ordered_json& json) {
  return json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

/// times.json of a folder; null if there is none.
ordered_json read_times(const std::filesystem::path& folder) {
  const auto file = folder / "times.json";
  const auto text = whole_text_if_there(file);
  if (!text) return nullptr;
  const auto times = parse_json_if_valid(*text);
  if (!times.is_object())
    throw ConfigError(file.string() + ": is damaged: no JSON object; remove it to go without times");
  return times;
}

}  // namespace

std::string times_json(int threads, const std::vector<std::pair<std::string, std::string>>& by_file) {
  ordered_json json{{"schema", "weft times 1"}, {"threads", threads}, {"cores", std::thread::hardware_concurrency()}};
  for (const auto& [file, times] : by_file) json[file] = ordered_json::parse(times);
  return saved_text(json);
}

std::string with_times(const std::string& json, const std::string& times) {
  ordered_json result = parse_json_if_valid(json);
  if (result.is_discarded()) throw ConfigError("a result that has times in times.json is not JSON");
  join(result, ordered_json::parse(times));
  return saved_text(result);
}

std::string with_times_of(const std::string& json, const std::filesystem::path& folder, const std::string& name) {
  const ordered_json times = read_times(folder);
  return times.contains(name) ? with_times(json, times[name].dump()) : json;
}

std::string with_machine_of(const std::string& provenance, const std::filesystem::path& folder) {
  const ordered_json times = read_times(folder);
  ordered_json machine = ordered_json::object();
  for (const char* key : {"threads", "cores"})
    if (times.contains(key)) machine[key] = times[key];
  return machine.empty() ? provenance : with_times(provenance, machine.dump());
}

}  // namespace weft
