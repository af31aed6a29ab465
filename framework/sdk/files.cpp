#include "sdk/files.hpp"

#include <dlfcn.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <mutex>
#include <random>
#include <set>

#include "sdk/ended_process.hpp"
#include "sdk/fingerprint.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kTemporary = ".tmp";
constexpr std::size_t kDigits = 8;  // of each of the three numbers behind it: machine, process, chance

/// In which processes' numbers are unique: a boot of a machine, and a space of process numbers.
std::uint32_t this_machine() {
  static const std::uint32_t hash = [] {
    std::string boot;
    std::getline(std::ifstream("/proc/sys/kernel/random/boot_id"), boot);
    std::error_code unknown;
    return static_cast<std::uint32_t>(fnv1a(boot + fs::read_symlink("/proc/self/ns/pid", unknown).string()));
  }();
  return hash;
}

std::string unique_suffix() {
  std::random_device device;
  char text[40];
  std::snprintf(text, sizeof(text), "%s%08x%08x%08x", kTemporary.data(), this_machine(),
                static_cast<unsigned>(getpid()), device());
  return text;
}

/// Whether a file is a temporary of a process of this machine that has ended. @param self may be its number: then that
/// is an earlier process.
bool is_left_behind(const std::string& name, pid_t self) {
  const auto place = name.rfind(kTemporary);
  if (place == std::string::npos || name.size() != place + kTemporary.size() + 3 * kDigits) return false;
  const char* digits = name.data() + place + kTemporary.size();
  std::uint32_t machine = 0, process = 0;
  for (auto* number : {&machine, &process}) {
    if (std::from_chars(digits, digits + kDigits, *number, 16).ptr != digits + kDigits) return false;
    digits += kDigits;
  }
  if (machine != this_machine()) return false;
  return static_cast<pid_t>(process) == self || has_ended(static_cast<pid_t>(process));
}

/// Removes the temporaries that ended processes left in a folder, before this process writes its first file there.
void clear_once(const fs::path& folder) {
  static std::mutex mutex;
  static auto& cleared = *new std::set<fs::path>();  // lives as long as the last thread
  std::error_code ignored;
  const fs::path place = fs::canonical(folder.empty() ? "." : folder, ignored);
  const std::lock_guard lock(mutex);
  if (place.empty() || !cleared.insert(place).second) return;
  for (const auto& entry : fs::directory_iterator(place, ignored))
    if (is_left_behind(entry.path().filename().string(), getpid())) fs::remove_all(entry.path(), ignored);
}

/// Makes a folder if needed. @return why no file can be written in it, with its name; empty: one can.
std::string folder_problem(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (!fs::is_directory(folder))
    return folder.string() + ": the folder cannot be made: " + write_problem(error ? error.value() : ENOTDIR);
  if (::access(folder.c_str(), W_OK | X_OK) == 0) return "";
  return folder.string() + ": no file can be written in this folder: " + write_problem(errno);
}

}  // namespace

std::string write_problem(int error_number) {
  const std::string reason = std::strerror(error_number);
  switch (error_number) {
    case 0:
      return "the reason is not known";
    case ENOSPC:
      return reason + "; make room and run the command again";
    case EDQUOT:
      return reason + "; make room in your quota and run the command again";
    case EROFS:
    case EACCES:
    case EPERM:
      return reason + "; name another place";
    default:
      return reason;
  }
}

void make_writable_folder(const fs::path& folder) {
  if (const std::string problem = folder_problem(folder); !problem.empty()) throw ConfigError(problem);
}

void make_folder_for_results(const fs::path& folder) {
  if (const std::string problem = folder_problem(folder); !problem.empty()) throw WriteError(problem);
}

std::string no_file(const fs::path& file) {
  std::error_code none;
  switch (fs::status(file, none).type()) {
    case fs::file_type::directory:
      return "is a folder";
    case fs::file_type::fifo:
      return "is a pipe";
    case fs::file_type::socket:
      return "is a socket";
    case fs::file_type::character:
    case fs::file_type::block:
      return "is a device";  // it may never end
    default:
      return "";
  }
}

std::string no_text_file(const fs::path& file) {
  const fs::path folder = file.parent_path();
  const bool is_given = file == "/dev/stdin" || folder == "/dev/fd" || folder == "/proc/self/fd";
  return is_given ? "" : no_file(file);
}

void require_file(const fs::path& file) {
  std::error_code none;
  if (const std::string other = no_file(file); !other.empty())
    throw ConfigError(file.string() + ": " + other + ", must be a file");
  if (!fs::exists(file, none)) throw ConfigError(file.string() + ": no such file");
}

bool is_lfs_pointer(std::string_view beginning) { return beginning.starts_with("version https://git-lfs.github.com/"); }

bool is_lfs_pointer_file(const fs::path& file) {
  std::error_code none;
  if (!fs::is_regular_file(file, none)) return false;
  char beginning[64];
  std::ifstream stream(file, std::ios::binary);
  stream.read(beginning, sizeof(beginning));
  return is_lfs_pointer(std::string_view(beginning, stream.gcount()));
}

std::optional<std::string> whole_text_if_there(const fs::path& file) {
  std::error_code none;
  if (!fs::exists(file, none)) return std::nullopt;
  if (const std::string other = no_text_file(file); !other.empty())
    throw ReadError(file.string() + ": " + other + ", must be a file");
  errno = 0;
  std::ifstream stream(file, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(stream), {}};
  if (!stream)
    throw ReadError(file.string() + ": cannot be read" + (errno != 0 ? std::string(": ") + std::strerror(errno) : ""));
  if (is_lfs_pointer(text)) throw ReadError(file.string() + ": " + kLfsPointer);
  return text;
}

std::string whole_text(const fs::path& file) {
  auto text = whole_text_if_there(file);
  if (!text) throw ConfigError(file.string() + ": no such file");
  return *std::move(text);
}

WholeFile::WholeFile(std::filesystem::path file)
    : file_(std::move(file)), temporary_(file_.string() + unique_suffix()) {
  clear_once(file_.parent_path());
}

WholeFile::~WholeFile() {
  std::error_code ignored;
  std::filesystem::remove(temporary_, ignored);
}

void WholeFile::commit() {
  // Without this a power cut may leave a new name with no contents. EINVAL: the file system cannot do it.
  const int opened = open(temporary_.c_str(), O_RDONLY | O_CLOEXEC);
  if (opened < 0) fail(write_problem(errno));
  const int problem = fsync(opened) == 0 || errno == EINVAL ? 0 : errno;
  close(opened);
  if (problem != 0) fail(write_problem(problem));
  std::error_code error;
  std::filesystem::rename(temporary_, file_, error);
  if (error) fail(write_problem(error.value()));
}

void WholeFile::fail(const std::string& reason) const {
  throw WriteError(file_.string() + ": cannot be written: " + reason);
}

TemporaryFolder::TemporaryFolder(const fs::path& in) : path_(in / ("folder" + unique_suffix())) {
  clear_once(in);
  make_folder_for_results(path_);
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

std::filesystem::path library_folder() {
  Dl_info self{};
  if (dladdr(reinterpret_cast<const void*>(&library_folder), &self) == 0 || self.dli_fname == nullptr)
    throw Error("libweft.so: the folder that it was loaded from is not known");
  return std::filesystem::absolute(self.dli_fname).parent_path();
}

void write_text(const std::filesystem::path& file, std::string_view text) {
  WholeFile whole(file);
  const int opened = open(whole.temporary().c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (opened < 0) whole.fail(write_problem(errno));
  int problem = 0;
  while (!text.empty() && problem == 0) {
    const ssize_t written = write(opened, text.data(), text.size());
    if (written >= 0)
      text.remove_prefix(written);
    else if (errno != EINTR)
      problem = errno;
  }
  if (close(opened) != 0 && problem == 0) problem = errno;  // where a file system reports late what it could not write
  if (problem != 0) whole.fail(write_problem(problem));
  whole.commit();
}

}  // namespace weft
