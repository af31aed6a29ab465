#pragma once
#include <sys/wait.h>

#include <array>
#include <cstdio>
#include <string>

namespace weft::test {

/// How a program ended: its exit code (128 + signal when it was killed) and what it printed.
struct Outcome {
  int code = -1;
  std::string output;
};

/// Runs a shell command without input; `output` holds stdout, and stderr too unless the command redirects it.
inline Outcome run_shell(const std::string& command) {
  Outcome outcome;
  FILE* pipe = popen(("{ " + command + "\n} 2>&1 </dev/null").c_str(), "r");
  if (pipe == nullptr) return outcome;
  std::array<char, 4096> block;
  for (std::size_t n; (n = fread(block.data(), 1, block.size(), pipe)) > 0;) outcome.output.append(block.data(), n);
  const int status = pclose(pipe);
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return outcome;
}

}  // namespace weft::test
