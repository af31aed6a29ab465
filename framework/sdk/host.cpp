#include "weft/host.hpp"

namespace weft {

Host::~Host() = default;

}  // namespace weft
