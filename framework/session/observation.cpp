#include "session/observation.hpp"

#include "simulation/surroundings.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kHiddenStream = stream_key("hide");
constexpr std::uint64_t kNoiseStream = stream_key("nois");
constexpr std::uint64_t kBiasStream = stream_key("bias");

}  // namespace

Observation observe_shape(const Positions& shape, const ObservationParams& params, std::uint64_t seed,
                          std::uint64_t number) {
  Observation seen{.positions = shape, .sigma = params.noise_m, .height_sigma = params.height_bias_m};
  if (params.height_bias_m > 0.0)
    seen.positions.col(2).array() += params.height_bias_m * RandomStream(seed, kBiasStream).normal();
  const RandomStream streams(seed, kNoiseStream, number);
  if (params.noise_m > 0.0) {
    RandomStream random = streams.child(0);
    for (Index k = 0; k < seen.positions.size(); ++k) seen.positions.data()[k] += params.noise_m * random.normal();
  }
  if (params.hidden_share > 0.0 || params.lost_share > 0.0) {
    RandomStream hidden(seed, kHiddenStream);
    RandomStream lost = streams.child(1);
    seen.observed.resize(shape.rows());
    for (std::size_t v = 0; v < seen.observed.size(); ++v) {
      const bool is_hidden = hidden.uniform() < params.hidden_share, is_lost = lost.uniform() < params.lost_share;
      seen.observed[v] = !is_hidden && !is_lost;
    }
  }
  return seen;
}

std::shared_ptr<const Positions> filled(const Observation& seen, const Positions& expected) {
  Positions shape = seen.positions;
  for (Index v = 0; v < shape.rows(); ++v) {
    if (!seen.sees(v)) shape.row(v) = expected.row(v);
  }
  return std::make_shared<const Positions>(std::move(shape));
}

double seen_distance_mm(const Observation& seen, const Positions& shape, const std::vector<bool>& counts) {
  require_shape("observed vertices", seen.positions.rows(), shape.rows());
  double sum = 0.0;
  Index count = 0;
  for (Index v = 0; v < shape.rows(); ++v) {
    if (!seen.sees(v) || (!counts.empty() && !counts[v])) continue;
    sum += (seen.positions.row(v) - shape.row(v)).norm();
    ++count;
  }
  return 1000.0 * sum / count;
}

std::shared_ptr<const Positions> filled_start(const Task& task, const Observation& seen) {
  if (task.start) return filled(seen, task.start->shape);
  Positions expected = task.garment->positions;
  const Garment& garment = *task.garment;
  double height = 0.0;  // of layer 0
  Index count = 0;
  for (Index v = 0; v < expected.rows(); ++v) {
    if (!seen.sees(v) || garment.layer(v) > 0.0) continue;
    height += seen.positions(v, 2) - (garment.form.layers.empty() ? 0.0 : garment.positions(v, 2));
    ++count;
  }
  if (count > 0) {
    height /= static_cast<double>(count);
    const double ground = work_surface(task);
    for (Index v = 0; v < expected.rows(); ++v)
      expected(v, 2) = garment.form.layers.empty()
                           ? height
                           : height + garment.layer(v) * (height - ground) + garment.positions(v, 2);
  }
  return filled(seen, expected);
}

}  // namespace weft
