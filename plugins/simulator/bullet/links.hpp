#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "weft/garment.hpp"
#include "weft/material.hpp"

namespace weft::bullet {

/// A spring between two vertices, in SI units; bullet.cpp turns it into a Bullet link.
struct Spring {
  std::int32_t a = 0, b = 0;
  double length = 0.0;      ///< m, in the rest shape
  double stiffness = 0.0;   ///< N/m; zero for a strut, which has pre-stress only
  double pre_stress = 0.0;  ///< N/m: force over length in the flat sheet, above zero for tension
};

/// The fabric as a network of springs.
///
/// Membrane. A spring of direction n, length L and stiffness k adds k L^2 (n.e.n)^2 / 2 to the energy of a strain e. So
/// a network has the quartic form C(p) = sum k L^2 (n.p)^4 / area for a strain along p. It has Cauchy's symmetry
/// C12 = C33 for any stiffnesses. The target is the fabric's K_warp, K_weft and shear G. That makes C12 = G and fixes
/// Poisson's ratio. The edges get the non-negative stiffnesses whose C(p), around every vertex and in all directions,
/// comes closest (relative least squares, held near K(n) area / L^2 [Van Gelder 1998]).
///
/// Bending. A distance between two vertices of a flat sheet does not change to first order when the sheet bends, so
/// links at rest have no linear bending stiffness, whatever their number. Links under stress do. Four points of a plane
/// carry one self-stress [Maxwell 1864]: with weights m that annul affine functions (sum m = 0, sum m x = 0), stress
/// densities -s m_i m_j between all six pairs balance at every point, and
///     -1/2 sum_{i<j} s m_i m_j |x_i - x_j|^2 = 1/2 s |sum_i m_i x_i|^2.
/// With the four corners of two faces that share an edge, scaled to 1/height, sum m x is the hinge's angle times its
/// normal: the right side is the isometric bending energy [Bergou et al. 2006, A quadratic bending model, eq. 3], the
/// left side is pre-stress of the edges and of a strut across the hinge. The hinges' s are fitted to B(p) as the
/// edges' stiffnesses are to C(p). Struts are what Bullet calls a bending link, with a rest length longer than flat.
struct SpringNetwork {
  std::vector<Spring> springs;        ///< edges first
  std::vector<double> vertex_masses;  ///< kg, a third of the faces around
  double shear_n_per_m = 0.0;         ///< of the network's target: the fabric's, or kLargestCoupling's
  double poisson = 0.0;               ///< nu12 of the network's target
  double stretch_misfit = 0.0;        ///< root mean square of C(p) / target - 1 over vertices and directions
  double bend_misfit = 0.0;           ///< the same of B(p)
  double raised_share = 0.0;          ///< of the edges: stiffened to carry their pre-stress
};

/// An edge's stiffness is at least this many times its pre-stress: below, the links' rest lengths are far from flat.
inline constexpr double kStiffnessPerPreStress = 4.0;

/// Largest sqrt(nu12 nu21) = G / sqrt(C11 C22) of the target. A fabric with a larger shear stiffness than
/// G = 2/3 sqrt(K_warp K_weft) gets this G.
inline constexpr double kLargestCoupling = 0.5;

/// @param fabric its tables are read at zero strain and curvature only.
SpringNetwork spring_network(const Garment& garment, const Fabric& fabric);

}  // namespace weft::bullet
