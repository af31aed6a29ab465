#include "experiments/prediction_figures.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <tuple>

#include "experiments/statistics.hpp"

namespace weft {

PredictionScore score_of(const ShapeDistribution& predicted, const Positions& truth) {
  double likelihood = 0.0, within = 0.0, squares = 0.0, sigmas = 0.0;
  for (Index i = 0; i < truth.size(); ++i) {
    const double s = predicted.sigma.data()[i] * 1e3;
    const double r = (predicted.mean.data()[i] - truth.data()[i]) * 1e3 / s;
    likelihood += 0.5 * r * r + std::log(s) + 0.5 * std::log(2.0 * std::numbers::pi);
    within += std::abs(r) <= 1.0;
    squares += r * r;
    sigmas += s;
  }
  const auto coordinates = static_cast<double>(truth.size());
  return {mean_distance_mm(predicted.mean, truth), likelihood / coordinates, within / coordinates,
          squares / coordinates, sigmas / coordinates};
}

void PredictionTally::add(std::size_t example, const PredictionScore& score, Index ahead) {
  steps_ += static_cast<double>(ahead);
  errors_.push_back(score.error_mm);
  examples_.push_back(example);
  nll_ += score.nll;
  sigma_ += score.sigma_mm;
  inside_.push_back(score.inside);
  square_.push_back(score.square);
}

void PredictionTally::add(std::size_t example, const Positions& predicted, const Positions& truth, Index ahead) {
  steps_ += static_cast<double>(ahead);
  errors_.push_back(mean_distance_mm(predicted, truth));
  examples_.push_back(example);
}

std::pair<double, double> PredictionTally::mean(const std::vector<double>& values) const {
  if (values.empty()) return {};
  const auto n = static_cast<double>(values.size());
  const double mean = mean_of(values);
  std::map<std::size_t, double> deviations;
  for (std::size_t k = 0; k < values.size(); ++k) deviations[examples_[k]] += values[k] - mean;
  double squares = 0.0;
  for (const auto& [example, deviation] : deviations) squares += deviation * deviation;
  return {mean, deviations.size() > 1 ? std::sqrt(squares) / n : kNaN};
}

PredictionFigures PredictionTally::figures() const {
  PredictionFigures f;
  f.n = static_cast<Index>(errors_.size());
  if (f.n == 0) return f;
  const auto n = static_cast<double>(f.n);
  std::vector<double> sorted = errors_;
  std::sort(sorted.begin(), sorted.end());
  f.examples = static_cast<Index>(std::set<std::size_t>(examples_.begin(), examples_.end()).size());
  std::tie(f.mean_mm, f.mean_mm_se) = mean(errors_);
  const std::size_t middle = sorted.size() / 2;
  f.median_mm = sorted.size() % 2 == 1 ? sorted[middle] : 0.5 * (sorted[middle - 1] + sorted[middle]);
  f.steps = steps_ / n;
  f.nll = nll_ / n;
  f.sigma_mm = sigma_ / n;
  std::tie(f.coverage_1sigma, f.coverage_1sigma_se) = mean(inside_);
  std::tie(f.nse, f.nse_se) = mean(square_);
  return f;
}

}  // namespace weft
