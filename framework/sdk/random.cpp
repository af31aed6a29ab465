#include "weft/random.hpp"

#include <cmath>
#include <numbers>

#include "sdk/philox.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

// The finaliser of splitmix64 spreads small keys over all bits.
std::uint64_t mix(std::uint64_t z) {
  z += 0x9E3779B97F4A7C15ull;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

}  // namespace

RandomStream::RandomStream(std::uint64_t seed, std::uint64_t key_a, std::uint64_t key_b)
    : key_(mix(seed)), stream_(mix(mix(key_a) + key_b)) {}

RandomStream RandomStream::child(std::uint64_t key) const {
  RandomStream stream = *this;
  stream.stream_ = mix(stream_ + mix(key));
  stream.counter_ = 0;
  stream.used_ = 4;
  stream.has_spare_ = false;
  return stream;
}

std::uint32_t RandomStream::bits() {
  if (used_ == 4) {
    philox(key_, stream_, counter_++, block_);
    used_ = 0;
  }
  return block_[used_++];
}

std::uint64_t RandomStream::bits64() {
  const std::uint64_t high = bits();
  return high << 32 | bits();
}

double RandomStream::uniform() { return static_cast<double>(bits64() >> 11) * 0x1.0p-53; }

double RandomStream::normal() {
  if (has_spare_) {
    has_spare_ = false;
    return spare_;
  }
  const double radius = std::sqrt(-2.0 * std::log(1.0 - uniform()));
  const double angle = 2.0 * std::numbers::pi * uniform();
  spare_ = radius * std::sin(angle);
  has_spare_ = true;
  return radius * std::cos(angle);
}

std::uint64_t RandomStream::below(std::uint64_t n) {
  if (n == 0) throw Error("RandomStream::below: n = 0, must be at least 1");
  const std::uint64_t limit = ~0ull - ~0ull % n;  // rejection makes it unbiased
  std::uint64_t value = bits64();
  while (value >= limit) value = bits64();
  return value % n;
}

}  // namespace weft
