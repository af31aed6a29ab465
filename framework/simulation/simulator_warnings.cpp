#include "simulation/simulator_warnings.hpp"

namespace weft {

std::vector<std::string> simulator_warnings(const Simulator& simulator, const Fabric& fabric, const Scene& scene) {
  std::vector<std::string> warnings;
  if (scene.ground_height && fabric.friction > 0.0 && !simulator.capabilities().ground_friction) {
    warnings.push_back(
        "the fabric has ground friction, which this simulator does not declare (capability ground_friction): the cloth "
        "may slide as if there were none");
  }
  if (const std::string own = simulator.diagnostics().warning; !own.empty()) warnings.push_back(own);
  return warnings;
}

}  // namespace weft
