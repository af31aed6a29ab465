// The targets under libFuzzer: weft_fuzz TARGET [OPTION|FOLDER...], see README.md.
#include <hdf5.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>

#include "fuzz.hpp"

namespace {

using namespace weft::fuzz;

const Target* target = nullptr;
constexpr const char* kVariable = "WEFT_FUZZ_TARGET";  // for the processes that libFuzzer starts itself

/// What the mutator may insert, in libFuzzer's form.
std::string dictionary() {
  const auto file = world().file("words.dict");
  std::ofstream out(file);
  for (const std::string& word : words_of_target(target->name)) {
    out << '"';
    for (const char c : word) {
      char text[8];
      std::snprintf(text, sizeof text, "\\x%02x", static_cast<unsigned char>(c));
      out << text;
    }
    out << "\"\n";
  }
  return file.string();
}

}  // namespace

// Short stacks of allocations: most of the time of a target goes into malloc(). A finding is run again with longer ones.
extern "C" const char* __asan_default_options() {
  return "quarantine_size_mb=16:detect_leaks=0:malloc_context_size=2:allocator_release_to_os_interval_ms=-1";
}

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  // An edit can make a file that libhdf5's writer cannot close, and the library then crashes as it cleans up at the end. Whether
  // weft's reading leaves something open is checked after each input.
  H5dont_atexit();
  static std::vector<char*> arguments(*argv, *argv + *argc);
  const char* name = std::getenv(kVariable);
  if (name == nullptr && arguments.size() > 1) {
    name = arguments[1];
    setenv(kVariable, name, 1);
    arguments.erase(arguments.begin() + 1);
  }
  for (const auto& one : kTargets)
    if (name != nullptr && std::strcmp(name, one.name) == 0) target = &one;
  if (target == nullptr) {
    std::fprintf(stderr, "usage: weft_fuzz TARGET [OPTION|FOLDER...], TARGET one of:\n");
    for (const auto& one : kTargets) std::fprintf(stderr, "  %s\n", one.name);
    std::exit(2);
  }
  // The timeout is in seconds of the wall, beside whatever else the machine does; an input takes a millisecond.
  // Without -detect_leaks=0 an input that leaves an allocation, as caches do, runs twice. With -entropic=1 a third of the time goes
  // into the bookkeeping of rare features, and no more code was reached.
  // Options of the command line come later and win.
  static std::vector<std::string> defaults = {
      "-max_len=2048",         "-malloc_limit_mb=64",  "-rss_limit_mb=1024",   "-timeout=300",
      "-dict=" + dictionary(), "-print_final_stats=1", "-use_value_profile=0", "-reload=0",
      "-print_funcs=0",        "-detect_leaks=0",      "-entropic=0"};
  for (std::size_t i = 0; i < defaults.size(); ++i)
    arguments.insert(arguments.begin() + 1 + static_cast<std::ptrdiff_t>(i), defaults[i].data());
  *argc = static_cast<int>(arguments.size());
  arguments.push_back(nullptr);
  *argv = arguments.data();
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  target->run(std::string_view(reinterpret_cast<const char*>(data), size));
  return 0;
}
