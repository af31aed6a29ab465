#include "processes/child_process.hpp"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <thread>

#include "weft/config.hpp"

extern char** environ;

namespace weft {
namespace {

constexpr std::size_t kMostErrors = 8192;
constexpr double kMostBetweenChecks = 2.0;  ///< s; a longer gap is not the child's: this program did not run
constexpr double kIdleShare = 1.0 / 600.0;  ///< of one processor: less counts as none

std::string number_text(double value) { return ConfigNode::number(value).as_string(); }

/// A pipe. The destructor closes it, and it is closed in every program that this one starts.
class Pipe {
 public:
  void open() {
    if (pipe2(ends_, O_CLOEXEC) != 0) throw Error(std::string("a pipe cannot be made: ") + std::strerror(errno));
  }
  Pipe() = default;
  ~Pipe() {
    close_reader();
    close_writer();
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  int reader() const { return ends_[0]; }
  int writer() const { return ends_[1]; }
  void close_reader() { close_end(ends_[0]); }
  void close_writer() { close_end(ends_[1]); }

 private:
  static void close_end(int& end) {
    if (end >= 0) close(end);
    end = -1;
  }
  int ends_[2] = {-1, -1};
};

/// While it exists, writing to an ended process gives an error instead of a signal that would end this program. It does
/// not change other threads or the program's handling of SIGPIPE.
class NoBrokenPipeSignal {
 public:
  NoBrokenPipeSignal() {
    sigemptyset(&broken_);
    sigaddset(&broken_, SIGPIPE);
    sigset_t pending;
    sigpending(&pending);
    was_pending_ = sigismember(&pending, SIGPIPE) == 1;
    pthread_sigmask(SIG_BLOCK, &broken_, &before_);
  }
  ~NoBrokenPipeSignal() {
    const timespec now{0, 0};
    if (!was_pending_) {
      while (sigtimedwait(&broken_, nullptr, &now) == -1 && errno == EINTR) continue;
    }
    pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  NoBrokenPipeSignal(const NoBrokenPipeSignal&) = delete;
  NoBrokenPipeSignal& operator=(const NoBrokenPipeSignal&) = delete;

 private:
  sigset_t broken_, before_;
  bool was_pending_ = false;
};

/// Waits until a file can be read or written, or a second one can be read.
/// @param other -1: none. @return whether `file` can; false also if the time is over or the second one can.
bool wait_for(int file, short event, MonotonicTime deadline, int other = -1) {
  while (true) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now()).count();
    pollfd files[2] = {{file, event, 0}, {other, POLLIN, 0}};
    const int ready = poll(files, 2, static_cast<int>(std::clamp<std::int64_t>(left, 0, 1000000)));
    if (ready > 0) return files[0].revents != 0;
    if (ready < 0 && errno != EINTR) throw Error(std::string("poll: ") + std::strerror(errno));
    if (left <= 0) return false;
  }
}

/// Appends what a pipe holds now. @return false: its writers have closed it.
bool drain(int file, std::string& text) {
  char block[4096];
  while (file >= 0) {
    const ssize_t n = read(file, block, sizeof(block));
    if (n > 0)
      text.append(block, static_cast<std::size_t>(n));
    else if (n == 0)
      return false;
    else if (errno != EINTR)
      return true;
  }
  return true;
}

void set_nonblocking(int file) { fcntl(file, F_SETFL, fcntl(file, F_GETFL) | O_NONBLOCK); }

/// This program's variables with some replaced.
std::vector<std::string> variables(const std::vector<std::pair<std::string, std::string>>& changes) {
  std::vector<std::string> list;
  for (char** one = environ; *one != nullptr; ++one) {
    const std::string text = *one;
    const bool changed = std::any_of(changes.begin(), changes.end(),
                                     [&](const auto& change) { return text.starts_with(change.first + "="); });
    if (!changed) list.push_back(text);
  }
  for (const auto& [name, value] : changes) list.push_back(name + "=" + value);
  return list;
}

std::vector<char*> pointers(std::vector<std::string>& words) {
  std::vector<char*> list;
  for (auto& word : words) list.push_back(word.data());
  list.push_back(nullptr);
  return list;
}

/// CPU time of a process and of its living and ended children, from /proc.
double cpu_seconds_of(pid_t process, int depth = 0) {
  const std::string folder = "/proc/" + std::to_string(process);
  std::ifstream stat(folder + "/stat");
  std::string text((std::istreambuf_iterator<char>(stat)), {});
  const auto name_end = text.rfind(')');
  if (name_end == std::string::npos) return 0.0;
  unsigned long user = 0, system = 0;
  long children_user = 0, children_system = 0;
  std::sscanf(text.c_str() + name_end + 1, " %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu %ld %ld", &user,
              &system, &children_user, &children_system);
  double seconds = static_cast<double>(user + system) + static_cast<double>(children_user + children_system);
  seconds /= static_cast<double>(sysconf(_SC_CLK_TCK));
  constexpr int kDeepest = 8;
  if (depth == kDeepest) return seconds;
  std::error_code gone;
  for (const auto& task : std::filesystem::directory_iterator(folder + "/task", gone)) {
    std::ifstream children(task.path() / "children");
    for (pid_t child = 0; children >> child;) seconds += cpu_seconds_of(child, depth + 1);
  }
  return seconds;
}

}  // namespace

MonotonicTime seconds_from_now(double seconds) {
  return std::chrono::steady_clock::now() +
         std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
}

std::string signal_text(int signal) {
  const char* name = sigabbrev_np(signal);
  const char* meaning = sigdescr_np(signal);
  if (name == nullptr || meaning == nullptr) return "signal " + std::to_string(signal);
  return std::string("SIG") + name + " (" + meaning + ")";
}

std::string ChildEnd::text() const {
  if (signal == 0) return "ended with exit code " + std::to_string(exit_code);
  return "was ended by " + signal_text(signal);
}

struct ChildProcess::State {
  pid_t process = -1;
  bool own_group = false;
  Pipe to, from, errors, report;
  std::string read, error_text, report_text;
  std::optional<ChildEnd> end;
};

ChildProcess::ChildProcess(const ChildOptions& options) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.own_group = options.own_group;
  s.to.open();
  s.from.open();
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_adddup2(&files, s.to.reader(), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&files, s.from.writer(), STDOUT_FILENO);
  if (options.keep_errors) {
    s.errors.open();
    posix_spawn_file_actions_adddup2(&files, s.errors.writer(), STDERR_FILENO);
  }
  if (options.crash_report) {
    s.report.open();
    posix_spawn_file_actions_adddup2(&files, s.report.writer(), kCrashReportFile);
  }
  if (!options.folder.empty()) posix_spawn_file_actions_addchdir_np(&files, options.folder.c_str());
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, static_cast<short>((options.own_group ? POSIX_SPAWN_SETPGROUP : 0) |
                                                           POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF));
  sigset_t none, standard;
  sigemptyset(&none);
  posix_spawnattr_setsigmask(&attributes, &none);
  sigemptyset(&standard);
  for (const int signal : {SIGPIPE, SIGINT, SIGTERM, SIGXFSZ}) sigaddset(&standard, signal);
  posix_spawnattr_setsigdefault(&attributes, &standard);
  std::vector<std::string> words = options.command, settings = variables(options.environment);
  const int problem = posix_spawnp(&s.process, words.front().c_str(), &files, &attributes, pointers(words).data(),
                                   pointers(settings).data());
  posix_spawn_file_actions_destroy(&files);
  posix_spawnattr_destroy(&attributes);
  if (problem != 0) throw ConfigError(std::string("cannot be run: ") + std::strerror(problem));
  s.to.close_reader();
  s.from.close_writer();
  s.errors.close_writer();
  s.report.close_writer();
  for (const int file : {s.to.writer(), s.from.reader(), s.errors.reader(), s.report.reader()})
    if (file >= 0) set_nonblocking(file);
}

ChildProcess::~ChildProcess() {
  if (wait_until(std::chrono::steady_clock::now())) return;
  kill(SIGKILL);
  while (waitpid(state_->process, nullptr, 0) == -1 && errno == EINTR) continue;
}

pid_t ChildProcess::id() const { return state_->process; }
const std::string& ChildProcess::unread() const { return state_->read; }
int ChildProcess::output_file() const { return state_->from.reader(); }
void ChildProcess::close_input() { state_->to.close_writer(); }
void ChildProcess::close_output() { state_->from.close_reader(); }

ChildProcess::Outcome ChildProcess::write(const std::string& text, MonotonicTime deadline) {
  const NoBrokenPipeSignal quiet;
  const int file = state_->to.writer();
  if (file < 0) return Outcome::ended;
  for (std::size_t sent = 0; sent < text.size();) {
    if (!wait_for(file, POLLOUT, deadline)) return Outcome::late;
    const ssize_t n = ::write(file, text.data() + sent, text.size() - sent);
    if (n >= 0)
      sent += static_cast<std::size_t>(n);
    else if (errno == EPIPE)
      return Outcome::ended;
    else if (errno != EAGAIN && errno != EINTR)
      throw Error("cannot be written to: " + std::string(std::strerror(errno)));
  }
  return Outcome::done;
}

ChildProcess::Outcome ChildProcess::read_line(std::string& line, MonotonicTime deadline, std::size_t longest) {
  State& s = *state_;
  char block[65536];
  std::size_t searched = 0;
  while (true) {
    if (const auto end = s.read.find('\n', searched); end != std::string::npos) {
      line = s.read.substr(0, end);
      s.read.erase(0, end + 1);
      return Outcome::done;
    }
    searched = s.read.size();
    if (s.read.size() > longest) return Outcome::too_long;
    if (!wait_for(s.from.reader(), POLLIN, deadline, s.errors.reader())) {
      errors();  // a child must not wait for room in the pipe of its stderr
      if (std::chrono::steady_clock::now() >= deadline) return Outcome::late;
      continue;
    }
    const ssize_t n = ::read(s.from.reader(), block, sizeof(block));
    if (n > 0)
      s.read.append(block, static_cast<std::size_t>(n));
    else if (n == 0)
      return Outcome::ended;
    else if (errno != EAGAIN && errno != EINTR)
      throw Error("cannot be read from: " + std::string(std::strerror(errno)));
  }
}

std::optional<ChildEnd> ChildProcess::wait_until(MonotonicTime deadline) {
  State& s = *state_;
  while (!s.end) {
    int status = 0;
    const pid_t reaped = waitpid(s.process, &status, WNOHANG);
    if (reaped == s.process) {
      s.end = WIFSIGNALED(status) ? ChildEnd{-1, WTERMSIG(status)} : ChildEnd{WEXITSTATUS(status), 0};
    } else if (std::chrono::steady_clock::now() >= deadline) {
      break;
    } else {
      errors();  // a full pipe would keep it from ending
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  }
  return s.end;
}

void ChildProcess::kill(int signal) {
  if (state_->end) return;  // its number may belong to another process now
  ::kill(state_->own_group ? -state_->process : state_->process, signal);
}

double ChildProcess::cpu_seconds() const { return state_->end ? 0.0 : cpu_seconds_of(state_->process); }

std::string ChildProcess::errors() {
  std::string& text = state_->error_text;
  if (!drain(state_->errors.reader(), text)) state_->errors.close_reader();
  if (text.size() > kMostErrors) text.erase(0, text.size() - kMostErrors);
  return text;
}

std::string ChildProcess::crash_report() {
  drain(state_->report.reader(), state_->report_text);
  return state_->report_text;
}

HangWatch::HangWatch(double cpu_limit_s, double idle_limit_s)
    : cpu_limit_s_(cpu_limit_s), idle_limit_s_(idle_limit_s), last_check_(std::chrono::steady_clock::now()) {}

void HangWatch::start(double cpu_seconds) {
  first_ = cpu_seconds;
  used_ = used_when_last_active_ = idle_ = 0.0;
  last_check_ = std::chrono::steady_clock::now();
}

std::string HangWatch::check(double cpu_seconds) {
  const auto now = std::chrono::steady_clock::now();
  idle_ += std::min(kMostBetweenChecks, std::chrono::duration<double>(now - last_check_).count());
  last_check_ = now;
  used_ = std::max(used_, cpu_seconds - first_);
  if (used_ - used_when_last_active_ > kIdleShare * idle_limit_s_) {
    used_when_last_active_ = used_;
    idle_ = 0.0;
  }
  if (used_ > cpu_limit_s_) return "used " + number_text(cpu_limit_s_) + " s of CPU time";
  if (idle_ > idle_limit_s_) return "used no CPU time for " + number_text(idle_limit_s_) + " s";
  return "";
}

}  // namespace weft
