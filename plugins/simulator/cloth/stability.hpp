#pragma once
#include <functional>
#include <vector>

#include "mass_scaling.hpp"

namespace weft::cloth {

/// Largest eigenvalue by power iteration from a rough vector [n], plus 5 % for the error of the iteration.
/// @param multiply replaces x by its product, at any scale; @return the Rayleigh quotient of x.
double power_iteration(std::size_t n, const std::function<double(std::vector<double>&)>& multiply);

/// Largest eigenvalue of M^-1 K.
/// @param stiffness writes K x to its second argument.
double largest_eigenvalue(const std::vector<double>& masses,
                          const std::function<void(const std::vector<double>&, std::vector<double>&)>& stiffness);

/// Largest eigenvalues of M^-1 K at the flat rest shape, 1/s^2, after scaling of the masses.
struct Spectrum {
  double membrane = 0.0;
  double bending = 0.0;
};
Spectrum largest_frequencies(const Elements& elements, const std::vector<double>& masses, const MassScaling& scaling);

/// Longest stable substep of the symplectic step v += dt a(x, v), x += dt v, as a part `safety` of the limit:
///     along + 0.3 across <= safety^2 and across + 0.3 along <= safety^2, where
///     along = dt^2/4 (membrane + bending) + dt/2 membrane stretch_damping
///     across = dt^2/4 bending + dt/2 bending bend_damping
/// with stiffness-proportional damping, s. [for one mode: dt^2 lambda/4 + dt beta lambda/2 <= 1 from the characteristic
/// polynomial of the step.] In every element the membrane's forces lie in its plane, and the damping of bending acts
/// along its normal. So a velocity adds to one only what it takes from the other, and in flat cloth the larger one is
/// the bound. Where normals differ between elements, both act on one velocity. Folded cloth measured less than 0.3.
double stable_step(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double safety);

/// What the elements take of the explicit limit dt^2 lambda = 4 at this step (s): 4 safety^2 at stable_step().
double limit_taken(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double step);

/// Part (<= 1) of the stiffness-proportional damping with which stable_step() is still `least_step` of its undamped
/// value.
double damping_part(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double safety,
                    double least_step);

}  // namespace weft::cloth
