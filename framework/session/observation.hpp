#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "weft/params.hpp"
#include "weft/task.hpp"

namespace weft {

/// What is seen of the cloth at the end of a segment.
struct Observation {
  Positions positions;         ///< [V, 3] m
  std::vector<bool> observed;  ///< [V]; empty: all. The positions of other vertices mean nothing and may be NaN
  double sigma = 0.0;          ///< m, standard deviation of the measurement, independent per coordinate
  double height_sigma = 0.0;   ///< m, standard deviation of what all heights of a session have in common

  bool sees(Index vertex) const { return observed.empty() || observed[vertex]; }
};

/// What a session sees of the cloth.
struct ObservationParams {
  double noise_m = 0.0;
  double height_bias_m = 0.0;
  double hidden_share = 0.0;
  double lost_share = 0.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v("noise_m", noise_m, range(0, 1, "m"), "Standard deviation of Gaussian noise on every coordinate that is seen.");
    v("height_bias_m", height_bias_m, range(0, 1, "m"),
      "Standard deviation of an error that all heights of a session share: how well the sensor knows the table.");
    v("hidden_share", hidden_share, range(0, 0.99), "Share of the vertices that are never seen, drawn from the seed.");
    v("lost_share", lost_share, range(0, 0.99), "Share of the vertices that an observation misses, drawn each time.");
  }
};

/// A shape as it is seen. @param number of the observation in the session: it draws the same numbers whatever went
/// before. @param seed of noise and of what stays hidden.
Observation observe_shape(const Positions& shape, const ObservationParams& params, std::uint64_t seed,
                          std::uint64_t number);
/// What was seen; the vertices that were not seen are where they were expected. @param expected [V, 3] m.
std::shared_ptr<const Positions> filled(const Observation& seen, const Positions& expected);
/// Mean distance of the vertices that are seen to the same vertices of a shape, mm. @param shape [V, 3] m.
double seen_distance_mm(const Observation& seen, const Positions& shape);
/// The start shape, what was not seen filled from the flat garment at the height at which the rest lies.
std::shared_ptr<const Positions> filled_start(const Task& task, const Observation& seen);

}  // namespace weft
