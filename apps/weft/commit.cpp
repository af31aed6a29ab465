#include "commit.hpp"

#include "weft_commit.hpp"

// The only source that a commit compiles again: a small one, not part of the others.

namespace weft::app {

const char* commit() { return WEFT_COMMIT; }

}  // namespace weft::app
