#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "weft/host.hpp"

namespace weft::emd {

constexpr std::size_t kChunks = 64;  // of the weights, for work on each single weight

/// body(chunk, from, to) over `all` weights, on the host's threads. Chunks do not depend on the threads.
template <class Body>
void in_chunks(Host& host, std::size_t all, const Body& body) {
  const std::size_t size = (all + kChunks - 1) / kChunks;
  host.parallel_for(kChunks, [&](std::int64_t chunk) {
    const std::size_t from = std::min(static_cast<std::size_t>(chunk) * size, all);
    body(static_cast<std::size_t>(chunk), from, std::min(from + size, all));
  });
}

}  // namespace weft::emd
