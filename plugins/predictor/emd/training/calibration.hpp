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
/// Calibrates the model on these examples: per number of segments, from the start of a session and from within one,
/// with exact knowledge and with none. The calibration is for the first dataset. The others add shapes where the first
/// has few.
std::vector<CalibrationRow> find_calibration(Passes& passes, Model& model, const std::vector<CalibrationPart>& parts,
                                             std::uint64_t seed);

/// Refits the sigma layer of the job's model to the job's examples, then calibrates it. The means do not change.
/// @throws Error when the host is cancelled.
void calibrate(CalibrationJob& job);

}  // namespace weft::emd
