#pragma once
#include <cstdint>

#include "../params.hpp"

namespace weft::emd {

/// Adam: a linear rise over `warmup` iterations, times half a cosine wave from `rate` to `final_rate`.
/// @param iteration iterations done.
/// @param time_used used share of the time limit, if there is one, in [0, 1]; the decay ends with it.
double cosine_rate(const Training& training, std::int64_t iteration, double time_used);

/// SignSGD: the rate after an evaluation without a new best: halved after every `patience` of them.
double rate_without_best(const Training& training, double rate, std::int64_t without_best);

}  // namespace weft::emd
