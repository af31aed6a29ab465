#pragma once
#include <string>

/// Fields of a CSV file [RFC 4180].
namespace weft {

std::string csv_quoted(const std::string& text);
/// The text, in quotes where it needs them.
std::string csv_field(const std::string& text);
/// The shortest text of at least 6 digits that reads back to the same number; empty if it is not finite.
std::string csv_number(double value);

}  // namespace weft
