#pragma once
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "weft/dataset.hpp"

namespace weft {

/// Positions in `dataset.examples` of the examples for calibration. They did not fail, were not used in the model's fit
/// and are not in the test split. For a dataset of the fit these are in the validation split, for any other dataset in
/// the train or validation split. Examples with equal seed and index count as the same example.
/// @param trained_on the datasets of the fit; empty if unknown: then only the validation split is returned.
std::vector<std::size_t> unseen_examples(const Dataset& dataset, const std::vector<DatasetOrigin>& trained_on);

/// Warns if a split does not match the model's history: some of its examples were in an earlier split of a training
/// set, the model was not trained on a train split, or its sigma was calibrated on some examples.
/// @param split nullopt: all examples, judged as test examples.
/// @return empty without a known reason, and if `trained_on` is empty.
std::string held_out_warning(const Dataset& dataset, std::optional<Split> split,
                             const std::vector<DatasetOrigin>& trained_on,
                             const std::vector<DatasetOrigin>& calibrated_on = {});

}  // namespace weft
