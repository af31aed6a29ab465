#pragma once
#include <nlohmann/json.hpp>
#include <string_view>

#include "weft/export.hpp"

// JSON from files and from other programs. Copying, comparing and printing a value call themselves once for every level,
// so text that is nested deeper than anything weft writes is refused before it becomes a value.

namespace weft {

inline constexpr std::size_t kMostJsonLevels = 100;

/// Levels of brackets in a text. What is not JSON gives any number.
WEFT_API std::size_t json_levels(std::string_view text);

/// @param comments // and /* */ are allowed. @throws nlohmann::json::exception if it is not JSON or is nested too deep.
template <class Json = nlohmann::ordered_json>
Json parse_json(std::string_view text, bool comments = false) {
  if (json_levels(text) > kMostJsonLevels) {
    throw nlohmann::json::other_error::create(501, "nested deeper than " + std::to_string(kMostJsonLevels) + " levels",
                                              nullptr);
  }
  return Json::parse(text, nullptr, true, comments);
}

/// The same without exceptions: is_discarded() if it is not JSON or is nested too deep.
template <class Json = nlohmann::ordered_json>
Json parse_json_if_valid(std::string_view text) {
  if (json_levels(text) > kMostJsonLevels) return Json(Json::value_t::discarded);
  return Json::parse(text, nullptr, false);
}

}  // namespace weft
