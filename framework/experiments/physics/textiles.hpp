#pragma once
#include <optional>
#include <string>
#include <vector>

#include "experiments/physics/physics.hpp"

/// Tests of a fabric by the standards of textile laboratories, on the fabric of `physics.fabric`.
namespace weft::physics {

/// Drape coefficients that were published for cloth of a fabric's kind.
struct DrapeBand {
  double low = 0.0, high = 0.0;  ///< %
  std::string source;
};
/// `drape: {percent: [LOW, HIGH], source: TEXT}` of a fabric's file or mapping, or null. @throws ConfigError.
std::optional<DrapeBand> read_drape_band(const ConfigNode& fabric);

/// drape (ISO 9073-9: Cusick's drape coefficient), bending length (ASTM D1388: the cantilever at 41.5 degrees), tensile
/// (stiffness along warp, weft and bias).
void add_textiles(std::vector<PhysicsCase>& cases, const PhysicsParams& params);

}  // namespace weft::physics
