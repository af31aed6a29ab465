#include "sdk/files.hpp"

#include <dlfcn.h>

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

WholeFile::WholeFile(std::filesystem::path file)
    : file_(std::move(file)), temporary_(file_.string() + unique_suffix()) {}

WholeFile::~WholeFile() {
  std::error_code ignored;
  std::filesystem::remove(temporary_, ignored);
}

void WholeFile::commit() {
  std::error_code error;
  std::filesystem::rename(temporary_, file_, error);
  if (error) fail(error.message());
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
  if (!stream) whole.fail(errno != 0 ? std::strerror(errno) : "the stream failed");
  whole.commit();
}

}  // namespace weft
