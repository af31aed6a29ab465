#include <cfenv>

#include "bad_plugins/bad_plugin.hpp"

namespace {

/// What a library that was linked with -ffast-math does as it is loaded (crtfastmath.o), and worse.
[[maybe_unused]] const bool changes_arithmetic = [] {
#ifdef __SSE2__
  __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);  // results and operands below 2.2e-308 become 0
#endif
  return std::fesetround(FE_UPWARD) == 0;
}();

}  // namespace

WEFT_PLUGIN(weft::Trajectory, weft::test::Toy, weft::test::NoParams, "good", "1.0.0")
