// An optimiser that passes every check of the loader, and does one bad thing when it is called.
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <string>
#include <thread>

#include "weft/error.hpp"
#include "weft/optimiser.hpp"
#include "weft/plugin.hpp"

namespace weft::test {

struct MisbehavesParams {
  std::string how = "segv";
  template <class Visitor>
  void visit(Visitor& v) {
    v("how", how,
      choice({"segv", "abort", "overflow", "exit", "_exit", "_Exit", "quick_exit", "fork", "throw", "thread_throws",
              "loop", "sleep"}),
      "What it does.");
  }
};

volatile int nothing = 0;
int* volatile nowhere = nullptr;

[[gnu::noinline]] void write_nowhere() { *nowhere = 1; }
[[gnu::noinline]] int descend(int depth) {  // NOLINT(misc-no-recursion)
  volatile char block[4096];
  block[0] = static_cast<char>(depth);
  return nothing == 0 ? descend(depth + 1) + block[0] : block[0];
}
[[gnu::noinline]] void turn_for_ever() {
  while (nothing == 0) continue;
}

/// Throws how a forked process ended that called _exit(7), which it may.
[[gnu::noinline]] void leave_forked_process() {
  const pid_t child = fork();
  if (child == 0) ::_exit(7);
  int status = 0;
  waitpid(child, &status, 0);
  throw Error("the forked process ended with " + std::to_string(WEXITSTATUS(status)));
}

class Misbehaves final : public Optimiser {
 public:
  explicit Misbehaves(const MisbehavesParams& params) : how_(params.how) {}
  OptimiserCapabilities capabilities() const override { return {}; }
  std::vector<OptimiserResult> minimise(Objective&, ConstMatrix, const Box&, ConstVec, const OptimiserOptions&,
                                        const OptimiserObserver&) const override {
    if (how_ == "segv") write_nowhere();
    if (how_ == "abort") std::abort();
    if (how_ == "overflow") nothing = descend(0);
    if (how_ == "exit") std::exit(0);
    if (how_ == "_exit") ::_exit(0);
    if (how_ == "_Exit") std::_Exit(0);
    if (how_ == "quick_exit") std::quick_exit(0);
    if (how_ == "fork") leave_forked_process();
    if (how_ == "throw") throw 42;
    if (how_ == "thread_throws") std::thread([] { throw std::runtime_error("from a thread"); }).join();
    if (how_ == "loop") turn_for_ever();
    while (true) sleep(1000);
  }

 private:
  std::string how_;
};

}  // namespace weft::test

WEFT_PLUGIN(weft::Optimiser, weft::test::Misbehaves, weft::test::MisbehavesParams, "misbehaves", "1.0.0")
