#pragma once
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "conformance/kit.hpp"
#include "weft/simulator.hpp"

/// Shared by the laws of simulators.
namespace weft::conformance {

/// Those about a scene's obstacles, or their refusal.
std::vector<Law> obstacle_laws();

namespace of_simulators {

inline constexpr double kGravity = 9.81;
inline constexpr Index kSide = 7;     // vertices along an edge of the sheet
inline constexpr double kSize = 0.3;  // m
inline const Positions kNothing(0, 3);

inline std::shared_ptr<const Garment> sheet(double z = 0.0) { return towel(kSide, kSize, z); }

inline Fabric damped_fabric() {
  Fabric fabric = plain_fabric();
  fabric.damping_stretch_s = 0.002;
  fabric.damping_bend_s = 0.01;
  fabric.damping_air_per_s = 2.0;
  return fabric;
}

/// The number of entries that differ between the states of two simulators.
inline double differing_state(const Simulator& a, const Simulator& b) {
  return differing(a.positions(), b.positions()) + differing(a.velocities(), b.velocities()) +
         (a.grasped() == b.grasped() ? 0.0 : 1.0) + (a.frame() == b.frame() ? 0.0 : 1.0);
}

inline std::string number(double value) {
  std::ostringstream out;
  out << value;
  return out.str();
}

}  // namespace of_simulators
}  // namespace weft::conformance
