#pragma once
#include <functional>
#include <string>
#include <vector>

#include "experiments/physics/physics.hpp"

/// Tests whose result has a closed form or is bounded by a conservation law. Each function adds its cases.
namespace weft::physics {

/// elastica: tips of heavy cantilevers; orthotropy: the same along warp, weft and bias.
void add_elastica(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// hanging: extension of a strip under its own weight.
void add_hanging(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// catenary: sag of a strip that hangs by both ends.
void add_catenary(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// incline, cloth on cloth, thrown sheet: Coulomb's friction.
void add_incline(std::vector<PhysicsCase>& cases, const PhysicsParams& params);
/// How far a sheet slides down a slope, m: the mean, and the largest motion of any vertex.
struct Slide {
  double mean = 0.0, largest = 0.0;
};
/// Rows of a sheet on a slope: it sticks `slack` below the threshold, slides `slack` above it, and its acceleration.
/// @param seconds of the longest slide. @param run (simulator, tan(alpha), s).
void incline_rows(std::vector<PhysicsRow>& rows, const std::string& test, const SimulatorVariant& variant,
                  const std::string& name, double mu, double seconds, double slack,
                  const std::function<Slide(Simulator&, double, double)>& run);
/// free fall, rest, momentum, energy, refinement.
void add_dynamics(std::vector<PhysicsCase>& cases, const PhysicsParams& params);

}  // namespace weft::physics
