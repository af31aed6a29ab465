#pragma once
#include <string>
#include <string_view>

#include "processes/work_status.hpp"
#include "weft/dataset.hpp"

namespace weft {

/// How a line begins that says, in the place of an example, why there is none.
inline constexpr std::string_view kNoExample = "no example: ";
std::string no_example_line(const WorkFailure& failure);
/// @param line begins with kNoExample. @throws ConfigError for another status than those of WorkStatus.
WorkFailure read_no_example(std::string_view line);

/// An example as one word of hexadecimal digits, for a pipe between two processes of one weft. Every bit is kept.
std::string example_to_hex(const Example& example);
/// @throws ConfigError for anything but a word from example_to_hex().
Example example_from_hex(std::string_view hex);

}  // namespace weft
