#include "kernels.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>

namespace weft::emd {

namespace v2 {
extern const Kernels table;
}
#if defined(__x86_64__)
namespace v3 {
extern const Kernels table;
}
namespace v4 {
extern const Kernels table;
}
#endif

void Kernels::pack(std::size_t k, std::size_t n, const float* b, std::size_t row_stride, std::size_t column_stride,
                   float* packed) const {
  for (std::size_t column = 0; column < n; column += panel) {
    const std::size_t columns = std::min(panel, n - column);
    for (std::size_t i = 0; i < k; ++i, packed += panel) {
      const float* from = b + i * row_stride + column * column_stride;
      for (std::size_t j = 0; j < panel; ++j) packed[j] = j < columns ? from[j * column_stride] : 0.0f;
    }
  }
}

const Kernels* find_kernels(const char* name) {
  if (std::strcmp(name, "v2") == 0) return &v2::table;
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (std::strcmp(name, "v3") == 0 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    return &v3::table;
  if (std::strcmp(name, "v4") == 0 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
    return &v4::table;
  }
#endif
  return nullptr;
}

const Kernels& kernels() {
  static const Kernels& chosen = []() -> const Kernels& {
    if (const char* wanted = std::getenv("WEFT_EMD_ISA")) {
      if (const Kernels* found = find_kernels(wanted)) return *found;
    }
    for (const char* name : {"v4", "v3"}) {
      if (const Kernels* found = find_kernels(name)) return *found;
    }
    return v2::table;
  }();
  return chosen;
}

}  // namespace weft::emd
