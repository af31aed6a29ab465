#pragma once
#include <cstddef>
#include <cstdint>

namespace weft {

/// FNV-1a, 64 bits, over bytes [Fowler, Noll, Vo 1991]: finds damage and tells contents apart; no defence against
/// forgery. Its values are in saved files.
class Fnv1a {
 public:
  Fnv1a() = default;
  /// Continues a hash. @param value of the bytes before.
  explicit Fnv1a(std::uint64_t value) : value_(value) {}
  void add(const void* data, std::size_t size) {
    const auto* bytes = static_cast<const unsigned char*>(data);
    for (std::size_t i = 0; i < size; ++i) value_ = (value_ ^ bytes[i]) * 0x100000001b3ull;
  }
  std::uint64_t value() const { return value_; }

 private:
  std::uint64_t value_ = 0xcbf29ce484222325ull;
};

}  // namespace weft
