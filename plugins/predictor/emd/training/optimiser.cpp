#include "optimiser.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "chunks.hpp"
#include "learning_rate.hpp"

namespace weft::emd {

void Optimiser::step(const std::vector<float>& direction, FitState& state) {
  if (t_.optimiser == "signsgd") {
    signsgd(direction, state);
  } else {
    adam(direction, state);
  }
  if (t_.average > 0) average(state);
}

/// Kingma & Ba 2015, with the decoupled weight decay of Loshchilov & Hutter 2019.
void Optimiser::adam(const std::vector<float>& gradient, FitState& state) {
  std::array<double, kChunks> squares{};
  in_chunks(host_, size_, [&](std::size_t chunk, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i)
      squares[chunk] += static_cast<double>(gradient[i]) * static_cast<double>(gradient[i]);
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
  in_chunks(host_, size_, [&](std::size_t, std::size_t from, std::size_t to) {
    constexpr float b1 = kBeta1, b2 = kBeta2;
    auto &first = state.first_moment, &second = state.second_moment, &weights = state.weights;
    for (std::size_t i = from; i < to; ++i) {
      const float g = gradient[i] * clip;
      first[i] = b1 * first[i] + (1.0f - b1) * g;
      second[i] = b2 * second[i] + (1.0f - b2) * g * g;
      weights[i] -= rate * first[i] * correct1 / (std::sqrt(second[i] * correct2) + 1e-8f) + decay * weights[i];
    }
  });
}

/// Majority vote (Bernstein et al. 2018): the sign of each part's gradient, summed, and the sign of that.
void Optimiser::signsgd(const std::vector<float>& vote, FitState& state) {
  const auto rate = static_cast<float>(state.rate);
  in_chunks(host_, size_, [&](std::size_t, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i) state.weights[i] -= rate * vote[i];
  });
}

/// Exponential moving average, which forgets faster at first.
void Optimiser::average(FitState& state) {
  const auto n = static_cast<double>(state.iteration);
  const auto keep = static_cast<float>(std::min(t_.average, (1.0 + n) / (10.0 + n)));
  in_chunks(host_, size_, [&](std::size_t, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i)
      state.average[i] = keep * state.average[i] + (1.0f - keep) * state.weights[i];
  });
}

}  // namespace weft::emd
