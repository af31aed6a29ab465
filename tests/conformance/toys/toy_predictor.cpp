#include <cmath>
#include <limits>
#include <mutex>

#include "toy.hpp"
#include "weft/plugin.hpp"
#include "weft/predictor.hpp"

namespace weft::toy {
namespace {

using Shapes = std::vector<std::vector<ShapeDistribution>>;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// What every vertex does, as closed formulas of
///     D = 0.1 (sum over segments and controls of control / scale + sum of state / scale)
///     mean = shape + 0.05 (sin(D + p) - sin(p)) M,     M = 1 + sum over properties of a_q centre_q + b_q width_q
///     sigma = 0.002 exp(0.3 sin(D + p) + 0.05 sum of centre + 0.125 sum of width)
/// with a phase p per vertex and axis and weights a, b per axis.
struct Formula {
  double phase(Index v, Index k) const { return 0.3 * static_cast<double>(v) + 0.9 * static_cast<double>(k); }
  double a(int q, Index k) const { return 0.3 * std::cos(static_cast<double>(q) + static_cast<double>(k)); }
  double b(int q, Index k) const { return 0.2 * std::sin(1.0 + static_cast<double>(q) - static_cast<double>(k)); }
  double drive(const PredictionCase& c, Index segments) const {
    double sum = c.state.cwiseQuotient(state_scale).sum();
    for (Index j = 0; j < segments; ++j) sum += c.controls.row(j).transpose().cwiseQuotient(control_scale).sum();
    return 0.1 * sum;
  }
  Vector control_scale, state_scale;
};

struct Partials {
  double d_drive_mean, d_drive_sigma;
  PropertyVector d_centre_mean, d_width_mean;
  double d_centre_sigma, d_width_sigma;  // the same for every property
};

Partials partials(const Formula& f, const PredictionCase& c, double drive, Index v, Index k, double sigma) {
  const double p = f.phase(v, k), s = 0.05 * (std::sin(drive + p) - std::sin(p));
  Partials d;
  double m = 1.0;
  for (int q = 0; q < 4; ++q) {
    m += f.a(q, k) * c.knowledge.centre[q] + f.b(q, k) * c.knowledge.width[q];
    d.d_centre_mean[q] = s * f.a(q, k);
    d.d_width_mean[q] = s * f.b(q, k);
  }
  d.d_drive_mean = 0.05 * std::cos(drive + p) * m;
  d.d_drive_sigma = sigma * 0.3 * std::cos(drive + p);
  d.d_centre_sigma = 0.05 * sigma;
  d.d_width_sigma = 0.125 * sigma;
  return d;
}

ShapeDistribution evaluate(const Formula& f, const PredictionCase& c, Index segments) {
  const double drive = f.drive(c, segments);
  ShapeDistribution shape{*c.shape, Positions(c.shape->rows(), 3)};
  for (Index v = 0; v < shape.mean.rows(); ++v) {
    for (Index k = 0; k < 3; ++k) {
      const double p = f.phase(v, k);
      double m = 1.0;
      for (int q = 0; q < 4; ++q) m += f.a(q, k) * c.knowledge.centre[q] + f.b(q, k) * c.knowledge.width[q];
      shape.mean(v, k) += 0.05 * (std::sin(drive + p) - std::sin(p)) * m;
      shape.sigma(v, k) = 0.002 * std::exp(0.3 * std::sin(drive + p) + 0.05 * c.knowledge.centre.sum() +
                                           0.125 * c.knowledge.width.sum());
    }
  }
  return shape;
}

class ToyPrediction final : public PlainPrediction {
 public:
  ToyPrediction(const Params& params, Formula formula, std::vector<PredictionCase> cases,
                const PredictionRequest& request, Shapes shapes)
      : PlainPrediction(cases.size()), p_(params), f_(std::move(formula)), cases_(std::move(cases)), request_(request) {
    shapes_ = std::move(shapes);
  }

  const Shapes& shapes() const override { return shared ? *shared : shapes_; }

  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    if (!p_.declare && !p_.accept) throw Unsupported("toy: no gradients");
    if (!request_.gradients && !is("pullback_is_for_those_who_asked"))
      throw Unsupported("toy: gradients were not asked for");
    std::vector<CaseGradient> all;
    for (std::size_t i = 0; i < cases_.size(); ++i) {
      const auto& c = cases_[i];
      CaseGradient g;
      g.controls = Controls::Zero(c.controls.rows(), c.controls.cols());
      g.state = Vector::Zero(c.state.size());
      g.shape = Positions::Zero(c.shape->rows(), 3);
      for (std::size_t s = 0; s < c.segments.size(); ++s) {
        Positions wm = cotangents.at(i).at(s).mean, ws = cotangents.at(i).at(s).sigma;
        const double empty = is("zero_cotangents_may_be_empty") ? 1.0 : 0.0;
        if (wm.rows() == 0) wm = Positions::Constant(c.shape->rows(), 3, empty);
        if (ws.rows() == 0) ws = Positions::Constant(c.shape->rows(), 3, empty);
        const auto at = evaluate(f_, c, c.segments[s]);
        const double drive = f_.drive(c, c.segments[s]);
        double d_drive = 0.0;
        for (Index v = 0; v < c.shape->rows(); ++v) {
          for (Index k = 0; k < 3; ++k) {
            const auto d = partials(f_, c, drive, v, k, at.sigma(v, k));
            d_drive += d.d_drive_mean * wm(v, k) + d.d_drive_sigma * ws(v, k);
            g.centre += wm(v, k) * d.d_centre_mean;
            g.width += wm(v, k) * d.d_width_mean;
            g.centre.array() += ws(v, k) * d.d_centre_sigma;
            g.width.array() += ws(v, k) * d.d_width_sigma;
          }
        }
        for (Index j = 0; j < c.segments[s]; ++j)
          g.controls.row(j) += 0.1 * d_drive * f_.control_scale.cwiseInverse().transpose();
        g.state += 0.1 * d_drive * f_.state_scale.cwiseInverse();
        g.shape += wm;
      }
      if (is("pullback_of_controls")) g.controls *= 1.1;
      if (is("pullback_of_centre")) g.centre *= 1.1;
      if (is("pullback_of_width")) g.width *= -1.0;
      if (is("pullback_of_state")) g.state *= 1.1;
      if (is("pullback_of_shape")) g.shape.setZero();
      if (!request_.state_gradients && !is("state_nobody_asked_for")) g.state.resize(0);
      if (!request_.shape_gradients && !is("shape_nobody_asked_for")) g.shape.resize(0, 3);
      if (!request_.control_gradients) g.controls.setZero();
      if (!request_.knowledge_gradients) {
        g.centre.setZero();
        g.width.setZero();
      }
      all.push_back(std::move(g));
    }
    return broken(std::move(all));
  }

  std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const override {
    if (!p_.declare && !p_.accept) return PlainPrediction::jvp(directions);
    std::vector<std::vector<std::vector<ShapeCotangent>>> all(cases_.size());
    for (std::size_t i = 0; i < cases_.size(); ++i) {
      const auto& c = cases_[i];
      for (const auto& direction : directions.at(i)) {
        all[i].emplace_back();
        for (const Index segment : c.segments) {
          const auto at = evaluate(f_, c, segment);
          const double drive = f_.drive(c, segment);
          double d_drive = 0.0;
          for (Index j = 0; j < segment; ++j)
            d_drive += 0.1 * direction.controls.row(j).transpose().cwiseQuotient(f_.control_scale).sum();
          if (is("jvp_matches")) d_drive *= 1.1;
          ShapeCotangent out{Positions(c.shape->rows(), 3), Positions(c.shape->rows(), 3)};
          for (Index v = 0; v < c.shape->rows(); ++v) {
            for (Index k = 0; k < 3; ++k) {
              const auto d = partials(f_, c, drive, v, k, at.sigma(v, k));
              out.mean(v, k) = d.d_drive_mean * d_drive + d.d_centre_mean.dot(direction.centre) +
                               d.d_width_mean.dot(direction.width);
              out.sigma(v, k) = d.d_drive_sigma * d_drive + d.d_centre_sigma * direction.centre.sum() +
                                d.d_width_sigma * direction.width.sum();
            }
          }
          if (is("short_jvp")) out.sigma = out.sigma.topRows(1).eval();
          if (is("nan_jvp")) out.mean(0, 0) = kNaN;
          out = {spoilt(p_, "jvp_mean", out.mean), spoilt(p_, "jvp_sigma", out.sigma)};
          all[i].back().push_back(std::move(out));
        }
        if (is("jvp_without_shapes")) all[i].back().clear();
      }
      if (is("jvp_of_one_direction")) all[i].resize(1);
    }
    if (is("jvp_of_one_case")) all.resize(1);
    return all;
  }

  std::shared_ptr<Shapes> shared;  // a mutant's: other predictions overwrite it

 private:
  bool is(const char* mutation) const { return p_.mutation == mutation; }
  /// Mistakes of authors: entries not filled in, and divisions by zero.
  std::vector<CaseGradient> broken(std::vector<CaseGradient> all) const {
    for (auto& g : all) {
      if (is("no_d_controls")) g.controls.resize(0, 0);
      if (is("one_d_control")) g.controls = Controls::Zero(1, 1);
      if (is("nan_d_controls")) g.controls(0, 0) = kNaN;
      if (is("nan_d_centre")) g.centre[2] = kNaN;
      if (is("nan_d_width")) g.width[3] = kNaN;
      if (is("short_d_state")) g.state = Vector::Zero(1);
      if (is("nan_d_state") && g.state.size() > 0) g.state[0] = kNaN;
      if (is("short_d_shape")) g.shape = Positions::Zero(1, 3);
      if (is("nan_d_shape") && g.shape.rows() > 0) g.shape(0, 0) = kNaN;
      // Only the requests of planning.
      if (is("nan_d_controls_of_means") && request_.moments == Moments::mean) g.controls(0, 0) = kNaN;
    }
    for (auto& g : all) {
      g.controls = spoilt(p_, "d_controls", g.controls);
      if (g.state.size() > 0) g.state = spoilt(p_, "d_state", g.state);
      if (g.shape.size() > 0) g.shape = spoilt(p_, "d_shape", g.shape);
      if (spoils(p_, "nan", "d_centre")) g.centre.setConstant(kNaN);
      if (spoils(p_, "nan", "d_width")) g.width.setConstant(kNaN);
    }
    if (is("gradient_of_one_case")) all.resize(1);
    if (spoils(p_, "empty", "gradients")) all.clear();
    return all;
  }
  Params p_;
  Formula f_;
  std::vector<PredictionCase> cases_;
  PredictionRequest request_;
};

}  // namespace

/// Closed formulas with derivatives by hand.
class ToyPredictor final : public Predictor {
 public:
  explicit ToyPredictor(const Params& params) : p_(params) {}

  PredictorCapabilities capabilities() const override {
    PredictorCapabilities c;
    c.gradients = c.state_gradients = c.shape_gradients = c.jvp = p_.declare;
    return c;
  }
  void bind(const Task& task) override {
    task_ = task;
    const auto scales = [](const std::vector<Variable>& variables) {
      Vector s(static_cast<Index>(variables.size()));
      for (Index i = 0; i < s.size(); ++i) s[i] = variables[static_cast<std::size_t>(i)].scale;
      return s;
    };
    const auto controls = task.trajectory->controls();
    f_.control_scale = scales(controls);
    range_ = {Vector(f_.control_scale.size()), Vector(f_.control_scale.size())};
    for (Index i = 0; i < f_.control_scale.size(); ++i) {
      range_.lower[i] = controls[static_cast<std::size_t>(i)].lower;
      range_.upper[i] = controls[static_cast<std::size_t>(i)].upper;
    }
    f_.state_scale = scales(task.trajectory->state());
  }

  std::optional<Box> control_range() const override {
    if (!p_.declare) return std::nullopt;
    return Box{spoilt(p_, "control_range", range_.lower), spoilt(p_, "control_range", range_.upper)};
  }
  std::optional<Index> max_segments() const override {
    return p_.declare ? std::optional(kMostSegments) : std::nullopt;
  }

  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request) const override {
    if (!task_.garment && is("binding_comes_first"))
      return std::make_unique<ToyPrediction>(p_, f_, cases, request, Shapes());
    check(cases);
    misbehave(p_);
    Shapes shapes;
    for (const auto& c : cases) {
      if (is("a_failed_case_costs_only_itself") && c.shape->cwiseAbs().maxCoeff() > 1e100)
        throw Diverged("toy: too far");
      shapes.emplace_back();
      std::vector<Index> wanted = c.segments;
      if (is("shapes_are_those_asked_for")) wanted = {1};
      for (const Index segment : wanted) {
        auto shape = evaluate(f_, c, segment);
        if (is("numbers_are_sound") && c.knowledge.width.isZero(0.0)) shape.sigma.setZero();
        if (is("batch_equals_singles")) shape.mean.array() += 1e-12 * static_cast<double>(cases.size());
        if (is("a_case_does_not_see_the_other_rows")) shape.mean.array() += 1e-12 * cases.back().controls.sum();
        if (is("same_input_same_bits")) shape.mean.array() += 1e-12 * object_ordinal();
        if (is("same_bits_on_two_threads")) shape.mean.array() += 1e-12 * thread_ordinal();
        if (request.moments == Moments::mean) shape.sigma.resize(0, 3);
        if (is("a_vertex_short")) shape.mean = shape.mean.topRows(shape.mean.rows() - 1).eval();
        if (is("nan_mean")) shape.mean(0, 0) = kNaN;
        if (is("nan_mean_of_means") && request.moments == Moments::mean && c.segments.size() > 1)
          shape.mean(0, 0) = kNaN;
        if (is("nan_sigma") && shape.sigma.rows() > 0) shape.sigma(0, 0) = kNaN;
        shape.mean = spoilt(p_, "mean", shape.mean);
        if (shape.sigma.rows() > 0) shape.sigma = spoilt(p_, "sigma", shape.sigma);
        shapes.back().push_back(std::move(shape));
      }
    }
    if (is("null_prediction")) return nullptr;
    if (is("one_result")) shapes.resize(1);
    if (is("missing_shapes")) shapes.back().clear();
    if (spoils(p_, "empty", "shapes")) shapes.clear();
    if (spoils(p_, "long", "shapes")) shapes.emplace_back();
    auto prediction = std::make_unique<ToyPrediction>(p_, f_, cases, request, std::move(shapes));
    if (is("predictions_live_side_by_side")) {
      const std::lock_guard lock(mutex_);
      *last_ = prediction->shapes();
      prediction->shared = last_;
    }
    return prediction;
  }

 private:
  static constexpr Index kMostSegments = 5;
  bool is(const char* mutation) const { return p_.mutation == mutation; }
  /// A mutant skips the checks that should refuse its input.
  void check(std::vector<PredictionCase> cases) const {
    for (auto& c : cases) {
      if (is("refuses_bad_shapes")) c.previous.reset();
      if (is("refuses_nan")) c.knowledge.width.setZero();
    }
    check_cases("toy", task_, cases, is("limits_are_sound") ? std::nullopt : max_segments());
  }

  Params p_;
  Formula f_;
  Box range_;
  Task task_;
  mutable std::mutex mutex_;
  std::shared_ptr<Shapes> last_ = std::make_shared<Shapes>();
};

}  // namespace weft::toy

WEFT_PLUGIN(weft::Predictor, weft::toy::ToyPredictor, weft::toy::Params, "toy_predictor", "1.0.0")
