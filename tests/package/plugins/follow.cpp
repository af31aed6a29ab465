#include <algorithm>
#include <cmath>

#include "weft/plugin.hpp"
#include "weft/predictor.hpp"

namespace follow {

struct Params {
  double radius_m = 0.2;
  double noise_m = 0.01;
  double spread_m = 0.02;
  template <class Visitor>
  void visit(Visitor& v) {
    v("radius_m", radius_m, weft::range(0.01, 10.0, "m"), "How far a hand takes the cloth along, at medium bending.");
    v("noise_m", noise_m, weft::range(1e-6, 1.0, "m"), "Standard deviation when the fabric is known.");
    v("spread_m", spread_m, weft::range(0.0, 1.0, "m"), "What knowing nothing of the fabric adds to it.");
  }
};

using namespace weft;

/// The simplest predictor with every gradient: cloth near a hand follows it, by a weight that falls with the distance
/// in the rest shape, and stiffer cloth follows from further away.
///     mean_v = x_v + sum_i w_vi (g_i(after) - g_i(start)),   w_vi = exp(-r_vi^2 / (2 rho^2)),
///     rho = radius (1/2 + bend centre),   sigma_v = noise + spread * mean(width)
/// It knows no gravity and no contact: a baseline, not a model of cloth.
class Follow final : public Predictor {
 public:
  explicit Follow(const Params& params) : p_(params) {}

  PredictorCapabilities capabilities() const override {
    return {.gradients = true, .state_gradients = true, .shape_gradients = true};
  }

  void bind(const Task& task) override {
    const auto& vertices = task.manipulation.grasp_vertices;
    const auto& rest = task.garment->rest;
    Matrix squares(rest.rows(), static_cast<Index>(vertices.size()));
    for (Index i = 0; i < squares.cols(); ++i) {
      squares.col(i) = (rest.rowwise() - rest.row(vertices[static_cast<std::size_t>(i)])).rowwise().squaredNorm();
    }
    task_ = task;
    squares_ = std::move(squares);
  }

  std::unique_ptr<weft::Prediction> predict(const std::vector<PredictionCase>& cases,
                                            const PredictionRequest& request) const override {
    if (!task_.trajectory) throw Error("follow: predict() before bind()");
    for (const auto& c : cases) check(c);
    return std::make_unique<Prediction>(*this, cases, request);
  }

 private:
  static constexpr Index kBend = 1;

  /// Copies what its pullback needs, so that it can outlive the cases.
  class Prediction final : public weft::Prediction {
   public:
    Prediction(const Follow& model, const std::vector<PredictionCase>& cases, const PredictionRequest& request)
        : p_(model.p_), task_(model.task_), squares_(model.squares_), cases_(cases), request_(request) {
      for (const auto& c : cases_) {
        const Matrix w = weights(c);
        const Positions start = hands(c.state);
        const Controls states = task_.trajectory->segment_states(task_.manipulation, c.state, c.controls);
        shapes_.emplace_back();
        for (const Index segment : c.segments) {
          ShapeDistribution shape;
          shape.mean = *c.shape + w * (hands(states.row(segment - 1).transpose()) - start);
          if (request.moments == Moments::mean_and_sigma) {
            shape.sigma = Positions::Constant(squares_.rows(), 3, p_.noise_m + p_.spread_m * c.knowledge.width.mean());
          }
          shapes_.back().push_back(std::move(shape));
        }
      }
    }

    const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return shapes_; }
    const std::string& failure(std::size_t) const override { return no_failure_; }

    std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
      if (!request_.gradients) throw Unsupported("follow: pullback() of a prediction made without gradients");
      require_shape("follow: cotangents", static_cast<std::ptrdiff_t>(cotangents.size()),
                    static_cast<std::ptrdiff_t>(cases_.size()));
      std::vector<CaseGradient> gradients;
      for (std::size_t i = 0; i < cases_.size(); ++i) gradients.push_back(pullback_case(cases_[i], cotangents[i]));
      return gradients;
    }

   private:
    double rho(const PredictionCase& c) const { return p_.radius_m * (0.5 + c.knowledge.centre[kBend]); }
    Matrix weights(const PredictionCase& c) const { return (-squares_ / (2.0 * rho(c) * rho(c))).array().exp(); }
    Positions hands(const Vector& state) const { return task_.trajectory->targets(task_.manipulation, state); }

    CaseGradient pullback_case(const PredictionCase& c, const std::vector<ShapeCotangent>& cotangents) const {
      require_shape("follow: cotangents of a case", static_cast<std::ptrdiff_t>(cotangents.size()),
                    static_cast<std::ptrdiff_t>(c.segments.size()));
      const auto& trajectory = *task_.trajectory;
      const auto& m = task_.manipulation;
      CaseGradient g;
      g.controls = Controls::Zero(c.controls.rows(), c.controls.cols());
      g.state = Vector::Zero(c.state.size());
      g.shape = Positions::Zero(squares_.rows(), 3);

      const Matrix w = weights(c);
      const Positions start = hands(c.state);
      // States after every frame; d_frames: dL/d of them through the targets alone.
      std::vector<Vector> states = {c.state};
      for (Index j = 0; j < c.controls.rows(); ++j) {
        for (Index k = 0; k < kFramesPerSegment; ++k) {
          states.push_back(trajectory.advance(m, states.back(), c.controls.row(j).transpose()));
        }
      }
      std::vector<Vector> d_frames(states.size(), Vector::Zero(c.state.size()));
      for (std::size_t s = 0; s < cotangents.size(); ++s) {
        if (cotangents[s].sigma.rows() > 0) g.width.array() += p_.spread_m / 4.0 * cotangents[s].sigma.sum();
        const Positions& d_mean = cotangents[s].mean;
        if (d_mean.rows() == 0) continue;
        g.shape += d_mean;
        const auto frame = static_cast<std::size_t>(c.segments[s] * kFramesPerSegment);
        const Positions d_hands = w.transpose() * d_mean;
        d_frames[frame] += trajectory.targets_pullback(m, states[frame], d_hands);
        d_frames[0] -= trajectory.targets_pullback(m, states[0], d_hands);
        // dL/dw_vi = d_mean_v . (hand i's way);  dw/drho = w r^2 / rho^3;  drho/dcentre = radius
        const Matrix d_w = d_mean * (hands(states[frame]) - start).transpose();
        g.centre[kBend] += p_.radius_m / std::pow(rho(c), 3) * d_w.cwiseProduct(w).cwiseProduct(squares_).sum();
      }
      // The chain of advance(), backwards.
      Vector carried = Vector::Zero(c.state.size()), d_state, d_control;
      for (std::size_t frame = states.size() - 1; frame > 0; --frame) {
        const Index j = static_cast<Index>(frame - 1) / kFramesPerSegment;
        carried += d_frames[frame];
        trajectory.advance_pullback(m, states[frame - 1], c.controls.row(j).transpose(), carried, d_state, d_control);
        g.controls.row(j) += d_control.transpose();
        carried = d_state;
      }
      g.state = carried + d_frames[0];
      if (!request_.control_gradients) g.controls.setZero();
      if (!request_.knowledge_gradients) {
        g.centre.setZero();
        g.width.setZero();
      }
      return g;
    }

    Params p_;
    Task task_;
    Matrix squares_;
    std::vector<PredictionCase> cases_;
    PredictionRequest request_;
    std::vector<std::vector<ShapeDistribution>> shapes_;
    std::string no_failure_;
  };

  void check(const PredictionCase& c) const {
    const Index vertices = squares_.rows();
    require_shape("follow: shape rows", c.shape ? c.shape->rows() : 0, vertices);
    if (c.previous) require_shape("follow: previous rows", c.previous->rows(), vertices);
    require_shape("follow: state", c.state.size(), static_cast<std::ptrdiff_t>(task_.trajectory->state().size()));
    require_shape("follow: controls columns", c.controls.cols(),
                  static_cast<std::ptrdiff_t>(task_.trajectory->controls().size()));
    Index before = 0;
    for (const Index segment : c.segments) {
      if (segment <= before || segment > c.controls.rows()) {
        throw ShapeError("follow: segment " + std::to_string(segment) + ", must ascend within [1, " +
                         std::to_string(c.controls.rows()) + "]");
      }
      before = segment;
    }
    if (!c.shape->allFinite() || (c.previous && !c.previous->allFinite()) || !c.state.allFinite() ||
        !c.controls.allFinite() || !c.knowledge.centre.allFinite() || !c.knowledge.width.allFinite()) {
      throw Error("follow: shapes, state, controls and knowledge must be finite");
    }
  }

  Params p_;
  Task task_;
  Matrix squares_;  // [V, hands] m^2: distances in the rest shape
};

}  // namespace follow

WEFT_PLUGIN(weft::Predictor, follow::Follow, follow::Params, "follow", "1.0.0")
