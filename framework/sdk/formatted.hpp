#pragma once
#include <cstdio>
#include <string>

namespace weft {

/// snprintf as a text; what is longer than 239 characters is cut off.
template <class... Values>
std::string formatted(const char* format, Values... values) {
  char text[240];
  std::snprintf(text, sizeof(text), format, values...);
  return text;
}

}  // namespace weft
