#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "session/estimator.hpp"
#include "session/twin.hpp"

namespace weft {

/// Estimates with the simulated sequence as the model; the network supplies derivatives alone. It minimises
///     n/2 sum_k log(mean_c (seen - sim(q) - b e_z)^2 + floor^2)  +  (z_0 - thickness(q) - b)^2 / 2 sigma_0^2
///         + b^2 / 2 sigma_b^2
/// over q in [0, 1]^4 and the error b that all heights share: a profile likelihood, in which every shape k has a scale of
/// its own, so that one bad settled shape does not drown the good early ones. The steps are those of Gauss-Newton in a
/// trust region, with the network's Jacobian and a least-change update that fits the differences simulated so far
/// [Broyden 1965, "A class of methods for solving nonlinear simultaneous equations"; for several differences at once
/// Fang & Saad 2009, "Two classes of multisecant methods"]. A step is kept if the simulated loss fell.
class EstimateCorrector {
 public:
  /// @throws ShapeError for lists of the wrong length.
  EstimateCorrector(const Task& task, std::shared_ptr<const Predictor> predictor, std::shared_ptr<const Twin> twin,
                    const EstimateCorrectionParams& params, Host& host);
  /// Whether a history of this many segments is corrected.
  bool applies(Index segments) const { return segments >= params_.segments; }
  /// The first corrected estimate of a session. @param start the network's, where the search starts.
  /// @throws Diverged if no sequence could be simulated.
  Estimate first(const EstimateRequest& request, const MaterialProperties& start) const;
  /// A later one. @param previous corrected, of a segment before: the search starts there. @throws as first().
  Estimate next(const EstimateRequest& request, const Estimate& previous) const;

 private:
  class Search;
  Estimate correct(const EstimateRequest& request, const MaterialProperties& start, const TwinSequence* so_far,
                   Index budget) const;
  Task task_;
  std::shared_ptr<const Predictor> predictor_;
  std::shared_ptr<const Twin> twin_;
  EstimateCorrectionParams params_;
  PropertyVector model_error_ = PropertyVector::Constant(0.01);
  PropertyVector deviation_scale_ = PropertyVector::Ones();
  Host& host_;
};

}  // namespace weft
