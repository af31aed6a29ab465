#include "processes/claims.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <mutex>
#include <random>
#include <thread>

#include "sdk/ended_process.hpp"
#include "sdk/files.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr const char* kUnknown = "unknown";

std::string first_line(const fs::path& file) {
  std::ifstream stream(file);
  std::string line;
  std::getline(stream, line);
  return line;
}

std::string host_name() {
  char name[256] = "";
  gethostname(name, sizeof(name) - 1);
  return name;
}

/// When a process began, in ticks since boot: tells it from a later one with its number. Empty: there is none.
std::string start_of(pid_t process) {
  const std::string stat = first_line("/proc/" + std::to_string(process) + "/stat");
  const auto name_end = stat.rfind(')');
  if (name_end == std::string::npos) return "";
  unsigned long long start = 0;
  constexpr const char* kField22 = " %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %*u %*u %*d %*d %*d %*d %*d %*d %llu";
  std::sscanf(stat.c_str() + name_end + 1, kField22, &start);
  return std::to_string(start);
}

std::string random_digits() {
  std::random_device device;
  char text[20];
  std::snprintf(text, sizeof(text), "%08x%08x", device(), device());
  return text;
}

/// What a claim file says: one line of words. Its length never changes, so that nobody reads half of an update.
struct Content {
  std::string machine, host, start, token;
  long process = 0, attempt = 0;
  unsigned long beat = 0;

  std::string line() const {
    char numbers[80];
    std::snprintf(numbers, sizeof(numbers), " %ld %ld %010lu\n", process, attempt, beat);
    return "weft-claim-1 " + machine + " " + host + " " + start + " " + token + numbers;
  }
  static std::optional<Content> parse(const std::string& text) {
    Content c;
    char machine[200], host[260], start[40], token[40];
    if (std::sscanf(text.c_str(), "weft-claim-1 %199s %259s %39s %39s %ld %ld %lu", machine, host, start, token,
                    &c.process, &c.attempt, &c.beat) != 7)
      return std::nullopt;
    c.machine = machine;
    c.host = host;
    c.start = start;
    c.token = token;
    return c;
  }
};

/// Opens the file each time: a network file system then asks its server for the newest contents.
std::optional<std::string> read_all(const fs::path& file) {
  const int opened = open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (opened < 0) return std::nullopt;
  std::string text;
  char block[1024];
  for (ssize_t n; (n = read(opened, block, sizeof(block))) > 0;) text.append(block, static_cast<std::size_t>(n));
  close(opened);
  return text;
}

bool write_once(int file, const std::string& text) {
  return pwrite(file, text.data(), text.size(), 0) == static_cast<ssize_t>(text.size());
}

}  // namespace

struct Claims::State {
  State(fs::path where, Options chosen) : folder(std::move(where)), options(std::move(chosen)) {
    self.machine = options.machine;
    self.host = host_name();
    if (self.host.empty()) self.host = kUnknown;
    self.process = getpid();
    self.start = start_of(getpid());
    if (self.start.empty()) self.start = kUnknown;
    toucher = std::thread([this] { touch_all(); });
  }

  fs::path file(const std::string& name) const { return folder / (name + ".claim"); }

  bool is_dead(const std::string& name, const std::string& text) {
    const auto content = Content::parse(text);
    if (content && content->machine == options.machine && content->start != kUnknown &&
        (start_of(static_cast<pid_t>(content->process)) != content->start ||
         has_ended(static_cast<pid_t>(content->process))))
      return true;
    const auto now = Clock::now();
    Observed& claim = observed[name];
    const bool is_first = claim.since == Clock::time_point();
    if (claim.text != text || is_first) {
      claim.has_changed = !is_first;
      claim.text = text;
      claim.since = now;
    }
    return std::chrono::duration<double>(now - claim.since).count() >= options.dead_after_s;
  }

  bool is_held(const std::string& name) {
    const auto text = read_all(file(name));
    if (!text || is_dead(name, *text)) return false;
    const auto content = Content::parse(*text);
    return (content && content->machine == options.machine && content->start != kUnknown) || observed[name].has_changed;
  }

  /// Removes a dead claim. @return false if another process was first, or if it lives after all.
  bool bury(const std::string& name, const std::string& text) {
    const fs::path claim = file(name), grave = claim.string() + ".dead" + random_digits();
    if (std::rename(claim.c_str(), grave.c_str()) != 0) return false;
    // Between the last look and the renaming, another process may have taken it: then it is put back.
    const bool is_it = read_all(grave) == text;
    if (!is_it && link(grave.c_str(), claim.c_str()) != 0 && errno != EEXIST) std::rename(grave.c_str(), claim.c_str());
    std::error_code ignored;
    fs::remove(grave, ignored);
    observed.erase(name);
    return is_it;
  }

  /// @return false: there is one.
  bool make(const std::string& name, long attempt) {
    const fs::path claim = file(name);
    const auto open_new = [&] { return open(claim.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0666); };
    int opened = open_new();
    if (opened < 0 && errno == ENOENT) {  // another process has ended and removed the empty folder
      std::error_code reported_below;
      fs::create_directories(folder, reported_below);
      opened = open_new();
    }
    if (opened < 0 && errno == EEXIST) return false;
    Content content = self;
    content.attempt = attempt;
    content.token = random_digits();
    const bool written = opened >= 0 && write_once(opened, content.line());
    const int reason = errno;
    if (opened >= 0) close(opened);
    if (!written) {
      std::error_code ignored;
      if (opened >= 0) fs::remove(claim, ignored);
      throw Error(claim.string() + ": cannot be made: " + write_problem(reason));
    }
    observed.erase(name);
    own[name] = content;
    return true;
  }

  void touch_all() {
    std::unique_lock lock(mutex);
    const auto period = std::chrono::duration<double>(options.touch_every_s);
    while (!wake.wait_for(lock, period, [&] { return ending; })) {
      for (auto& [name, content] : own) {
        ++content.beat;
        // Not made again if it has been taken: the other process's claim, which this may touch once, is not harmed.
        const int opened = open(file(name).c_str(), O_WRONLY | O_CLOEXEC);
        if (opened < 0) continue;
        if (const auto now = read_all(file(name));
            now && Content::parse(*now) && Content::parse(*now)->token == content.token)
          write_once(opened, content.line());
        close(opened);
      }
    }
  }

  void release(const std::string& name) {
    const auto mine = own.find(name);
    if (mine == own.end()) return;
    const auto text = read_all(file(name));
    const auto content = text ? Content::parse(*text) : std::nullopt;
    std::error_code ignored;
    if (content && content->token == mine->second.token) fs::remove(file(name), ignored);
    own.erase(mine);
  }

  fs::path folder;
  Options options;
  Content self;  ///< without attempt and token
  std::mutex mutex;
  std::condition_variable wake;
  bool ending = false;
  std::map<std::string, Content> own;
  /// Another process's claim.
  struct Observed {
    std::string text;  ///< its contents
    Clock::time_point since;
    bool has_changed = false;  ///< since it was seen first
  };
  std::map<std::string, Observed> observed;
  std::thread toucher;
};

Claims::Claims(fs::path folder) : Claims(std::move(folder), Options()) {}

Claims::Claims(fs::path folder, Options options) {
  std::error_code problem;
  fs::create_directories(folder, problem);
  if (!fs::is_directory(folder)) throw Error(folder.string() + ": cannot be made: " + write_problem(problem.value()));
  state_ = std::make_unique<State>(std::move(folder), std::move(options));
}

Claims::~Claims() {
  {
    const std::lock_guard lock(state_->mutex);
    while (!state_->own.empty()) state_->release(state_->own.begin()->first);
    state_->ending = true;
  }
  state_->wake.notify_all();
  state_->toucher.join();
  std::error_code not_empty;
  fs::remove(state_->folder, not_empty);
}

std::optional<int> Claims::take(const std::string& name) {
  const std::lock_guard lock(state_->mutex);
  if (state_->own.contains(name)) return std::nullopt;
  if (state_->make(name, 1)) return 1;
  const auto text = read_all(state_->file(name));
  if (!text || !state_->is_dead(name, *text)) return std::nullopt;
  const auto before = Content::parse(*text);
  if (!state_->bury(name, *text)) return std::nullopt;
  const long attempt = before ? before->attempt + 1 : 2;
  return state_->make(name, attempt) ? std::optional(static_cast<int>(attempt)) : std::nullopt;
}

bool Claims::is_held(const std::string& name) {
  const std::lock_guard lock(state_->mutex);
  return state_->is_held(name);
}

void Claims::release(const std::string& name) {
  const std::lock_guard lock(state_->mutex);
  state_->release(name);
}

std::string Claims::this_machine() {
  std::error_code unknown;
  std::string space = fs::read_symlink("/proc/self/ns/pid", unknown).string();  // pid:[4026531836]
  for (char& c : space) {
    if (c <= ' ') c = '_';
  }
  const std::string boot = first_line("/proc/sys/kernel/random/boot_id");
  return (boot.empty() ? kUnknown : boot) + "/" + space;
}

bool take_in_turn(Claims& claims, const std::string& name, const std::function<void()>& waiting,
                  const std::function<bool()>& cancelled) {
  for (bool is_first = true; !claims.take(name); is_first = false) {
    if (is_first) waiting();
    if (cancelled()) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
  }
  return true;
}

Leftovers::Leftovers(const fs::path& folder) {
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(folder, none)) {
    const std::string name = entry.path().filename().string();
    if (const auto end = name.rfind(".tmp"); end != std::string::npos)
      by_name_[name.substr(0, end)].push_back(entry.path());
  }
}

void Leftovers::remove(const fs::path& file) {
  const auto found = by_name_.find(file.filename().string());
  if (found == by_name_.end()) return;
  std::error_code ignored;
  for (const auto& one : found->second) fs::remove(one, ignored);
  by_name_.erase(found);
}

}  // namespace weft
