#include "kernels.hpp"

#if defined(__x86_64__)
#include <cpuid.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

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
namespace amx {
extern const Kernels table;
}
#endif

#if defined(__x86_64__)
namespace {

/// Whether the processor has AMX tiles of bfloat16, and the kernel lets this process use them.
bool has_amx() {
  constexpr unsigned kTiles = 1u << 24, kTileProducts = 1u << 22, kConversions = 1u << 5;
  unsigned a = 0, b = 0, c = 0, d = 0;
  if (__get_cpuid_count(7, 0, &a, &b, &c, &d) == 0 || (d & kTiles) == 0 || (d & kTileProducts) == 0) return false;
  if (__get_cpuid_count(7, 1, &a, &b, &c, &d) == 0 || (a & kConversions) == 0) return false;
  constexpr long kRequestPermission = 0x1023, kTileData = 18;  // Linux: Documentation/arch/x86/xstate.rst
  return ::syscall(SYS_arch_prctl, kRequestPermission, kTileData) == 0;
}

}  // namespace
#endif

const Kernels* find_kernels(const char* name) {
  if (std::strcmp(name, "v2") == 0) return &v2::table;
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (std::strcmp(name, "v3") == 0 && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    return &v3::table;
  const bool is_v4 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                     __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                     __builtin_cpu_supports("avx512vl");
  if (std::strcmp(name, "v4") == 0 && is_v4) return &v4::table;
  if (std::strcmp(name, "amx") == 0 && is_v4) {
    static const bool has_tiles = has_amx();
    return has_tiles ? &amx::table : nullptr;
  }
#endif
  return nullptr;
}

std::vector<std::string> kernels_here() {
  std::vector<std::string> names;
  for (const char* name : {"v2", "v3", "v4", "amx"})
    if (find_kernels(name) != nullptr) names.emplace_back(name);
  return names;
}

const Kernels& kernels(const std::string& name) {
  const Kernels* found = find_kernels(name == "auto" ? kernels_here().back().c_str() : name.c_str());
  if (found == nullptr) throw Unsupported("emd: this processor cannot run the kernels '" + name + "'");
  return *found;
}

}  // namespace weft::emd
