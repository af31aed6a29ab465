#include <dlfcn.h>

#include <cstdlib>
#include <filesystem>
#include <mutex>

#include "kernels/kernels.hpp"
#include "training_library.hpp"

namespace weft::emd {

namespace {

/// Makes libtorch and OpenBLAS use the code for an instruction set. They read this when they are loaded.
void choose_instruction_set(const std::string& variant) {
  const bool v4 = variant == "v4" || variant == "amx", v3 = variant == "v3";
  ::setenv("ATEN_CPU_CAPABILITY", v4 ? "avx512" : v3 ? "avx2" : "default", 1);
  ::setenv("OPENBLAS_CORETYPE", v4 ? "SkylakeX" : v3 ? "Haswell" : "Nehalem", 1);
}

}  // namespace

void* training_function(const char* name, const std::string& kernels) {
  static std::mutex mutex;
  static void* library = nullptr;
  static std::string loaded_for;
  const std::lock_guard lock(mutex);
  const std::string variant = kernels == "auto" ? kernels_here().back() : kernels;
  if (library != nullptr && variant != loaded_for) {
    throw Unsupported("emd: this process trains with the kernels " + loaded_for + " already, so it cannot with " +
                      variant);
  }
  if (library == nullptr) {
    choose_instruction_set(variant);
    loaded_for = variant;
    // Beside the plugin's folder: lib/weft/plugins/<this plugin>, lib/weft/libweft_emd_training.so.
    Dl_info self{};
    if (dladdr(reinterpret_cast<const void*>(&training_function), &self) == 0)
      throw Unsupported("emd: cannot find its own library");
    const auto folder = std::filesystem::absolute(self.dli_fname).parent_path();
    std::string reason;
    for (const auto& place : {folder.parent_path(), folder, folder.parent_path() / "lib" / "weft"}) {
      const auto file = place / "libweft_emd_training.so";
      if (!std::filesystem::exists(file)) continue;
      library = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
      if (library != nullptr) break;
      reason = dlerror();
    }
    if (library == nullptr) {
      throw Unsupported(reason.empty()
                            ? "emd: this build cannot train: it was made without libtorch (Debian: libtorch-dev)"
                            : "emd: the training library cannot be loaded: " + reason);
    }
  }
  void* function = dlsym(library, name);
  if (function == nullptr) throw Unsupported(std::string("emd: the training library has no ") + name);
  return function;
}

}  // namespace weft::emd
