#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

/// Who was at work when a process of weft died: a signal handler that names the plugin, its function, and the call.
namespace weft {

/// Writes what the calling thread is doing: "optimiser adam, minimise(), planning, segment 3". It is called in a signal
/// handler: it must neither allocate nor lock.
/// @param buffer gets at most `size` - 1 characters and a null. @return their number.
using WhereWriter = std::size_t (*)(char* buffer, std::size_t size) noexcept;

/// Plain data, so that a signal handler can write it into a pipe as it is.
struct CrashReport {
  char magic[8];        ///< "wcrash1"
  std::int32_t signal;  ///< 0: the process called exit() or the like
  std::int32_t exit_code;
  char call[16];         ///< "exit", "_exit", "_Exit" or "quick_exit"; empty if there was a signal
  char where[400];       ///< what WhereWriter wrote of the thread that crashed
  char plugin[104];      ///< "simulator cloth"; empty: no plugin's code was being run
  char library[256];     ///< file that holds `function`
  char function[512];    ///< mangled name; empty: its symbols have been stripped
  std::uint64_t offset;  ///< of the instruction in the library

  /// "SIGSEGV (Segmentation fault) in plugin simulator cloth, weft::cloth::step(...) of libweft_simulator_cloth.so
  /// (simulator cloth, step(), planning, segment 3)". @param demangle takes memory from the heap.
  std::string text() const;
  /// The same without the signal, for a process that was asked where it is: "plugin simulator cloth, ...".
  std::string place() const;
};
/// What ChildProcess::crash_report() holds. @return false if it is no report.
bool read_crash_report(std::string_view bytes, CrashReport& report);

/// From now on, a signal that would end this program, and a call of exit(), _exit(), _Exit() or quick_exit() in a
/// CrashWatch, are reported first; then the program ends as it would have. The innermost function that belongs to a plugin
/// is blamed. A process that was forked from this one reports no call.
/// @param file kCrashReportFile: the report goes there as it is; STDERR_FILENO: as one line "error: ...". @param where may be null.
void install_crash_report(int file, WhereWriter where);

/// Reports one more signal before it ends the program, such as SIGINT. install_crash_report() comes first. A signal
/// handler may call it.
void report_before_end(int signal) noexcept;

/// A stack for the signal handler on this thread, so that an overflow of the thread's own can be reported too. The
/// thread that calls install_crash_report() has one.
class CrashStack {
 public:
  CrashStack();
  ~CrashStack();
  CrashStack(const CrashStack&) = delete;
  CrashStack& operator=(const CrashStack&) = delete;

 private:
  static constexpr std::size_t kBytes = 1 << 16;
  std::unique_ptr<char[]> memory_;
};

/// While it exists, a call of exit(), _exit(), _Exit() or quick_exit() is reported, and ends the program with code 1.
class CrashWatch {
 public:
  CrashWatch();
  ~CrashWatch();
  CrashWatch(const CrashWatch&) = delete;
  CrashWatch& operator=(const CrashWatch&) = delete;
};

/// Makes a loaded library known to the crash report. Thread-safe; never undone.
/// @param plugin "simulator cloth". @param symbol any address in the library.
void announce_plugin(const std::string& plugin, const void* symbol);

}  // namespace weft
