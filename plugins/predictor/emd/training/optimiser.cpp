#include "optimiser.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "learning_rate.hpp"

namespace weft::emd {
namespace {

constexpr std::size_t kChunks = 64;  // of the weights, for work on each single weight

}  // namespace

void Optimiser::step(const std::vector<std::vector<float>>& gradients, FitState& state) {
  if (t_.optimiser == "signsgd") {
    signsgd(gradients, state);
  } else {
    adam(gradients, state);
  }
  if (t_.average > 0) average(state);
}

/// body(chunk, from, to) over the weights. Chunks do not depend on the threads.
template <class Body>
void Optimiser::in_chunks(const Body& body) {
  const std::size_t all = sum_.size(), size = (all + kChunks - 1) / kChunks;
  host_.parallel_for(kChunks, [&](std::int64_t chunk) {
    const std::size_t from = std::min(chunk * size, all);
    body(chunk, from, std::min(from + size, all));
  });
}

/// Kingma & Ba 2015, with the decoupled weight decay of Loshchilov & Hutter 2019.
void Optimiser::adam(const std::vector<std::vector<float>>& gradients, FitState& state) {
  std::array<double, kChunks> squares{};
  in_chunks([&](std::int64_t chunk, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i) {
      float g = 0.0f;
      for (const auto& part : gradients) g += part[i];
      sum_[i] = g;
      squares[chunk] += static_cast<double>(g) * static_cast<double>(g);
    }
  });
  const double norm = std::sqrt(std::accumulate(squares.begin(), squares.end(), 0.0));
  const auto clip = static_cast<float>(t_.clip > 0 && norm > t_.clip ? t_.clip / norm : 1.0);
  state.rate = cosine_rate(t_, state.iteration, state.time_used);
  constexpr double kBeta1 = 0.9, kBeta2 = 0.99;
  const double n = static_cast<double>(state.iteration) + 1.0;
  const auto correct1 = static_cast<float>(1.0 / (1.0 - std::pow(kBeta1, n)));
  const auto correct2 = static_cast<float>(1.0 / (1.0 - std::pow(kBeta2, n)));
  const auto rate = static_cast<float>(state.rate);
  const auto decay = static_cast<float>(state.rate * t_.weight_decay);
  in_chunks([&](std::int64_t, std::size_t from, std::size_t to) {
    constexpr float b1 = kBeta1, b2 = kBeta2;
    auto &first = state.first_moment, &second = state.second_moment, &weights = state.weights;
    for (std::size_t i = from; i < to; ++i) {
      const float g = sum_[i] * clip;
      first[i] = b1 * first[i] + (1.0f - b1) * g;
      second[i] = b2 * second[i] + (1.0f - b2) * g * g;
      weights[i] -= rate * first[i] * correct1 / (std::sqrt(second[i] * correct2) + 1e-8f) + decay * weights[i];
    }
  });
}

/// Majority vote (Bernstein et al. 2018): the sign of each part's gradient, summed, and the sign of that.
void Optimiser::signsgd(const std::vector<std::vector<float>>& gradients, FitState& state) {
  const auto rate = static_cast<float>(state.rate);
  in_chunks([&](std::int64_t, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i) {
      int votes = 0;
      for (const auto& part : gradients) votes += (part[i] > 0) - (part[i] < 0);
      state.weights[i] -= rate * static_cast<float>((votes > 0) - (votes < 0));
    }
  });
}

/// Exponential moving average, which forgets faster at first.
void Optimiser::average(FitState& state) {
  const auto n = static_cast<double>(state.iteration);
  const auto keep = static_cast<float>(std::min(t_.average, (1.0 + n) / (10.0 + n)));
  in_chunks([&](std::int64_t, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i)
      state.average[i] = keep * state.average[i] + (1.0f - keep) * state.weights[i];
  });
}

}  // namespace weft::emd
