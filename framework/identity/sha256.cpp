#include "identity/sha256.hpp"

#include <openssl/evp.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <map>
#include <mutex>
#include <tuple>
#include <vector>

#include "sdk/machine_failure.hpp"

namespace weft {

namespace fs = std::filesystem;

struct Sha256::Impl {
  std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context{EVP_MD_CTX_new(), EVP_MD_CTX_free};
};

Sha256::Sha256() : impl_(std::make_unique<Impl>()) {
  if (!impl_->context || EVP_DigestInit_ex(impl_->context.get(), EVP_sha256(), nullptr) != 1)
    throw Error("SHA-256 is not available in this OpenSSL");
}
Sha256::~Sha256() = default;

void Sha256::add(const void* data, std::size_t size) {
  if (EVP_DigestUpdate(impl_->context.get(), data, size) != 1) throw Error("SHA-256 failed");
}

std::string Sha256::hex() {
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int size = 0;
  if (EVP_DigestFinal_ex(impl_->context.get(), digest, &size) != 1) throw Error("SHA-256 failed");
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string text;
  for (unsigned int i = 0; i < size; ++i) {
    text += kDigits[digest[i] >> 4];
    text += kDigits[digest[i] & 15];
  }
  return text;
}

std::string sha256(std::string_view text) {
  Sha256 hash;
  hash.add(text);
  return hash.hex();
}

namespace {

std::string hash_bytes_of(const fs::path& file) {
  errno = 0;  // a stream does not report why it failed; errno does
  std::ifstream stream(file, std::ios::binary);
  std::vector<char> block(1 << 16);
  Sha256 hash;
  while (stream) {
    stream.read(block.data(), static_cast<std::streamsize>(block.size()));
    hash.add(block.data(), static_cast<std::size_t>(stream.gcount()));
  }
  if (!stream.eof())
    throw ReadError(file.string() + ": cannot be read: " + (errno != 0 ? std::strerror(errno) : "the stream failed"));
  return hash.hex();
}

}  // namespace

std::string sha256_of_file(const fs::path& file) {
  using State = std::tuple<std::uintmax_t, fs::file_time_type>;
  static std::mutex mutex;
  static std::map<fs::path, std::pair<State, std::string>> known;
  std::error_code unreadable, ignored;
  if (const auto status = fs::status(file, ignored); fs::exists(status) && !fs::is_regular_file(status))
    throw ConfigError(file.string() + ": is not a file");  // a device may never end
  const State state{fs::file_size(file, unreadable), fs::last_write_time(file, ignored)};
  const fs::path key = fs::weakly_canonical(file, ignored);
  if (!unreadable) {
    const std::lock_guard lock(mutex);
    if (const auto found = known.find(key); found != known.end() && found->second.first == state)
      return found->second.second;
  }
  const std::string hash = hash_bytes_of(file);
  const std::lock_guard lock(mutex);
  known[key] = {state, hash};
  return hash;
}

std::string sha256_of_dataset(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code problem;
  for (const auto& entry : fs::directory_iterator(folder, problem)) {
    if (entry.path().filename().string().starts_with("shard-") && entry.path().extension() == ".h5")
      files.push_back(entry.path());
  }
  if (problem) throw ReadError(folder.string() + ": cannot be read: " + problem.message());
  std::sort(files.begin(), files.end());
  Sha256 hash;
  for (const auto& file : files) hash.add(file.filename().string() + " " + sha256_of_file(file) + "\n");
  return hash.hex();
}

}  // namespace weft
