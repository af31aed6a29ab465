#pragma once
#include <charconv>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "weft/error.hpp"

namespace weft {

/// JSON has no NaN, so null replaces non-finite numbers.
inline nlohmann::ordered_json json_number(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}
inline nlohmann::ordered_json json_interval(const std::pair<double, double>& interval) {
  return nlohmann::ordered_json::array({json_number(interval.first), json_number(interval.second)});
}
/// As files hold it; bytes that are not UTF-8 are replaced.
inline std::string text_of_json(const nlohmann::ordered_json& json) {
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}
inline double number_of(const nlohmann::ordered_json& json) {
  return json.is_null() ? std::numeric_limits<double>::quiet_NaN() : json.get<double>();
}

/// A number as it is, also infinity, which JSON has not.
inline std::string exact(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof(text), value).ptr};
}
/// @throws ConfigError unless it is from exact().
inline double exact_of(const nlohmann::ordered_json& json) {
  const auto& text = json.get_ref<const std::string&>();
  double value = 0.0;
  if (std::from_chars(text.data(), text.data() + text.size(), value).ec != std::errc())
    throw ConfigError("'" + text + "' is not a number");
  return value;
}

}  // namespace weft
