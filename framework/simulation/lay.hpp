#pragma once
#include <optional>

#include "meshes/intersections.hpp"
#include "simulation/fold.hpp"
#include "weft/params.hpp"
#include "weft/simulator.hpp"

namespace weft {

/// How a garment is brought to the table.
struct LayParams {
  double thickness_m = 0.001;
  double density_kg_per_m2 = 0.15;
  double stretch_n_per_m = 200.0;
  double bend_n_m = 2.0e-5;
  double air_per_s = 4.0;
  double load = 20.0;
  double fall_s = 4.0;
  double press_s = 2.0;
  template <class Visitor>
  void visit(Visitor& v) {
    v("thickness_m", thickness_m, range(1e-4, 0.02, "m"), "Distance of the layers while the garment is laid.");
    v("density_kg_per_m2", density_kg_per_m2, range(0.01, 5, "kg/m^2"), "Of the cloth while it is laid.");
    v("stretch_n_per_m", stretch_n_per_m, range(1, 1e5, "N/m"), "Its membrane stiffness.");
    v("bend_n_m", bend_n_m, range(0, 1, "N m"), "Its bending stiffness.");
    v("air_per_s", air_per_s, range(0, 100, "1/s"), "Drag that slows its fall.");
    v("load", load, range(1, 1000), "The press: so many times gravity pull on the cloth.");
    v("fall_s", fall_s, range(0.1, 60, "s"), "Longest time of the fall.");
    v("press_s", press_s, range(0, 60, "s"), "Time under the press.");
  }
};

struct LaidGarment {
  Positions positions;                          ///< [V, 3] m, z above the place of the vertex's layer
  std::vector<double> layers;                   ///< [V] sheets of cloth below
  Index crossings_before = 0;                   ///< of edges and faces, as drawn
  std::optional<Intersection> crossing_before;  ///< one of them: of two pieces where there is such a one
  Index crossings = 0;                          ///< most at the end, of half, all and four times the thickness
  Index frames = 0;                             ///< simulated
  double height = 0.0;                          ///< m, of the highest vertex
  double median_strain = 0.0, largest_strain = 0.0;
  bool settled = false;
};

/// The garment turned to lie: a tube or a closed garment on its back, its up axis along y; a sheet, and what is thin, as it is most
/// extended. A turn, no stretch.
Positions lying_pose(const Garment& garment);

/// Lays a garment on the table by simulation: it falls in drag, without friction; lies under a press; and comes to rest
/// under gravity alone.
/// @param garment with a rest shape; its layers do not matter. @throws Diverged, ConfigError, Interrupted.
LaidGarment lay_garment(const Garment& garment, Simulator& simulator, const LayParams& params,
                        const Cancelled& cancelled = {});

}  // namespace weft
