#include "sdk/yaml_lines.hpp"

#include <algorithm>
#include <cstdint>

namespace weft {
namespace {

bool is_blank(char c) { return c == ' ' || c == '\t'; }

/// The column behind the text that is quoted from column `i` on, or npos if it does not end on this line.
std::size_t behind_quoted(std::string_view line, std::size_t i) {
  const char quote = line[i];
  for (++i; i < line.size(); ++i) {
    if (quote == '"' && line[i] == '\\') {
      ++i;
    } else if (line[i] == quote) {
      if (quote == '"' || i + 1 == line.size() || line[i + 1] != '\'') return i + 1;
      ++i;  // '' is one apostrophe
    }
  }
  return std::string_view::npos;
}

std::size_t indentation(std::string_view line) { return line.find_first_not_of(" \t"); }

}  // namespace

std::vector<std::string_view> yaml_lines(std::string_view text) {
  if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
  std::vector<std::string_view> lines;
  for (std::size_t begin = 0; begin <= text.size();) {
    const auto end = std::min(text.find('\n', begin), text.size());
    lines.push_back(text.substr(begin, end - begin));
    begin = end + 1;
  }
  return lines;
}

int line_that_is_not_utf8(std::string_view text) {
  int line = 1;
  for (std::size_t i = 0; i < text.size();) {
    const auto byte = [&](std::size_t k) { return k < text.size() ? static_cast<unsigned char>(text[k]) : 0u; };
    const unsigned first = byte(i);
    if (first == '\n') ++line;
    const std::size_t length = first < 0x80         ? 1
                               : first >> 5 == 0x6  ? 2
                               : first >> 4 == 0xe  ? 3
                               : first >> 3 == 0x1e ? 4
                                                    : 0;
    if (length == 0) return line;
    std::uint32_t code = length == 1 ? first : first & (0x7fu >> length);
    for (std::size_t k = 1; k < length; ++k) {
      if (byte(i + k) >> 6 != 0x2) return line;
      code = code << 6 | (byte(i + k) & 0x3fu);
    }
    constexpr std::uint32_t kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
    if (code < kLeast[length] || code > 0x10ffff || (code >= 0xd800 && code <= 0xdfff)) return line;
    i += length;
  }
  return 0;
}

bool has_open_quote_at(std::string_view line, std::size_t column) {
  std::size_t i = column;
  while (i < line.size() && (line[i] == '&' || line[i] == '!')) {  // anchor and tag come before the quote
    while (i < line.size() && !is_blank(line[i])) ++i;
    while (i < line.size() && is_blank(line[i])) ++i;
  }
  return i < line.size() && (line[i] == '"' || line[i] == '\'') && behind_quoted(line, i) == std::string_view::npos;
}

int line_with_open_quote(const std::vector<std::string_view>& lines) {
  for (std::size_t n = 0; n < lines.size(); ++n) {
    const std::string_view line = lines[n];
    bool may_begin = true;  // a value or key may begin here; within one, a quote is an ordinary character
    for (std::size_t i = 0; i < line.size(); ++i) {
      const char c = line[i];
      const bool blank_follows = i + 1 == line.size() || is_blank(line[i + 1]) || line[i + 1] == '\r';
      if (is_blank(c)) continue;
      if (c == '#' && (i == 0 || is_blank(line[i - 1]))) break;
      if (may_begin && (c == '"' || c == '\'')) {
        i = behind_quoted(line, i);
        if (i == std::string_view::npos) return static_cast<int>(n) + 1;
        --i;
        may_begin = false;
      } else if (may_begin && (c == '|' || c == '>')) {  // a block: text up to the next line that is not indented more
        while (n + 1 < lines.size() &&
               (indentation(lines[n + 1]) == std::string_view::npos || indentation(lines[n + 1]) > indentation(line)))
          ++n;
        break;
      } else if (may_begin && (c == '&' || c == '!')) {
        while (i + 1 < line.size() && !is_blank(line[i + 1])) ++i;
      } else if (!(may_begin && (c == '-' || c == '?') && blank_follows)) {
        may_begin = c == '[' || c == '{' || c == ',' || (c == ':' && blank_follows);
      }
    }
  }
  return 0;
}

bool is_indented_with_tab(std::string_view line) {
  return line.substr(0, indentation(line)).find('\t') != std::string_view::npos;
}

}  // namespace weft
