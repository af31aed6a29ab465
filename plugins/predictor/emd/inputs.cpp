#include "inputs.hpp"

#include <algorithm>

namespace weft::emd {

void write_inputs(const Dimensions& d, const double* control, const double* state_before, const double* state_after,
                  const double* targets_before, const double* targets_after, bool released,
                  const PropertyVector& centre, const PropertyVector& width, double* to) {
  to = std::copy_n(control, d.controls, to);
  to = std::copy_n(state_before, d.states, to);
  to = std::copy_n(state_after, d.states, to);
  to = std::copy_n(targets_before, 3 * d.hands, to);
  to = std::copy_n(targets_after, 3 * d.hands, to);
  *to++ = released ? 1.0 : 0.0;
  to = std::copy_n(centre.data(), 4, to);
  std::copy_n(width.data(), 4, to);
}

CaseInputs::CaseInputs(const Task& task, const Dimensions& dimensions, const PredictionCase& one, Index steps)
    : task_(task), dim_(dimensions), controls_(one.controls.topRows(steps)), knowledge_(one.knowledge) {
  const auto& trajectory = *task.trajectory;
  states_.resize(steps + 1, dim_.states);
  states_.row(0) = one.state.transpose();
  if (steps > 0) states_.bottomRows(steps) = trajectory.segment_states(task.manipulation, one.state, controls_);
  targets_.resize(steps + 1, 3 * dim_.hands);
  for (Index j = 0; j <= steps; ++j) {
    const Positions targets = trajectory.targets(task.manipulation, states_.row(j).transpose());
    targets_.row(j) = Eigen::Map<const Vector>(targets.data(), targets.size()).transpose();
    if (j > 0) released_.push_back(trajectory.released(states_.row(j).transpose()));
  }
}

void CaseInputs::write(const Model& model, Index j, float* to) const {
  double raw[512];  // load_model and describe_task bound the sizes
  write_inputs(dim_, controls_.row(j).data(), states_.row(j).data(), states_.row(j + 1).data(), targets_.row(j).data(),
               targets_.row(j + 1).data(), released_[j], knowledge_.centre, knowledge_.width, raw);
  for (Index i = 0; i < dim_.inputs(); ++i) {
    to[i] = static_cast<float>((raw[i] - model.input_mean[i]) / model.input_sd[i]);
  }
}

void CaseInputs::pullback(const Model& model, const std::vector<const float*>& d_inputs, CaseGradient& gradient) const {
  const auto& trajectory = *task_.trajectory;
  const Index steps = controls_.rows(), targets = 3 * dim_.hands;
  const Index before = dim_.controls, after = before + dim_.states;
  const Index targets_before = after + dim_.states, targets_after = targets_before + targets;
  Controls raw(steps, dim_.inputs());
  for (Index j = 0; j < steps; ++j) {
    for (Index i = 0; i < raw.cols(); ++i) {
      raw(j, i) = static_cast<double>(d_inputs[j][i]) / static_cast<double>(model.input_sd[i]);
    }
  }
  // The gradient that the inputs of segment j pass to a state, directly and through its targets.
  const auto add_state = [&](Index row, Index j, Index state_at, Index targets_at, Vector& d_state) {
    d_state += raw.row(j).segment(state_at, dim_.states).transpose();
    const Positions d_targets = Eigen::Map<const Positions>(raw.row(j).data() + targets_at, dim_.hands, 3);
    d_state += trajectory.targets_pullback(task_.manipulation, states_.row(row).transpose(), d_targets);
  };
  // The state after a segment is the one before the next.
  const auto add = [&](Index j, Vector& d_state) {
    if (j + 1 < steps) add_state(j + 1, j + 1, before, targets_before, d_state);
    add_state(j + 1, j, after, targets_after, d_state);
  };
  Vector d_start =
      trajectory.pullback_states(task_.manipulation, states_.row(0).transpose(), controls_, add, gradient.controls);
  if (steps > 0) add_state(0, 0, before, targets_before, d_start);
  gradient.state += d_start;
  for (Index j = steps - 1; j >= 0; --j) {
    gradient.controls.row(j) += raw.row(j).head(dim_.controls);
    gradient.centre += raw.row(j).segment<4>(dim_.centre_input()).transpose();
    gradient.width += raw.row(j).segment<4>(dim_.width_input()).transpose();
  }
}

void CaseInputs::jvp(const Model& model, const CaseDirection& direction, std::vector<std::vector<float>>& to) const {
  const auto& trajectory = *task_.trajectory;
  const Index steps = controls_.rows(), s = dim_.states, c = dim_.controls, g = 3 * dim_.hands;
  to.assign(steps, std::vector<float>(dim_.inputs()));
  Vector d_state = Vector::Zero(s), d_targets = Vector::Zero(g);
  Vector row_state, row_control;
  for (Index j = 0; j < steps; ++j) {
    Vector raw(dim_.inputs());
    raw.head(c) = direction.controls.row(j).transpose();
    raw.segment(c, s) = d_state;
    raw.segment(c + 2 * s, g) = d_targets;
    const Vector control = controls_.row(j).transpose();
    Vector state = states_.row(j).transpose();
    for (Index frame = 0; frame < kFramesPerSegment; ++frame) {
      // Rows of the Jacobians, one pullback each: a trajectory offers no jvp.
      Vector next(s);
      for (Index i = 0; i < s; ++i) {
        trajectory.advance_pullback(task_.manipulation, state, control, Vector::Unit(s, i), row_state, row_control);
        next(i) = row_state.dot(d_state) + row_control.dot(raw.head(c));
      }
      state = trajectory.advance(task_.manipulation, state, control);
      d_state = next;
    }
    for (Index i = 0; i < g; ++i) {
      Positions unit = Positions::Zero(dim_.hands, 3);
      unit.data()[i] = 1.0;
      d_targets(i) = trajectory.targets_pullback(task_.manipulation, state, unit).dot(d_state);
    }
    raw.segment(c + s, s) = d_state;
    raw.segment(c + 2 * s + g, g) = d_targets;
    raw(dim_.released_input()) = 0.0;
    raw.segment<4>(dim_.centre_input()) = direction.centre;
    raw.segment<4>(dim_.width_input()) = direction.width;
    for (Index i = 0; i < raw.size(); ++i) {
      to[j][i] = static_cast<float>(raw(i) / static_cast<double>(model.input_sd[i]));
    }
  }
}

}  // namespace weft::emd
