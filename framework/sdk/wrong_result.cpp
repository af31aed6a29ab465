#include "sdk/wrong_result.hpp"

namespace weft {

WrongResult::~WrongResult() = default;
NotFinite::~NotFinite() = default;

}  // namespace weft
