#include "weft/trajectory.hpp"

namespace weft {

Controls Trajectory::default_controls(Index horizon) const {
  const auto variables = controls();
  Controls result(horizon, static_cast<Index>(variables.size()));
  for (std::size_t c = 0; c < variables.size(); ++c) {
    result.col(static_cast<Index>(c)).setConstant(variables[c].default_value);
  }
  return result;
}

SegmentPath Trajectory::segment(const Manipulation& manipulation, ConstVec state, ConstVec control) const {
  SegmentPath path;
  path.end_state = state;
  for (Index frame = 0; frame < kFramesPerSegment; ++frame) {
    path.end_state = advance(manipulation, path.end_state, control);
    path.targets.push_back(targets(manipulation, path.end_state));
  }
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

}  // namespace weft
