#include "weft/trajectory.hpp"

#include <algorithm>
#include <iterator>

namespace weft {
namespace {

Index count(const std::vector<Variable>& variables) { return variables.size(); }

/// One field of the control variables, repeated to `size` entries.
Vector repeated(const std::vector<Variable>& controls, double Variable::*field, Index size) {
  Vector result(size);
  for (Index i = 0; i < size; ++i) result[i] = controls[i % count(controls)].*field;
  return result;
}

}  // namespace

Vector Trajectory::advance(const Manipulation&, ConstVec state, ConstVec control) const {
  const Index size = count(controls());
  require_shape("trajectory: state", state.size(), size);
  require_shape("trajectory: control", control.size(), size);
  return state + control;
}

void Trajectory::advance_pullback(const Manipulation&, ConstVec state, ConstVec control, ConstVec d_next,
                                  Vector& d_state, Vector& d_control) const {
  const Index size = count(controls());
  require_shape("trajectory: state", state.size(), size);
  require_shape("trajectory: control", control.size(), size);
  require_shape("trajectory: d_next", d_next.size(), size);
  d_state = d_next;
  d_control = d_next;
}

Index Trajectory::decision_size(Index horizon) const {
  if (horizon < 0) throw ShapeError("trajectory: horizon = " + std::to_string(horizon) + ", must be >= 0");
  return count(controls()) * horizon;
}

Controls Trajectory::decode(ConstVec x, Index horizon, ConstVec state) const {
  require_shape("trajectory: x", x.size(), decision_size(horizon));
  check_state("trajectory", *this, state);
  return Eigen::Map<const Controls>(x.data(), horizon, count(controls()));
}

Vector Trajectory::decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const {
  require_shape("trajectory: x", x.size(), decision_size(horizon));
  check_state("trajectory", *this, state);
  require_shape("trajectory: d_controls rows", d_controls.rows(), horizon);
  require_shape("trajectory: d_controls columns", d_controls.cols(), count(controls()));
  return Eigen::Map<const Vector>(d_controls.data(), d_controls.size());
}

Vector Trajectory::encode(const Controls& controls, ConstVec state) const {
  require_shape("trajectory: controls columns", controls.cols(), count(this->controls()));
  check_state("trajectory", *this, state);
  return Eigen::Map<const Vector>(controls.data(), controls.size());
}

Box Trajectory::decision_bounds(Index horizon) const {
  const auto variables = controls();
  const Index size = decision_size(horizon);
  return {repeated(variables, &Variable::lower, size), repeated(variables, &Variable::upper, size)};
}

Vector Trajectory::decision_scale(Index horizon) const {
  return repeated(controls(), &Variable::scale, decision_size(horizon));
}

Controls Trajectory::default_controls(Index horizon) const {
  const auto variables = controls();
  Controls result(horizon, variables.size());
  for (std::size_t c = 0; c < variables.size(); ++c) {
    result.col(c).setConstant(variables[c].default_value);
  }
  return result;
}

std::vector<Index> Trajectory::holding(const Manipulation& manipulation, ConstVec state) const {
  const Vector& opens_at = manipulation.opens_at;
  const double reached = opens_at.size() > 0 ? progress(state) : 0.0;
  std::vector<Index> hands;
  for (Index hand = 0; hand < this->hands(); ++hand)
    if (opens_at.size() == 0 || reached < opens_at[hand]) hands.push_back(hand);
  return hands;
}

SegmentPath Trajectory::segment(const Manipulation& manipulation, ConstVec state, ConstVec control) const {
  SegmentPath path;
  path.end_state = state;
  for (Index frame = 0; frame < kFramesPerSegment; ++frame) {
    path.end_state = advance(manipulation, path.end_state, control);
    path.targets.push_back(targets(manipulation, path.end_state));
  }
  if (manipulation.opens_at.size() == 0 || released(path.end_state)) return path;
  const auto before = holding(manipulation, state), after = holding(manipulation, path.end_state);
  std::set_difference(before.begin(), before.end(), after.begin(), after.end(), std::back_inserter(path.opening));
  return path;
}

Controls Trajectory::segment_states(const Manipulation& manipulation, ConstVec state, const Controls& controls) const {
  Controls states(controls.rows(), state.size());
  Vector current = state;
  for (Index j = 0; j < controls.rows(); ++j) {
    for (Index frame = 0; frame < kFramesPerSegment; ++frame) {
      current = advance(manipulation, current, controls.row(j).transpose());
    }
    states.row(j) = current.transpose();
  }
  return states;
}

Index Trajectory::release_segment(const Manipulation& manipulation, ConstVec state, const Controls& controls) const {
  if (controls.rows() == 0) throw ShapeError("release_segment: controls have 0 rows, must be at least 1");
  const Controls states = segment_states(manipulation, state, controls);
  for (Index j = 0; j < states.rows(); ++j) {
    if (released(states.row(j).transpose())) return j + 1;
  }
  return controls.rows();
}

Vector Trajectory::pullback_states(const Manipulation& manipulation, ConstVec state, const Controls& controls,
                                   const AddStateGradient& add, Controls& d_controls) const {
  if (d_controls.rows() < controls.rows())
    require_shape("pullback_states: d_controls rows", d_controls.rows(), controls.rows());
  require_shape("pullback_states: d_controls columns", d_controls.cols(), controls.cols());
  // The state before every frame, [S, 12 k].
  Matrix before(state.size(), controls.rows() * kFramesPerSegment);
  Vector current = state;
  for (Index frame = 0; frame < before.cols(); ++frame) {
    before.col(frame) = current;
    if (frame + 1 < before.cols())
      current = advance(manipulation, current, controls.row(frame / kFramesPerSegment).transpose());
  }
  Vector d_current = Vector::Zero(state.size()), d_before, d_control;
  for (Index j = controls.rows() - 1; j >= 0; --j) {
    add(j, d_current);
    const Vector control = controls.row(j).transpose();
    for (Index frame = (j + 1) * kFramesPerSegment - 1; frame >= j * kFramesPerSegment; --frame) {
      advance_pullback(manipulation, before.col(frame), control, d_current, d_before, d_control);
      require_shape("pullback_states: d_state of advance_pullback()", d_before.size(), state.size());
      require_shape("pullback_states: d_control of advance_pullback()", d_control.size(), controls.cols());
      d_controls.row(j) += d_control.transpose();
      d_current = d_before;
    }
  }
  return d_current;
}

void check_manipulation(const std::string& who, const Trajectory& trajectory, const Manipulation& manipulation) {
  require_shape(who + ": manipulation.grasp_points rows", manipulation.grasp_points.rows(), trajectory.hands());
  if (!manipulation.grasp_points.allFinite() || !manipulation.displacement.allFinite())
    throw ConfigError(who + ": grasp points and displacement of the manipulation must be finite");
  if (manipulation.opens_at.size() > 0)
    require_shape(who + ": manipulation.opens_at", manipulation.opens_at.size(), trajectory.hands());
}

void check_state(const std::string& who, const Trajectory& trajectory, ConstVec state) {
  require_shape(who + ": state", state.size(), count(trajectory.state()));
}

}  // namespace weft
