#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "weft/trainable.hpp"

namespace weft::emd {

/// Another rank has died, or does not answer.
class RanksLost : public Error {
 public:
  using Error::Error;
};

/// The processes that fit one model, connected by libtorch's Gloo over TCP. All ranks make the same calls in the same
/// order, each from one thread. @throws RanksLost from any call when another rank has died or does not answer for
/// ten minutes.
class Ranks {
 public:
  /// Joins the others. One rank alone needs nobody. @throws Unsupported without Gloo; Error when the others do not come
  /// within half an hour.
  explicit Ranks(const FitRanks& options);
  ~Ranks();
  Ranks(const Ranks&) = delete;
  Ranks& operator=(const Ranks&) = delete;

  std::size_t rank() const { return rank_; }
  std::size_t size() const { return size_; }
  bool is_first() const { return rank_ == 0; }

  /// Rank 0 calls it after work that takes any time; the others wait there for it.
  void wait_for_first();
  /// @throws ConfigError naming the rank whose text is not the one of rank 0.
  void require_same(const std::string& text);
  /// Gives all ranks the values of rank 0.
  template <class T>
  void broadcast(T* values, std::size_t count) {
    static_assert(std::is_trivially_copyable_v<T>);
    broadcast_bytes(reinterpret_cast<std::byte*>(values), count * sizeof(T));
  }
  template <class T>
  void broadcast(std::vector<T>& values) {
    std::uint64_t count = values.size();
    broadcast(&count, 1);
    values.resize(count);
    broadcast(values.data(), values.size());
  }
  /// Sends block r of `to` to rank r. @param to, from [size][bytes]: block r of `from` is the one that rank r sent here.
  void exchange(const std::byte* to, std::byte* from, std::size_t bytes);
  /// @param mine [bytes]. @param all [size][bytes], in the order of the ranks.
  void gather(const std::byte* mine, std::byte* all, std::size_t bytes);
  /// That this rank has sent to others by exchange() and gather().
  std::uint64_t bytes_sent() const { return bytes_sent_; }

 private:
  void broadcast_bytes(std::byte* values, std::size_t bytes);
  template <class Body>
  void together(const Body& body);
  struct Engine;
  std::size_t rank_, size_;
  std::uint64_t bytes_sent_ = 0;
  std::unique_ptr<Engine> engine_;  // null: one rank
};

}  // namespace weft::emd
