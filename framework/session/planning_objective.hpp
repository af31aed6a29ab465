#pragma once
#include <optional>
#include <vector>

#include "session/planner.hpp"
#include "simulation/hand_limits.hpp"

namespace weft {

/// Eq. 4 on a batch of decision vectors: the loss of planning. With PlanRequest::release the release segment u is fixed,
/// and a penalty keeps it there: the cloth must be released in segment u and not before. With Task::hands a penalty
/// (limit_residuals) keeps the controls within the limits, and those that are not are made so (within_limits): shapes,
/// release and activity are those of the limited controls.
class PlanningObjective final : public Objective {
 public:
  /// All arguments must live as long as the objective. @param weights [V]. @param host whose threads find the nearest
  /// points of a goal without correspondence; null: this one.
  PlanningObjective(const Task& task, const Predictor& predictor, const PlannerParams& params, const Vector& weights,
                    const PlanRequest& request, Index horizon, Host* host = nullptr);

  Index dim() const override { return task_.trajectory->decision_size(horizon_); }
  /// Residuals: 3 V of the shape, with `loss: expected` also 3 V of sigma, then those of the activity loss, then, where
  /// the release segment is fixed, two of its penalty, then, where the hands have limits, those of theirs. Cost = 1/2 |r|^2 up to rounding. With PlanRequest::surface those of
  /// the shape are GoalSurface's; a silhouette has none.
  ObjectiveCapabilities capabilities() const override;
  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& wanted) override;

  /// The case of one decision vector. It requests only the shape after the release segment u (eq. 5).
  PredictionCase make_case(ConstVec x) const;
  /// Controls of a decision vector, [horizon, C], clamped to the predictor's control range, within the hands' limits.
  Controls decode(ConstVec x) const;
  /// Whether they keep the limits in the first frame (LimitedControls::kept).
  bool keeps_limits(ConstVec x) const;
  /// The loss if the plan ended in this shape, the penalty of the hands' limits included. @param shape [V, 3] m. @param u its
  /// release segment.
  double loss_of(const Positions& shape, ConstVec x, Index u) const;
  Index evaluations() const { return evaluations_; }

 private:
  /// The part of the loss that a shape makes.
  struct ShapeTerm {
    double loss = 0.0, sigma_loss = 0.0;
    Positions d_mean, d_sigma;  // gradients
    GoalPairs pairs;            // with a surface
    Vector residuals;
  };
  ShapeTerm shape_term(const Positions& mean, const Positions* sigma, bool with_gradient) const;
  /// The penalty's residuals, [2] or [0]. @param gradients null, or set to their gradients with respect to the controls.
  Vector release_residuals(const Controls& controls, std::vector<Controls>* gradients) const;
  void limit_gradient(ConstVec x, Controls& gradient) const;
  /// The controls of a decision vector, [horizon, C]: before the limits of the hands, and within them.
  struct Decoded {
    Controls wanted;
    LimitedControls limited;  // without limits its controls alone
  };
  Decoded decoded(ConstVec x) const;
  PredictionCase case_of(const Controls& controls) const;
  /// dL/d Decoded::wanted from dL/d Decoded::limited. Where a row was moved to keep the workspace, it counts as if it had
  /// not been.
  Controls unlimited_gradient(const Decoded& point, const Controls& gradient) const;
  /// The penalty's residuals, [4 horizon] or [0]. @param gradients as in limit_residuals(), of Decoded::wanted.
  Vector hand_residuals(const Decoded& point, std::vector<Controls>* gradients) const;
  bool has_limits() const { return task_.hands.any(); }
  Index shape_rows() const {
    const Index coordinates = 3 * task_.garment->vertex_count();
    if (request_.surface) return request_.surface->residual_count();
    return (moments_ == Moments::mean ? 1 : 2) * coordinates;
  }
  /// The residuals of a shape, [shape_rows()]; or their change with a change of it, the nearest points fixed.
  Vector shape_residuals(const Positions& mean, const Positions* sigma, const ShapeTerm& term, bool is_change) const;
  bool uses_jvp(const EvaluationRequest& wanted) const { return wanted.jacobians && predictor_.capabilities().jvp; }
  void add_residuals(ConstMatrix x, const std::vector<Decoded>& points, const std::vector<PredictionCase>& cases,
                     const Prediction& prediction, const std::vector<ShapeTerm>& terms, bool with_jacobians,
                     Evaluation& result);
  Matrix decoding(ConstVec x, const Decoded& point, Index u) const;

  const Task& task_;
  const Predictor& predictor_;
  const PlannerParams& params_;
  const Vector& weights_;
  const PlanRequest& request_;
  Index horizon_;
  Moments moments_;
  std::optional<Box> range_;  // [C]
  Host* host_;
  Index evaluations_ = 0;
};

/// L_act of eq. 4 prefers smooth trajectories that progress. It is the mean over the segments up to u of
///     sum_c ((m_{j+1,c} - m_{j,c}) / scale_c)^2  +  slowness_weight max(0, 1 - b (p_j - p_{j-1}))^2,
/// where p is the trajectory's progress. The second term is zero at a pace that reaches release within b segments.
/// The paper states the purpose of this loss but not its form; this form is ours.
double activity_loss(const Task& task, ConstVec state, const Controls& controls, Index u, double slowness_weight,
                     Controls* gradient);
/// The same as a sum of squares: L_act = |r|^2, r [(k-1) C + k] for k rows of controls; entries beyond u are zero.
/// @param jacobian null, or set to dr / d controls row by row, [r, k C].
Vector activity_residuals(const Task& task, ConstVec state, const Controls& controls, Index u, double slowness_weight,
                          Matrix* jacobian);

}  // namespace weft
