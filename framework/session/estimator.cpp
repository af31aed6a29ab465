#include "session/estimator.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>

#include "loader/where.hpp"
#include "session/halving.hpp"
#include "session/instance_rows.hpp"
#include "session/jvp.hpp"

namespace weft {
namespace {

/// A sigma below this value does not lower the loss. So 1 + log(sigma / floor) stays positive, as least squares needs.
constexpr double kSigmaFloor = 1e-4;  // m

/// One seen coordinate: the shape, the entry in it, and the measured value.
struct Coordinate {
  std::size_t shape;
  Index entry;  // of [V, 3], row-major
  double position;
};

struct History {
  std::vector<Coordinate> coordinates;
  std::vector<Index> segments;  // those with a seen vertex, ascending, 1-based
  std::vector<double> noise;    // [segments], m
};

History collect(const EstimateRequest& request, Index vertices) {
  History history;
  for (std::size_t j = 0; j < request.observations.size(); ++j) {
    const auto& seen = *request.observations[j];
    const std::string where = "estimation: observation " + std::to_string(j + 1);
    require_shape(where + ": positions", seen.positions.rows(), vertices);
    if (!seen.observed.empty()) require_shape(where + ": observed", seen.observed.size(), vertices);
    if (!(seen.sigma >= 0.0) || !std::isfinite(seen.sigma)) throw Error(where + ": sigma must be finite and >= 0");
    const std::size_t before = history.coordinates.size();
    for (Index v = 0; v < vertices; ++v) {
      if (!seen.sees(v)) continue;
      if (!seen.positions.row(v).allFinite()) throw Error(where + ": vertex " + std::to_string(v) + " is not finite");
      for (Index axis = 0; axis < 3; ++axis)
        history.coordinates.push_back({history.segments.size(), 3 * v + axis, seen.positions(v, axis)});
    }
    if (history.coordinates.size() == before) continue;
    history.segments.push_back(j + 1);
    history.noise.push_back(seen.sigma);
  }
  return history;
}

/// Loss of a batch of (c, w), or of c alone at w = 0. It is the mean over the coordinates of
///     1/2 ((x - mu) / sigma)^2 + 1 + log(sigma / floor)  =  eq. 6 + constant,
/// where sigma includes the measurement's noise, plus the prior on w and the term of the start shape's height.
class EstimationObjective final : public Objective {
 public:
  EstimationObjective(const Task& task, const Predictor& predictor, const EstimatorParams& params,
                      const EstimateRequest& request, const History& history)
      : task_(task), predictor_(predictor), params_(params), request_(request), history_(history) {
    is_certain_ = params.method == "posterior";
    const auto n = static_cast<double>(history.coordinates.size());
    per_coordinate_ = 1.0 / n;
    if (!is_certain_) return;
    const auto shapes = static_cast<double>(history.segments.size());
    // Errors shared by the shapes of a sequence do not average out: the design effect [Kish 1965, "Survey sampling"].
    information_ =
        std::min(n, params.effective_coordinates * shapes / (1.0 + (shapes - 1.0) * params.shape_correlation));
    noise_share_ = information_ / n;
    // What an earlier fold left lies in folds, whose height is not that of the thickness.
    has_start_height_ = params.start_height_sigma_m > 0.0 && !request.start->isZero(0.0) && !task.start;
    if (has_start_height_) {
      start_height_ = lowest_layer(*task.garment, *request.start).height;
      start_height_sigma_ = std::hypot(params.start_height_sigma_m, request.start_sigma, request.start_height_sigma);
    }
  }

  Index dim() const override { return is_certain_ ? 4 : 8; }
  ObjectiveCapabilities capabilities() const override {
    return {.gradients = predictor_.capabilities().gradients,
            .residuals = 2 * static_cast<Index>(history_.coordinates.size()) + (is_certain_ ? 1 : 4)};
  }

  PredictionCase make_case(ConstVec x) const {
    PredictionCase one{.shape = request_.start, .previous = nullptr, .state = request_.state};
    one.controls = request_.controls;
    one.knowledge = knowledge(x);
    one.segments = history_.segments;
    return one;
  }
  MaterialKnowledge knowledge(ConstVec x) const {
    MaterialKnowledge k;
    k.centre = x.head<4>();
    if (is_certain_)
      k.width.setZero();
    else
      k.width = x.tail<4>();
    return k;
  }

  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& wanted) override {
    require_shape("estimation objective: x rows", x.rows(), dim());
    require_shape("estimation objective: instances", instances.size(), x.cols());
    if (wanted.gradients && !capabilities().gradients)
      throw Unsupported("estimation objective: the predictor has no gradients");
    const Index n = x.cols();
    std::vector<PredictionCase> cases;
    for (Index i = 0; i < n; ++i) cases.push_back(make_case(x.col(i)));
    const bool has_jvp = wanted.jacobians && predictor_.capabilities().jvp;
    const auto prediction = predict_in_rows(predictor_, cases, instances, params_.instances,
                                            {.moments = Moments::mean_and_sigma,
                                             .gradients = wanted.gradients || has_jvp,
                                             .control_gradients = false,
                                             .knowledge_gradients = true});
    evaluations_ += n;
    Evaluation result;
    result.costs = Vector::Constant(n, std::numeric_limits<double>::infinity());
    std::vector<std::vector<ShapeCotangent>> cotangents(cases.size());
    for (Index i = 0; i < n; ++i) {
      cotangents[i].resize(history_.segments.size());
      if (!prediction->failure(i).empty()) continue;
      const auto& shapes = prediction->shapes()[i];
      double prior = 0.0;
      for (Index p = 4; p < dim(); ++p) prior += prior_term(x(p, i));
      const double start = start_residual(x.col(i));
      result.costs(i) = shape_cost(shapes, wanted.gradients ? &cotangents[i] : nullptr) + prior + 0.5 * start * start;
    }
    if (wanted.gradients) {
      const auto gradients = pullback(*prediction, cases, cotangents);
      result.gradients = Matrix::Zero(dim(), n);
      for (Index i = 0; i < n; ++i) {
        if (!std::isfinite(result.costs(i))) continue;
        result.gradients.col(i).head<4>() = gradients[i].centre;
        if (!is_certain_) result.gradients.col(i).tail<4>() = gradients[i].width;
        for (Index p = 4; p < dim(); ++p) result.gradients(p, i) += prior_slope(x(p, i));
        if (has_start_height_)
          result.gradients(kThickness, i) += start_residual(x.col(i)) * start_slope(x(kThickness, i));
      }
    }
    if (wanted.residuals || wanted.jacobians) add_residuals(x, cases, *prediction, wanted.jacobians, result);
    return result;
  }

  /// Sets nll and misfit, two means over the coordinates: the negative log-likelihood (eq. 6 alone, lengths in mm) and
  /// the squared normalised error.
  void rate(const std::vector<ShapeDistribution>& shapes, Estimate& estimate) const {
    estimate.nll = estimate.misfit = 0.0;
    for (const auto& c : history_.coordinates) {
      const double variance = variance_of(shapes, c);
      const double error = c.position - shapes[c.shape].mean.data()[c.entry];
      estimate.misfit += per_coordinate_ * error * error / variance;
      estimate.nll += per_coordinate_ * 0.5 * std::log(2.0 * std::numbers::pi * variance * 1e6);
    }
    estimate.nll += 0.5 * estimate.misfit;
  }

  /// The posterior around the best q: gradient and Gauss-Newton precision of n L(q) by central differences, n the
  /// number of independent measurements. For normal distributions the precision (the Fisher information) is the sum of
  ///     dmu dmu' / sigma^2 + 2 dsigma dsigma' / sigma^2.
  /// Sigma is right on average, but not for each sequence. So all variances of a sequence get a common factor: the
  /// weighted mean of its mean squared residual (Birge's ratio [Birge 1932, "The calculation of errors by the method of
  /// least squares"]), with the weight of n measurements, and of 1, with the weight `misfit_prior`.
  MaterialPosterior posterior(const PropertyVector& mode, double misfit) {
    std::vector<PredictionCase> cases{make_case(mode)};
    PropertyVector low, high;
    for (Index p = 0; p < 4; ++p) {
      PropertyVector q = mode;
      low(p) = q(p) = std::max(0.0, mode(p) - params_.difference_step);
      cases.push_back(make_case(q));
      high(p) = q(p) = std::min(1.0, mode(p) + params_.difference_step);
      cases.push_back(make_case(q));
    }
    const auto prediction = predictor_.predict(cases, {.moments = Moments::mean_and_sigma});
    evaluations_ += cases.size();
    if (!prediction->failure(0).empty())
      throw Error("estimation: the best estimate cannot be predicted: " + prediction->failure(0));
    const auto& shapes = prediction->shapes();
    // A side that cannot be predicted is left out. If both sides are, the property stays unknown.
    std::array<const std::vector<ShapeDistribution>*, 4> lower{}, upper{};
    MaterialPosterior result;
    result.mode = mode;
    for (std::size_t p = 0; p < 4; ++p) {
      const bool has_lower = prediction->failure(1 + 2 * p).empty() && low(p) < mode(p);
      const bool has_upper = prediction->failure(2 + 2 * p).empty() && high(p) > mode(p);
      lower[p] = has_lower ? &shapes[1 + 2 * p] : &shapes[0];
      upper[p] = has_upper ? &shapes[2 + 2 * p] : &shapes[0];
      if (!has_lower) low(p) = mode(p);
      if (!has_upper) high(p) = mode(p);
    }
    const double factor = (params_.misfit_prior + information_ * misfit) / (params_.misfit_prior + information_);
    const double weight = information_ * per_coordinate_ / factor;
    for (const auto& c : history_.coordinates) {
      const double s = shapes[0][c.shape].sigma.data()[c.entry], variance = variance_of(shapes[0], c);
      const double error = c.position - shapes[0][c.shape].mean.data()[c.entry];
      PropertyVector mean, deviation;
      for (std::size_t p = 0; p < 4; ++p) {
        const double span = high(p) - low(p);
        const auto& a = (*lower[p])[c.shape];
        const auto& b = (*upper[p])[c.shape];
        mean(p) = span > 0 ? (b.mean.data()[c.entry] - a.mean.data()[c.entry]) / span : 0.0;
        // d sqrt(sigma^2 + noise^2) = sigma / total dsigma
        deviation(p) =
            span > 0 ? (b.sigma.data()[c.entry] - a.sigma.data()[c.entry]) / span * s / std::sqrt(variance) : 0.0;
      }
      const PropertyVector in_block = std::sqrt(variance / block_variance_of(shapes[0], c)) * mean;
      result.precision +=
          weight / variance * (in_block * in_block.transpose() + 2.0 * deviation * deviation.transpose());
      result.gradient -= weight * error / variance * mean;
      result.gradient += weight * (1.0 - error * error / variance) / std::sqrt(variance) * deviation;
    }
    if (has_start_height_) {
      const double slope = start_slope(mode(kThickness)) / start_factor();
      result.precision(kThickness, kThickness) += slope * slope;
      result.gradient(kThickness) += start_residual(mode) / start_factor() * slope;
    }
    // Inside the box the search has found a minimum, so the rest of the gradient is its tolerance.
    for (Index p = 0; p < 4; ++p) {
      const bool held_low = mode(p) <= 0.0 && result.gradient(p) > 0.0,
                 held_high = mode(p) >= 1.0 && result.gradient(p) < 0.0;
      if (!held_low && !held_high) result.gradient(p) = 0.0;
    }
    return result;
  }
  Index evaluations() const { return evaluations_; }

 private:
  static constexpr Index kThickness = 3;

  double variance_of(const std::vector<ShapeDistribution>& shapes, const Coordinate& c) const {
    const double s = shapes[c.shape].sigma.data()[c.entry], noise = history_.noise[c.shape];
    return s * s + noise * noise;
  }
  /// Of the mean of a block of coordinates whose predictions err together: the measurement's noise averages out in it.
  double block_variance_of(const std::vector<ShapeDistribution>& shapes, const Coordinate& c) const {
    const double s = shapes[c.shape].sigma.data()[c.entry], noise = history_.noise[c.shape];
    return s * s + noise_share_ * noise * noise;
  }

  double shape_cost(const std::vector<ShapeDistribution>& shapes, std::vector<ShapeCotangent>* cotangents) const {
    if (cotangents) {
      for (std::size_t k = 0; k < shapes.size(); ++k) {
        (*cotangents)[k].mean = Positions::Zero(shapes[k].mean.rows(), 3);
        (*cotangents)[k].sigma = Positions::Zero(shapes[k].mean.rows(), 3);
      }
    }
    double sum = 0.0;
    for (const auto& c : history_.coordinates) {
      const double s = shapes[c.shape].sigma.data()[c.entry], variance = variance_of(shapes, c);
      const double error = c.position - shapes[c.shape].mean.data()[c.entry];
      const bool above = variance > kSigmaFloor * kSigmaFloor;
      const double z2 = error * error / variance;
      sum += 0.5 * z2 + 1.0 + (above ? 0.5 * std::log(variance / (kSigmaFloor * kSigmaFloor)) : 0.0);
      if (cotangents) {
        (*cotangents)[c.shape].mean.data()[c.entry] = -per_coordinate_ * error / variance;
        (*cotangents)[c.shape].sigma.data()[c.entry] = per_coordinate_ * s / variance * ((above ? 1.0 : 0.0) - z2);
      }
    }
    return sum * per_coordinate_;
  }

  // lambda (1 + log((1 + offset) / (w + offset))): -lambda log(w + offset) with a constant that keeps it positive.
  double prior_term(double w) const {
    if (params_.method != "prior") return 0.0;
    return params_.width_prior * (1.0 + std::log((1.0 + params_.width_offset) / (w + params_.width_offset)));
  }
  double prior_slope(double w) const {
    return params_.method == "prior" ? -params_.width_prior / (w + params_.width_offset) : 0.0;
  }

  /// The weight of the height term. The loss is that of one measurement, so the square is 1 / `information_`.
  double start_factor() const { return 1.0 / std::sqrt(information_); }
  double start_residual(ConstVec x) const {
    if (!has_start_height_) return 0.0;
    return start_factor() * (task_.material.ranges[kThickness].at(x(kThickness)) - start_height_) / start_height_sigma_;
  }
  double start_slope(double q) const {
    const auto& range = task_.material.ranges[kThickness];
    constexpr double h = 1e-5;
    return start_factor() * (range.at(q + h) - range.at(q - h)) / (2.0 * h) / start_height_sigma_;
  }

  /// The loss as 1/2 |r|^2. r holds (x - mu) / sigma and sqrt(2 (1 + log(sigma / floor))) of every coordinate, then the
  /// prior on w and the height term.
  void add_residuals(ConstMatrix x, const std::vector<PredictionCase>& cases, const Prediction& prediction,
                     bool with_jacobians, Evaluation& result) {
    const Index seen = history_.coordinates.size();
    const Index rows = capabilities().residuals, n = x.cols();
    const double root = std::sqrt(per_coordinate_);
    result.residuals = Matrix::Zero(rows, n);
    if (with_jacobians) result.jacobians.assign(n, Matrix::Zero(rows, dim()));
    std::vector<std::vector<CaseDirection>> directions(n);
    for (Index i = 0; i < n; ++i) {
      if (!std::isfinite(result.costs(i))) continue;
      const auto& shapes = prediction.shapes()[i];
      for (Index k = 0; k < seen; ++k) {
        const auto& c = history_.coordinates[k];
        const double deviation = std::sqrt(variance_of(shapes, c));
        result.residuals(k, i) = root * (c.position - shapes[c.shape].mean.data()[c.entry]) / deviation;
        result.residuals(seen + k, i) =
            root * std::sqrt(2.0 * (1.0 + std::log(std::max(deviation, kSigmaFloor) / kSigmaFloor)));
      }
      for (Index p = 4; p < dim(); ++p) result.residuals(2 * seen + p - 4, i) = std::sqrt(2.0 * prior_term(x(p, i)));
      if (is_certain_) result.residuals(2 * seen, i) = start_residual(x.col(i));
      if (!with_jacobians) continue;
      for (Index p = 0; p < dim(); ++p) {
        CaseDirection direction;
        direction.controls = Controls::Zero(request_.controls.rows(), request_.controls.cols());
        (p < 4 ? direction.centre(p) : direction.width(p - 4)) = 1.0;
        directions[i].push_back(std::move(direction));
        if (p >= 4 && params_.method == "prior" && params_.width_prior > 0.0)
          result.jacobians[i](2 * seen + p - 4, p) = prior_slope(x(p, i)) / result.residuals(2 * seen + p - 4, i);
      }
      if (has_start_height_) result.jacobians[i](2 * seen, kThickness) = start_slope(x(kThickness, i));
    }
    if (!with_jacobians) return;
    const auto derivatives = jvp(predictor_, prediction, cases, directions, *task_.trajectory, Moments::mean_and_sigma,
                                 {.step = params_.difference_step}, &evaluations_);
    for (Index i = 0; i < n; ++i) {
      if (!std::isfinite(result.costs(i))) continue;
      const auto& shapes = prediction.shapes()[i];
      for (Index k = 0; k < seen; ++k) {
        const auto& c = history_.coordinates[k];
        const double s = shapes[c.shape].sigma.data()[c.entry], deviation = std::sqrt(variance_of(shapes, c));
        for (Index p = 0; p < dim(); ++p) {
          const auto& change = derivatives[i][p][c.shape];
          const double d_log = change.sigma.data()[c.entry] * s / (deviation * deviation);  // of the total deviation
          result.jacobians[i](k, p) = -root * change.mean.data()[c.entry] / deviation - result.residuals(k, i) * d_log;
          if (deviation > kSigmaFloor)
            result.jacobians[i](seen + k, p) = per_coordinate_ * d_log / result.residuals(seen + k, i);
        }
      }
    }
  }

  const Task& task_;
  const Predictor& predictor_;
  const EstimatorParams& params_;
  const EstimateRequest& request_;
  const History& history_;
  bool is_certain_ = false;  // 4 variables: q, at w = 0
  double per_coordinate_ = 1.0, noise_share_ = 1.0;
  double information_ = 1.0;
  bool has_start_height_ = false;
  double start_height_ = 0.0, start_height_sigma_ = 1.0;
  Index evaluations_ = 0;
};

}  // namespace

Estimator::Estimator(const Task& task, std::shared_ptr<const Predictor> predictor,
                     std::shared_ptr<const Optimiser> optimiser, const EstimatorParams& params, Host& host)
    : task_(task), predictor_(std::move(predictor)), optimiser_(std::move(optimiser)), params_(params), host_(host) {
  if (optimiser_->capabilities().needs_gradients && !predictor_->capabilities().gradients) {
    throw Unsupported("the optimiser needs gradients, but the predictor has none; choose a gradient-free optimiser");
  }
  if (!params_.deviation_scale.empty()) {
    require_shape("estimation: deviation_scale", params_.deviation_scale.size(), 4);
    deviation_scale_ = Eigen::Map<const Eigen::Vector4d>(params_.deviation_scale.data());
  }
}

Estimate Estimator::estimate(const EstimateRequest& request) const {
  const Step segment("segment", request.round + 1);
  const Step estimation("estimation");
  const auto started = std::chrono::steady_clock::now();
  require_shape("estimation: start", request.start->rows(), task_.garment->vertex_count());
  require_shape("estimation: observations", request.observations.size(), request.controls.rows());
  if (!request.start->allFinite()) throw Error("estimation: the start shape is not finite");
  Estimate estimate;
  const History history = collect(request, task_.garment->vertex_count());
  if (history.coordinates.empty()) return estimate;

  EstimationObjective objective(task_, *predictor_, params_, request, history);
  const bool first = !request.previous || request.round == 0;  // then it is a prior
  const MaterialKnowledge before = request.previous.value_or(MaterialKnowledge::none());
  const Box bounds{Vector::Zero(objective.dim()), Vector::Ones(objective.dim())};
  Vector centre(objective.dim());
  centre.head<4>() = before.centre;
  if (centre.size() == 8) centre.tail<4>() = before.width;
  // Instance 0 starts from the previous estimate, the others from it plus noise. Except in the paper's variant, one in
  // four starts anywhere, because the first segments may have led to the wrong side of a ridge. The first noise is as wide
  // as what is known.
  const auto noise = [&](Index k) {
    return first ? params_.noise * (k < 4 ? before.width(k) : 1.0) : params_.later_noise;
  };
  Matrix starts(centre.size(), params_.instances);
  for (Index i = 0; i < starts.cols(); ++i) {
    RandomStream random = RandomStream(request.seed, stream_key("estim"), static_cast<std::uint64_t>(request.round))
                              .child(static_cast<std::uint64_t>(i));
    for (Index k = 0; k < starts.rows(); ++k) {
      const bool anywhere = params_.method != "plain" && i % 4 == 3 && k < 4;
      starts(k, i) = anywhere ? random.uniform() : centre(k) + (i == 0 ? 0.0 : noise(k) * random.normal());
    }
    starts.col(i) = bounds.clamp(starts.col(i));
  }
  OptimiserOptions options;
  options.max_iterations = first ? params_.iterations : params_.later_iterations;
  options.seed = RandomStream(request.seed, stream_key("estopt"), static_cast<std::uint64_t>(request.round)).bits64();
  Halving halving(params_.instances, options.max_iterations, params_.halvings);
  options.wanted = [&](Index instance) { return halving.wants(instance); };
  const auto observer = [&](Index iteration, const Vector& best) {
    estimate.iterations = iteration;
    halving.look(iteration, best);
    return !host_.cancelled();
  };
  const auto results = optimiser_->minimise(objective, starts, bounds, Vector::Ones(centre.size()), options, observer);

  estimate.loss = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < results.size(); ++i) {
    estimate.losses.push_back(results[i].cost);
    if (results[i].cost < estimate.loss) {
      estimate.loss = results[i].cost;
      estimate.instance = i;
    }
  }
  if (!std::isfinite(estimate.loss))
    throw Diverged("estimation: no instance reached a finite loss: " + results.front().message);
  estimate.ended = search_end(results, estimate.instance);
  const Vector& best = results[estimate.instance].x;
  const auto prediction = predictor_->predict({objective.make_case(best)}, {.moments = Moments::mean_and_sigma});
  objective.rate(prediction->shapes().front(), estimate);
  if (params_.method == "posterior") {
    estimate.posterior = objective.posterior(best, estimate.misfit);
    estimate.knowledge = interval_of(estimate.posterior->widened(deviation_scale_));
  } else {
    estimate.knowledge = objective.knowledge(best);
  }
  estimate.evaluations = objective.evaluations() + 1;
  estimate.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  return estimate;
}

}  // namespace weft
