#include "processes/crash_report.hpp"

#include <cxxabi.h>
#include <dlfcn.h>
#include <elf.h>
#include <execinfo.h>
#include <fcntl.h>
#include <link.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>

#include "processes/child_process.hpp"
#include "weft/export.hpp"

// What runs inside a signal handler takes no memory from the heap, which the crash may have damaged, and takes no lock
// but the dynamic linker's. An alarm ends the program when that one is held.

namespace weft {

namespace {

constexpr char kMagic[8] = "wcrash1";
constexpr int kFatal[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGSYS, SIGTRAP, SIGXCPU, SIGQUIT};
constexpr unsigned kCrashReportSeconds = 5;
constexpr std::size_t kMostPlugins = 256;

/// Where a plugin lies in memory.
struct LoadedPlugin {
  char name[sizeof(CrashReport::plugin)];
  char file[sizeof(CrashReport::library)];
  std::uintptr_t begin, end, base;
};
LoadedPlugin plugins[kMostPlugins];  // written once each, before `plugin_count` says that it is there
std::atomic<std::size_t> plugin_count = 0;

std::atomic<int> report_file = -1;
std::atomic<WhereWriter> where_writer = nullptr;
std::atomic<int> watches = 0;
std::atomic<bool> reported = false;
std::atomic<pid_t> watched_process = -1;
char plain_line[2048];  // what write_line() prints if the nicer text cannot be made

template <std::size_t N>
void copy_text(char (&to)[N], const char* from) {
  std::snprintf(to, N, "%s", from);
}

const LoadedPlugin* plugin_at(const void* address) {
  const auto place = reinterpret_cast<std::uintptr_t>(address);
  const std::size_t count = plugin_count;
  for (std::size_t i = 0; i < count; ++i)
    if (place >= plugins[i].begin && place < plugins[i].end) return &plugins[i];
  return nullptr;
}

/// Name of the function at an offset of a library, from its file's table of symbols, which also has those that are not
/// exported. Empty if there is none.
void find_function(const char* file, std::uint64_t offset, char (&name)[sizeof(CrashReport::function)]) {
  name[0] = 0;
  const int opened = open(file, O_RDONLY | O_CLOEXEC);
  struct stat info;
  if (opened < 0) return;
  if (fstat(opened, &info) != 0 || info.st_size < static_cast<off_t>(sizeof(ElfW(Ehdr)))) {
    close(opened);
    return;
  }
  const auto size = static_cast<std::uint64_t>(info.st_size);
  void* mapped = mmap(nullptr, size, PROT_READ, MAP_PRIVATE, opened, 0);
  close(opened);
  if (mapped == MAP_FAILED) return;
  const char* bytes = static_cast<const char*>(mapped);
  const auto* head = reinterpret_cast<const ElfW(Ehdr)*>(bytes);
  const auto* sections = reinterpret_cast<const ElfW(Shdr)*>(bytes + head->e_shoff);
  const bool whole = head->e_shoff + std::uint64_t{head->e_shnum} * sizeof(ElfW(Shdr)) <= size;
  for (int i = 0; whole && i < head->e_shnum && name[0] == 0; ++i) {
    const auto& table = sections[i];
    if ((table.sh_type != SHT_SYMTAB && table.sh_type != SHT_DYNSYM) || table.sh_link >= head->e_shnum) continue;
    const auto& names = sections[table.sh_link];
    if (table.sh_offset + table.sh_size > size || names.sh_offset + names.sh_size > size) continue;
    const auto* symbols = reinterpret_cast<const ElfW(Sym)*>(bytes + table.sh_offset);
    for (std::uint64_t s = 0; s < table.sh_size / sizeof(ElfW(Sym)); ++s) {
      const auto& symbol = symbols[s];
      if (ELF64_ST_TYPE(symbol.st_info) != STT_FUNC || symbol.st_name >= names.sh_size) continue;
      if (offset < symbol.st_value || offset >= symbol.st_value + symbol.st_size) continue;
      copy_text(name, bytes + names.sh_offset + symbol.st_name);
      break;
    }
  }
  munmap(mapped, size);
}

/// What ends the process.
struct Ending {
  int signal = 0;
  const void* crashed_at = nullptr;  ///< the instruction that raised the signal
  const char* call = "";             ///< if there is no signal
  int exit_code = 0;
};

void fill(CrashReport& report, const Ending& ending) {
  std::memcpy(report.magic, kMagic, sizeof(kMagic));
  report.signal = ending.signal;
  report.exit_code = ending.exit_code;
  copy_text(report.call, ending.call);
  if (const WhereWriter where = where_writer) where(report.where, sizeof(report.where));
  void* frames[128];
  const int depth = backtrace(frames, 128);
  for (int i = 0; i < depth; ++i) {
    const LoadedPlugin* plugin = plugin_at(frames[i]);
    if (plugin == nullptr) continue;
    copy_text(report.plugin, plugin->name);
    copy_text(report.library, plugin->file);
    // A return address is that of the next instruction, which may belong to the next function.
    report.offset =
        reinterpret_cast<std::uintptr_t>(frames[i]) - plugin->base - (frames[i] == ending.crashed_at ? 0 : 1);
    find_function(plugin->file, report.offset, report.function);
    return;
  }
}

/// "SIGSEGV (Segmentation fault)", "a call of exit(0)".
void print_signal(const CrashReport& report, char* text, std::size_t size) {
  const char* name = report.signal != 0 ? sigabbrev_np(report.signal) : nullptr;
  if (report.signal == 0)
    std::snprintf(text, size, "a call of %s(%d)", report.call, report.exit_code);
  else if (name == nullptr)
    std::snprintf(text, size, "signal %d", report.signal);
  else
    std::snprintf(text, size, "SIG%s (%s)", name, sigdescr_np(report.signal));
}

/// "plugin simulator cloth, weft::cloth::step() of libweft_simulator_cloth.so (simulator cloth, step(), planning)".
/// @param function its name as people read it.
void print_place(const CrashReport& report, const char* function, char* text, std::size_t size) {
  const char* file = std::strrchr(report.library, '/');
  file = file == nullptr ? report.library : file + 1;
  const bool busy = report.where[0] != 0;
  char place[700] = "";
  if (report.function[0] != 0)
    std::snprintf(place, sizeof(place), ", %s of %s", function, file);
  else if (report.plugin[0] != 0)
    std::snprintf(place, sizeof(place), ", %s+0x%llx", file, static_cast<unsigned long long>(report.offset));
  // A library that dies as it is loaded has not said yet which plugin it is.
  if (report.plugin[0] == 0 && std::strncmp(report.where, "library ", 8) == 0)
    return void(std::snprintf(text, size, "%s", report.where));
  std::snprintf(text, size, "%s%s%s%s%s%s", report.plugin[0] != 0 ? "plugin " : "weft itself", report.plugin, place,
                busy ? " (" : "", report.where, busy ? ")" : "");
}

void write_all(int file, const char* bytes, std::size_t size) {
  while (size > 0) {
    const ssize_t n = write(file, bytes, size);
    if (n <= 0) return;
    bytes += n;
    size -= static_cast<std::size_t>(n);
  }
}

/// What _exit() is without this file.
[[noreturn]] void leave_now(int code) {
  while (true) syscall(SYS_exit_group, code);
}

[[noreturn]] void end_as(int signal) {
  std::signal(signal, SIG_DFL);
  sigset_t one;
  sigemptyset(&one);
  sigaddset(&one, signal);
  pthread_sigmask(SIG_UNBLOCK, &one, nullptr);
  raise(signal);
  leave_now(128 + signal);
}

std::atomic<int> ends_with = 0;
void print_line_and_end(int) {
  write_all(STDERR_FILENO, plain_line, std::strlen(plain_line));
  end_as(ends_with);
}

void write_report(const Ending& ending) {
  alarm(kCrashReportSeconds);
  static CrashReport report;  // handlers have little stack
  fill(report, ending);
  const int file = report_file;
  if (file == kCrashReportFile) {
    write_all(file, reinterpret_cast<const char*>(&report), sizeof(report));
    return;
  }
  static char what[80], place[1400];
  print_signal(report, what, sizeof(what));
  print_place(report, report.function, place, sizeof(place));
  std::snprintf(plain_line, sizeof(plain_line), "error: %s in %s\n", what, place);
  // Names that people can read take memory from the heap. If that fails, the line above is printed.
  ends_with = ending.signal == 0 ? SIGABRT : ending.signal;
  struct sigaction plain {};
  plain.sa_handler = print_line_and_end;
  plain.sa_flags = SA_NODEFER | SA_ONSTACK;
  for (const int other : {SIGSEGV, SIGBUS, SIGABRT, SIGALRM}) sigaction(other, &plain, nullptr);
  const std::string readable = "error: " + report.text() + "\n";
  write_all(STDERR_FILENO, readable.c_str(), readable.size());
}

void on_fatal_signal(int signal, siginfo_t*, void* context) {
  if (!reported.exchange(true)) {
    const auto& registers = static_cast<const ucontext_t*>(context)->uc_mcontext.gregs;
    write_report({.signal = signal, .crashed_at = reinterpret_cast<const void*>(registers[REG_RIP])});
  } else {
    pause();  // another thread reports, and ends the program
  }
  end_as(signal);
}

/// Returns if weft itself ends, or a process that was forked from it.
void before_exit(const char* call, int code) {
  if (watches == 0 || getpid() != watched_process) return;
  while (reported.exchange(true)) pause();  // another thread reports, and ends the program
  write_report({.call = call, .exit_code = code});
  leave_now(1);
}

void on_exit_call(int code, void*) { before_exit("exit", code); }

/// The function of this name that this file hides: the C library's, or a sanitizer's. It is looked up before main(),
/// since dlsym() takes a lock that a forked process may never get.
using ExitFunction = void (*)(int);
ExitFunction hidden(const char* name) { return reinterpret_cast<ExitFunction>(dlsym(RTLD_NEXT, name)); }
const ExitFunction hidden_exit = hidden("_exit"), hidden_quick_exit = hidden("quick_exit");

[[noreturn]] void call_hidden(ExitFunction function, int code) {
  if (function != nullptr) function(code);  // null only before this file's variables are initialised
  leave_now(code);
}

}  // namespace

std::string CrashReport::place() const {
  std::string readable = function;
  int status = 0;
  const std::unique_ptr<char, decltype(&std::free)> plain(abi::__cxa_demangle(function, nullptr, nullptr, &status),
                                                          &std::free);
  if (status == 0 && plain) readable = plain.get();
  constexpr std::size_t kMost = 200;
  if (readable.size() > kMost) readable = readable.substr(0, kMost) + "...";
  char text[1400];
  print_place(*this, readable.c_str(), text, sizeof(text));
  return text;
}

std::string CrashReport::text() const {
  char what[80];
  print_signal(*this, what, sizeof(what));
  return what + (" in " + place());
}

bool read_crash_report(std::string_view bytes, CrashReport& report) {
  if (bytes.size() < sizeof(report)) return false;
  std::memcpy(&report, bytes.data(), sizeof(report));
  if (std::memcmp(report.magic, kMagic, sizeof(kMagic)) != 0) return false;
  report.call[sizeof(report.call) - 1] = 0;
  report.where[sizeof(report.where) - 1] = report.plugin[sizeof(report.plugin) - 1] = 0;
  report.library[sizeof(report.library) - 1] = report.function[sizeof(report.function) - 1] = 0;
  return true;
}

void install_crash_report(int file, WhereWriter where) {
  where_writer = where;
  if (file == kCrashReportFile) fcntl(file, F_SETFD, FD_CLOEXEC);  // not for the programs that this one starts
  const bool first = report_file.exchange(file) < 0;
  if (!first) return;
  void* frames[4];
  backtrace(frames, 4);  // loads what it needs now, and not in the handler
  static const CrashStack main_thread;
  for (const int signal : kFatal) report_before_end(signal);
  watched_process = getpid();
  on_exit(on_exit_call, nullptr);
}

void report_before_end(int signal) noexcept {
  struct sigaction action {};
  action.sa_sigaction = on_fatal_signal;
  action.sa_flags = SA_ONSTACK | SA_SIGINFO;
  for (const int other : {SIGINT, SIGTERM, SIGHUP}) sigaddset(&action.sa_mask, other);  // one report is enough
  sigaction(signal, &action, nullptr);
}

CrashStack::CrashStack() : memory_(std::make_unique<char[]>(kBytes)) {
  const stack_t stack{memory_.get(), 0, kBytes};
  sigaltstack(&stack, nullptr);
}
CrashStack::~CrashStack() {
  const stack_t none{nullptr, SS_DISABLE, 0};
  sigaltstack(&none, nullptr);
}

CrashWatch::CrashWatch() { ++watches; }
CrashWatch::~CrashWatch() { --watches; }

void announce_plugin(const std::string& plugin, const void* symbol) {
  static std::mutex mutex;
  const std::lock_guard lock(mutex);
  Dl_info info;
  link_map* map = nullptr;
  if (dladdr1(symbol, &info, reinterpret_cast<void**>(&map), RTLD_DL_LINKMAP) == 0 || map == nullptr) return;
  // Where a library was that has been unloaded, another one may be now.
  const LoadedPlugin* before = plugin_at(symbol);
  const std::size_t index = before != nullptr ? static_cast<std::size_t>(before - plugins) : plugin_count.load();
  if (index == kMostPlugins) return;
  LoadedPlugin& entry = plugins[index];
  entry.base = map->l_addr;
  entry.begin = entry.end = reinterpret_cast<std::uintptr_t>(info.dli_fbase);
  copy_text(entry.name, plugin.c_str());
  copy_text(entry.file, map->l_name);
  const auto widen = [](dl_phdr_info* library, std::size_t, void* given) {
    auto& found = *static_cast<LoadedPlugin*>(given);
    if (library->dlpi_addr != found.base) return 0;
    for (int i = 0; i < library->dlpi_phnum; ++i) {
      const auto& part = library->dlpi_phdr[i];
      if (part.p_type == PT_LOAD)
        found.end = std::max<std::uintptr_t>(found.end, found.base + part.p_vaddr + part.p_memsz);
    }
    return 1;
  };
  dl_iterate_phdr(widen, &entry);
  plugin_count = std::max(plugin_count.load(), index + 1);
}

}  // namespace weft

// The C library calls no handler of on_exit() before these three end the program. So a program that has this file defines
// them itself, and plugins call its definitions: the dynamic linker searches the program before libraries. exit() in the
// C library does not come here. A plugin that makes the system call itself cannot be seen.
extern "C" {
WEFT_API void _exit(int code) {
  weft::before_exit("_exit", code);
  weft::call_hidden(weft::hidden_exit, code);
}
WEFT_API void _Exit(int code) noexcept {
  weft::before_exit("_Exit", code);
  weft::call_hidden(weft::hidden_exit, code);
}
WEFT_API void quick_exit(int code) noexcept {
  weft::before_exit("quick_exit", code);
  weft::call_hidden(weft::hidden_quick_exit, code);
}
}
