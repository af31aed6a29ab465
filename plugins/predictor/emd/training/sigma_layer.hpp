#pragma once
#include <cstdint>
#include <vector>

#include "../model.hpp"

namespace weft::emd {

class Passes;

/// What the sigma layer is fitted to: of r = (x - mu) / sigma, the mean over coordinates of
///   log sigma + (1 - 3 t) r^2 / 2 + t r^4 / 4,
/// which is least at sigma's true value for normal errors, whatever t is. With t > 0 sigma is wider where errors have
/// heavy tails: there the plain likelihood (t = 0) leaves a mean squared error that a few shapes make up.
/// r^4 goes on linearly in r^2 beyond r^2 = kTailEnd, so that no single buckle decides.
inline constexpr float kTailEnd = 60.0f;

/// Fits the decoder's sigma layer (Ws, bs of Layout) to examples; everything else, and so every mean, stays.
/// Runs on the thread that calls it.
/// @param examples positions in the dataset, [n].
/// @param passes_over how often each example is drawn, on average.
/// @param tails t, in [0, 1/3].
/// @return all weights of the model, with that layer anew, [Layout::size].
std::vector<float> fit_sigma_layer(const Passes& passes, const Model& model, const std::vector<std::size_t>& examples,
                                   std::int64_t passes_over, double tails, std::uint64_t seed);

/// The mean over those examples' shapes of what the layer is fitted to: from the start and from within, with exact
/// knowledge, eq. 3's and none, as drawn for the fit.
double sigma_layer_loss(const Passes& passes, const Model& model, const std::vector<float>& weights,
                        const std::vector<std::size_t>& examples, double tails, std::uint64_t seed);

}  // namespace weft::emd
