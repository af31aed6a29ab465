#pragma once
#include <vector>

#include "experiments/physics/physics.hpp"

/// Tests of sewn cloth.
namespace weft::physics {

/// closed tube, two layers: they hang and bend as the single sheet does in closed form.
void add_sewn_cloth(std::vector<PhysicsCase>& cases, const PhysicsParams& params);

}  // namespace weft::physics
