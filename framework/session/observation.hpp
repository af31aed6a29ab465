#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "weft/params.hpp"
#include "weft/task.hpp"

namespace weft {

/// One observation of the cloth, at the start or at the end of a segment.
struct Observation {
  Positions positions;         ///< [V, 3] m
  std::vector<bool> observed;  ///< [V]; empty: all. The positions of the others are undefined and may be NaN
  double sigma = 0.0;          ///< m, standard deviation of the measurement, independent per coordinate
  double height_sigma = 0.0;   ///< m, standard deviation of the error shared by all heights of a session

  bool sees(Index vertex) const { return observed.empty() || observed[vertex]; }
};

/// Errors and gaps of the observations of a session.
struct ObservationParams {
  double noise_m = 0.0;
  double height_bias_m = 0.0;
  double hidden_share = 0.0;
  double lost_share = 0.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v("noise_m", noise_m, range(0, 1, "m"), "Standard deviation of Gaussian noise on every seen coordinate.");
    v("height_bias_m", height_bias_m, range(0, 1, "m"),
      "Standard deviation of one error on all heights of a session: the sensor's error about the table's height.");
    v("hidden_share", hidden_share, range(0, 0.99), "Share of the vertices that are never seen, drawn from the seed.");
    v("lost_share", lost_share, range(0, 0.99), "Share of the vertices missed in an observation, drawn each time.");
  }
};

/// Simulates an observation of a shape.
/// @param number of the observation in the session. Seed and number fix all random draws.
/// @param seed of the noise and of the hidden vertices.
Observation observe_shape(const Positions& shape, const ObservationParams& params, std::uint64_t seed,
                          std::uint64_t number);
/// The observed positions; unseen vertices get their expected positions. @param expected [V, 3] m.
std::shared_ptr<const Positions> filled(const Observation& seen, const Positions& expected);
/// Mean distance between the seen vertices and the same vertices of a shape, mm. @param shape [V, 3] m.
double seen_distance_mm(const Observation& seen, const Positions& shape, const std::vector<bool>& counts = {});
/// The observed start shape. Unseen vertices come from the flat garment, at the mean height of the seen ones.
std::shared_ptr<const Positions> filled_start(const Task& task, const Observation& seen);

}  // namespace weft
