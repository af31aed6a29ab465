#include "mppi.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "weft/random.hpp"

namespace weft::mppi {
namespace {

/// One search. Its numbers depend on its own start, number and evaluations only.
struct Instance {
  Vector mean, sigma;
  Matrix samples;  // of this iteration
  Vector costs;
  bool running = true;
  OptimiserResult result;

  void stop(OptimiserStatus status, std::string message) {
    running = false;
    result.status = status;
    result.message = std::move(message);
  }
};

/// One call of minimise(): what does not change over its iterations, and what an iteration does with an instance.
class Search {
 public:
  Search(const Params& params, const Box& bounds, ConstVec scale, const OptimiserOptions& options)
      : p_(params),
        bounds_(bounds),
        scale_(scale),
        options_(options),
        width_(bounds.upper - bounds.lower),
        floor_((p_.min_noise * scale).cwiseMin(width_)) {}

  Instance begin(ConstVec start) const {
    Instance it;
    it.mean = bounds_.clamp(start);
    it.sigma = (p_.noise * scale_).cwiseMin(width_);
    it.result.x = it.mean;
    return it;
  }

  /// Draws the population of an iteration: as many samples as the parameters ask for and the budget allows.
  void sample(Instance& it, RandomStream random) const {
    const Index dim = it.mean.size();
    const Index n = std::min<Index>(p_.samples, options_.max_evaluations - it.result.evaluations);
    it.samples.resize(dim, n);
    it.samples.col(0) = it.mean;
    for (Index k = 1; k < n; ++k)
      for (Index d = 0; d < dim; ++d)
        it.samples(d, k) = std::clamp(it.mean[d] + it.sigma[d] * random.normal(), bounds_.lower[d], bounds_.upper[d]);
  }

  /// What an instance makes of its population's costs.
  void update(Instance& it, Index iteration) const {
    const std::vector<Index> finite = record(it);
    if (it.result.iterations >= options_.max_iterations || it.result.evaluations >= options_.max_evaluations)
      return it.stop(OptimiserStatus::budget_spent, "");
    ++it.result.iterations;
    if (finite.empty()) return;  // other samples next time
    if (p_.method == "cem")
      cross_entropy_update(it, finite, iteration);
    else
      path_integral_update(it, finite);
    it.mean = bounds_.clamp(it.mean);
    if ((it.sigma.array() <= p_.step_tolerance * scale_.array()).all())
      it.stop(OptimiserStatus::converged, "the noise of every variable is below step_tolerance");
  }

 private:
  /// Counts the population and keeps its best point. @return the samples whose cost is finite.
  static std::vector<Index> record(Instance& it) {
    std::vector<Index> finite;
    for (Index k = 0; k < it.costs.size(); ++k) {
      ++it.result.evaluations;
      if (!std::isfinite(it.costs[k])) continue;
      finite.push_back(k);
      if (it.costs[k] < it.result.cost) {
        it.result.cost = it.costs[k];
        it.result.x = it.samples.col(k);
      }
    }
    return finite;
  }

  void path_integral_update(Instance& it, const std::vector<Index>& finite) const {
    const auto n = static_cast<double>(finite.size());
    double least = it.costs[finite.front()], average = 0.0, square = 0.0;
    for (Index k : finite) least = std::min(least, it.costs[k]);
    for (Index k : finite) average += (it.costs[k] - least) / n;
    for (Index k : finite) square += std::pow(it.costs[k] - least - average, 2) / n;
    const double lambda = p_.mppi.temperature * (p_.mppi.temperature_unit == "cost" ? 1.0 : std::sqrt(square));
    if (lambda > 0.0) {  // zero: all samples cost the same
      Vector step = Vector::Zero(it.mean.size());
      double sum = 0.0;
      for (Index k : finite) {
        const double weight = std::exp(-(it.costs[k] - least) / lambda);
        step += weight * (it.samples.col(k) - it.mean);
        sum += weight;
      }
      it.mean += step / sum;
    }
    it.sigma = (p_.mppi.noise_decay * it.sigma).cwiseMax(floor_);
  }

  void cross_entropy_update(Instance& it, std::vector<Index> finite, Index iteration) const {
    const auto elite =
        std::min(finite.size(),
                 static_cast<std::size_t>(std::ceil(p_.cem.elite_fraction * static_cast<double>(it.costs.size()))));
    std::stable_sort(finite.begin(), finite.end(), [&](Index a, Index b) { return it.costs[a] < it.costs[b]; });
    finite.resize(elite);
    const auto n = static_cast<double>(elite);
    Vector mean = Vector::Zero(it.mean.size()), square = mean;
    for (Index k : finite) mean += it.samples.col(k) / n;
    for (Index k : finite) square += (it.samples.col(k) - mean).cwiseAbs2() / n;
    const double t = static_cast<double>(iteration + 1);
    const double beta =
        p_.cem.noise_smoothing - p_.cem.noise_smoothing * std::pow(1.0 - 1.0 / t, p_.cem.noise_smoothing_power);
    it.mean = p_.cem.smoothing * mean + (1.0 - p_.cem.smoothing) * it.mean;
    it.sigma = (beta * square.cwiseSqrt() + (1.0 - beta) * it.sigma).cwiseMax(floor_);
  }

  const Params& p_;
  const Box& bounds_;
  ConstVec scale_;
  const OptimiserOptions& options_;
  Vector width_, floor_;
};

}  // namespace

Mppi::Mppi(const Params& params) : p_(params) {
  if (p_.method == "cem" && static_cast<double>(p_.samples) * p_.cem.elite_fraction < 1.0)
    throw ConfigError("mppi: cem.elite_fraction of `samples` is less than one sample");
}

OptimiserCapabilities Mppi::capabilities() const { return {}; }

std::vector<OptimiserResult> Mppi::minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                            const OptimiserOptions& options, const OptimiserObserver& observer) const {
  check_search("mppi", objective, starts, bounds, scale);
  const Search search(p_, bounds, scale, options);
  std::vector<Instance> all;
  for (Index i = 0; i < starts.cols(); ++i) all.push_back(search.begin(starts.col(i)));

  if (options.max_evaluations <= 0)
    for (auto& it : all) it.stop(OptimiserStatus::budget_spent, "max_evaluations allows no evaluation");

  Vector best_costs = Vector::Constant(starts.cols(), std::numeric_limits<double>::infinity());
  for (Index iteration = 0;; ++iteration) {
    std::vector<Index> owners;
    std::vector<Index> active;
    for (Index i = 0; i < starts.cols(); ++i) {
      if (!all[i].running) continue;
      active.push_back(i);
      search.sample(all[i], RandomStream(options.seed, i).child(iteration));
      owners.insert(owners.end(), all[i].samples.cols(), i);
    }
    if (active.empty()) break;

    Matrix x(objective.dim(), owners.size());
    Index column = 0;
    for (Index i : active) {
      x.middleCols(column, all[i].samples.cols()) = all[i].samples;
      column += all[i].samples.cols();
    }
    const Evaluation e = objective.evaluate(x, owners, {});
    require_shape("mppi: costs of the objective", e.costs.size(), x.cols());
    column = 0;
    for (Index i : active) {
      all[i].costs = e.costs.segment(column, all[i].samples.cols());
      column += all[i].samples.cols();
      search.update(all[i], iteration);
      best_costs[i] = all[i].result.cost;
    }
    if (observer && !observer(iteration, best_costs))
      for (auto& it : all)
        if (it.running) it.stop(OptimiserStatus::stopped, "stopped by the observer");
    for (Index i : active)
      if (options.wanted && all[i].running && !options.wanted(i))
        all[i].stop(OptimiserStatus::stopped, "not wanted any more");
  }

  std::vector<OptimiserResult> results;
  for (auto& it : all) {
    if (it.result.evaluations > 0 && !std::isfinite(it.result.cost)) {
      it.result.status = OptimiserStatus::diverged;
      it.result.message = "no finite cost was found";
    }
    results.push_back(std::move(it.result));
  }
  return results;
}

}  // namespace weft::mppi
