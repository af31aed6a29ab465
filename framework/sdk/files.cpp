#include "sdk/files.hpp"

#include <dlfcn.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <random>

#include "weft/error.hpp"

namespace weft {
namespace {

std::string unique_suffix() {
  std::random_device device;
  char text[24];
  std::snprintf(text, sizeof(text), ".tmp%08x%08x", device(), device());
  return text;
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

void make_writable_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (!std::filesystem::is_directory(folder)) {
    throw ConfigError(folder.string() +
                      ": the folder cannot be made: " + write_problem(error ? error.value() : ENOTDIR));
  }
  if (::access(folder.c_str(), W_OK | X_OK) != 0)
    throw ConfigError(folder.string() + ": no file can be written in this folder: " + write_problem(errno));
}

bool is_lfs_pointer(std::string_view beginning) { return beginning.starts_with("version https://git-lfs.github.com/"); }

WholeFile::WholeFile(std::filesystem::path file)
    : file_(std::move(file)), temporary_(file_.string() + unique_suffix()) {}

WholeFile::~WholeFile() {
  std::error_code ignored;
  std::filesystem::remove(temporary_, ignored);
}

void WholeFile::commit() {
  std::error_code error;
  std::filesystem::rename(temporary_, file_, error);
  if (error) fail(write_problem(error.value()));
}

void WholeFile::fail(const std::string& reason) const {
  throw Error(file_.string() + ": cannot be written: " + reason);
}

std::filesystem::path library_folder() {
  Dl_info self{};
  if (dladdr(reinterpret_cast<const void*>(&library_folder), &self) == 0 || self.dli_fname == nullptr)
    throw Error("libweft.so: the folder that it was loaded from is not known");
  return std::filesystem::absolute(self.dli_fname).parent_path();
}

void write_text(const std::filesystem::path& file, std::string_view text) {
  WholeFile whole(file);
  errno = 0;  // a stream does not report why it failed; errno does
  std::ofstream stream(whole.temporary(), std::ios::binary);
  stream.write(text.data(), static_cast<std::streamsize>(text.size()));
  stream.close();
  if (!stream) whole.fail(write_problem(errno));
  whole.commit();
}

}  // namespace weft
