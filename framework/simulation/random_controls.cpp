#include "simulation/random_controls.hpp"

#include <algorithm>
#include <cmath>

namespace weft {

Controls random_controls(const Trajectory& trajectory, Index horizon, const RandomControlsParams& params,
                         RandomStream& random) {
  const auto variables = trajectory.controls();
  Controls controls = trajectory.default_controls(horizon);
  const double pace = std::exp(random.uniform(std::log(params.pace_low), std::log(params.pace_high)));
  const double innovation = std::sqrt(1.0 - params.smoothness * params.smoothness);
  for (Index c = 0; c < controls.cols(); ++c) {
    const auto& variable = variables[c];
    const double constant = params.drift * random.normal();
    double walk = random.normal();  // stationary from the first segment on
    for (Index j = 0; j < horizon; ++j) {
      const double value = pace * variable.default_value + variable.scale * (constant + params.walk * walk);
      controls(j, c) = std::clamp(value, variable.lower, variable.upper);
      walk = params.smoothness * walk + innovation * random.normal();
    }
  }
  return controls;
}

}  // namespace weft
