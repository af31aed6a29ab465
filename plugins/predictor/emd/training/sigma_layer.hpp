#pragma once
#include <cstdint>
#include <vector>

#include "../model.hpp"

namespace weft::emd {

class Passes;

/// The loss of the sigma layer: with r = (x - mu) / sigma, the mean over coordinates of
///   log sigma + (1 - 3 t) r^2 / 2 + t r^4 / 4.
/// For normal errors its minimum lies at sigma's true value, for any t. With t > 0 sigma gets wider where errors
/// have heavy tails. There the plain likelihood (t = 0) leaves a mean squared error that comes from a few shapes.
/// Beyond r^2 = kTailEnd the term r^4 continues linearly in r^2, so that no single buckle dominates.
inline constexpr float kTailEnd = 60.0f;

/// Fits the decoder's sigma layer (Ws, bs of Layout) of the passes' model to examples. No other weight changes, so the
/// means stay the same. Runs on the calling thread.
/// @param examples positions in the dataset, [n].
/// @param passes_over how often each example is drawn, on average.
/// @param tails t, in [0, 1/3].
/// @return all weights of the model with the new layer, [Layout::size].
std::vector<float> fit_sigma_layer(const Passes& passes, const std::vector<std::size_t>& examples,
                                   std::int64_t passes_over, double tails, std::uint64_t seed);

/// The loss of that fit on examples, as a mean over shapes. Sequences are drawn as for the fit: from the start and from
/// within, with exact knowledge, with none and with that of eq. 3.
/// @param weights [Layout::size]
double sigma_layer_loss(const Passes& passes, const std::vector<float>& weights,
                        const std::vector<std::size_t>& examples, double tails, std::uint64_t seed);

}  // namespace weft::emd
