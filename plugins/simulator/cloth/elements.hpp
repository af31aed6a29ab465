#pragma once
#include <algorithm>
#include <array>
#include <vector>

#include "bending_patch.hpp"
#include "element_block.hpp"
#include "forces.hpp"
#include "simd.hpp"
#include "topology.hpp"
#include "weft/material.hpp"

namespace weft::cloth {

/// Orthotropic membrane stiffness, N/m: S11 = c11 E11 + c12 E22, S22 = c12 E11 + c22 E22, S12 = g 2 E12.
struct MembraneModuli {
  double c11 = 0.0, c12 = 0.0, c22 = 0.0, g = 0.0;
};
/// From engineering constants: nu21 = nu12 K_weft / K_warp; C11 = K_warp / (1 - nu12 nu21), C12 = nu12 C22.
MembraneModuli membrane_moduli(const Fabric& fabric);
/// From an ARCSim/ARGUS table at Green strain (e11, e22, e12): C = 2 max(c, 0), linear in the principal strain's angle
/// and size (0 .. 1/6, constant above). ARGUS writes C33 E12^2, so the shear modulus is g = c33 (not doubled).
MembraneModuli membrane_moduli(const MaterialTables& tables, double multiplier, double e11, double e22, double e12);

/// Bending along p = (c, s): B(p) = warp c^4 + weft s^4 + (4 bias - warp - weft) c^2 s^2 = d11 c^4 + d22 s^4 +
/// (2 d12 + d33) c^2 s^2. d12 = 0 where that leaves d33 >= 0; a softer bias takes the rest out of d12.
BendingModuli bending_moduli(double warp, double weft, double bias);
/// From an ARCSim/ARGUS table at a curvature (1/m): B = ke / 4, linear between the columns, constant above. A row names
/// the direction of the edge, which is the bend axis: row 0 (edge along warp) is bending along weft.
BendingModuli bending_moduli(const MaterialTables& tables, double multiplier, double curvature);

/// The internal forces: constant-strain membrane triangles and six-node bending patches.
///
/// Membrane: Green strain E = (F^T F - 1)/2 of the linear triangle, St. Venant-Kirchhoff, moduli above.
/// Bending: a quadratic through the triangle's corners and the three vertices across its edges, in rest coordinates,
/// gives constant second derivatives x_uu, x_vv, x_uv (vectors). Where the sheet does not stretch, |x_uu| is the normal
/// curvature along u, so the plate energy is a quadratic form of positions with constant weights: no normals, no
/// angles, exact for every quadratic shape on every mesh. At a free edge the missing vertex is put where it costs least
/// energy (static condensation), which is the natural boundary condition: no bending moment across the edge.
class Elements {
 public:
  Elements(const Topology& topology, const Fabric& fabric);

  /// m per fixed-point unit; a power of four, so that scaling by it or its root is exact.
  double unit() const { return unit_; }
  /// forces += internal forces, N. velocities are read only when the fabric is damped.
  /// @return the largest squared principal stretch of any element, at least 1.
  /// @param wide sixteen elements at a time instead of eight; the bits are the same.
  float add_forces(const Fixed4* x, const Float4* v, Float4* forces, bool wide = has_wide_lanes()) const;
  /// Tables only: the moduli of no strain and curvature become those that Growth refers to, and act, unless they leave
  /// some deformation free. Before, Growth refers to an upper bound of all.
  void refer_to_rest();
  /// At most so many times as stiff as the reference is any element, at least 1.
  struct Growth {
    double membrane = 1.0, bending = 1.0;
  };
  /// Tables only: moduli from the present strain and curvature (secant, lagged to this call).
  Growth update_moduli(const Double4* x);
  /// Raises the fabric's stiffness-proportional dampings to these, s, where they are smaller.
  void damp_at_least(double stretch_s, double bend_s) {
    fabric_.damping_stretch_s = std::max(fabric_.damping_stretch_s, stretch_s);
    fabric_.damping_bend_s = std::max(fabric_.damping_bend_s, bend_s);
  }
  double stretch_damping_s() const { return fabric_.damping_stretch_s; }
  double bend_damping_s() const { return fabric_.damping_bend_s; }
  /// Both stiffness-proportional dampings times `part`.
  void scale_damping(double part) {
    fabric_.damping_stretch_s *= part;
    fabric_.damping_bend_s *= part;
  }
  bool nonlinear() const { return fabric_.tables != nullptr; }

  /// Linearised stiffness at the flat rest shape: out = K u for in-plane displacements u [V][2]. With tables, of the
  /// moduli that Growth refers to.
  void membrane_stiffness(const std::vector<std::array<double, 2>>& u, std::vector<std::array<double, 2>>& out) const;
  /// The same about the garment as it was drawn, in space: frames have no common plane.
  void membrane_stiffness(const std::vector<std::array<double, 3>>& u, std::vector<std::array<double, 3>>& out) const;
  bool has_frames() const { return topology_->frames != nullptr; }
  /// out = K w, bending; the same for each coordinate.
  void bending_stiffness(const std::vector<double>& w, std::vector<double>& out) const;
  /// Upper bound of the moduli over all strains, for the step size.
  const MembraneModuli& stiffest_membrane() const { return stiffest_membrane_; }

  /// Green strain (e11, e22, e12) of a face.
  std::array<double, 3> strain(const Double4* x, std::int32_t face) const;
  /// Largest |principal stretch - 1| of a face.
  double principal_strain(const Double4* x, std::int32_t face) const;
  std::int32_t face_count() const { return static_cast<std::int32_t>(topology_->faces.size()); }

 private:
  struct Patch {
    std::array<std::int32_t, 6> node;
    PatchRows second;
    std::array<bool, 3> ghost;
  };
  Patch make_patch(std::int32_t face) const;
  PatchPoints points_of(std::int32_t face, const Patch& patch) const;
  void set_bending(std::int32_t face, const BendingModuli& moduli);
  void set_bending_inside(std::int32_t face, const BendingModuli& moduli);
  void set_membrane(std::int32_t face, const MembraneModuli& moduli);
  void set_all(const MembraneModuli& membrane, const BendingModuli& bending);
  void take_stiffest(BendingModuli& bending);
  /// |x_uu|^2 + |x_vv|^2 + 2 |x_uv|^2, 1/m^2, of a patch without free edges.
  static double square_curvature(const Double4* x, const Patch& patch);

  const Topology* topology_;
  Fabric fabric_;
  double unit_ = 0.0;
  std::vector<std::array<double, 4>> gradient_;  ///< [f] as in ElementBlock, 1/m
  std::vector<Patch> patches_;
  std::vector<ElementBlock> blocks_;
  std::vector<PatchRows> factors_;  ///< [f] rows of sqrt(area D) second, double
  MembraneModuli stiffest_membrane_, reference_membrane_;
  BendingModuli reference_bending_;
  bool free_edges_set_ = false;  ///< tables only: the bending at free edges, which never changes
};

}  // namespace weft::cloth
