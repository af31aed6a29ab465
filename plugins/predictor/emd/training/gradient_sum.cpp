#include "gradient_sum.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numeric>

#include "chunks.hpp"

namespace weft::emd {
namespace {

/// A slice of weights as it is sent: all its numbers.
struct SumWire {
  static std::size_t bytes(std::size_t weights) { return weights * sizeof(float); }
  static void put(const float* from, std::size_t count, std::byte* to) { std::memcpy(to, from, count * sizeof(float)); }
  /// Joins a slice of all parts. @param parts one after the other.
  static void join(const std::byte* parts, std::size_t count, std::size_t weights, std::byte* to) {
    const auto* part = reinterpret_cast<const float*>(parts);
    auto* sum = reinterpret_cast<float*>(to);
    for (std::size_t i = 0; i < weights; ++i) {
      float g = 0.0f;
      for (std::size_t p = 0; p < count; ++p) g += part[p * weights + i];
      sum[i] = g;
    }
  }
  static void get(const std::byte* from, std::size_t count, float* to) { std::memcpy(to, from, count * sizeof(float)); }
};

/// Eight sums side by side, so that none waits for the one before.
double sum_of_squares(const std::vector<float>& values, std::size_t from, std::size_t to) {
  std::array<double, 8> sums{};
  for (std::size_t i = from; i < to; ++i)
    sums[(i - from) % sums.size()] += static_cast<double>(values[i]) * static_cast<double>(values[i]);
  return std::accumulate(sums.begin(), sums.end(), 0.0);
}

int sign_of(float value) { return (value > 0) - (value < 0); }
int sign_of(int value) { return (value > 0) - (value < 0); }

/// One byte per weight: 1, 0 or -1.
struct SignWire {
  static std::size_t bytes(std::size_t weights) { return weights; }
  static void put(const float* from, std::size_t count, std::byte* to) {
    for (std::size_t i = 0; i < count; ++i) to[i] = static_cast<std::byte>(sign_of(from[i]));
  }
  static void join(const std::byte* parts, std::size_t count, std::size_t weights, std::byte* to) {
    for (std::size_t i = 0; i < weights; ++i) {
      int votes = 0;
      for (std::size_t p = 0; p < count; ++p) votes += static_cast<std::int8_t>(parts[p * weights + i]);
      to[i] = static_cast<std::byte>(sign_of(votes));
    }
  }
  static void get(const std::byte* from, std::size_t count, float* to) {
    for (std::size_t i = 0; i < count; ++i) to[i] = static_cast<float>(static_cast<std::int8_t>(from[i]));
  }
};

/// One bit per weight: whether it is negative. Weights are a multiple of 8.
struct BitWire {
  static std::size_t bytes(std::size_t weights) { return weights / 8; }
  static bool has(const std::byte* bits, std::size_t i) {
    return ((bits[i / 8] >> (i % 8)) & std::byte{1}) != std::byte{};
  }
  static void put(const float* from, std::size_t count, std::byte* to) {
    for (std::size_t i = 0; i < count; ++i) to[i / 8] |= std::byte{from[i] < 0} << (i % 8);
  }
  static void join(const std::byte* parts, std::size_t count, std::size_t weights, std::byte* to) {
    for (std::size_t i = 0; i < weights; ++i) {
      std::size_t minus = 0;
      for (std::size_t p = 0; p < count; ++p) minus += has(parts + p * bytes(weights), i) ? 1 : 0;
      to[i / 8] |= std::byte{2 * minus > count} << (i % 8);
    }
  }
  static void get(const std::byte* from, std::size_t count, float* to) {
    for (std::size_t i = 0; i < count; ++i) to[i] = has(from, i) ? -1.0f : 1.0f;
  }
};

}  // namespace

std::size_t parts_of_batch(const Training& t, std::size_t ranks) {
  const bool votes = t.optimiser == "signsgd";
  const auto parts = static_cast<std::size_t>(t.batch_parts());
  const std::string key = votes ? "training.votes" : "training.parts";
  if (parts % ranks != 0) {
    throw ConfigError("emd: " + key + " = " + std::to_string(parts) + ", must be a multiple of the number of ranks, " +
                      std::to_string(ranks));
  }
  if (votes && t.vote == "one_bit" && parts % 2 == 0)
    throw ConfigError("emd: " + key + " = " + std::to_string(parts) + ", must be odd with training.vote = one_bit");
  return parts;
}

GradientSum::GradientSum(const Training& training, Host& host, Ranks& ranks, std::size_t weights, std::size_t parts)
    : kind_(training.optimiser != "signsgd" ? Kind::sum
            : training.vote == "one_bit"    ? Kind::one_bit
                                            : Kind::sign),
      host_(host),
      ranks_(ranks),
      parts_(parts),
      slice_(8 * ((weights + 8 * ranks.size() - 1) / (8 * ranks.size()))),
      joined_(weights) {}

GradientSum::Direction GradientSum::join(const std::vector<std::vector<float>>& mine) {
  std::vector<double> squares(kChunks, 0.0);
  if (ranks_.size() == 1) {
    join_here(mine, squares);
  } else {
    if (kind_ == Kind::sum) {
      join_over_ranks<SumWire>(mine);
    } else if (kind_ == Kind::sign) {
      join_over_ranks<SignWire>(mine);
    } else {
      join_over_ranks<BitWire>(mine);
    }
    in_chunks(host_, joined_.size(), [&](std::size_t chunk, std::size_t from, std::size_t to) {
      squares[chunk] = sum_of_squares(joined_, from, to);
    });
  }
  return {joined_, std::sqrt(std::accumulate(squares.begin(), squares.end(), 0.0))};
}

void GradientSum::join_here(const std::vector<std::vector<float>>& mine, std::vector<double>& squares) {
  in_chunks(host_, joined_.size(), [&](std::size_t chunk, std::size_t from, std::size_t to) {
    if (kind_ == Kind::sum) {
      std::copy(mine.front().begin() + from, mine.front().begin() + to, joined_.begin() + from);
      for (std::size_t p = 1; p < mine.size(); ++p)
        for (std::size_t i = from; i < to; ++i) joined_[i] += mine[p][i];
    } else {
      for (std::size_t i = from; i < to; ++i) {
        int votes = 0;
        for (const auto& part : mine) votes += kind_ == Kind::sign ? sign_of(part[i]) : (part[i] < 0 ? -1 : 1);
        joined_[i] = static_cast<float>(sign_of(votes));
      }
    }
    squares[chunk] = sum_of_squares(joined_, from, to);
  });
}

template <class Wire>
void GradientSum::join_over_ranks(const std::vector<std::vector<float>>& mine) {
  const std::size_t weights = joined_.size(), here = mine.size(), ranks = ranks_.size();
  const std::size_t bytes = Wire::bytes(slice_);
  to_.assign(ranks * here * bytes, std::byte{});
  from_.resize(ranks * here * bytes);
  own_.assign(bytes, std::byte{});
  all_.resize(ranks * bytes);
  const auto begin = [&](std::size_t rank) { return std::min(rank * slice_, weights); };
  host_.parallel_for(static_cast<std::int64_t>(ranks * here), [&](std::int64_t k) {
    const auto block = static_cast<std::size_t>(k);
    const std::size_t rank = block / here;
    Wire::put(mine[block % here].data() + begin(rank), begin(rank + 1) - begin(rank), to_.data() + block * bytes);
  });
  ranks_.exchange(to_.data(), from_.data(), here * bytes);
  Wire::join(from_.data(), parts_, slice_, own_.data());
  ranks_.gather(own_.data(), all_.data(), bytes);
  host_.parallel_for(static_cast<std::int64_t>(ranks), [&](std::int64_t r) {
    const auto rank = static_cast<std::size_t>(r);
    Wire::get(all_.data() + rank * bytes, begin(rank + 1) - begin(rank), joined_.data() + begin(rank));
  });
}

}  // namespace weft::emd
