#pragma once
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "weft/dataset.hpp"

namespace weft {

/// Positions in `dataset.examples` of the good examples that a model's fit has not seen and that are not reserved for
/// tests. Of a dataset that the model was trained on that is the validation split; of any other dataset it is the train
/// and validation splits. Examples with equal seed and index count as the same example.
/// @param trained_on the datasets of the fit; empty when they are not known: then only the validation split is returned.
std::vector<std::size_t> unseen_examples(const Dataset& dataset, const std::vector<DatasetOrigin>& trained_on);

/// Says why the examples of a split may not be what the split's name says, for a model with this history: some were in
/// an earlier split of a training set, none of a train split was trained on, or sigma was calibrated on some of them.
/// @param split nullopt: all examples, judged as test examples.
/// @return empty when no reason is known, as when `trained_on` is empty.
std::string held_out_warning(const Dataset& dataset, std::optional<Split> split,
                             const std::vector<DatasetOrigin>& trained_on,
                             const std::vector<DatasetOrigin>& calibrated_on = {});

}  // namespace weft
