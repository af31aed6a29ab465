#pragma once
#include "weft/material.hpp"

namespace weft {

/// A density over the material properties: uniform prior on [0, 1]^4 times exp(-E), with the energy
///     E(q) = g'(q - m) + 1/2 (q - m)' L (q - m)      g: `gradient`, L: `precision`, m: `mode`
/// It is a normal distribution truncated to the box. A direction with precision 0 stays uniform.
struct MaterialPosterior {
  PropertyVector mode = PropertyVector::Constant(0.5);
  PropertyVector gradient = PropertyVector::Zero();  ///< of E at the mode; not zero if the mode lies on a bound
  Eigen::Matrix<double, 4, 4, Eigen::DontAlign> precision = Eigen::Matrix<double, 4, 4>::Zero();  ///< symmetric, >= 0

  /// The posterior with standard deviations times `factor`, entry by entry. Correlations stay.
  MaterialPosterior widened(const PropertyVector& factor) const;
};

/// The interval (c, w) of a posterior, per property. It is the support of the uniform distribution whose central 50 %
/// and 80 % intervals agree with those of the posterior, on average over the two. So
///     [c - a w/2, c + a w/2]
/// contains q with a probability near a. For a normal distribution w is 2.95 standard deviations (coverage .54 at
/// a = .5, .76 at .8). For a uniform distribution it is the interval itself. The quantiles come from `sweeps` sweeps of
/// a Gibbs sampler with a fixed seed: the same posterior gives the same bits.
MaterialKnowledge interval_of(const MaterialPosterior& posterior, int sweeps = 3000);

}  // namespace weft
