#pragma once
#include <string>
#include <vector>

#include "weft/optimiser.hpp"
#include "weft/params.hpp"

namespace weft::mppi {

struct Params {
  std::string method = "mppi";
  std::int64_t samples = 32;
  double noise = 1.0;
  double min_noise = 1e-3;
  double step_tolerance = 1e-3;

  struct PathIntegral {
    double temperature = 0.1;
    std::string temperature_unit = "spread";
    double noise_decay = 0.97;
    template <class Visitor>
    void visit(Visitor& v) {
      v("temperature", temperature, range(1e-9, 1e9),
        "lambda: a small one follows the best sample, a large one averages.");
      v("temperature_unit", temperature_unit, choice({"spread", "cost"}),
        "spread: in standard deviations of the samples' costs; cost: in units of the objective, as in the source.");
      v("noise_decay", noise_decay, range(0.1, 1.0),
        "Factor on the sampling noise per iteration; 1: the source's constant noise.");
    }
  } mppi;

  struct CrossEntropy {
    double elite_fraction = 0.2;
    double smoothing = 0.9;
    double noise_smoothing = 0.5;
    double noise_smoothing_power = 5.0;
    template <class Visitor>
    void visit(Visitor& v) {
      v("elite_fraction", elite_fraction, range(1e-3, 1.0),
        "rho: part of the samples that the next distribution is fitted to.");
      v("smoothing", smoothing, range(1e-3, 1.0), "alpha: weight of the elite's mean against the last mean.");
      v("noise_smoothing", noise_smoothing, range(1e-3, 1.0),
        "beta: weight of the elite's deviation against the last one, in the first iteration.");
      v("noise_smoothing_power", noise_smoothing_power, range(0, 100),
        "q: how slowly that weight falls over the iterations.");
    }
  } cem;

  template <class Visitor>
  void visit(Visitor& v) {
    v("method", method, choice({"mppi", "cem"}), "Path integral update or cross-entropy method.");
    v("samples", samples, range(2, 100000), "K: points per instance and iteration.");
    v("noise", noise, range(1e-6, 1e6), "First sampling noise, in units of each variable's scale.");
    v("min_noise", min_noise, range(0, 1e6), "The noise never falls below it, in units of scale.");
    v("step_tolerance", step_tolerance, range(0, 1e6),
      "Converged when the noise of every variable is at most this, in units of scale.");
    v.group("mppi", mppi, "The path integral update.");
    v.group("cem", cem, "The cross-entropy method.");
  }
};

/// Sampling without gradients; a population of K points per instance and iteration, all instances' populations in one
/// batch. Sample 0 is the mean mu itself; x_k = clamp(mu + sigma e_k), e_k standard normal. S_k is the objective's
/// cost.
///
/// mppi: the weights of information theoretic MPC [Williams et al. 2017, "Information theoretic MPC for model-based
/// reinforcement learning", ICRA; the same, arXiv:1707.02342, algorithms 1 and 2], without the control cost term (their
/// gamma = 0), since the objective already holds all costs, on a whole decision vector instead of a control sequence:
///     rho = min_k S_k,   w_k = exp(-(S_k - rho)/lambda) / sum_j exp(-(S_j - rho)/lambda),
///     mu <- mu + sum_k w_k (x_k - mu)
/// Departures: lambda is by default in standard deviations of the S_k, since costs span decades from the first plan to
/// the last; sigma shrinks by noise_decay per iteration, since the problem stays the same during the iterations.
///
/// cem: the cross-entropy method with normal updating and dynamic smoothing [Rubinstein & Kroese 2004, "The
/// cross-entropy method", ch. 5; Kroese, Porotsky & Rubinstein 2006, Methodol. Comput. Appl. Probab. 8], over the
/// N_e = ceil(rho K) best samples:
///     mu    <- alpha mean_e + (1 - alpha) mu
///     sigma <- beta_t std_e + (1 - beta_t) sigma,   beta_t = beta - beta (1 - 1/t)^q
/// Departures: sigma has a floor, min_noise; beta is 0.5 by default. The source has 0.8 to 0.99 and a first sigma as
/// wide as the search space. From a start of one scale such a beta shrinks sigma before the mean has arrived.
class Mppi final : public Optimiser {
 public:
  explicit Mppi(const Params& params);
  OptimiserCapabilities capabilities() const override;
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override;

 private:
  Params p_;
};

}  // namespace weft::mppi
