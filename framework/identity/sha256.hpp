#pragma once
#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

namespace weft {

/// SHA-256 [FIPS 180-4] over bytes. Unlike Fingerprint it resists forgery: equal hashes mean equal contents.
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  void add(const void* data, std::size_t size);
  void add(std::string_view text) { add(text.data(), text.size()); }
  std::string hex();  ///< 64 digits. Call it once, at the end.

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

std::string sha256(std::string_view text);
/// Hash of a file's bytes. Remembers it while the file keeps its size and time.
/// @throws ConfigError naming the file and the reason if it cannot be read.
std::string sha256_of_file(const std::filesystem::path& file);
/// Hash of the names and contents of a folder's shard-*.h5, in the order of their names. Other files are ignored.
std::string sha256_of_dataset(const std::filesystem::path& folder);

}  // namespace weft
