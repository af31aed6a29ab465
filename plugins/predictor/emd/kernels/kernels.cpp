#include "kernels.hpp"

#include <algorithm>
#include <cstring>

#include "weft/error.hpp"

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

std::vector<std::string> kernels_here() {
  std::vector<std::string> names;
  for (const char* name : {"v2", "v3", "v4"})
    if (find_kernels(name) != nullptr) names.emplace_back(name);
  return names;
}

const Kernels& kernels(const std::string& name) {
  const Kernels* found = find_kernels(name == "auto" ? kernels_here().back().c_str() : name.c_str());
  if (found == nullptr) throw Unsupported("emd: this processor cannot run the kernels '" + name + "'");
  return *found;
}

}  // namespace weft::emd
