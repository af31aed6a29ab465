#include "sdk/located_config.hpp"

#include <nlohmann/json.hpp>

#include "sdk/config_data.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;
using Access = ConfigNodeAccess;

ordered_json to_located(const ConfigNode& node) {
  const auto& data = Access::data(node);
  ordered_json json{
      {"kind", static_cast<int>(data.kind)}, {"file", data.file}, {"line", data.line}, {"path", data.path}};
  // A folder may be relative to this process's working folder.
  json["folder"] = data.folder.empty() ? std::string() : std::filesystem::absolute(data.folder).string();
  switch (data.kind) {
    case ConfigNode::Kind::null:
      break;
    case ConfigNode::Kind::scalar:
      json["text"] = data.text;
      json["quoted"] = data.is_quoted;
      break;
    case ConfigNode::Kind::sequence:
      json["items"] = ordered_json::array();
      for (const auto& item : data.items) json["items"].push_back(to_located(item));
      break;
    case ConfigNode::Kind::mapping:
      json["entries"] = ordered_json::array();
      for (const auto& [key, value] : data.entries) json["entries"].push_back({key, to_located(value)});
      break;
  }
  return json;
}

ConfigNode from_located(const ordered_json& json) {
  Access::Data data;
  const int kind = json.at("kind").get<int>();
  if (kind < 0 || kind > static_cast<int>(ConfigNode::Kind::mapping)) throw ConfigError("no kind of node");
  data.kind = static_cast<ConfigNode::Kind>(kind);
  data.file = json.at("file").get<std::string>();
  data.line = json.at("line").get<int>();
  data.path = json.at("path").get<std::string>();
  data.folder = json.at("folder").get<std::string>();
  if (data.kind == ConfigNode::Kind::scalar) {
    data.text = json.at("text").get<std::string>();
    data.is_quoted = json.at("quoted").get<bool>();
  }
  if (data.kind == ConfigNode::Kind::sequence)
    for (const auto& item : json.at("items")) data.items.push_back(from_located(item));
  if (data.kind == ConfigNode::Kind::mapping)
    for (const auto& entry : json.at("entries"))
      data.entries.emplace_back(entry.at(0).get<std::string>(), from_located(entry.at(1)));
  return Access::make(std::move(data));
}

}  // namespace

std::string located_json(const ConfigNode& config) {
  return to_located(config).dump(-1, ' ', true, ordered_json::error_handler_t::replace);
}

ConfigNode read_located_json(std::string_view text) {
  try {
    return from_located(ordered_json::parse(text));
  } catch (const nlohmann::json::exception& error) {
    throw ConfigError(std::string("is no located config: ") + error.what());
  }
}

}  // namespace weft
