#pragma once
#include <string>
#include <string_view>
#include <vector>

#include "weft/config.hpp"

// How a refusal says where, which key, what it got and what is allowed. Beside ConfigNode::fail().

namespace weft {

/// The node at a dotted key path ("goal.material", "pins.0"), for messages about it: where there is none, null, in the
/// place of the innermost node on the path that there is.
WEFT_API ConfigNode place(const ConfigNode& config, std::string_view dotted_path);

/// A value in a message: 5, "5" if quoted, [1, 2], a mapping.
WEFT_API std::string shown(const ConfigNode& node);
/// "one of A, B, C".
WEFT_API std::string one_of(const std::vector<std::string>& allowed);
/// "; nearest: ENTRY" for the end of a message; empty when more than two letters, and half of them, differ.
WEFT_API std::string nearest_hint(std::string_view word, const std::vector<std::string>& known);

/// @throws ConfigError "<where>: <path> = <got>, must be <wanted>".
[[noreturn]] WEFT_API void must_be(const ConfigNode& node, const std::string& wanted);
/// For what a value leads to: a file, a name. @throws ConfigError "<where>: <path> = <got>: <reason>".
[[noreturn]] WEFT_API void fail_because(const ConfigNode& node, const std::string& reason);

/// What `read` returns; its ConfigError is blamed on the node, as fail_because() does.
template <class Read>
auto blaming(const ConfigNode& node, Read&& read) {
  try {
    return read();
  } catch (const ConfigError& error) {
    fail_because(node, error.what());
  }
}

}  // namespace weft
