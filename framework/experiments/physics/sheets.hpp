#pragma once
#include <memory>
#include <vector>

#include "experiments/physics/physics.hpp"
#include "weft/garment.hpp"
#include "weft/material.hpp"
#include "weft/simulator.hpp"

/// Strips of test fabric, and how they are brought to rest.
namespace weft::physics {

constexpr double kGravity = 9.81;
inline const Positions kNothing(0, 3);  ///< targets of a step that holds nothing

enum class Pattern { regular, rotated, irregular };
const char* name_of(Pattern pattern);

struct Sheet {
  Positions positions;
  RestPositions rest;
  Faces faces;
  double edge = 0.0;
  double length = 0.0, width = 0.0;

  std::shared_ptr<const Garment> garment(const char* name = "sheet") const {
    Mesh mesh;
    mesh.positions = positions;
    mesh.rest = rest;
    mesh.faces = faces;
    mesh.source = name;
    return std::make_shared<const Garment>(make_garment(mesh, name));
  }
  /// Vertices whose first rest coordinate along the strip is x.
  std::vector<Index> column(double x) const {
    std::vector<Index> found;
    for (Index i = 0; i < flat.rows(); ++i)
      if (std::abs(flat(i, 0) - x) < 1e-9 * length) found.push_back(i);
    return found;
  }
  RestPositions flat;  ///< along and across the strip, m; rest may be turned against it
};

/// A strip [0, length] x [0, width] of triangles with edges near `edge`. Borders and the first two columns are regular
/// in every pattern, so that a clamp is the same; the inside is a grid, a grid turned by 27 degrees, or a shaken grid,
/// the last two triangulated by Delaunay. @param turn rad: the warp direction makes this angle with the strip.
Sheet strip(double length, double width, double edge, Pattern pattern, double turn = 0.0);
/// Two sheets as one garment of two pieces.
Sheet both(const Sheet& a, const Sheet& b);
/// [n] kg: a third of each triangle's mass at its corners.
Vector lumped_masses(const Sheet& sheet, double density);

/// Isotropic, undamped, without Poisson's effect: what the closed forms assume.
Fabric test_fabric(const PhysicsParams& p);
void set_bend(Fabric& fabric, double bend);
Scene no_ground();
/// Steps until the largest speed stays below `speed` for ten frames. @return frames; the limit if it never does.
Index rest(Simulator& simulator, double speed, Index limit);

}  // namespace weft::physics
