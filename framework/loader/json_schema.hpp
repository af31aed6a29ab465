#pragma once
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "loader/registry.hpp"
#include "weft/params.hpp"

namespace weft {

/// A JSON Schema (draft 2020-12) for editors, from the same visit() as `weft describe`: keys, types, ranges, choices,
/// defaults, and units and texts as descriptions. It accepts what read_params() accepts. What a component reads itself is
/// open: any value.
/// The parameters of a slot are those of the plugin it names, if the registry finds it. A name that the registry does not
/// find is refused; a library file may be named.
/// @param is_file for a config file, which may say `extends`.
nlohmann::ordered_json json_schema(const std::string& title, const std::function<void(ParamVisitor&)>& visit,
                                   bool is_file, const PluginRegistry& registry);

}  // namespace weft
