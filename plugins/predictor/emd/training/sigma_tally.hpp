#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "../model.hpp"

namespace weft::emd {

/// Calibration of sigma: sigma' = factor sqrt(sigma^2 + added^2).
///
/// Errors have heavier tails than a normal distribution of the network's sigma: cloth that nearly always lies still now
/// and then has a buckle. A factor alone cannot bring the mean normalised squared error to 1 and the share within one
/// sigma to 0.683. The added length covers those tails, and widens certain predictions only by little.
class SigmaTally {
 public:
  struct Choice {
    float factor = 1.0f, added = 0.0f;  ///< added: units of kLength
  };

  /// Counts a shape. @param error, sigma [n], units of kLength.
  void add(const float* error, const float* sigma, Index n) {
    shapes_ += 1.0;
    auto& shape = squares_.emplace_back(Squares{1.0, {}});
    for (std::size_t a = 0; a < kAdded.size(); ++a) {
      const auto added = static_cast<float>(kAdded[a]) / kLength;
      double square = 0.0, log_sigma = 0.0;
      std::array<double, kFactors> inside{};
      for (Index c = 0; c < n; ++c) {
        const float variance = sigma[c] * sigma[c] + added * added, ratio = error[c] * error[c] / variance;
        square += static_cast<double>(ratio);
        log_sigma += 0.5 * static_cast<double>(std::log(variance));
        const double at = (0.5 * static_cast<double>(std::log(ratio + 1e-12f)) - std::log(kLeast)) / spacing();
        if (at < kFactors - 1) ++inside[static_cast<std::size_t>(std::max(0.0, std::floor(at) + 1.0))];
      }
      shape.square[a] = square / static_cast<double>(n);
      log_sigma_[a] += log_sigma / static_cast<double>(n);
      double sum = 0.0;
      for (std::size_t f = 0; f < kFactors; ++f) inside_[a][f] += (sum += inside[f]) / static_cast<double>(n);
    }
  }
  /// @param weight of each of its shapes.
  void add(const SigmaTally& t, double weight = 1.0) {
    shapes_ += weight * t.shapes_;
    for (const Squares& s : t.squares_) squares_.push_back({weight * s.weight, s.square});
    for (std::size_t a = 0; a < kAdded.size(); ++a) {
      log_sigma_[a] += weight * t.log_sigma_[a];
      for (std::size_t f = 0; f < kFactors; ++f) inside_[a][f] += weight * t.inside_[a][f];
    }
  }
  /// Adds its shapes, all with one weight, until there are so many.
  void add_up_to(double wanted, const SigmaTally& t) {
    if (t.shapes_ > 0.0 && shapes_ < wanted) add(t, std::min(1.0, (wanted - shapes_) / t.shapes_));
  }
  double shapes() const { return shapes_; }

  /// The likeliest choice of those that are well within 0.8 to 1.25 (mean normalised squared error) and 0.62 to 0.74
  /// (share within one sigma). If there is none, the choice that is least outside.
  Choice choose() const {
    Choice best;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t a = 0; a < kAdded.size(); ++a) {
      const auto [mean, error] = mean_square(a);
      const double expected = mean + error;  // most samples of a heavy-tailed distribution have too few tail values
      for (std::size_t f = 0; f < kFactors; ++f) {
        const double factor = std::exp(std::log(kLeast) + static_cast<double>(f) * spacing());
        const double off = std::max(std::abs(std::log(expected / (factor * factor))) / (kSquare * std::log(1.25)),
                                    std::abs(inside_[a][f] / shapes_ - 0.68) / (kInside * 0.06));
        const double loss = log_sigma_[a] / shapes_ + std::log(factor) + 0.5 * mean / (factor * factor);
        const double rank = off < 1.0 ? loss : 1e6 * off;
        if (rank < least) {
          least = rank;
          best = {static_cast<float>(factor), static_cast<float>(kAdded[a] / static_cast<double>(kLength))};
        }
      }
    }
    return best;
  }

 private:
  static constexpr std::size_t kFactors = 97;
  static constexpr double kLeast = 0.4, kMost = 2.5;
  static constexpr std::array<double, 8> kAdded = {0.0, 0.15e-3, 0.3e-3, 0.6e-3, 1.2e-3, 1.8e-3, 2.7e-3, 4.0e-3};  // m
  /// How much of the way to the bounds may be used. With more the choice is likelier, but fewer fresh samples of some
  /// hundred shapes stay within the bounds.
  static constexpr double kSquare = 0.5, kInside = 0.65;
  /// About one fold in a thousand ends up somewhere else entirely, with a square of hundreds. It counts as this many
  /// medians, so that it does not set the sigma of all others.
  static constexpr double kMedians = 20.0;
  static double spacing() { return std::log(kMost / kLeast) / static_cast<double>(kFactors - 1); }

  struct Squares {
    double weight;
    std::array<double, kAdded.size()> square;  ///< mean squared error over sigma^2 + added^2
  };
  /// Mean over shapes of the a-th squares, and its standard error.
  std::pair<double, double> mean_square(std::size_t a) const {
    std::vector<std::pair<double, double>> sorted;  // square, weight
    sorted.reserve(squares_.size());
    for (const Squares& s : squares_) sorted.emplace_back(s.square[a], s.weight);
    std::sort(sorted.begin(), sorted.end());
    double below = 0.0, most = 0.0, sum = 0.0, sum_of_squares = 0.0;
    for (const auto& [square, weight] : sorted) {
      if (below < 0.5 * shapes_) most = kMedians * square;
      below += weight;
    }
    for (const auto& [square, weight] : sorted) {
      const double counted = std::min(square, most);
      sum += weight * counted;
      sum_of_squares += weight * counted * counted;
    }
    const double mean = sum / shapes_, variance = std::max(0.0, sum_of_squares / shapes_ - mean * mean);
    return {mean, std::sqrt(variance / shapes_)};
  }

  double shapes_ = 0.0;
  std::vector<Squares> squares_;
  /// Sum over shapes of the mean logarithm of sqrt(sigma^2 + added^2).
  std::array<double, kAdded.size()> log_sigma_{};
  /// Share of the coordinates with |error| < factor sqrt(sigma^2 + added^2).
  std::array<std::array<double, kFactors>, kAdded.size()> inside_{};
};

}  // namespace weft::emd
