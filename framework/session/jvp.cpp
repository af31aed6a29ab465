#include "session/jvp.hpp"

#include <algorithm>
#include <cmath>

namespace weft {
namespace {

/// One side of one difference.
struct Side {
  std::size_t instance, direction;
  double amount;  ///< multiple of the direction
};

/// Largest t >= 0 with value + t * rate in [0, 1] for every entry, at most `wanted`.
double reach(const PropertyVector& value, const PropertyVector& rate, double wanted) {
  for (Index p = 0; p < 4; ++p) {
    if (rate(p) > 0.0) wanted = std::min(wanted, (1.0 - value(p)) / rate(p));
    if (rate(p) < 0.0) wanted = std::min(wanted, value(p) / -rate(p));
  }
  return std::max(wanted, 0.0);
}

void check(const std::vector<PredictionCase>& cases, const std::vector<std::vector<CaseDirection>>& directions) {
  require_shape("jvp: directions", static_cast<Index>(directions.size()), static_cast<Index>(cases.size()));
  for (std::size_t i = 0; i < cases.size(); ++i) {
    for (const auto& d : directions[i]) {
      require_shape("jvp: rows of a direction", d.controls.rows(), cases[i].controls.rows());
      require_shape("jvp: columns of a direction", d.controls.cols(), cases[i].controls.cols());
    }
  }
}

}  // namespace

std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(const Predictor& predictor, const Prediction& prediction,
                                                          const std::vector<PredictionCase>& cases,
                                                          const std::vector<std::vector<CaseDirection>>& directions,
                                                          const Trajectory& trajectory, Moments moments,
                                                          const JvpOptions& options, Index* predicted) {
  check(cases, directions);
  if (predictor.capabilities().jvp) return prediction.jvp(directions);

  Vector scale(static_cast<Index>(trajectory.controls().size()));
  for (Index c = 0; c < scale.size(); ++c) scale(c) = trajectory.controls()[static_cast<std::size_t>(c)].scale;

  std::vector<std::vector<std::vector<ShapeCotangent>>> result(cases.size());
  std::vector<Side> sides;  // pairs: up, down
  for (std::size_t i = 0; i < cases.size(); ++i) {
    result[i].resize(directions[i].size());
    if (!prediction.failure(i).empty()) {
      for (auto& one : result[i]) one.resize(cases[i].segments.size());
      continue;
    }
    for (std::size_t d = 0; d < directions[i].size(); ++d) {
      const auto& direction = directions[i][d];
      double largest = std::max(direction.centre.cwiseAbs().maxCoeff(), direction.width.cwiseAbs().maxCoeff());
      for (Index c = 0; c < direction.controls.cols(); ++c)
        for (Index j = 0; j < direction.controls.rows(); ++j)
          largest = std::max(largest, std::abs(direction.controls(j, c)) / scale(c));
      const double step = largest > 0.0 ? options.step / largest : 0.0;
      const auto& q = cases[i].knowledge;
      const double up = std::min(reach(q.centre, direction.centre, step), reach(q.width, direction.width, step));
      const double down = std::min(reach(q.centre, -direction.centre, step), reach(q.width, -direction.width, step));
      sides.push_back({i, d, up});
      sides.push_back({i, d, -down});
    }
  }

  // Shapes of every side; empty if its case has no result.
  std::vector<std::vector<ShapeDistribution>> shapes(sides.size());
  const auto batch = static_cast<std::size_t>(std::max<Index>(1, options.batch));
  std::vector<std::size_t> wanted;
  for (std::size_t k = 0; k < sides.size(); ++k)
    if (sides[k].amount != 0.0) wanted.push_back(k);
  // If bits depend on the batch, a batch holds the sides of one case only.
  const bool mixed = predictor.capabilities().deterministic;
  for (std::size_t first = 0, last = 0; first < wanted.size(); first = last) {
    while (last < wanted.size() && last - first < batch &&
           (mixed || sides[wanted[last]].instance == sides[wanted[first]].instance))
      ++last;
    std::vector<PredictionCase> perturbed;
    for (std::size_t k = first; k < last; ++k) {
      const Side& side = sides[wanted[k]];
      const auto& direction = directions[side.instance][side.direction];
      PredictionCase one = cases[side.instance];
      one.controls += side.amount * direction.controls;
      one.knowledge.centre += side.amount * direction.centre;
      one.knowledge.width += side.amount * direction.width;
      // Rounding may leave [0, 1] by a bit. Entries that do not move stay as they are, even outside [0, 1].
      for (Index p = 0; p < 4; ++p) {
        if (direction.centre(p) != 0.0) one.knowledge.centre(p) = std::clamp(one.knowledge.centre(p), 0.0, 1.0);
        if (direction.width(p) != 0.0) one.knowledge.width(p) = std::clamp(one.knowledge.width(p), 0.0, 1.0);
      }
      perturbed.push_back(std::move(one));
    }
    const auto there = predictor.predict(perturbed, {.moments = moments, .gradients = false});
    if (predicted != nullptr) *predicted += static_cast<Index>(perturbed.size());
    for (std::size_t k = first; k < last; ++k)
      if (there->failure(k - first).empty()) shapes[wanted[k]] = there->shapes()[k - first];
  }

  for (std::size_t k = 0; k < sides.size(); k += 2) {
    const std::size_t i = sides[k].instance;
    const auto& base = prediction.shapes()[i];
    const bool has_up = !shapes[k].empty(), has_down = !shapes[k + 1].empty();
    const double length = (has_up ? sides[k].amount : 0.0) - (has_down ? sides[k + 1].amount : 0.0);
    const auto& up = has_up ? shapes[k] : base;
    const auto& down = has_down ? shapes[k + 1] : base;
    // A zero direction has derivative zero. If both sides have no result, there is no derivative.
    const bool is_zero = sides[k].amount == 0.0 && sides[k + 1].amount == 0.0;
    auto& derivatives = result[i][sides[k].direction];
    for (std::size_t s = 0; s < base.size(); ++s) {
      ShapeCotangent one;
      one.mean = is_zero ? Positions::Zero(base[s].mean.rows(), 3) : Positions((up[s].mean - down[s].mean) / length);
      if (moments == Moments::mean_and_sigma)
        one.sigma =
            is_zero ? Positions::Zero(base[s].sigma.rows(), 3) : Positions((up[s].sigma - down[s].sigma) / length);
      else
        one.sigma.resize(0, 3);
      derivatives.push_back(std::move(one));
    }
  }
  return result;
}

}  // namespace weft
