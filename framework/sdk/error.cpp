#include "weft/error.hpp"

namespace weft {

// Out of line, so that the type information of each class is in this library only.
Error::~Error() = default;
ShapeError::~ShapeError() = default;
ConfigError::~ConfigError() = default;
PluginError::~PluginError() = default;
Unsupported::~Unsupported() = default;
Diverged::~Diverged() = default;

void require_shape(const std::string& what, std::ptrdiff_t got, std::ptrdiff_t wanted) {
  if (got != wanted) throw ShapeError(what + " = " + std::to_string(got) + ", must be " + std::to_string(wanted));
}

}  // namespace weft
