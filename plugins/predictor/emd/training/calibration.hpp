#pragma once
#include <cstdint>
#include <vector>

#include "../model.hpp"
#include "weft/trainable.hpp"

namespace weft::emd {

class Passes;
struct CalibrationJob;

/// Examples, and the weights that predict them.
struct CalibrationPart {
  std::vector<std::size_t> examples;  ///< positions in the dataset
  const std::vector<float>& weights;  ///< [Layout::size]; they may differ from the model's own
};
/// Finds the model's calibration on these examples: per number of segments, from the start of a session and from within
/// one, with exact knowledge and with none. It is a calibration for the first dataset; the others help out where the
/// first has few shapes.
std::vector<CalibrationRow> find_calibration(Passes& passes, Model& model, const std::vector<CalibrationPart>& parts,
                                             std::uint64_t seed);

/// Refits the sigma layer of the job's model to the job's examples, then its calibration. No mean changes.
/// @throws Error when the host is cancelled.
void calibrate(CalibrationJob& job);

}  // namespace weft::emd
