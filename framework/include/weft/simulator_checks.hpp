#pragma once
#include <string>

#include "weft/simulator.hpp"

namespace weft {

/// What every simulator of cloth refuses in reset(): a garment without faces, moduli, friction, thickness and damping
/// that are not finite or out of range, a scene that is not finite, pins that the garment has not.
/// @param plugin name that messages begin with. @param self_contact layers need a thickness above 0.
/// @throws ConfigError naming the value, what it is and what it must be.
WEFT_API void check_reset(const std::string& plugin, const Garment* garment, const Fabric& fabric, const Scene& scene,
                          bool self_contact);

/// Empty, or the warning that a grasp stretched the cloth more than the plugin's parameter grasp_strain_warning.
WEFT_API std::string grasp_strain_warning(double largest_strain, double limit);

}  // namespace weft
