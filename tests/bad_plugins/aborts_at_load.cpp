#include <cstdlib>

namespace {

[[maybe_unused]] const bool never = [] {
  std::abort();
  return true;
}();

}  // namespace
