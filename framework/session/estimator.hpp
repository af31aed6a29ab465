#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "session/material_posterior.hpp"
#include "session/observation.hpp"
#include "session/search_end.hpp"
#include "simulation/task_config.hpp"
#include "weft/host.hpp"
#include "weft/optimiser.hpp"
#include "weft/params.hpp"
#include "weft/predictor.hpp"

namespace weft {

struct EstimatorParams {
  std::string method = "posterior";
  std::int64_t instances = 8;
  std::int64_t iterations = 40;
  std::int64_t later_iterations = 20;
  double noise = 0.2;
  double later_noise = 0.05;
  double width_prior = 0.02;
  double width_offset = 0.03;
  double effective_coordinates = 20.0;
  double shape_correlation = 0.0;
  double misfit_prior = 5.0;
  double start_height_sigma_m = 0.0002;
  double difference_step = 0.05;
  std::vector<double> deviation_scale;

  template <class Visitor>
  void visit(Visitor& v) {
    v("method", method, choice({"posterior", "prior", "plain"}),
      "plain: the paper's eq. 6 over c and w. prior: the same with a prior on w. posterior: q by eq. 6 at w = 0, then "
      "(c, w) as the interval of its posterior.");
    v("instances", instances, range(1, 4096), "Searches that run side by side; the best residual loss wins.");
    v("iterations", iterations, range(0, 100000), "Optimiser iterations of the first estimate of a session.");
    v("later_iterations", later_iterations, range(0, 100000), "Optimiser iterations of later estimates.");
    v("noise", noise, range(0, 10), "Gaussian noise on the starts of the first estimate.");
    v("later_noise", later_noise, range(0, 10), "The same for later estimates.");
    v("width_prior", width_prior, range(0, 10),
      "prior: lambda of -lambda sum_p log(w_p + width_offset), beside the mean loss per coordinate.");
    v("width_offset", width_offset, range(1e-6, 1), "prior: keeps its logarithm finite at w = 0.");
    v("effective_coordinates", effective_coordinates, range(1e-3, 1e9),
      "posterior: independent measurements that the coordinates of one shape are worth.");
    v("shape_correlation", shape_correlation, range(0, 1),
      "posterior: correlation rho of the predictor's errors between the shapes of a sequence: n shapes are worth "
      "n / (1 + (n - 1) rho).");
    v("misfit_prior", misfit_prior, range(0, 1e9),
      "posterior: measurements' worth of belief that sigma is right, against what the residuals say; 1e9: it is.");
    v("start_height_sigma_m", start_height_sigma_m, range(0, 1, "m"),
      "posterior: the start shape lies flat, at the thickness of the cloth, up to this and to the declared errors of "
      "the observation; 0: do not use that.");
    v("difference_step", difference_step, range(1e-6, 0.5),
      "posterior: step of the differences that give its precision.");
    v("deviation_scale", deviation_scale, range(1e-3, 1e3),
      "posterior: factors on its standard deviations; default 1. `weft evaluate estimation` reports those that "
      "calibrate it.",
      property_list());
  }
};

/// What was done and seen since the start of a session.
struct EstimateRequest {
  std::shared_ptr<const Positions> start;                        ///< [V, 3] m: s_0, whole
  Vector state;                                                  ///< [S] at the start
  Controls controls;                                             ///< [i, C]: m_0 ... m_{i-1}
  std::vector<std::shared_ptr<const Observation>> observations;  ///< [i]: s_1 ... s_i
  double start_sigma = 0.0;                                      ///< m: measurement noise of s_0, per coordinate
  double start_height_sigma = 0.0;                               ///< m: of the error that its heights have in common
  std::optional<MaterialKnowledge> previous;                     ///< the preceding estimate
  Index round = 0;                                               ///< which estimate of the session; keys the noise
  std::uint64_t seed = 0;
};

struct Estimate {
  MaterialKnowledge knowledge;
  std::optional<MaterialPosterior> posterior;  ///< method posterior; before deviation_scale
  double loss = 0.0;                           ///< residual estimation loss of the winner, per coordinate
  double nll = 0.0;                            ///< eq. 6 at the winner: mean over coordinates of -log density, in mm
  double misfit = 0.0;  ///< mean over coordinates of ((x - mu) / sigma)^2 at the winner; 1 where sigma is right
  Index instance = 0;
  std::vector<double> losses;  ///< [instances], residual
  SearchEnd ended;             ///< why the optimiser stopped
  Index iterations = 0;
  Index evaluations = 0;  ///< points predicted, over all instances
  double seconds = 0.0;
};

/// Material estimation (section 5, eq. 6): the knowledge under which what was seen is likeliest. Always from s_0 and
/// the whole history.
///
/// Eq. 6 by itself is a type-II likelihood: p(s | c, w) is the mean of p(s | q) over the interval, and no mean exceeds
/// its largest term. So its maximum lies at w = 0 whatever the data, and the widths that `plain` finds are what the
/// network's misfit leaves: they say little about how sure one can be. Besides, eq. 6 takes the errors of thousands of
/// coordinates for independent, which they are not: they come from a handful of smooth modes.
///
/// `posterior` keeps eq. 6 as the likelihood of one material, L(q) at (c, w) = (q, 0), and widens where the paper
/// collapses: with the uniform prior of section 3 the density of q given what was seen is exp(-n L(q)), n the number of
/// independent measurements that the shapes are worth. It is approximated by a normal distribution on the box (Laplace,
/// precision of Gauss-Newton), and (c, w) is the interval that stands for it (interval_of).
class Estimator {
 public:
  /// @throws Unsupported when the optimiser needs gradients that the predictor lacks; ShapeError for a
  /// deviation_scale of the wrong length.
  Estimator(const Task& task, std::shared_ptr<const Predictor> predictor, std::shared_ptr<const Optimiser> optimiser,
            const EstimatorParams& params, Host& host);
  /// Without segments, or with nothing observed, the answer is "no knowledge".
  /// @throws ShapeError; Error for positions that are marked as observed and not finite, or when no instance reached a
  /// finite loss.
  Estimate estimate(const EstimateRequest& request) const;
  const EstimatorParams& params() const { return params_; }
  /// Longest history that the predictor takes; estimate() of more throws its ShapeError. nullopt: no limit.
  std::optional<Index> max_segments() const { return predictor_->max_segments(); }

 private:
  Task task_;
  std::shared_ptr<const Predictor> predictor_;
  std::shared_ptr<const Optimiser> optimiser_;
  EstimatorParams params_;
  PropertyVector deviation_scale_ = PropertyVector::Ones();
  Host& host_;
};

}  // namespace weft
