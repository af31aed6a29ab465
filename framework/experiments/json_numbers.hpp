#pragma once
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

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

}  // namespace weft
