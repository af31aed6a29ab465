#pragma once
#include <vector>

#include "experiments/physics/physics.hpp"

/// Tests of cloth on obstacles, by Coulomb's law.
namespace weft::physics {

/// tilted box: threshold and acceleration; capstan: tensions of a strip over a bar; table edge: the overhang at which a
/// strip slips from a table.
void add_obstacles(std::vector<PhysicsCase>& cases, const PhysicsParams& params);

/// Overhang of a strip that is about to slip from a table, m, hanging part plus the part around the edge.
/// The strip is inextensible and perfectly flexible, w its weight per length, L its length. Its mid-surface goes round the
/// edge with radius rho. Along that arc, with phi the angle from the table's top, friction is fully used up:
///     dT/dphi = mu (T + w rho cos phi) - w rho sin phi
/// The first term presses by tension and weight; the last one is the weight that helps it down. With
/// T(0) = mu w (L - rho pi/2 - b) from the flat part and T(pi/2) = w b from what hangs, the solution
///     T(pi/2) = e^(mu pi/2) T(0) + w rho (2 mu - e^(mu pi/2) (1 - mu^2)) / (1 + mu^2)
/// is linear in b. For rho = 0 it is b = mu L / (mu + 1): the hanging weight against mu times that on the table.
double overhang_at_slip(double length, double rho, double mu);

}  // namespace weft::physics
