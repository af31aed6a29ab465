#pragma once
#include <memory>
#include <vector>

#include "experiments/physics/physics.hpp"
#include "weft/garment.hpp"
#include "weft/material.hpp"
#include "weft/simulator.hpp"

/// Strips of test fabric, and a function that brings them to rest.
namespace weft::physics {

constexpr double kGravity = 9.81;
inline const Positions kNothing(0, 3);  ///< targets of a step without held vertices

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
  RestPositions flat;  ///< [V, 2] m, along and across the strip; `rest` may be rotated against it
};

/// A strip [0, length] x [0, width] of triangles with edges near `edge`. Borders and the first two columns are regular
/// in every pattern, so that clamps are equal. The inside is a grid (regular), a grid rotated by 27 degrees, or a
/// perturbed grid (irregular); the last two are triangulated by Delaunay.
/// @param turn rad: angle between the warp direction and the strip.
Sheet strip(double length, double width, double edge, Pattern pattern, double turn = 0.0);
/// Two sheets as one garment of two pieces.
Sheet both(const Sheet& a, const Sheet& b);
/// [n] kg: a third of each triangle's mass at its corners.
Vector lumped_masses(const Sheet& sheet, double density);

/// An isotropic, undamped fabric without Poisson's effect, as the closed forms assume.
Fabric test_fabric(const PhysicsParams& p);
void set_bend(Fabric& fabric, double bend);
Scene no_ground();
/// Steps until the largest speed stays below `speed` for ten frames in a row. @return frames, at most `limit`.
Index rest(Simulator& simulator, double speed, Index limit);
Vec3 mean_of(const Positions& x, const std::vector<Index>& rows);
/// Tip of a cantilever at rest: (x / L, drop / L). `fabric` gives the stiffness; drag near the critical one is added.
Vec2 cantilever(Simulator& simulator, const Sheet& sheet, Fabric fabric, double bend);
/// Tip extension, m, of a strip that hangs by one column under `gravity`, m/s^2. `stiffness`, N/m, gives the drag.
double hang(Simulator& simulator, const Sheet& sheet, Fabric fabric, double stiffness, double gravity = kGravity);

}  // namespace weft::physics
