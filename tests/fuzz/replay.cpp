// Runs targets on files, without the fuzzer: the inputs of earlier findings, in every build.
//   weft_fuzz_inputs TARGET FILE|FOLDER...
//   weft_fuzz_inputs --serve          opens the files that stdin names: "KIND FILE"; prints "read", "refused" or "died ..."
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <iterator>

#include "fuzz.hpp"
#include "processes/child_process.hpp"

namespace {

namespace fs = std::filesystem;
using namespace weft::fuzz;

constexpr int kEnoughFiles = 77;  // an exit code: what libhdf5 leaks at damaged files shall not add up

/// @return 0 at the end of stdin.
int open_files() {
  constexpr int kEnough = 20000;
  int opened = 0;
  for (std::string line; std::getline(std::cin, line);) {
    const auto blank = line.find(' ');
    const std::string kind = line.substr(0, blank), file = line.substr(blank + 1);
    const auto use = kind == "session" ? use_session : kind == "dataset" ? use_dataset : use_model;
    const std::string reason = refusal([&] { use(file); });
    std::cout << (reason.empty() ? "read" : "refused") << std::endl;
    if (++opened == kEnough) return kEnoughFiles;
  }
  return 0;
}

/// Opens files in a process that may die of them, which is then made again. It is forked before any thread begins: to start
/// this program takes the time of a hundred files.
int serve() {
  while (true) {
    const pid_t opener = fork();
    if (opener < 0) return 1;
    if (opener == 0) _exit(open_files());
    int status = 0;
    if (waitpid(opener, &status, 0) != opener) return 1;
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return 0;
    if (WIFEXITED(status) && WEXITSTATUS(status) == kEnoughFiles) continue;
    const weft::ChildEnd end =
        WIFSIGNALED(status) ? weft::ChildEnd{-1, WTERMSIG(status)} : weft::ChildEnd{WEXITSTATUS(status), 0};
    std::cerr << kReportEnds << std::flush;
    std::cout << kDied << end.text() << std::endl;
  }
}

std::vector<fs::path> files_of(const fs::path& place) {
  if (!fs::is_directory(place)) return {place};
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(place)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

/// No input may make weft allocate more than this. Sanitizers reserve more address space than any limit.
void limit_memory() {
#ifdef WEFT_FUZZ_LIMIT_MEMORY
  const rlimit limit{rlim_t{3} << 30, rlim_t{3} << 30};
  setrlimit(RLIMIT_AS, &limit);
#endif
}

}  // namespace

int main(int argc, char** argv) {
  limit_memory();
  if (argc == 2 && std::strcmp(argv[1], "--serve") == 0) return serve();
  const Target* target = nullptr;
  for (const auto& one : kTargets)
    if (argc > 2 && std::strcmp(argv[1], one.name) == 0) target = &one;
  if (target == nullptr) {
    std::fprintf(stderr, "usage: weft_fuzz_inputs TARGET FILE|FOLDER...\n");
    return 2;
  }
  int count = 0;
  for (int i = 2; i < argc; ++i) {
    for (const auto& file : files_of(argv[i])) {
      std::ifstream stream(file, std::ios::binary);
      const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
      std::fprintf(stderr, "%s\n", file.c_str());  // the last line before a crash names the input
      target->run(bytes);
      ++count;
    }
  }
  std::printf("%s: %d inputs\n", target->name, count);
  return count > 0 ? 0 : 1;
}
