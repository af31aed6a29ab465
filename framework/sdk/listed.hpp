#pragma once
#include <string>
#include <vector>

#include "weft/export.hpp"

namespace weft {

/// "a, b, c"
WEFT_API std::string listed(const std::vector<std::string>& texts, const std::string& between = ", ");

}  // namespace weft
