#include "sdk/machine_failure.hpp"

namespace weft {

WriteError::~WriteError() = default;
ReadError::~ReadError() = default;
OutOfMemory::~OutOfMemory() = default;

}  // namespace weft
