#include "session/process_environment.hpp"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <thread>

#include "weft/config.hpp"

extern char** environ;

namespace weft {
namespace {

using json = nlohmann::json;
using Clock = std::chrono::steady_clock;

constexpr const char* kProtocol = "weft environment";
constexpr double kGraceSeconds = 2.0;  ///< wait for the process to end by itself, and once more after SIGTERM

Clock::time_point seconds_from_now(double seconds) {
  return Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(seconds));
}

/// A pipe. The destructor closes it, and it is closed in every program that this one starts.
class Pipe {
 public:
  Pipe() {
    if (pipe2(ends_, O_CLOEXEC) != 0) throw Error(std::string("a pipe cannot be made: ") + std::strerror(errno));
  }
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

/// @return false if the time is over first.
bool wait_for(int file, short event, Clock::time_point deadline) {
  while (true) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now()).count();
    pollfd one{file, event, 0};
    const int ready = poll(&one, 1, static_cast<int>(std::clamp<std::int64_t>(left, 0, 1000000)));
    if (ready > 0) return true;
    if (ready < 0 && errno != EINTR) throw Error(std::string("poll: ") + std::strerror(errno));
    if (left <= 0) return false;
  }
}

/// The beginning of a process's output, for a message.
std::string excerpt(const std::string& text) {
  constexpr std::size_t kMost = 80;
  std::string shown = text.substr(0, kMost);
  for (char& c : shown) {
    if (c < ' ' || c > '~') c = '?';
  }
  return "'" + shown + (text.size() > kMost ? "...'" : "'");
}

std::string seconds_text(double seconds) { return ConfigNode::number(seconds).as_string() + " s"; }

json rows_of(const auto& matrix) {
  auto rows = json::array();
  for (Index r = 0; r < matrix.rows(); ++r) {
    auto row = json::array();
    for (Index c = 0; c < matrix.cols(); ++c) row.push_back(matrix(r, c));
    rows.push_back(std::move(row));
  }
  return rows;
}

/// The first request: all that the process must know about the task.
json greeting(const Task& task) {
  const auto& garment = *task.garment;
  return {{"type", "hello"},
          {"protocol", kProtocol},
          {"version", ProcessEnvironment::kProtocolVersion},
          {"garment",
           {{"name", garment.name},
            {"vertices", garment.vertex_count()},
            {"positions_m", rows_of(garment.positions)},
            {"rest_positions_m", rows_of(garment.rest)},
            {"faces", rows_of(garment.faces)}}},
          {"grasp_vertices", task.manipulation.grasp_vertices},
          {"grasp_points_m", rows_of(task.manipulation.grasp_points)},
          {"frame_s", kFrameSeconds},
          {"frames_per_segment", kFramesPerSegment},
          {"settle",
           {{"speed_m_per_s", task.settle.speed},
            {"hold_s", task.settle.hold_frames * kFrameSeconds},
            {"timeout_s", task.settle.max_frames * kFrameSeconds}}}};
}

}  // namespace

/// The process and its two pipes, which carry lines.
class ProcessEnvironment::Link {
 public:
  Link(const ProcessOptions& options, Index vertices) : timeout_s_(options.timeout_s) {
    for (const auto& word : options.command) name_ += (name_.empty() ? "" : " ") + word;
    longest_line_ = 1'000'000 + 1'000 * static_cast<std::size_t>(vertices);
    start(options);
  }
  ~Link() { end(); }

  [[noreturn]] void fail(const std::string& message) const { throw Error("environment `" + name_ + "` " + message); }

  /// Sends a request and reads its answer. @param wanted type of the answer.
  json ask(const json& request, const std::string& wanted) {
    const auto asked = request.at("type").get<std::string>();
    const auto deadline = seconds_from_now(timeout_s_);
    send(asked, request.dump() + "\n", deadline);
    const json answer = parsed(asked, receive(asked, deadline));
    if (!answer.is_object() || !answer.contains("type") || !answer["type"].is_string())
      fail("answered " + asked + " with " + excerpt(answer.dump()) + ", must be an object with a type");
    const auto type = answer["type"].get<std::string>();
    if (type == "error") fail("refuses " + asked + ": " + text(answer, "message"));
    if (type != wanted) fail("answered " + asked + " with type " + excerpt(type) + ", must be '" + wanted + "'");
    if (answer.contains("warning")) {
      const std::string warning = text(answer, "warning");
      if (std::find(warnings_.begin(), warnings_.end(), warning) == warnings_.end()) warnings_.push_back(warning);
    }
    return answer;
  }

  std::string text(const json& answer, const char* key) const {
    if (!answer.contains(key) || !answer[key].is_string()) fail("sent no `" + std::string(key) + "`, must be a text");
    return answer[key].get<std::string>();
  }
  /// A number >= 0; `otherwise` if the key is missing.
  double number(const json& answer, const char* key, double otherwise) const {
    if (!answer.contains(key)) return otherwise;
    const json& value = answer[key];
    if (!value.is_number() || value.get<double>() < 0.0)
      fail("answered `" + std::string(key) + "` = " + excerpt(value.dump()) + ", must be a number >= 0");
    return value.get<double>();
  }

  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  void start(const ProcessOptions& options) {
    if (!std::filesystem::is_directory(options.folder))
      throw ConfigError("the working folder " + options.folder.string() + " does not exist");
    posix_spawn_file_actions_t files;
    posix_spawn_file_actions_init(&files);
    posix_spawn_file_actions_adddup2(&files, to_.reader(), STDIN_FILENO);
    posix_spawn_file_actions_adddup2(&files, from_.writer(), STDOUT_FILENO);
    posix_spawn_file_actions_addchdir_np(&files, options.folder.c_str());
    // Its own process group: ^C ends a session after the current segment, and must not reach the robot's process.
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    sigset_t none, standard;
    sigemptyset(&none);
    posix_spawnattr_setsigmask(&attributes, &none);
    sigemptyset(&standard);
    for (const int signal : {SIGPIPE, SIGINT, SIGTERM}) sigaddset(&standard, signal);
    posix_spawnattr_setsigdefault(&attributes, &standard);
    std::vector<std::string> words = options.command;
    std::vector<char*> arguments;
    for (auto& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    const int problem = posix_spawnp(&process_, arguments.front(), &files, &attributes, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&files);
    posix_spawnattr_destroy(&attributes);
    if (problem != 0) throw ConfigError(std::string("cannot be run: ") + std::strerror(problem));
    to_.close_reader();
    from_.close_writer();
    for (const int file : {to_.writer(), from_.reader()}) fcntl(file, F_SETFL, fcntl(file, F_GETFL) | O_NONBLOCK);
  }

  /// @return whether the process has ended by the deadline. Does not reap it.
  bool ended_by(Clock::time_point deadline) const {
    while (true) {
      siginfo_t info{};
      if (waitid(P_PID, process_, &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid != 0) return true;
      if (Clock::now() >= deadline) return false;
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  }
  void end() {
    to_.close_writer();
    from_.close_reader();
    for (const int signal : {SIGTERM, SIGKILL}) {
      if (ended_by(seconds_from_now(kGraceSeconds))) break;
      kill(-process_, signal);
    }
    while (waitpid(process_, nullptr, 0) == -1 && errno == EINTR) continue;
  }
  /// Reports a process that closed its pipe.
  [[noreturn]] void fail_ended(const std::string& asked) const {
    siginfo_t info{};
    if (!ended_by(seconds_from_now(1.0)) || waitid(P_PID, process_, &info, WEXITED | WNOHANG | WNOWAIT) != 0)
      fail("closed its pipe before it answered " + asked);
    if (info.si_code == CLD_EXITED)
      fail("ended with exit code " + std::to_string(info.si_status) + " before it answered " + asked);
    fail("was ended by signal " + std::to_string(info.si_status) + " (" + strsignal(info.si_status) +
         ") before it answered " + asked);
  }

  void send(const std::string& asked, const std::string& line, Clock::time_point deadline) {
    if (!read_.empty()) fail("sent more than its answer: " + excerpt(read_));
    const NoBrokenPipeSignal quiet;
    for (std::size_t sent = 0; sent < line.size();) {
      if (!wait_for(to_.writer(), POLLOUT, deadline))
        fail("did not read " + asked + " within " + seconds_text(timeout_s_) + " (environment.timeout_s)");
      const ssize_t n = write(to_.writer(), line.data() + sent, line.size() - sent);
      if (n >= 0)
        sent += n;
      else if (errno == EPIPE)
        fail_ended(asked);
      else if (errno != EAGAIN && errno != EINTR)
        fail("cannot be written to: " + std::string(std::strerror(errno)));
    }
  }
  std::string receive(const std::string& asked, Clock::time_point deadline) {
    char block[65536];
    while (true) {
      if (const auto end = read_.find('\n'); end != std::string::npos) {
        const std::string line = read_.substr(0, end);
        read_.erase(0, end + 1);
        return line;
      }
      if (read_.size() > longest_line_)
        fail("answered " + asked + " with a line of more than " + std::to_string(longest_line_) + " bytes");
      if (!wait_for(from_.reader(), POLLIN, deadline))
        fail("did not answer " + asked + " within " + seconds_text(timeout_s_) + " (environment.timeout_s)");
      const ssize_t n = read(from_.reader(), block, sizeof(block));
      if (n > 0)
        read_.append(block, n);
      else if (n == 0)
        fail_ended(asked);
      else if (errno != EAGAIN && errno != EINTR)
        fail("cannot be read from: " + std::string(std::strerror(errno)));
    }
  }
  json parsed(const std::string& asked, const std::string& line) const {
    bool finite = true;
    try {
      return json::parse(line);
    } catch (const json::out_of_range&) {  // 1e999
      finite = false;
    } catch (const json::parse_error&) {  // NaN and Infinity are not JSON, but many programs write them
      finite = line.find("NaN") == std::string::npos && line.find("Infinity") == std::string::npos;
    }
    if (!finite) fail("answered " + asked + " with a number that is not finite");
    fail("answered " + asked + " with " + excerpt(line) + ", must be one line of JSON");
  }

  std::string name_;
  double timeout_s_;
  std::size_t longest_line_;
  pid_t process_ = -1;
  Pipe to_, from_;
  std::string read_;  ///< text after the last line
  std::vector<std::string> warnings_;
};

ProcessEnvironment::ProcessEnvironment(const ProcessOptions& options, const Task& task)
    : options_(options), vertices_(task.garment->vertex_count()), link_(std::make_unique<Link>(options, vertices_)) {
  const json answer = link_->ask(greeting(task), "hello");
  if (link_->text(answer, "protocol") != kProtocol)
    link_->fail("speaks another protocol, " + excerpt(link_->text(answer, "protocol")));
  if (!answer.contains("version") || answer["version"] != kProtocolVersion)
    link_->fail("speaks version " + excerpt(answer.value("version", json()).dump()) +
                " of the protocol, this weft speaks version " + std::to_string(kProtocolVersion));
}
ProcessEnvironment::~ProcessEnvironment() = default;

std::vector<std::string> ProcessEnvironment::warnings() const { return link_->warnings(); }

Observation ProcessEnvironment::observe() {
  const json answer = link_->ask({{"type", "observe"}}, "observation");
  if (!answer.contains("positions_m") || !answer["positions_m"].is_array())
    link_->fail("sent an observation without positions_m, must be a list with one entry per vertex");
  const json& positions = answer["positions_m"];
  if (positions.size() != static_cast<std::size_t>(vertices_))
    link_->fail("observed " + std::to_string(positions.size()) + " vertices, must be " + std::to_string(vertices_));
  Observation seen;
  seen.positions.resize(vertices_, 3);
  seen.sigma = link_->number(answer, "sigma_m", options_.sigma);
  seen.height_sigma = link_->number(answer, "height_sigma_m", options_.height_sigma);
  std::vector<bool> observed(positions.size());
  for (Index v = 0; v < vertices_; ++v) {
    const json& point = positions[v];
    observed[v] = !point.is_null();
    if (point.is_null()) {
      seen.positions.row(v).setConstant(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    const bool is_point = point.is_array() && point.size() == 3 &&
                          std::all_of(point.begin(), point.end(), [](const json& x) { return x.is_number(); });
    if (!is_point)
      link_->fail("observed vertex " + std::to_string(v) + " at " + excerpt(point.dump()) +
                  ", must be [x, y, z] in m, or null if it is not seen");
    for (Index c = 0; c < 3; ++c) seen.positions(v, c) = point[c].get<double>();
  }
  const auto count = std::count(observed.begin(), observed.end(), true);
  if (count == 0) link_->fail("observed no vertex, must observe at least one");
  if (count < vertices_) seen.observed = std::move(observed);  // empty: all are seen
  return seen;
}

void ProcessEnvironment::execute(const SegmentPath& path) {
  auto targets = json::array();
  for (const auto& points : path.targets) targets.push_back(rows_of(points));
  link_->ask({{"type", "execute"}, {"targets_m", targets}}, "executed");
}

SettleResult ProcessEnvironment::release() {
  const json answer = link_->ask({{"type", "release"}}, "released");
  if (!answer.contains("settled") || !answer["settled"].is_boolean())
    link_->fail("answered release without `settled`, must be true or false");
  SettleResult result;
  result.settled = answer["settled"].get<bool>();
  result.frames = std::lround(std::min(link_->number(answer, "settle_s", 0.0), 1e6) / kFrameSeconds);
  return result;
}

}  // namespace weft
