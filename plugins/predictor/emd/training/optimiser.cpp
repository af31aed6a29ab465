#include "optimiser.hpp"

#include <algorithm>
#include <cmath>

#include "chunks.hpp"
#include "learning_rate.hpp"

namespace weft::emd {

void Optimiser::step(const GradientSum::Direction& direction, FitState& state) {
  if (t_.optimiser == "signsgd") {
    signsgd(direction.values, state);
  } else {
    adam(direction, state);
  }
}

void Optimiser::adam(const GradientSum::Direction& gradient, FitState& state) {
  state.rate = cosine_rate(t_, state.iteration, state.time_used);
  constexpr double kBeta1 = 0.9, kBeta2 = 0.99;
  const double n = static_cast<double>(state.iteration) + 1.0;
  const AdamStep step{
      .clip = static_cast<float>(t_.clip > 0 && gradient.norm > t_.clip ? t_.clip / gradient.norm : 1.0),
      .b1 = static_cast<float>(kBeta1),
      .b2 = static_cast<float>(kBeta2),
      .c1 = static_cast<float>(1.0 / (1.0 - std::pow(kBeta1, n))),
      .c2 = static_cast<float>(1.0 / (1.0 - std::pow(kBeta2, n))),
      .rate = static_cast<float>(state.rate),
      .decay = static_cast<float>(state.rate * t_.weight_decay),
      .keep = keep_average(state),
  };
  in_chunks(host_, size_, [&](std::size_t, std::size_t from, std::size_t to) {
    kernels_.adam(to - from, step, gradient.values.data() + from, state.first_moment.data() + from,
                  state.second_moment.data() + from, state.weights.data() + from,
                  t_.average > 0 ? state.average.data() + from : nullptr);
  });
}

/// Of the exponential moving average of the weights, which forgets faster at first.
float Optimiser::keep_average(const FitState& state) const {
  const auto n = static_cast<double>(state.iteration);
  return static_cast<float>(std::min(t_.average, (1.0 + n) / (10.0 + n)));
}

/// Majority vote (Bernstein et al. 2018): the sign of each part's gradient, summed, and the sign of that.
void Optimiser::signsgd(const std::vector<float>& vote, FitState& state) {
  const auto rate = static_cast<float>(state.rate);
  const float keep = keep_average(state);
  in_chunks(host_, size_, [&](std::size_t, std::size_t from, std::size_t to) {
    for (std::size_t i = from; i < to; ++i) {
      state.weights[i] -= rate * vote[i];
      if (t_.average > 0) state.average[i] = keep * state.average[i] + (1.0f - keep) * state.weights[i];
    }
  });
}

}  // namespace weft::emd
