#pragma once
#include <cstdint>
#include <string_view>

#include "weft/export.hpp"

namespace weft {

/// Key of a random stream: the bytes of a word of at most eight ASCII letters, the first one highest.
/// stream_key("goal") == 0x676f616c. Every purpose has its own stream.
consteval std::uint64_t stream_key(std::string_view word) {
  if (word.empty() || word.size() > 8) throw "a stream's word has 1 to 8 letters";
  std::uint64_t key = 0;
  for (const char letter : word) key = key << 8 | static_cast<unsigned char>(letter);
  return key;
}

/// Counter-based random numbers (Philox 4x32-10, Salmon et al. 2011). The stream is a pure function of (seed, keys).
/// So example 17 draws the same numbers in any order of examples and on any thread. Cheap to make and to copy.
class WEFT_API RandomStream {
 public:
  explicit RandomStream(std::uint64_t seed, std::uint64_t key_a = 0, std::uint64_t key_b = 0);
  /// An independent stream, fixed by this one's keys and `key`.
  RandomStream child(std::uint64_t key) const;
  std::uint32_t bits();
  std::uint64_t bits64();
  double uniform();  ///< [0, 1), 53 bits
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  double normal();                       ///< mean 0, sd 1 (Box-Muller)
  std::uint64_t below(std::uint64_t n);  ///< uniform in [0, n), n > 0, unbiased

 private:
  std::uint64_t key_;
  std::uint64_t stream_;
  std::uint64_t counter_ = 0;
  std::uint32_t block_[4] = {};
  int used_ = 4;
  double spare_ = 0.0;
  bool has_spare_ = false;
};

}  // namespace weft
