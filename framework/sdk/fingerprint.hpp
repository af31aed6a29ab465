#pragma once
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "weft/hash.hpp"

namespace weft {

inline std::uint64_t fnv1a(std::string_view text) {
  Fnv1a hash;
  hash.add(text.data(), text.size());
  return hash.value();
}

/// 16 hexadecimal digits.
inline std::string hex_digits(std::uint64_t value) {
  static constexpr char kDigits[] = "0123456789abcdef";
  std::string text(16, '0');
  for (std::size_t i = 16; i-- > 0; value >>= 4) text[i] = kDigits[value & 15];
  return text;
}

/// 64-bit FNV-1a over bytes, with a final mix. Detects damage and tells configurations apart. Does not resist forgery.
class Fingerprint {
 public:
  void add(const void* data, std::size_t size) {
    Fnv1a hash(hash_);
    hash.add(data, size);
    hash_ = hash.value();
  }
  void add(std::string_view text) {
    const std::uint64_t size = text.size();
    add(&size, sizeof(size));
    add(text.data(), text.size());
  }
  template <class T>
  void add_values(const T* data, std::size_t count) {
    const std::uint64_t size = count;
    add(&size, sizeof(size));
    // Word by word: eight times faster than bytes, and these arrays are large.
    const auto* bytes = reinterpret_cast<const unsigned char*>(data);
    std::size_t left = count * sizeof(T);
    for (; left >= 8; left -= 8, bytes += 8) {
      std::uint64_t word = 0;
      __builtin_memcpy(&word, bytes, 8);
      hash_ = (hash_ ^ word) * 0x9E3779B97F4A7C15ull;
      hash_ ^= hash_ >> 29;
    }
    add(bytes, left);
  }
  std::uint64_t value() const {
    std::uint64_t z = hash_;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
    return z ^ (z >> 31);
  }
  std::string hex() const { return hex_digits(value()); }

 private:
  std::uint64_t hash_ = Fnv1a().value();
};

}  // namespace weft
