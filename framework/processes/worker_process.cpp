#include "processes/worker_process.hpp"

#include <fcntl.h>
#include <sys/prctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <limits>
#include <new>
#include <string_view>
#include <utility>

#include "processes/child_process.hpp"
#include "processes/crash_report.hpp"

namespace weft {
namespace {

constexpr double kLook = 0.5;           ///< s between two looks at a child that is at work
constexpr double kStopSeconds = 2.0;    ///< for a child to stop by itself when it is asked to
constexpr double kReportSeconds = 3.0;  ///< for a child to say where it hangs

/// The last line of a child's stderr that is not empty, for a message.
std::string last_words(const std::string& errors) {
  const auto end = errors.find_last_not_of(" \n\r\t");
  if (end == std::string::npos) return "";
  const auto begin = errors.find_last_of('\n', end);
  std::string words = errors.substr(begin == std::string::npos ? 0 : begin + 1, end + 1);
  if (const auto stop = words.find('\n'); stop != std::string::npos) words.resize(stop);
  constexpr std::size_t kMost = 300;
  if (words.size() > kMost) words = words.substr(0, kMost) + "...";
  return "; its last words: " + words;
}

// In the place of an answer:
constexpr const char* kCancelled = "cancelled";
constexpr const char* kNoMemory = "no memory";  // outside of the work: the process ends

std::atomic<bool>* cancel_of_server = nullptr;

}  // namespace

struct WorkerProcess::State {
  std::vector<std::string> command;
  std::unique_ptr<ChildProcess> child;

  std::string report_text() const {
    CrashReport report;
    return read_crash_report(child->crash_report(), report) ? report.text() : "";
  }

  /// Says why a child that answered nothing has ended, and forgets it.
  WorkEnd ended() {
    auto end = child->wait_until(seconds_from_now(5.0));
    if (!end) {
      child->kill(SIGKILL);
      end = child->wait_until(seconds_from_now(5.0));
    }
    const std::string report = report_text(), words = last_words(child->errors());
    child.reset();
    if (!report.empty()) return {WorkEnd::Kind::crashed, report + words};
    if (!end) return {WorkEnd::Kind::lost, "its process closed its output and could not be ended"};
    for (const int signal : {SIGKILL, SIGTERM, SIGINT, SIGHUP}) {
      if (end->signal == signal)
        return {WorkEnd::Kind::lost, "its process was ended from outside by " + signal_text(signal) +
                                         (signal == SIGKILL ? "; was the memory full?" : "")};
    }
    return {WorkEnd::Kind::crashed, "its process " + end->text() + words};
  }

  WorkEnd hung(const std::string& why) {
    child->kill(SIGQUIT);
    for (const auto deadline = seconds_from_now(kReportSeconds); std::chrono::steady_clock::now() < deadline;) {
      if (child->wait_until(seconds_from_now(0.05)) || !report_text().empty()) break;
    }
    CrashReport report;
    std::string text = why;
    if (read_crash_report(child->crash_report(), report)) text += "; was in " + report.place();
    child.reset();  // kills it
    return {WorkEnd::Kind::hung, text};
  }

  WorkEnd stopped() {
    child->kill(SIGTERM);
    std::string dropped;
    const auto outcome = child->read_line(dropped, seconds_from_now(kStopSeconds));
    if (outcome != ChildProcess::Outcome::done) child.reset();
    return {WorkEnd::Kind::cancelled, ""};
  }
};

WorkLimits work_limits(double cell_limit_s, double slowest) {
  constexpr double kTimesSlowest = 20.0, kLeast = 600.0;
  constexpr double kDay = 86400.0;  // the longest units known, plans of stiff cloth in the simulator, take half of it
  WorkLimits limits;
  if (cell_limit_s > 0.0)
    limits.cpu_s = cell_limit_s;
  else
    limits.cpu_s = slowest > 0.0 ? std::max(kLeast, kTimesSlowest * slowest) : kDay;
  return limits;
}

WorkFailure failure_of(const WorkEnd& end) {
  switch (end.kind) {
    case WorkEnd::Kind::crashed:
      return {WorkStatus::crashed, end.text};
    case WorkEnd::Kind::hung:
      return {WorkStatus::hung, end.text};
    case WorkEnd::Kind::lost:
    case WorkEnd::Kind::cancelled:
      return {WorkStatus::lost, end.text};
    case WorkEnd::Kind::answered:
      break;
  }
  return {WorkStatus::done, ""};
}

void SlowestUnit::add(double cpu_seconds) {
  constexpr double kTooFastToMeasure = 1e-3;
  cpu_seconds = std::max(cpu_seconds, kTooFastToMeasure);
  for (double known = slowest_; cpu_seconds > known && !slowest_.compare_exchange_weak(known, cpu_seconds);) continue;
}

WorkerProcess::WorkerProcess(std::vector<std::string> command)
    : state_(std::make_unique<State>(State{std::move(command), nullptr})) {}

WorkerProcess::~WorkerProcess() {
  if (state_->child == nullptr) return;
  state_->child->close_input();
  state_->child->wait_until(seconds_from_now(kStopSeconds));
}

WorkEnd WorkerProcess::run(const std::string& request, const std::function<WorkLimits()>& limits,
                           const std::function<bool()>& cancelled) {
  WorkEnd end;
  for (int attempt = 1; attempt <= kMostAttempts; ++attempt) {
    end = run_once(request, limits, cancelled);
    if (end.kind != WorkEnd::Kind::lost) return end;
    if (cancelled()) return {WorkEnd::Kind::cancelled, ""};
  }
  end.text += "; so it went " + std::to_string(kMostAttempts) + " times";
  return end;
}

WorkEnd WorkerProcess::run_once(const std::string& request, const std::function<WorkLimits()>& limits,
                                const std::function<bool()>& cancelled) {
  State& s = *state_;
  if (s.child == nullptr)
    s.child =
        std::make_unique<ChildProcess>(ChildOptions{.command = s.command, .keep_errors = true, .crash_report = true});
  WorkLimits now = limits();
  const auto cpu_limit = [&] { return now.cpu_s > 0.0 ? now.cpu_s : std::numeric_limits<double>::infinity(); };
  HangWatch watch(cpu_limit(), now.idle_s);
  watch.start(s.child->cpu_seconds());
  // A child that reads nothing is one that never began: it is watched below like one that never answers.
  if (s.child->write(request + "\n", seconds_from_now(now.idle_s)) == ChildProcess::Outcome::ended) return s.ended();
  std::string line;
  while (true) {
    switch (s.child->read_line(line, seconds_from_now(kLook))) {
      case ChildProcess::Outcome::done:
        if (line == kCancelled) return {WorkEnd::Kind::lost, "its process was told from outside to stop"};
        if (line == kNoMemory) {
          s.child.reset();
          return {WorkEnd::Kind::lost, "there was not enough memory"};
        }
        return {WorkEnd::Kind::answered, std::move(line), watch.used()};
      case ChildProcess::Outcome::ended:
      case ChildProcess::Outcome::too_long:
        return s.ended();
      case ChildProcess::Outcome::late:
        break;
    }
    if (cancelled()) return s.stopped();
    now = limits();
    watch.set_cpu_limit(cpu_limit());
    if (const std::string why = watch.check(s.child->cpu_seconds()); !why.empty()) return s.hung(why);
  }
}

void serve_work(const std::function<std::string(const std::string& request)>& answer, std::atomic<bool>& cancelled) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  cancel_of_server = &cancelled;
  for (const int signal : {SIGINT, SIGHUP}) std::signal(signal, SIG_IGN);
  std::signal(SIGTERM, [](int) { *cancel_of_server = true; });
  // Answers go to a copy of stdout, which nothing else can write to.
  const int out = fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 10);
  dup2(STDERR_FILENO, STDOUT_FILENO);
  // Whether it was written; false: the parent is gone. Takes no memory.
  const auto send = [out](std::string_view line) {
    while (!line.empty()) {
      const ssize_t n = write(out, line.data(), line.size());
      if (n < 0 && errno != EINTR) return false;
      if (n > 0) line.remove_prefix(n);
    }
    return true;
  };
  // Not std::cin, which takes single characters from stdin: requests have some 10 kB.
  struct Request {
    char* text = nullptr;
    std::size_t room = 0;
    ~Request() { std::free(text); }
  } request;
  try {
    ssize_t size = 0;
    for (errno = 0; (size = ::getline(&request.text, &request.room, stdin)) > 0; errno = 0) {
      if (request.text[size - 1] == '\n') --size;
      cancelled = false;
      const std::string line = answer(std::string(request.text, size));
      if (!send(cancelled ? std::string_view(kCancelled) : std::string_view(line)) || !send("\n")) return;
    }
    if (errno == ENOMEM) throw std::bad_alloc();
  } catch (const std::bad_alloc&) {
    if (send(kNoMemory)) send("\n");
  }
}

std::vector<std::string> this_program(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), std::filesystem::read_symlink("/proc/self/exe").string());
  return arguments;
}

}  // namespace weft
