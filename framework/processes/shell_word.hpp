#pragma once
#include <string>

namespace weft {

/// A word for the shell.
std::string shell_word(const std::string& text);

}  // namespace weft
