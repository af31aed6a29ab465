#pragma once
#include "weft/material.hpp"

namespace weft {

/// A density over the material properties: uniform prior on [0, 1]^4 times exp(-E), with the energy
///     E(q) = g'(q - m) + 1/2 (q - m)' L (q - m)      g: `gradient`, L: `precision`, m: `mode`
/// A normal distribution cut off by the box. A direction of which nothing is known has no precision, and stays uniform.
struct MaterialPosterior {
  PropertyVector mode = PropertyVector::Constant(0.5);
  PropertyVector gradient = PropertyVector::Zero();  ///< of E at the mode; not zero where the mode lies on a bound
  Eigen::Matrix<double, 4, 4, Eigen::DontAlign> precision = Eigen::Matrix<double, 4, 4>::Zero();  ///< symmetric, >= 0

  /// Standard deviations times `factor` (entry by entry), correlations as they are.
  MaterialPosterior widened(const PropertyVector& factor) const;
};

/// The interval (c, w) that stands for a posterior, property by property: that of the uniform distribution whose
/// central 50 % and 80 % intervals agree with those of the posterior, on average over the two. So [c - a w/2, c + a
/// w/2] holds q with probability near a; of a normal distribution w = 2.95 standard deviations (coverage .54 at a = .5,
/// .76 at .8), of a uniform one the interval itself. Quantiles from `sweeps` of a Gibbs sampler with random numbers of
/// its own: same posterior, same bits.
MaterialKnowledge interval_of(const MaterialPosterior& posterior, int sweeps = 3000);

}  // namespace weft
