#pragma once
#include <array>
#include <memory>
#include <string>

#include "weft/config.hpp"
#include "weft/types.hpp"

namespace weft {

/// The order of P = {friction, bend, stretch, thickness} (section 2.2) everywhere in weft.
inline constexpr std::array<const char*, 4> kPropertyNames = {"friction", "bend", "stretch", "thickness"};
/// One number per property, in the order of kPropertyNames. Unaligned: it crosses libraries by value.
using PropertyVector = Eigen::Matrix<double, 4, 1, Eigen::DontAlign>;
/// q: normalised material properties, [4] in [0, 1].
using MaterialProperties = PropertyVector;

/// (c, w) of section 2.2: property p lies in [c - w/2, c + w/2] clipped to [0, 1].
/// (Eq. 2 prints c +- w; eq. 3, Table 1 and Fig. 4 use c +- w/2, and so does weft.)
struct MaterialKnowledge {
  PropertyVector centre = PropertyVector::Constant(0.5);
  PropertyVector width = PropertyVector::Constant(1.0);

  static MaterialKnowledge none() { return {}; }
  static MaterialKnowledge certain(const MaterialProperties& q) { return {q, PropertyVector::Zero()}; }
  PropertyVector lower() const { return (centre - width / 2).cwiseMax(0.0).cwiseMin(1.0); }
  PropertyVector upper() const { return (centre + width / 2).cwiseMax(0.0).cwiseMin(1.0); }
};

/// Tables of an ARCSim/ARGUS material file, in the file's own units.
struct MaterialTables {
  /// N/m. Row 0: zero strain; rows 1-5: principal stretch 1 + 1/6 at 0, 22.5, 45, 67.5, 90 deg from warp.
  /// Columns c11, c12, c22, c33. The stiffness is C = 2 c with negatives clamped to 0 (see docs/file-formats.md).
  std::array<std::array<double, 4>, 6> stretching{};
  /// N m, "ke". Rows: direction of the edge (bend axis) 0, 45, 90 deg from warp; columns: curvature 0, 10, 20, 30, 40
  /// 1/m. The plate's bending modulus is B = ke / 4.
  std::array<std::array<double, 5>, 3> bending{};
};

/// A fabric in SI units, in rest-shape coordinates (warp = rest x, weft = rest y).
struct Fabric {
  std::string name;
  double density_kg_per_m2 = 0.15;
  // Membrane stiffness K = E t, N/m (force per width per strain); shear is G t.
  double stretch_warp_n_per_m = 100.0;
  double stretch_weft_n_per_m = 100.0;
  double stretch_shear_n_per_m = 40.0;
  double poisson = 0.0;  ///< nu12: warp strain from weft pull is nu21 = nu12 K_weft / K_warp
  // Plate bending modulus B, N m (moment per width per curvature).
  double bend_warp_n_m = 2.0e-5;
  double bend_weft_n_m = 2.0e-5;
  double bend_bias_n_m = 2.0e-5;   ///< at 45 deg: B(p) = Bw c^4 + Bf s^4 + (4 Bb - Bw - Bf) c^2 s^2
  double friction = 0.5;           ///< Coulomb, cloth on ground
  double self_friction = 0.3;      ///< Coulomb, cloth on cloth
  double thickness_m = 0.001;      ///< distance mid-surface to ground and mid-surface to mid-surface
  double damping_stretch_s = 0.0;  ///< stiffness-proportional
  double damping_bend_s = 0.0;     ///< stiffness-proportional
  double damping_air_per_s = 0.0;  ///< mass-proportional drag against still air
  /// Set if the fabric came from an ARCSim/ARGUS file. The tables, times the multipliers, then replace the constants
  /// above.
  std::shared_ptr<const MaterialTables> tables;
  double stretch_multiplier = 1.0;  ///< applies to the tables; the constants above are already multiplied
  double bend_multiplier = 1.0;     ///< likewise

  /// This fabric with its membrane stiffness times `stretch` and its bending stiffness times `bend`.
  WEFT_API Fabric scaled(double stretch, double bend) const;
};

/// Reads `fabric:` of a scene or task. It is one of
///   - a mapping in SI units,
///   - the path of a YAML file with such a mapping, or of an ARCSim/ARGUS material .json,
///   - a mapping {file: PATH, stretch_multiplier, bend_multiplier, ...}. Its other keys replace those of the file (of a
///     .json: name, density, friction, self_friction, thickness and damping).
/// Files may hold multipliers too; the two are multiplied. Defaults: shear is the mean of warp and weft / 2 /
/// (1 + poisson), bias the mean of warp and weft.
/// @throws ConfigError with file and line.
WEFT_API Fabric read_fabric(const ConfigNode& node);
/// The fabric as a mapping. read_fabric reads the same bits from it.
WEFT_API ConfigNode write_fabric(const Fabric& fabric);

/// Maps the paper's normalised properties to SI: q = 0 is `low`, q = 1 is `high`, log or linear between.
struct PropertyRange {
  double low = 0.0;
  double high = 1.0;
  bool logarithmic = false;
  WEFT_API double at(double q) const;       ///< value for q in [0, 1]
  WEFT_API double inverse(double v) const;  ///< q for a value; may lie outside [0, 1]
};

/// The paper's material space (section 3): a nominal fabric, and the range over which each property changes it.
/// friction: ground friction mu (self friction keeps its ratio to it); bend, stretch: multipliers on the nominal
/// stiffness; thickness: m.
struct MaterialSpace {
  Fabric nominal;
  std::array<PropertyRange, 4> ranges;
  /// @throws ConfigError if q is not in [0, 1] (1e-9 slack) or not finite.
  WEFT_API Fabric at(const MaterialProperties& q) const;
};
/// Reads a material space file: `nominal:` (a fabric) and `properties:` {friction, bend, stretch, thickness} each
/// {low, high, scale: log|linear}.
WEFT_API MaterialSpace read_material_space(const ConfigNode& node);
WEFT_API ConfigNode write_material_space(const MaterialSpace& space);

}  // namespace weft
