#pragma once
#include <cstdint>

#include "weft/params.hpp"

namespace weft {

/// How much `weft learn` makes: the part of an experiment's config under `learn:`. How long it fits is a parameter of the
/// predictor.
struct LearnParams {
  std::int64_t examples = 2048;
  std::int64_t calibration_examples = 512;
  std::int64_t held_out_examples = 256;

  template <class Visitor>
  void visit(Visitor& v) {
    v("examples", examples, range(1, 1e9), "Examples that the predictor is fitted to.");
    v("calibration_examples", calibration_examples, range(1, 1e9),
      "Examples that its sigma is calibrated on, of the next seed.");
    v("held_out_examples", held_out_examples, range(1, 1e9),
      "Examples that it is measured on, of the seed after that.");
  }
};

/// What this machine does in a second, as a short trial found.
struct LearnRates {
  double examples_per_s = 0.0, iterations_per_s = 0.0;
};
/// LearnParams, and the iterations of the fit.
struct LearnNumbers {
  LearnParams examples;
  std::int64_t iterations = 0;
};

/// The calibration takes this part of the time in which its examples are simulated (docs/model.md: 5 of 38 minutes).
inline constexpr double kCalibrationCost = 1.0 / 7.0;

/// Seconds that learning takes: simulating all examples, the fit and the calibration.
double seconds_of(const LearnNumbers& numbers, const LearnRates& rates);

/// The numbers that fill so many seconds: three iterations for each example of the fit; a quarter as many examples for the
/// calibration and an eighth held out, at least 64 each. Beyond 10,000 examples more iterations help more than more examples,
/// so the time that is left goes there.
/// @param seconds > 0. @param rates > 0. @param least examples of the fit, also where that takes longer.
LearnNumbers numbers_for(double seconds, const LearnRates& rates, std::int64_t least);

}  // namespace weft
