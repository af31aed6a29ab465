#include "weft/host.hpp"

namespace weft {

Host::~Host() = default;

std::vector<ConfigNode> Host::files(const std::string&, const ConfigNode&) { return {}; }

}  // namespace weft
