#pragma once
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

namespace weft {

/// JSON has no NaN: null stands for what is not finite.
inline nlohmann::ordered_json json_number(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}
inline double number_of(const nlohmann::ordered_json& json) {
  return json.is_null() ? std::numeric_limits<double>::quiet_NaN() : json.get<double>();
}

}  // namespace weft
