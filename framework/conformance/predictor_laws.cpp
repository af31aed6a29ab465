// The laws of a predictor. It is bound to a small towel fold, or to the `task:` of its tolerances.
// More than 700 lines: a table of laws, one function each.
#include <algorithm>
#include <functional>

#include "conformance/kit.hpp"
#include "simulation/fold.hpp"
#include "simulation/task_config.hpp"

namespace weft::conformance {
namespace of_predictors {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

MaterialSpace material_space() {
  MaterialSpace space;
  space.nominal = plain_fabric();
  space.nominal.damping_air_per_s = 1.0;
  space.ranges = {{{0.2, 0.9, false}, {0.3, 3.0, true}, {0.3, 3.0, true}, {0.0008, 0.002, false}}};
  return space;
}

/// A bound predictor and the cases for it.
struct Fold {
  explicit Fold(const Bench& bench) : task(predictor_task(bench)), predictor(bench.make<Predictor>()) {
    predictor->bind(task);
    capabilities = predictor->capabilities();
    start = task.trajectory->initial_state(task.manipulation);
    Positions flat = task.garment->positions;
    flat.col(2) = flat.col(2).cwiseMax(task.manipulation.contact_height);
    shape = std::make_shared<const Positions>(flat);
  }

  /// Controls near the default ones. They keep a margin to their bounds for finite differences.
  Controls controls(Index segments, std::uint64_t key) const {
    RandomStream random(31, key);
    Controls c = task.trajectory->default_controls(segments);
    const auto variables = task.trajectory->controls();
    for (Index i = 0; i < c.cols(); ++i) {
      const auto& v = variables[i];
      const double margin = std::min(0.3 * v.scale, 0.25 * (v.upper - v.lower));
      for (Index j = 0; j < segments; ++j)
        c(j, i) = std::clamp(c(j, i) + v.scale * random.uniform(-0.5, 0.5), v.lower + margin, v.upper - margin);
    }
    return c;
  }
  PredictionCase ask(Index segments, std::vector<Index> wanted, std::uint64_t key) const {
    PredictionCase c;
    c.shape = shape;
    c.state = start;
    c.controls = controls(segments, key);
    RandomStream random(32, key);
    for (int p = 0; p < 4; ++p) {
      c.knowledge.centre[p] = random.uniform(0.35, 0.65);
      c.knowledge.width[p] = random.uniform(0.1, 0.4);
    }
    c.segments = std::move(wanted);
    return c;
  }
  /// Two cases from the start, the second one longer, and one in mid-air after the first segment.
  std::vector<PredictionCase> cases() const {
    std::vector<PredictionCase> all = {ask(2, {1, 2}, 1), ask(3, {3}, 2), ask(2, {2}, 3)};
    const auto first = predict({ask(1, {1}, 4)}, {.moments = Moments::mean});
    if (!first->failure(0).empty()) throw Error("case 0 failed: " + first->failure(0));
    all[2].previous = shape;
    all[2].shape = std::make_shared<const Positions>(first->shapes().at(0).at(0).mean);
    all[2].state = task.trajectory->segment_states(task.manipulation, start, controls(1, 4)).row(0).transpose();
    return all;
  }
  /// A request for every declared gradient.
  PredictionRequest all_gradients() const {
    return {.gradients = true,
            .state_gradients = capabilities.state_gradients,
            .shape_gradients = capabilities.shape_gradients};
  }
  /// predict(). Its shapes must have the requested sizes; a failed case may have none.
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request = {}) const {
    auto prediction = predictor->predict(cases, request);
    if (!prediction) throw Error("predict() returned null");
    const auto& shapes = prediction->shapes();
    require_shape("cases of shapes()", shapes.size(), cases.size());
    for (std::size_t i = 0; i < cases.size(); ++i) {
      if (!prediction->failure(i).empty() && shapes[i].empty()) continue;
      const std::string of = " of case " + std::to_string(i);
      require_shape("shapes" + of, shapes[i].size(), cases[i].segments.size());
      for (const auto& s : shapes[i]) {
        require_shape("rows of a mean" + of, s.mean.rows(), vertices());
        require_shape("rows of a sigma" + of, s.sigma.rows(), request.moments == Moments::mean ? 0 : vertices());
      }
    }
    return prediction;
  }
  Index vertices() const { return shape->rows(); }

  Task task;
  std::shared_ptr<Predictor> predictor;
  PredictorCapabilities capabilities;
  Vector start;
  std::shared_ptr<const Positions> shape;
};

using Cotangents = std::vector<std::vector<ShapeCotangent>>;

/// A smooth weight per vertex, axis and moment, of the order of 1 / V: dL/d(mean, sigma) of the losses below.
Cotangents smooth_cotangents(const Fold& fold, const std::vector<PredictionCase>& cases) {
  const RestPositions& rest = fold.task.garment->rest;
  const double size = (rest.colwise().maxCoeff() - rest.colwise().minCoeff()).maxCoeff();
  Cotangents all;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    all.emplace_back();
    for (std::size_t s = 0; s < cases[i].segments.size(); ++s) {
      ShapeCotangent w{Positions(fold.vertices(), 3), Positions(fold.vertices(), 3)};
      for (Index v = 0; v < fold.vertices(); ++v) {
        for (Index k = 0; k < 3; ++k) {
          const double phase =
              (3.0 * rest(v, 0) + 2.0 * rest(v, 1)) / size + static_cast<double>(k) + 0.7 * static_cast<double>(i + s);
          w.mean(v, k) = std::cos(phase) / static_cast<double>(fold.vertices());
          w.sigma(v, k) = std::sin(phase + 0.5) / static_cast<double>(fold.vertices());
        }
      }
      all.back().push_back(w);
    }
  }
  return all;
}

/// pullback(). It must return one gradient per case, with all controls.
std::vector<CaseGradient> pull(const Prediction& prediction, const std::vector<PredictionCase>& cases,
                               const Cotangents& weights) {
  auto gradients = prediction.pullback(weights);
  require_shape("cases of pullback()", gradients.size(), cases.size());
  for (std::size_t i = 0; i < cases.size(); ++i) {
    require_shape("rows of d controls", gradients[i].controls.rows(), cases[i].controls.rows());
    require_shape("columns of d controls", gradients[i].controls.cols(), cases[i].controls.cols());
  }
  return gradients;
}

std::string failures(const Prediction& prediction, std::size_t count) {
  std::string text;
  for (std::size_t i = 0; i < count; ++i)
    if (!prediction.failure(i).empty())
      text += "case " + std::to_string(i) + " failed: " + prediction.failure(i) + "; ";
  return text;
}

/// Loss of every case: cotangents . shapes.
Vector losses(const Fold& fold, const std::vector<PredictionCase>& cases, const Cotangents& weights) {
  const auto prediction = fold.predict(cases);
  if (const auto text = failures(*prediction, cases.size()); !text.empty()) throw Error(text);
  Vector sums = Vector::Zero(cases.size());
  for (std::size_t i = 0; i < cases.size(); ++i) {
    for (std::size_t s = 0; s < cases[i].segments.size(); ++s) {
      const auto& shape = prediction->shapes()[i][s];
      const auto& w = weights[i % weights.size()][s];
      sums[i] += shape.mean.cwiseProduct(w.mean).sum() + shape.sigma.cwiseProduct(w.sigma).sum();
    }
  }
  return sums;
}

/// One direction in the space of a case's inputs.
struct Direction {
  Controls controls;
  PropertyVector centre = PropertyVector::Zero(), width = PropertyVector::Zero();
  Vector state;
  Positions shape;
};

PredictionCase moved(PredictionCase c, const Direction& d, double step) {
  if (d.controls.size() > 0) c.controls += step * d.controls;
  c.knowledge.centre += step * d.centre;
  c.knowledge.width += step * d.width;
  if (d.state.size() > 0) c.state += step * d.state;
  if (d.shape.size() > 0) c.shape = std::make_shared<const Positions>(*c.shape + step * d.shape);
  return c;
}

/// Fourth-order central difference over four copies of `cases`, shifted by -2, -1, 1, 2 steps.
constexpr double kSteps[] = {-2.0, -1.0, 1.0, 2.0};
constexpr double kWeights[] = {1.0 / 12.0, -8.0 / 12.0, 8.0 / 12.0, -1.0 / 12.0};

/// Relative error of pullback against central differences of predict, over three random directions.
/// @param direction fills in one direction, in steps of a typical size.
Outcome pullback_error(const Fold& fold, double step,
                       const std::function<Direction(const PredictionCase&, RandomStream&)>& direction) {
  const auto cases = fold.cases();
  const auto weights = smooth_cotangents(fold, cases);
  const auto prediction = fold.predict(cases, fold.all_gradients());
  if (const auto text = failures(*prediction, cases.size()); !text.empty()) return failed(text);
  const auto gradients = pull(*prediction, cases, weights);
  double error = 0.0, size = 0.0;
  RandomStream random(33);
  for (int trial = 0; trial < 3; ++trial) {
    std::vector<Direction> directions;
    for (const auto& c : cases) directions.push_back(direction(c, random));
    std::vector<PredictionCase> all;
    for (double k : kSteps)
      for (std::size_t i = 0; i < cases.size(); ++i) all.push_back(moved(cases[i], directions[i], k * step));
    const Vector values = losses(fold, all, weights);
    for (std::size_t i = 0; i < cases.size(); ++i) {
      double slope = 0.0;
      for (std::size_t k = 0; k < 4; ++k) slope += kWeights[k] * values[k * cases.size() + i] / step;
      const auto& d = directions[i];
      const auto& g = gradients[i];
      double predicted = d.centre.dot(g.centre) + d.width.dot(g.width);
      if (d.controls.size() > 0) {
        predicted += d.controls.cwiseProduct(g.controls).sum();
      }
      if (d.state.size() > 0) {
        require_shape("d state", g.state.size(), d.state.size());
        predicted += d.state.dot(g.state);
      }
      if (d.shape.size() > 0) {
        require_shape("rows of d shape", g.shape.rows(), d.shape.rows());
        predicted += d.shape.cwiseProduct(g.shape).sum();
      }
      error += (predicted - slope) * (predicted - slope);
      size += slope * slope;
    }
  }
  return {std::sqrt(error) / std::max(std::sqrt(size), 1e-9), ""};
}

Outcome refuses_gradients(const Fold& fold) {
  Refusals refusals;
  const auto cases = fold.cases();
  refusals.wants<Unsupported>(
      "pullback()", [&] { fold.predict(cases, {.gradients = true})->pullback(smooth_cotangents(fold, cases)); });
  return refusals.outcome().measured > 0 ? refusals.outcome() : undeclared();
}

// ---------------------------------------------------------------------------------------------------------------------

Outcome pullback_of_controls(const Bench& bench) {
  const Fold fold(bench);
  if (!fold.capabilities.gradients) return refuses_gradients(fold);
  const auto variables = fold.task.trajectory->controls();
  return pullback_error(fold, 0.05, [&](const PredictionCase& c, RandomStream& random) {
    Direction d;
    d.controls.resize(c.controls.rows(), c.controls.cols());
    for (Index j = 0; j < d.controls.rows(); ++j)
      for (Index i = 0; i < d.controls.cols(); ++i) d.controls(j, i) = random.uniform(-1.0, 1.0) * variables[i].scale;
    return d;
  });
}

Outcome pullback_of_centre(const Bench& bench) {
  const Fold fold(bench);
  if (!fold.capabilities.gradients) return refuses_gradients(fold);
  return pullback_error(fold, 0.02, [](const PredictionCase&, RandomStream& random) {
    Direction d;
    for (int p = 0; p < 4; ++p) d.centre[p] = random.uniform(-1.0, 1.0);
    return d;
  });
}

Outcome pullback_of_width(const Bench& bench) {
  const Fold fold(bench);
  if (!fold.capabilities.gradients) return refuses_gradients(fold);
  return pullback_error(fold, 0.02, [](const PredictionCase&, RandomStream& random) {
    Direction d;
    for (int p = 0; p < 4; ++p) d.width[p] = random.uniform(-1.0, 1.0);
    return d;
  });
}

/// An undeclared part of the gradient stays empty even if it is requested. Without gradients pullback() throws
/// Unsupported.
Outcome part_left_out(const Fold& fold, const std::string& what,
                      const std::function<bool(const CaseGradient&)>& empty) {
  if (!fold.capabilities.gradients) return refuses_gradients(fold);
  const auto cases = fold.cases();
  const PredictionRequest request{.gradients = true, .state_gradients = true, .shape_gradients = true};
  for (const auto& g : pull(*fold.predict(cases, request), cases, smooth_cotangents(fold, cases)))
    if (!empty(g)) return failed("not declared, but d " + what + " is not empty");
  return {0.0, "not declared; left out of the gradient"};
}

Outcome pullback_of_state(const Bench& bench) {
  const Fold fold(bench);
  if (!fold.capabilities.state_gradients)
    return part_left_out(fold, "state", [](const CaseGradient& g) { return g.state.size() == 0; });
  const auto variables = fold.task.trajectory->state();
  return pullback_error(fold, 0.005, [&](const PredictionCase& c, RandomStream& random) {
    Direction d;
    d.state = Vector::Zero(c.state.size());
    // Many trajectories have a kink at the start, but none after one segment.
    if (c.previous)
      for (Index i = 0; i < c.state.size(); ++i) d.state[i] = random.uniform(-1.0, 1.0) * variables[i].scale;
    return d;
  });
}

Outcome pullback_of_shape(const Bench& bench) {
  const Fold fold(bench);
  if (!fold.capabilities.shape_gradients)
    return part_left_out(fold, "shape", [](const CaseGradient& g) { return g.shape.rows() == 0; });
  return pullback_error(fold, 0.05, [&](const PredictionCase& c, RandomStream& random) {
    Direction d;
    d.shape.resize(c.shape->rows(), 3);
    const double phase = random.uniform(0.0, 6.0);
    for (Index v = 0; v < d.shape.rows(); ++v)
      for (Index k = 0; k < 3; ++k)
        d.shape(v, k) =
            0.002 * std::sin(phase + 10.0 * (*c.shape)(v, 0) + 7.0 * (*c.shape)(v, 1) + static_cast<double>(k));
    return d;
  });
}

Outcome jvp_matches(const Bench& bench) {
  const Fold fold(bench);
  const auto cases = fold.cases();
  std::vector<std::vector<CaseDirection>> directions(cases.size());
  RandomStream random(34);
  const auto variables = fold.task.trajectory->controls();
  for (std::size_t i = 0; i < cases.size(); ++i) {
    for (std::size_t n = 0; n <= i % 2; ++n) {
      CaseDirection d;
      d.controls.resize(cases[i].controls.rows(), cases[i].controls.cols());
      for (Index j = 0; j < d.controls.rows(); ++j)
        for (Index k = 0; k < d.controls.cols(); ++k) d.controls(j, k) = random.uniform(-1.0, 1.0) * variables[k].scale;
      for (int p = 0; p < 4; ++p) {
        d.centre[p] = random.uniform(-0.5, 0.5);
        d.width[p] = random.uniform(-0.5, 0.5);
      }
      directions[i].push_back(d);
    }
  }
  if (!fold.capabilities.jvp) {
    Refusals refusals;
    const PredictionRequest request{.gradients = fold.capabilities.gradients};
    refusals.wants<Unsupported>("jvp()", [&] { fold.predict(cases, request)->jvp(directions); });
    return refusals.outcome().measured > 0 ? refusals.outcome() : undeclared();
  }
  const auto slopes = fold.predict(cases, {.gradients = true})->jvp(directions);
  require_shape("cases of jvp()", slopes.size(), cases.size());
  double error = 0.0, size = 0.0;
  const double step = 0.03;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    require_shape("directions of jvp()", slopes[i].size(), directions[i].size());
    for (std::size_t n = 0; n < directions[i].size(); ++n) {
      require_shape("shapes of jvp()", slopes[i][n].size(), cases[i].segments.size());
      Direction d;
      d.controls = directions[i][n].controls;
      d.centre = directions[i][n].centre;
      d.width = directions[i][n].width;
      std::vector<PredictionCase> all;
      for (double k : kSteps) all.push_back(moved(cases[i], d, k * step));
      const auto prediction = fold.predict(all);
      if (const auto text = failures(*prediction, all.size()); !text.empty()) return failed(text);
      for (std::size_t s = 0; s < cases[i].segments.size(); ++s) {
        Positions mean = Positions::Zero(fold.vertices(), 3), sigma = mean;
        for (std::size_t k = 0; k < 4; ++k) {
          mean += kWeights[k] / step * prediction->shapes()[k][s].mean;
          sigma += kWeights[k] / step * prediction->shapes()[k][s].sigma;
        }
        const auto& got = slopes[i][n][s];
        require_shape("rows of a jvp's mean", got.mean.rows(), fold.vertices());
        require_shape("rows of a jvp's sigma", got.sigma.rows(), fold.vertices());
        error += (got.mean - mean).squaredNorm() + (got.sigma - sigma).squaredNorm();
        size += mean.squaredNorm() + sigma.squaredNorm();
      }
    }
  }
  return {std::sqrt(error) / std::max(std::sqrt(size), 1e-9), ""};
}

Outcome pullback_is_for_those_who_asked(const Bench& bench) {
  const Fold fold(bench);
  const auto cases = fold.cases();
  const auto weights = smooth_cotangents(fold, cases);
  Refusals refusals;
  refusals.wants<Unsupported>("pullback() of a prediction without gradients",
                              [&] { fold.predict(cases)->pullback(weights); });
  if (!fold.capabilities.gradients) return refusals.outcome();
  // Gradients of controls and knowledge are zero if not requested; those of state and shape are empty. The requested
  // ones do not depend on the others.
  const auto all = pull(*fold.predict(cases, fold.all_gradients()), cases, weights);
  const auto both = pull(*fold.predict(cases, {.gradients = true}), cases, weights);
  const auto knowledge = pull(*fold.predict(cases, {.gradients = true, .control_gradients = false}), cases, weights);
  const auto controls = pull(*fold.predict(cases, {.gradients = true, .knowledge_gradients = false}), cases, weights);
  const auto near = [](const auto& a, const auto& b) { return (a - b).norm() <= 1e-9 * (a.norm() + b.norm()); };
  for (std::size_t i = 0; i < cases.size(); ++i) {
    if (!knowledge[i].controls.isZero(0.0)) refusals.miss("d controls is not zero without a request");
    if (!controls[i].centre.isZero(0.0) || !controls[i].width.isZero(0.0))
      refusals.miss("d knowledge is not zero without a request");
    if (both[i].state.size() > 0) refusals.miss("d state is not empty without a request");
    if (both[i].shape.rows() > 0) refusals.miss("d shape is not empty without a request");
    if (!near(all[i].controls, both[i].controls) || !near(all[i].centre, both[i].centre) ||
        !near(all[i].width, both[i].width))
      refusals.miss("the gradient changes if state and shape are requested too");
    if (!near(controls[i].controls, both[i].controls) || !near(knowledge[i].centre, both[i].centre) ||
        !near(knowledge[i].width, both[i].width))
      refusals.miss("the gradient changes if only one of controls and knowledge is requested");
  }
  return refusals.outcome();
}

Outcome zero_cotangents_may_be_empty(const Bench& bench) {
  const Fold fold(bench);
  if (!fold.capabilities.gradients) return refuses_gradients(fold);
  const auto cases = fold.cases();
  auto weights = smooth_cotangents(fold, cases);
  auto holes = weights;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    for (std::size_t s = 0; s < weights[i].size(); ++s) {
      const bool mean = (i + s) % 2 == 0;
      (mean ? weights[i][s].mean : weights[i][s].sigma).setZero();
      (mean ? holes[i][s].mean : holes[i][s].sigma).resize(0, 3);
    }
  }
  const auto difference = [&](const std::vector<CaseGradient>& a, const std::vector<CaseGradient>& b) {
    double error = 0.0, size = 1e-12;
    for (std::size_t i = 0; i < cases.size(); ++i) {
      error += (a[i].controls - b[i].controls).norm() + (a[i].centre - b[i].centre).norm() +
               (a[i].width - b[i].width).norm();
      size += a[i].controls.norm() + a[i].centre.norm() + a[i].width.norm();
    }
    return error / size;
  };
  const auto prediction = fold.predict(cases, {.gradients = true});
  const double of_holes = difference(pull(*prediction, cases, weights), pull(*prediction, cases, holes));
  // Planning requests means only.
  for (std::size_t i = 0; i < cases.size(); ++i) {
    for (std::size_t s = 0; s < weights[i].size(); ++s) {
      weights[i][s].sigma.setZero();
      holes[i][s] = {weights[i][s].mean, Positions(0, 3)};
    }
  }
  const auto means = fold.predict(cases, {.moments = Moments::mean, .gradients = true});
  const double of_means = difference(pull(*prediction, cases, weights), pull(*means, cases, holes));
  return {of_holes + of_means, ""};
}

/// The number of entries that differ between case i of one prediction and case j of another.
double differing_case(const Prediction& a, std::size_t i, const Prediction& b, std::size_t j) {
  const auto &x = a.shapes().at(i), &y = b.shapes().at(j);
  double wrong = x.size() == y.size() && a.failure(i) == b.failure(j) ? 0.0 : 1.0;
  for (std::size_t s = 0; s < std::min(x.size(), y.size()); ++s)
    wrong += differing(x[s].mean, y[s].mean) + differing(x[s].sigma, y[s].sigma);
  return wrong;
}
double differing_gradient(const CaseGradient& a, const CaseGradient& b) {
  return differing(a.controls, b.controls) + differing(a.centre, b.centre) + differing(a.width, b.width) +
         differing(a.state, b.state) + differing(a.shape, b.shape);
}

/// The predictions of a batch, to compare each case with its prediction in another batch.
struct BatchOfCases {
  explicit BatchOfCases(const Fold& of) : fold(of) {
    if (request.gradients) gradients = pull(*prediction, cases, weights);
  }
  /// The number of entries of case i, in shapes and gradients, that differ if it is `row` of `others`.
  double differing(std::size_t i, const std::vector<PredictionCase>& others, std::size_t row) const {
    const auto other = fold.predict(others, request);
    double wrong = differing_case(*prediction, i, *other, row);
    if (!request.gradients) return wrong;
    auto cotangents = smooth_cotangents(fold, others);
    cotangents[row] = weights[i];
    return wrong + differing_gradient(gradients[i], pull(*other, others, cotangents).at(row));
  }

  const Fold& fold;
  std::vector<PredictionCase> cases = fold.cases();
  std::vector<std::vector<ShapeCotangent>> weights = smooth_cotangents(fold, cases);
  PredictionRequest request = fold.capabilities.gradients ? fold.all_gradients() : PredictionRequest();
  std::unique_ptr<Prediction> prediction = fold.predict(cases, request);
  std::vector<CaseGradient> gradients;
};

Outcome batch_equals_singles(const Bench& bench) {
  const Fold fold(bench);
  if (!fold.capabilities.deterministic) return undeclared_without_call();
  const BatchOfCases batch(fold);
  const auto& cases = batch.cases;
  double wrong = 0.0;
  for (std::size_t i = 0; i < cases.size(); ++i) wrong += batch.differing(i, {cases[i]}, 0);
  const std::vector<PredictionCase> backwards(cases.rbegin(), cases.rend());
  for (std::size_t i = 0; i < cases.size(); ++i) wrong += batch.differing(i, backwards, cases.size() - 1 - i);
  return {wrong, ""};
}

Outcome a_case_does_not_see_the_other_rows(const Bench& bench) {
  const Fold fold(bench);
  const BatchOfCases batch(fold);
  const auto& cases = batch.cases;
  double wrong = 0.0;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    // The other rows hold a case of another length and the padding of a search.
    std::vector<PredictionCase> changed(cases.size(), cases[i]);
    for (std::size_t j = 0; j < cases.size(); ++j)
      if (j != i) changed[j].segments.clear();
    changed[(i + 1) % cases.size()] = fold.ask(1, {1}, 70 + i);
    wrong += batch.differing(i, changed, i);
  }
  return {wrong, ""};
}

Outcome same_input_same_bits(const Bench& bench) {
  const Fold fold(bench), other(bench);
  if (!fold.capabilities.deterministic) return undeclared_without_call();
  const auto cases = fold.cases();
  const auto a = fold.predict(cases), b = fold.predict(cases), c = other.predict(cases);
  double wrong = 0.0;
  for (std::size_t i = 0; i < cases.size(); ++i) wrong += differing_case(*a, i, *b, i) + differing_case(*a, i, *c, i);
  return {wrong, ""};
}

Outcome predictions_live_side_by_side(const Bench& bench) {
  const Fold fold(bench);
  const auto cases = fold.cases();
  const auto weights = smooth_cotangents(fold, cases);
  const bool gradients = fold.capabilities.gradients;
  const PredictionRequest request = gradients ? fold.all_gradients() : PredictionRequest();
  auto first = fold.predict(cases, request);
  std::vector<std::vector<ShapeDistribution>> copy = first->shapes();
  std::vector<CaseGradient> before;
  if (gradients) before = pull(*first, cases, weights);
  // Make and destroy other predictions, and the inputs of them.
  for (int k = 0; k < 2; ++k) {
    std::vector<PredictionCase> others = {fold.ask(1, {1}, 50 + static_cast<std::uint64_t>(k)), fold.ask(2, {2}, 60)};
    const auto other = fold.predict(others, request);
    if (gradients) pull(*other, others, smooth_cotangents(fold, others));
  }
  const auto& now = first->shapes();
  if (now.size() != copy.size()) return failed("the number of cases in the prediction changed");
  double wrong = 0.0;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    if (now[i].size() != copy[i].size()) return failed("the number of shapes in the prediction changed");
    for (std::size_t s = 0; s < copy[i].size(); ++s)
      wrong += differing(copy[i][s].mean, now[i][s].mean) + differing(copy[i][s].sigma, now[i][s].sigma);
  }
  if (gradients && fold.capabilities.deterministic) {
    const auto after = pull(*first, cases, weights);
    for (std::size_t i = 0; i < cases.size(); ++i) wrong += differing_gradient(before[i], after[i]);
  }
  return {wrong, ""};
}

Outcome same_bits_on_two_threads(const Bench& bench) {
  const Fold fold(bench);
  const auto cases = fold.cases();
  std::unique_ptr<Prediction> results[3];
  results[0] = fold.predict(cases);
  on_two_threads([&] { results[1] = fold.predict(cases); }, [&] { results[2] = fold.predict(cases); });
  double wrong = 0.0;
  for (std::size_t i = 0; i < cases.size(); ++i) {
    if (fold.capabilities.deterministic)
      wrong += differing_case(*results[0], i, *results[1], i) + differing_case(*results[0], i, *results[2], i);
    else if (results[1]->shapes().at(i).size() != cases[i].segments.size())
      ++wrong;
  }
  return {wrong, ""};
}

Outcome shapes_are_those_asked_for(const Bench& bench) {
  const Fold fold(bench);
  Refusals wrong;
  const std::vector<PredictionCase> cases = {fold.ask(3, {1, 2, 3}, 1), fold.ask(3, {2}, 1), fold.ask(2, {}, 5),
                                             fold.ask(1, {1}, 6)};
  const auto all = fold.predict(cases),
             means = fold.predict(cases, {.moments = Moments::mean});  // which check the sizes
  for (const Prediction* p : {all.get(), means.get()})
    if (const auto text = failures(*p, cases.size()); !text.empty()) return failed(text);
  // Segment 2 has the same shape whether or not its neighbours are requested, up to float rounding.
  if (fold.capabilities.deterministic) {
    const double gap = (all->shapes()[0][1].mean - all->shapes()[1][0].mean).cwiseAbs().maxCoeff();
    if (!(gap < 1e-5)) wrong.miss("segment 2 moves by " + std::to_string(gap) + " m if it is requested alone");
  }
  return wrong.outcome();
}

Outcome numbers_are_sound(const Bench& bench) {
  const Fold fold(bench);
  auto cases = fold.cases();
  for (const double c : {0.0, 1.0}) {
    for (const double w : {0.0, 1.0}) {
      cases.push_back(fold.ask(2, {1, 2}, 7));
      cases.back().knowledge.centre.setConstant(c);
      cases.back().knowledge.width.setConstant(w);
    }
  }
  double wrong = 0.0;
  const auto count = [&](const auto& array) { wrong += static_cast<double>((!array.array().isFinite()).count()); };
  for (const bool with_gradients : {false, true}) {
    for (const Moments moments : {Moments::mean_and_sigma, Moments::mean}) {
      if (with_gradients && !fold.capabilities.gradients) continue;
      PredictionRequest request = with_gradients ? fold.all_gradients() : PredictionRequest();
      request.moments = moments;
      const auto prediction = fold.predict(cases, request);
      if (const auto text = failures(*prediction, cases.size()); !text.empty()) return failed(text);
      for (const auto& shapes : prediction->shapes()) {
        for (const auto& s : shapes) {
          count(s.mean);
          count(s.sigma);
          wrong += static_cast<double>((s.sigma.array() <= 0.0).count());
        }
      }
      if (!with_gradients || moments == Moments::mean) continue;
      for (const auto& g : pull(*prediction, cases, smooth_cotangents(fold, cases))) {
        count(g.controls);
        count(g.centre);
        count(g.width);
        count(g.state);
        count(g.shape);
      }
    }
  }
  return {wrong, ""};
}

Outcome a_failed_case_costs_only_itself(const Bench& bench) {
  const Fold fold(bench);
  std::vector<PredictionCase> cases = {fold.ask(1, {1}, 1), fold.ask(1, {1}, 1), fold.ask(1, {1}, 2)};
  const auto sound = fold.predict(cases);
  // Finite, but their squares overflow.
  cases[1].shape = std::make_shared<const Positions>(1e200 * (*fold.shape));
  const auto prediction = fold.predict(cases);
  double wrong = 0.0;
  std::string detail;
  if (fold.capabilities.deterministic)
    wrong = differing_case(*sound, 0, *prediction, 0) + differing_case(*sound, 2, *prediction, 2);
  if (wrong > 0) detail = "the other cases changed";
  const auto& shapes = prediction->shapes().at(1);
  if (!prediction->failure(1).empty() && !shapes.empty()) {
    ++wrong;
    detail = "a failed case has shapes";
  }
  for (const auto& s : shapes) {
    if (s.mean.allFinite() && s.sigma.allFinite()) continue;
    ++wrong;
    detail = "non-finite shapes without a recorded failure";
  }
  return {wrong, detail};
}

Outcome binding_comes_first(const Bench& bench) {
  const Fold fold(bench);
  const auto unbound = bench.make<Predictor>();
  Refusals refusals;
  if (!unbound->capabilities().needs_binding) return undeclared_without_call();
  refusals.wants<Error>("predict() before bind()", [&] { unbound->predict({fold.ask(1, {1}, 1)}, {}); });
  return refusals.outcome();
}

Outcome limits_are_sound(const Bench& bench) {
  const Fold fold(bench);
  const auto range = fold.predictor->control_range();
  const auto most = fold.predictor->max_segments();
  if (!range && !most) return undeclared_without_call();
  Refusals wrong;
  if (range) {
    const Index count = fold.task.trajectory->controls().size();
    const auto &low = range->lower, &high = range->upper;
    if (low.size() != count || high.size() != count || !low.allFinite() || !high.allFinite() ||
        (low.array() > high.array()).any())
      wrong.miss("control_range() is not a finite box of " + std::to_string(count) + " controls");
  }
  if (most) {
    if (*most < 1) return failed("max_segments() is " + std::to_string(*most));
    fold.predict({fold.ask(*most, {*most}, 1)});
    wrong.wants<ShapeError>("one segment more than max_segments()",
                            [&] { fold.predict({fold.ask(*most + 1, {1}, 1)}); });
  }
  return wrong.outcome();
}

Outcome refuses_bad_shapes(const Bench& bench) {
  const Fold fold(bench);
  Refusals refusals;
  const auto with = [&](const std::string& what, const std::function<void(PredictionCase&)>& change) {
    std::vector<PredictionCase> cases = {fold.ask(2, {1, 2}, 1), fold.ask(2, {2}, 2)};
    change(cases[1]);
    refusals.wants<ShapeError>(what, [&] { fold.predict(cases); });
  };
  with("a shape with a vertex too few", [&](PredictionCase& c) {
    c.shape = std::make_shared<const Positions>(fold.shape->topRows(fold.vertices() - 1));
  });
  with("no shape", [](PredictionCase& c) { c.shape.reset(); });
  with("a previous shape with a vertex too few", [&](PredictionCase& c) {
    c.previous = std::make_shared<const Positions>(fold.shape->topRows(fold.vertices() - 1));
  });
  with("a state with an entry too many", [](PredictionCase& c) { c.state = Vector::Zero(c.state.size() + 1); });
  with("controls with a column too few",
       [](PredictionCase& c) { c.controls = Controls(c.controls.leftCols(c.controls.cols() - 1)); });
  with("segment 0", [](PredictionCase& c) { c.segments = {0, 1}; });
  with("a segment beyond the last", [](PredictionCase& c) { c.segments = {3}; });
  with("segments that do not ascend", [](PredictionCase& c) { c.segments = {2, 1}; });
  return refusals.outcome();
}

Outcome refuses_nan(const Bench& bench) {
  const Fold fold(bench);
  Refusals refusals;
  const auto with = [&](const std::string& what, const std::function<void(PredictionCase&)>& change) {
    std::vector<PredictionCase> cases = {fold.ask(2, {1, 2}, 1), fold.ask(2, {2}, 2)};
    change(cases[1]);
    refusals.wants<Error>(what, [&] { fold.predict(cases); });
  };
  with("a NaN position", [&](PredictionCase& c) {
    Positions bad = *fold.shape;
    bad(1, 1) = kNaN;
    c.shape = std::make_shared<const Positions>(bad);
  });
  with("a NaN state", [](PredictionCase& c) { c.state[0] = kNaN; });
  with("an infinite control", [](PredictionCase& c) { c.controls(1, 0) = std::numeric_limits<double>::infinity(); });
  with("a NaN centre", [](PredictionCase& c) { c.knowledge.centre[2] = kNaN; });
  with("a NaN width", [](PredictionCase& c) { c.knowledge.width[3] = kNaN; });
  return refusals.outcome();
}

}  // namespace
}  // namespace of_predictors

void probe_predictor(const Bench& bench) {
  using namespace of_predictors;
  const Fold fold(bench);
  fold.predict({fold.ask(1, {1}, 1)});
}

Task predictor_task(const Bench& bench) {
  if (bench.task.has("garment")) {
    TaskParams params;
    read_params(bench.task, params);
    return make_task(params, bench.task, bench.host);
  }
  if (!bench.task.is_null()) bench.task.refuse_unknown_keys({"garment", "simulator", "trajectory"});
  Task task;
  task.garment = towel(6, 0.25);
  task.material = of_predictors::material_space();
  task.simulator = bench.task.find("simulator").value_or(ConfigNode::parse("{plugin: cloth}", "conformance"));
  task.trajectory = bench.host.create<Trajectory>(
      bench.task.find("trajectory").value_or(ConfigNode::parse("{plugin: arc}", "conformance")));
  auto& m = task.manipulation;
  m.grasp_vertices = {task.garment->vertex("near_left"), task.garment->vertex("far_left")};
  m.displacement = {0.18, 0.0};
  m.drop_height = 0.02;
  m.contact_height = 0.002;
  m.grasp_points.resize(2, 3);
  for (Index i = 0; i < 2; ++i) {
    m.grasp_points.row(i) = task.garment->positions.row(m.grasp_vertices[i]);
    m.grasp_points(i, 2) = m.contact_height;
  }
  return task;
}

const std::vector<Law>& predictor_laws() {
  using namespace of_predictors;
  static const std::vector<Law> laws = {
      {"pullback_of_controls", "gradients: d loss / d controls agrees with central differences of predict (relative).",
       0.02, pullback_of_controls},
      {"pullback_of_centre", "gradients: the same for the centre of the material knowledge.", 0.02, pullback_of_centre},
      {"pullback_of_width", "gradients: the same for the width of the material knowledge.", 0.02, pullback_of_width},
      {"pullback_of_state", "state_gradients: the same for the control state, if requested; undeclared: empty.", 0.02,
       pullback_of_state},
      {"pullback_of_shape", "shape_gradients: the same for the start shape, if requested; undeclared: empty.", 0.02,
       pullback_of_shape},
      {"jvp_matches", "jvp: directional derivatives agree with central differences of predict (relative).", 0.02,
       jvp_matches},
      {"pullback_is_for_those_who_asked",
       "pullback() throws Unsupported without a request, and differentiates requested inputs only (violations).", 0,
       pullback_is_for_those_who_asked},
      {"zero_cotangents_may_be_empty",
       "gradients: a cotangent without rows counts as zeros, also if only means were predicted (relative).", 1e-9,
       zero_cotangents_may_be_empty},
      {"batch_equals_singles",
       "deterministic: shapes and gradients of a case do not depend on its batch (numbers that differ).", 0,
       batch_equals_singles},
      {"a_case_does_not_see_the_other_rows",
       "Shapes and gradients of a case do not depend on the contents of the other rows (numbers that differ).", 0,
       a_case_does_not_see_the_other_rows},
      {"same_input_same_bits", "deterministic: same input, same bits, also from a second object (numbers that differ).",
       0, same_input_same_bits},
      {"predictions_live_side_by_side", "A prediction does not change while others are made (numbers that differ).", 0,
       predictions_live_side_by_side},
      {"same_bits_on_two_threads", "predict() on two threads gives the bits of one (numbers that differ).", 0,
       same_bits_on_two_threads},
      {"shapes_are_those_asked_for",
       "The result holds the requested segments and moments only, in order and in size (violations).", 0,
       shapes_are_those_asked_for},
      {"numbers_are_sound",
       "Means, sigmas and gradients are finite and sigma > 0, also at the corners of the knowledge (numbers).", 0,
       numbers_are_sound},
      {"a_failed_case_costs_only_itself",
       "A case whose numbers overflow is recorded as failed and changes no other (numbers).", 0,
       a_failed_case_costs_only_itself},
      {"binding_comes_first", "needs_binding: predict() before bind() is refused (accepted).", 0, binding_comes_first},
      {"limits_are_sound",
       "control_range() is a box of the controls; max_segments() are taken, and one more is refused with ShapeError "
       "(violations).",
       0, limits_are_sound},
      {"refuses_bad_shapes", "Wrong sizes and segments are refused with ShapeError (accepted).", 0, refuses_bad_shapes},
      {"refuses_nan", "Input that is not finite is refused (accepted).", 0, refuses_nan},
  };
  return laws;
}

}  // namespace weft::conformance
