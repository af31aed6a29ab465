#pragma once
#include <string>
#include <vector>

#include "weft/simulator.hpp"

namespace weft {

/// Warnings about a simulator that was reset with this fabric and scene: an ability that they need and the simulator
/// does not declare, and the warning of its diagnostics. All commands that simulate use this function.
std::vector<std::string> simulator_warnings(const Simulator& simulator, const Fabric& fabric, const Scene& scene);

}  // namespace weft
