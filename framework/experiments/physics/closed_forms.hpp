#pragma once
#include <vector>

#include "experiments/physics/physics.hpp"

/// Tests whose outcome is known in closed form, or bounded by a law of conservation. Each adds its cases.
namespace weft::physics {

/// elastica: tips of heavy cantilevers; orthotropy: the same along warp, weft and bias.
void add_elastica(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// hanging: extension of a strip under its own weight.
void add_hanging(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// catenary: sag of a strip that hangs by both ends.
void add_catenary(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// incline, cloth on cloth, thrown sheet: Coulomb's friction.
void add_incline(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// free fall, rest, momentum, energy, refinement.
void add_dynamics(std::vector<PhysicsCase>& cases, const PhysicsParams& params);

}  // namespace weft::physics
