#include <dlfcn.h>

#include <filesystem>
#include <mutex>

#include "training_library.hpp"

namespace weft::emd {

void* training_function(const char* name) {
  static std::mutex mutex;
  static void* library = nullptr;
  const std::lock_guard lock(mutex);
  if (library == nullptr) {
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
