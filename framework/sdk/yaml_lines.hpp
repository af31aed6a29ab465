#pragma once
#include <cstddef>
#include <string_view>
#include <vector>

// What yaml-cpp does not tell: where a quoted text ends, and which line a syntax error comes from.

namespace weft {

inline constexpr const char* kOpenQuote =
    "a quote begins on this line and does not end on it; close it, or write a long text as a block (`key: |`)";

/// The lines of a text, without its byte order mark.
std::vector<std::string_view> yaml_lines(std::string_view text);

/// The first line with a byte that is not UTF-8; 0: none.
int line_that_is_not_utf8(std::string_view text);

/// Whether a quoted text, or its anchor or tag, begins at this column and the text does not end on the line.
bool has_open_quote_at(std::string_view line, std::size_t column);

/// The first line of a file that is not YAML on which a quote stays open; 0: none. Errors that such a quote causes are
/// reported far behind it.
int line_with_open_quote(const std::vector<std::string_view>& lines);

bool is_indented_with_tab(std::string_view line);

}  // namespace weft
