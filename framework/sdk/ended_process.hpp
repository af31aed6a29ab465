#pragma once
#include <sys/types.h>

#include "weft/export.hpp"

namespace weft {

/// Whether no thread of a process of this machine runs any more: there is no process of this number, or it has ended and nobody
/// has asked how (a zombie; where the first process of a container reaps nothing, it stays).
WEFT_API bool has_ended(pid_t process);

}  // namespace weft
