#pragma once
#include <map>
#include <string>
#include <vector>

#include "experiments/prediction_figures.hpp"
#include "weft/dataset.hpp"
#include "weft/trajectory.hpp"

namespace weft {

/// Predictions of the settled shape without a network: persistence (the shape before the last segment), start_shape.
/// Also mean_shape, linear_pca, nearest_example and nearest_example_oracle, which learn from the train split. The
/// oracle chooses its example by the true shape.
/// @param test positions in dataset.examples. @param components of linear_pca.
/// @param learn false if the train split is the one to predict: then only the first two.
std::map<std::string, PredictionFigures> measure_baselines(const Dataset& dataset, const std::vector<std::size_t>& test,
                                                           const Trajectory& trajectory, Index components, bool learn);

}  // namespace weft
