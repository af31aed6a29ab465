#pragma once
#include <map>
#include <string>
#include <vector>

#include "experiments/prediction_figures.hpp"
#include "weft/dataset.hpp"
#include "weft/trajectory.hpp"

namespace weft {

/// Predictions of the settled shape that need no network: persistence (the shape before the last segment), start_shape,
/// and those learned from the train split: mean_shape, linear_pca, nearest_example and nearest_example_oracle, which is
/// chosen by the truth.
/// @param test positions in dataset.examples. @param components of linear_pca.
/// @param learn whether the train split may be learned from: not when it is what is predicted.
std::map<std::string, PredictionFigures> measure_baselines(const Dataset& dataset, const std::vector<std::size_t>& test,
                                                           const Trajectory& trajectory, Index components, bool learn);

}  // namespace weft
