#pragma once
#include <sys/types.h>

#include <chrono>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace weft {

using MonotonicTime = std::chrono::steady_clock::time_point;
MonotonicTime seconds_from_now(double seconds);

/// The file number under which a child finds the pipe of its crash report (see crash_report.hpp).
constexpr int kCrashReportFile = 3;

struct ChildOptions {
  std::vector<std::string> command = {};                              ///< program, searched in PATH, and its arguments
  std::filesystem::path folder = {};                                  ///< where it runs; empty: where this program runs
  std::vector<std::pair<std::string, std::string>> environment = {};  ///< set for it on top of this program's variables
  bool own_group = false;     ///< ^C in the terminal does not reach it, and kill() ends what it started too
  bool keep_errors = false;   ///< errors() has the end of its stderr; otherwise it goes where this program's goes
  bool crash_report = false;  ///< it gets a pipe for its crash report
};

/// How a process ended.
struct ChildEnd {
  int exit_code = -1;  ///< -1: it was ended by the signal
  int signal = 0;
  /// "ended with exit code 3", or "was ended by SIGSEGV (Segmentation fault)".
  std::string text() const;
};
/// "SIGSEGV (Segmentation fault)".
std::string signal_text(int signal);

/// A program that this one starts. Both write lines to each other. Not thread-safe.
class ChildProcess {
 public:
  enum class Outcome { done, late, ended, too_long };

  /// @throws ConfigError if the command cannot be run; Error if no pipe can be made.
  explicit ChildProcess(const ChildOptions& options);
  /// Kills it, unless it has ended, and reaps it.
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  pid_t id() const;
  /// Writes to its stdin. @return done; late: the deadline passed; ended: it does not read any more.
  Outcome write(const std::string& text, MonotonicTime deadline);
  /// Closes its stdin.
  void close_input();
  /// Closes its stdout: what it writes is an error to it.
  void close_output();
  /// Reads the next line of its stdout, without the line's end.
  /// @param longest bytes of a line; a longer one is too_long.
  /// @return ended: it has closed its stdout.
  Outcome read_line(std::string& line, MonotonicTime deadline, std::size_t longest = 1 << 30);
  /// What it has written after the last line that was read.
  const std::string& unread() const;
  /// For poll(): readable when it has written something or has ended.
  int output_file() const;

  /// @return how it ended; nothing if it runs at the deadline.
  std::optional<ChildEnd> wait_until(MonotonicTime deadline);
  /// Sends a signal; to its whole group if it has one of its own.
  void kill(int signal);
  /// CPU time of the process, and of the processes it started, so far, s. 0 after it has ended.
  double cpu_seconds() const;

  /// The last bytes of its stderr (8 kB at most), read without waiting.
  std::string errors();
  /// The bytes of its crash report, read without waiting. Empty: there is none.
  std::string crash_report();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Says when a process hangs: it has used more CPU time than it may, or next to none for long. Only time in which this
/// program itself ran counts, so a suspended machine makes nothing hang.
class HangWatch {
 public:
  /// @param cpu_limit_s CPU time that it may use. @param idle_limit_s time that it may spend without using any.
  HangWatch(double cpu_limit_s, double idle_limit_s);
  /// Begins to count. @param cpu_seconds of the process until now.
  void start(double cpu_seconds);
  /// Call it every second or more often. @param cpu_seconds of the process until now.
  /// @return "used 60 s of CPU time", "used no CPU time for 60 s"; empty: it does not hang.
  std::string check(double cpu_seconds);
  void set_cpu_limit(double seconds) { cpu_limit_s_ = seconds; }
  double used() const { return used_; }  ///< CPU time since start(), s

 private:
  double cpu_limit_s_, idle_limit_s_;
  double first_ = 0.0, used_ = 0.0, used_when_last_active_ = 0.0, idle_ = 0.0;
  MonotonicTime last_check_;
};

}  // namespace weft
