#pragma once
#include <memory>
#include <string>
#include <vector>

#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/trajectory.hpp"

namespace weft::spline {

struct Params {
  ConfigNode geometry = ConfigNode::parse("{plugin: arc}", "default");
  std::int64_t control_points = 6;
  std::string over = "progress";

  template <class Visitor>
  void visit(Visitor& v) {
    v("geometry", geometry, PluginSlot{"trajectory"}, "Trajectory whose controls the spline makes.");
    v("control_points", control_points, range(4, 100), "Control points per control variable.");
    v("over", over, choice({"progress", "horizon"}),
      "Parameter of the spline: the progress from the start of the plan to release, or the segments of the horizon.");
  }
};

/// Few, smooth controls: every control variable of another trajectory (the arc) is a uniform cubic B-spline
/// [de Boor 1978] over K control points:
///     m_c(t) = sum_{i=0..3} B_i(s) x_{floor t + i, c},   t in [0, K - 3],   s = t - floor t,
///     B_0 = (1 - s)^3 / 6,  B_1 = (3 s^3 - 6 s^2 + 4) / 6,  B_2 = (-3 s^3 + 3 s^2 + 3 s + 1) / 6,  B_3 = s^3 / 6.
/// Segment j takes its controls at
///     over progress:  t_j = (K - 3) (p_j - p_0) / (1 - p_0), p_j the progress at the start of the segment, at most 1;
///     over horizon:   t_j = (K - 3) j / (horizon - 1).
/// Geometry, controls, state and release are the other trajectory's, so a predictor trained for it serves this one.
/// A B-spline stays within its control points: a box of control bounds decodes into the control bounds.
///
/// Over progress, decode() is a recursion, because the pace decides how far the spline has come. decode_pullback() runs
/// it backwards. The other trajectory's advance() must then not depend on the manipulation, which decode() does not
/// know. encode() is the linear least squares fit at the progress of the given controls. Segments that start after
/// release hardly count. The fit is exact for controls that decode() made. Of equally good fits it is the one nearest
/// the mean.
class Spline final : public Trajectory {
 public:
  Spline(const Params& params, Host& host);

  std::vector<Variable> controls() const override { return geometry_->controls(); }
  std::vector<Variable> state() const override { return geometry_->state(); }
  Index hands() const override { return geometry_->hands(); }
  Vector initial_state(const Manipulation& m) const override { return geometry_->initial_state(m); }
  Vector advance(const Manipulation& m, ConstVec state, ConstVec control) const override {
    return geometry_->advance(m, state, control);
  }
  Positions targets(const Manipulation& m, ConstVec state) const override { return geometry_->targets(m, state); }
  void advance_pullback(const Manipulation& m, ConstVec state, ConstVec control, ConstVec d_next, Vector& d_state,
                        Vector& d_control) const override {
    geometry_->advance_pullback(m, state, control, d_next, d_state, d_control);
  }
  Vector targets_pullback(const Manipulation& m, ConstVec state, const Positions& d_targets) const override {
    return geometry_->targets_pullback(m, state, d_targets);
  }
  double progress(ConstVec state) const override { return geometry_->progress(state); }

  Index decision_size(Index horizon) const override;
  Controls decode(ConstVec x, Index horizon, ConstVec state) const override;
  Vector decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const override;
  Vector encode(const Controls& controls, ConstVec state) const override;

 private:
  struct Place;
  Place place(double t) const;
  /// t_j of segment j of `horizon`. @param progress at the start of the segment; @param first at that of the plan.
  double parameter(Index j, Index horizon, double progress, double first) const;
  /// State after a segment.
  Vector after(ConstVec state, ConstVec control) const;
  double parameter_of_progress(double progress, double first) const;

  std::shared_ptr<const Trajectory> geometry_;
  Index points_;   // K
  Index columns_;  // C
  bool by_progress_;
};

}  // namespace weft::spline
