#include "session/jvp.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

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
  require_shape("jvp: directions", directions.size(), cases.size());
  for (std::size_t i = 0; i < cases.size(); ++i) {
    for (const auto& d : directions[i]) {
      require_shape("jvp: rows of a direction", d.controls.rows(), cases[i].controls.rows());
      require_shape("jvp: columns of a direction", d.controls.cols(), cases[i].controls.cols());
    }
  }
}

/// Step along a direction whose largest change, of a control in units of `scale`, is `options.step`.
double step_along(const CaseDirection& direction, const Vector& scale, const JvpOptions& options) {
  double largest = std::max(direction.centre.cwiseAbs().maxCoeff(), direction.width.cwiseAbs().maxCoeff());
  for (Index c = 0; c < direction.controls.cols(); ++c)
    for (Index j = 0; j < direction.controls.rows(); ++j)
      largest = std::max(largest, std::abs(direction.controls(j, c)) / scale(c));
  return largest > 0.0 ? options.step / largest : 0.0;
}

/// The sides of all differences of the cases that have a result, in pairs: up, down.
std::vector<Side> sides_of(const Prediction& prediction, const std::vector<PredictionCase>& cases,
                           const std::vector<std::vector<CaseDirection>>& directions, const Trajectory& trajectory,
                           const JvpOptions& options) {
  const auto controls = trajectory.controls();
  Vector scale(controls.size());
  for (Index c = 0; c < scale.size(); ++c) scale(c) = controls[c].scale;

  std::vector<Side> sides;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    if (!prediction.failure(i).empty()) continue;
    for (std::size_t d = 0; d < directions[i].size(); ++d) {
      const auto& direction = directions[i][d];
      const double step = step_along(direction, scale, options);
      const auto& q = cases[i].knowledge;
      const double up = std::min(reach(q.centre, direction.centre, step), reach(q.width, direction.width, step));
      const double down = std::min(reach(q.centre, -direction.centre, step), reach(q.width, -direction.width, step));
      sides.push_back({i, d, up});
      sides.push_back({i, d, -down});
    }
  }
  return sides;
}

PredictionCase perturbed(const PredictionCase& base, const CaseDirection& direction, double amount) {
  PredictionCase one = base;
  one.controls += amount * direction.controls;
  one.knowledge.centre += amount * direction.centre;
  one.knowledge.width += amount * direction.width;
  // Rounding may leave [0, 1] by a bit. Entries that do not move stay as they are, even outside [0, 1].
  for (Index p = 0; p < 4; ++p) {
    if (direction.centre(p) != 0.0) one.knowledge.centre(p) = std::clamp(one.knowledge.centre(p), 0.0, 1.0);
    if (direction.width(p) != 0.0) one.knowledge.width(p) = std::clamp(one.knowledge.width(p), 0.0, 1.0);
  }
  return one;
}

/// Shapes of every side; empty where there is none.
/// @param predicted as in jvp().
std::vector<std::vector<ShapeDistribution>> predict_sides(const Predictor& predictor, const std::vector<Side>& sides,
                                                          const std::vector<PredictionCase>& cases,
                                                          const std::vector<std::vector<CaseDirection>>& directions,
                                                          Moments moments, const JvpOptions& options,
                                                          Index* predicted) {
  std::vector<std::vector<ShapeDistribution>> shapes(sides.size());
  const std::size_t batch = std::max<Index>(1, options.batch);
  std::vector<std::size_t> wanted;
  for (std::size_t k = 0; k < sides.size(); ++k)
    if (sides[k].amount != 0.0) wanted.push_back(k);
  // If bits depend on the batch, a batch holds the sides of one case only.
  const bool mixed = predictor.capabilities().deterministic;
  for (std::size_t first = 0, last = 0; first < wanted.size(); first = last) {
    while (last < wanted.size() && last - first < batch &&
           (mixed || sides[wanted[last]].instance == sides[wanted[first]].instance))
      ++last;
    std::vector<PredictionCase> moved;
    for (std::size_t k = first; k < last; ++k) {
      const Side& side = sides[wanted[k]];
      moved.push_back(perturbed(cases[side.instance], directions[side.instance][side.direction], side.amount));
    }
    const auto there = predictor.predict(moved, {.moments = moments, .gradients = false});
    if (predicted != nullptr) *predicted += moved.size();
    for (std::size_t k = first; k < last; ++k)
      if (there->failure(k - first).empty()) shapes[wanted[k]] = there->shapes()[k - first];
  }
  return shapes;
}

/// The derivatives of a case along one direction.
/// @param base,up_shapes,down_shapes shapes of the case and of its two sides; empty where a side has none.
/// @param up_amount,down_amount multiples of the direction at which the sides lie.
std::vector<ShapeCotangent> difference(const std::vector<ShapeDistribution>& base,
                                       const std::vector<ShapeDistribution>& up_shapes, double up_amount,
                                       const std::vector<ShapeDistribution>& down_shapes, double down_amount,
                                       Moments moments) {
  const bool has_up = !up_shapes.empty(), has_down = !down_shapes.empty();
  const double length = (has_up ? up_amount : 0.0) - (has_down ? down_amount : 0.0);
  const auto& up = has_up ? up_shapes : base;
  const auto& down = has_down ? down_shapes : base;
  // A zero direction has derivative zero. If both sides have no result, there is no derivative.
  const bool is_zero = up_amount == 0.0 && down_amount == 0.0;
  std::vector<ShapeCotangent> derivatives;
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
  return derivatives;
}

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// Prediction::jvp(), case by case if one of the batch diverges.
std::vector<std::vector<std::vector<ShapeCotangent>>> jvp_of(
    const Prediction& prediction, const std::vector<std::vector<CaseDirection>>& directions) {
  try {
    return prediction.jvp(directions);
  } catch (const Diverged&) {  // found below
  }
  std::vector<std::vector<std::vector<ShapeCotangent>>> result(directions.size());
  for (std::size_t i = 0; i < directions.size(); ++i) {
    std::vector<std::vector<CaseDirection>> alone(directions.size());
    for (const auto& direction : directions[i]) {
      alone[i] = {direction};
      try {
        result[i].push_back(std::move(prediction.jvp(alone).at(i).at(0)));
      } catch (const Diverged&) {
        std::vector<ShapeCotangent> none;
        for (const auto& shape : prediction.shapes().at(i))
          none.push_back({Positions::Constant(shape.mean.rows(), 3, kNaN),
                          Positions::Constant(shape.sigma.rows(), shape.sigma.cols(), kNaN)});
        result[i].push_back(std::move(none));
      }
    }
  }
  return result;
}

}  // namespace

std::vector<CaseGradient> pullback(const Prediction& prediction, const std::vector<PredictionCase>& cases,
                                   const std::vector<std::vector<ShapeCotangent>>& cotangents) {
  try {
    return prediction.pullback(cotangents);
  } catch (const Diverged&) {  // found below
  }
  std::vector<CaseGradient> result(cases.size());
  for (std::size_t i = 0; i < cases.size(); ++i) {
    if (!prediction.failure(i).empty()) continue;
    std::vector<std::vector<ShapeCotangent>> alone(cases.size());
    for (std::size_t k = 0; k < cases.size(); ++k) alone[k].resize(cotangents[k].size());
    alone[i] = cotangents[i];
    try {
      result[i] = std::move(prediction.pullback(alone).at(i));
    } catch (const Diverged&) {
      result[i].controls = Controls::Constant(cases[i].controls.rows(), cases[i].controls.cols(), kNaN);
      result[i].centre.setConstant(kNaN);
      result[i].width.setConstant(kNaN);
    }
  }
  return result;
}

std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(const Predictor& predictor, const Prediction& prediction,
                                                          const std::vector<PredictionCase>& cases,
                                                          const std::vector<std::vector<CaseDirection>>& directions,
                                                          const Trajectory& trajectory, Moments moments,
                                                          const JvpOptions& options, Index* predicted) {
  check(cases, directions);
  if (predictor.capabilities().jvp) return jvp_of(prediction, directions);

  std::vector<std::vector<std::vector<ShapeCotangent>>> result(cases.size());
  for (std::size_t i = 0; i < cases.size(); ++i) {
    result[i].resize(directions[i].size());
    if (prediction.failure(i).empty()) continue;
    for (auto& one : result[i]) one.resize(cases[i].segments.size());
  }
  const std::vector<Side> sides = sides_of(prediction, cases, directions, trajectory, options);
  const auto shapes = predict_sides(predictor, sides, cases, directions, moments, options, predicted);
  for (std::size_t k = 0; k < sides.size(); k += 2) {
    const Side &up = sides[k], &down = sides[k + 1];
    result[up.instance][up.direction] =
        difference(prediction.shapes()[up.instance], shapes[k], up.amount, shapes[k + 1], down.amount, moments);
  }
  return result;
}

}  // namespace weft
