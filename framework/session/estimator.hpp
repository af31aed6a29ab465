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

/// Corrects estimates by simulations of the executed sequence.
struct EstimateCorrectionParams {
  std::int64_t simulations = 0;
  std::int64_t later_simulations = 3;
  std::int64_t segments = 3;
  double radius = 0.15;
  double least_step = 1e-3;
  double difference_step = 0.02;
  double effective_coordinates = 4.0;
  double shape_correlation = 1.0;
  double start_height_sigma_m = 1e-5;
  std::vector<double> model_error;
  std::vector<double> deviation_scale;

  template <class Visitor>
  void visit(Visitor& v) {
    v("simulations", simulations, range(0, 1000),
      "Simulated sequences of the first corrected estimate; 0: no estimate is corrected.");
    v("later_simulations", later_simulations, range(0, 1000), "The same of every later estimate.");
    v("segments", segments, range(1, 1000, "segments"),
      "The first corrected estimate is made after this many segments. The loss is smooth there: release and settling "
      "make it rough.");
    v("radius", radius, range(1e-4, 1), "Largest change of a property in the first step.");
    v("least_step", least_step, range(1e-9, 1), "A search ends with a step below this change of every property.");
    v("difference_step", difference_step, range(1e-6, 0.5), "Step of the finite differences in the properties.");
    v("effective_coordinates", effective_coordinates, range(1e-3, 1e9),
      "Number of independent errors of the simulation in one shape.");
    v("shape_correlation", shape_correlation, range(0, 1),
      "Correlation rho of the simulation's errors between the shapes of a sequence. n shapes count as n / (1 + (n - 1) "
      "rho).");
    v("start_height_sigma_m", start_height_sigma_m, range(0, 1, "m"),
      "As estimation.start_height_sigma_m. 0: the start height is not used.");
    v("model_error", model_error, range(0, 1),
      "Standard deviations of the properties that the simulator's errors as a model of real cloth add; default 0.01.",
      property_list());
    v("deviation_scale", deviation_scale, range(1e-3, 1e3), "Factors on the standard deviations; default 1.",
      property_list());
  }
};

struct EstimatorParams {
  std::string method = "posterior";
  std::int64_t instances = 8;
  std::int64_t iterations = 40;
  std::int64_t later_iterations = 20;
  std::int64_t halvings = 1;
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
  EstimateCorrectionParams correction;

  template <class Visitor>
  void visit(Visitor& v) {
    v("method", method, choice({"posterior", "prior", "plain"}),
      "plain: the paper's eq. 6 over c and w. prior: the same with a prior on w. posterior: q by eq. 6 at w = 0, then "
      "(c, w) as the interval of its posterior.");
    v("instances", instances, range(1, 4096), "Parallel searches; the one with the lowest residual loss wins.");
    v("iterations", iterations, range(0, 100000), "Optimiser iterations of the first estimate of a session.");
    v("later_iterations", later_iterations, range(0, 100000), "Optimiser iterations of later estimates.");
    v("halvings", halvings, range(0, 30),
      "How many times the worse half of the searches ends, after 1/2, 1/4, 1/8, ... of the iterations. 0: all go on to the end.");
    v("noise", noise, range(0, 10),
      "Gaussian noise on the starts of the first estimate, relative to the width of the prior.");
    v("later_noise", later_noise, range(0, 10), "The same for later estimates.");
    v("width_prior", width_prior, range(0, 10),
      "prior: lambda of -lambda sum_p log(w_p + width_offset), added to the mean loss per coordinate.");
    v("width_offset", width_offset, range(1e-6, 1), "prior: keeps the logarithm finite at w = 0.");
    v("effective_coordinates", effective_coordinates, range(1e-3, 1e9),
      "posterior: number of independent measurements in one shape.");
    v("shape_correlation", shape_correlation, range(0, 1),
      "posterior: correlation rho of the predictor's errors between the shapes of a sequence. n shapes count as "
      "n / (1 + (n - 1) rho).");
    v("misfit_prior", misfit_prior, range(0, 1e9),
      "posterior: weight, in measurements, of the prior that sigma is right, against the residuals; 1e9: trust sigma.");
    v("start_height_sigma_m", start_height_sigma_m, range(0, 1, "m"),
      "posterior: standard deviation of the start shape's height from that of flat cloth, besides the declared errors "
      "of the observation. The height tells the thickness, but not of a cloth that starts as a fold left it. 0: do not "
      "use it.");
    v("difference_step", difference_step, range(1e-6, 0.5),
      "posterior: step of the finite differences for the precision.");
    v("deviation_scale", deviation_scale, range(1e-3, 1e3),
      "posterior: factors on the standard deviations; default 1. `weft evaluate estimation` reports factors that "
      "calibrate them.",
      property_list());
    v.group("correction", correction, "Corrects estimates by simulations.");
  }
};

/// Controls and observations since the start of a session.
struct EstimateRequest {
  std::shared_ptr<const Positions> start;                        ///< [V, 3] m: s_0, all vertices
  Vector state;                                                  ///< [S] at the start
  Controls controls;                                             ///< [i, C]: m_0 ... m_{i-1}
  std::vector<std::shared_ptr<const Observation>> observations;  ///< [i]: s_1 ... s_i
  double start_sigma =
      0.0;  ///< m: of the mean height of s_0's lowest layer, by the noise of the vertices that were seen
  double start_height_sigma = 0.0;            ///< m: of the error shared by all heights of s_0
  std::optional<MaterialKnowledge> previous;  ///< the previous estimate, or a prior
  Index round = 0;                            ///< number of the estimate; keys the noise
  std::uint64_t seed = 0;
};

struct TwinSequence;

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
  Index evaluations = 0;                         ///< points predicted, over all instances
  std::optional<MaterialProperties> corrected;   ///< q by simulations (EstimateCorrector)
  std::shared_ptr<const TwinSequence> sequence;  ///< at `corrected`, for the next estimate; null in results
  Index simulations = 0;                         ///< simulated sequences of that
  double residual_mm = 0.0;                      ///< root mean square of seen - simulated
  double seconds = 0.0;
};

/// Material estimation (section 5, eq. 6): finds the knowledge with the highest likelihood of the observations. Every
/// estimate uses s_0 and the whole history.
///
/// Eq. 6 by itself is a type-II likelihood: p(s | c, w) is the mean of p(s | q) over the interval. A mean never exceeds
/// its largest term, so the maximum lies at w = 0 for any data. The widths of `plain` come from the network's misfit
/// and do not measure uncertainty. Eq. 6 also treats the errors of thousands of coordinates as independent. In fact
/// they come from a handful of smooth modes.
///
/// `posterior` uses eq. 6 as the likelihood of one material, L(q) at (c, w) = (q, 0). With the uniform prior of section
/// 3 the posterior density of q is proportional to exp(-n L(q)), where n is the number of independent measurements in
/// the shapes. It is approximated by a normal distribution on the box (Laplace, with the precision of Gauss-Newton).
/// (c, w) is the interval of that distribution (interval_of).
class Estimator {
 public:
  /// @throws Unsupported if the optimiser needs gradients that the predictor lacks; ShapeError for a deviation_scale of
  /// the wrong length.
  Estimator(const Task& task, std::shared_ptr<const Predictor> predictor, std::shared_ptr<const Optimiser> optimiser,
            const EstimatorParams& params, Host& host);
  /// Without segments, or without an observed vertex, returns MaterialKnowledge::none().
  /// @throws ShapeError; Error if an observed position is not finite, or if no instance reached a finite loss.
  Estimate estimate(const EstimateRequest& request) const;
  const EstimatorParams& params() const { return params_; }
  /// Longest history that the predictor accepts; for a longer one estimate() throws its ShapeError. nullopt: no limit.
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
