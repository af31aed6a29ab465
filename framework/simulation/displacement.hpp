#pragma once
#include "simulation/fold.hpp"
#include "simulation/task_config.hpp"

namespace weft {

/// The tuned length of d (section 3: "its length is tuned so that ... the shirt is folded approximately in two").
struct DisplacementResult {
  Vec2 displacement = Vec2::Zero();  ///< m
  double misfit_mm = 0.0;            ///< mean distance, in XY, of the folded half from its mirror image
  Index evaluations = 0;             ///< folds simulated
};

/// Golden-section search over |d|; the direction of d stays. Every fold uses half the default control (for the arc the
/// paper's (1, 0, 0, 0, 0)) and the given material. The fold line runs through the middle of the garment's extent along
/// d. The misfit is the mean distance of the vertices on the grasped side from their mirror images.
/// @param task its manipulation.displacement gives the direction. @throws Diverged, ConfigError,
/// Interrupted.
DisplacementResult tune_displacement(const Task& task, Simulator& simulator, const MaterialProperties& material,
                                     const Cancelled& cancelled = {}, double tolerance_m = 0.001);

}  // namespace weft
