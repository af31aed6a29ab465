#pragma once
#include <string>
#include <string_view>

#include "weft/config.hpp"
#include "weft/export.hpp"

namespace weft {

/// A config with the file, line and folder of every node, so that another process can read it: its messages name the
/// same lines, and its relative paths start where they did. One line of JSON, for programs; people get to_yaml().
WEFT_API std::string located_json(const ConfigNode& config);
/// @throws ConfigError for anything but a text from located_json().
WEFT_API ConfigNode read_located_json(std::string_view text);

}  // namespace weft
