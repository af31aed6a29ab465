#pragma once
#include <vector>

#include "../model.hpp"

namespace weft::emd {

class Passes;

/// Finds the model's mean shape, principal components of the shapes (where the architecture uses them), mean and
/// standard deviation of the inputs, and the range of the controls.
/// @param model the model that `passes` refers to; its architecture and dimensions are known.
/// @param train positions in the dataset.
void find_normalisation(const Passes& passes, const std::vector<std::size_t>& train, bool half_precision, Model& model);

}  // namespace weft::emd
