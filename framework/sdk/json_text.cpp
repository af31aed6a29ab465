#include "sdk/json_text.hpp"

#include <algorithm>

namespace weft {

std::size_t json_levels(std::string_view text) {
  std::size_t level = 0, most = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '"') {
      for (++i; i < text.size() && text[i] != '"'; ++i) i += text[i] == '\\' ? 1 : 0;
    } else if (c == '/') {  // a comment, which may hold quotes and brackets
      const bool is_block = text.substr(i).starts_with("/*");
      const std::size_t end = text.find(is_block ? "*/" : "\n", i + (is_block ? 2 : 1));
      if (end == std::string_view::npos) break;
      i = end + (is_block ? 1 : 0);
    } else if (c == '[' || c == '{') {
      most = std::max(most, ++level);
    } else if ((c == ']' || c == '}') && level > 0) {
      --level;
    }
  }
  return most;
}

}  // namespace weft
