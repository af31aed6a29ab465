#pragma once
#include <vector>

#include "weft/task.hpp"

namespace weft {

/// What the hands do on a path: the largest speed and acceleration of a hand, how near the hands come to one another, and
/// how far a hand is outside the workspace.
struct HandMotion {
  double speed = 0.0;                   ///< m/s
  double acceleration = 0.0;            ///< m/s^2
  double distance = HandLimits::kNone;  ///< m; infinity: one hand
  double outside = 0.0;                 ///< m, along one axis
};

/// Measures a path, frame by frame.
class HandMotionMeter {
 public:
  /// @param start [G, 3] m: where the hands are. @param step [G, 3] m: how far they moved in the frame before; 0 rows: they
  /// are at rest.
  HandMotionMeter(const HandLimits& limits, const Positions& start, const Positions& step);
  /// @param targets [G, 3] m after the next frame.
  void add(const Positions& targets);
  /// These hands have opened: where they are no longer counts.
  void open(const std::vector<Index>& hands);
  const HandMotion& motion() const { return motion_; }
  const Positions& last_step() const { return step_; }  ///< [G, 3] m

 private:
  void place(const Positions& targets);
  const HandLimits& limits_;
  Positions at_, step_;
  std::vector<Index> closed_;  // hands that hold
  HandMotion motion_;
};

/// How far the hands move in the last frame of a segment, [G, 3] m. @param state [S] before it.
Positions last_step(const Task& task, ConstVec state, ConstVec control);

/// Controls within the limits of the hands.
struct LimitedControls {
  Controls controls;         ///< [horizon, C]
  std::vector<Index> rows;   ///< [horizon]: the given row that a row is a part of
  std::vector<Index> parts;  ///< [horizon]: into how many parts that row is divided
  /// false: whatever is done, the change of speed in the first frame is too large. It cannot be if the hands are at rest.
  bool kept = true;
};

/// Makes controls keep Task::hands on every frame until the release; a hand that has opened before has no limits. A row that
/// would leave the workspace, or bring the hands too close, is replaced by the nearest one that does not (in units of the
/// controls' scales; by its beginning if there is none). A row that is too fast, or too fast after the one before, is divided
/// into equal parts, so that the hands take their way more slowly: a control is a change per frame, and the state adds them
/// up. The rows after the release, and those that no longer fit into the horizon, are dropped or moved.
/// @param state [S]; @param step [G, 3] m: how far the hands moved in the frame before, 0 rows: they are at rest.
/// @param controls [horizon, C].
LimitedControls within_limits(const Task& task, ConstVec state, const Positions& step, const Controls& controls);

/// The penalty of planning for controls that exceed the limits: four residuals a segment, of speed, acceleration, distance
/// and place. Each is the root of the mean of squares over its frames and hands of what exceeds, relative to the limit; of
/// distance and place per 10 mm. A hand that has opened exceeds nothing.
/// @param controls [k, C]; the rows after `u` do not count. @param gradients null, or set to those of the residuals with
/// respect to the controls, an empty one where the residual is 0.
/// @return [4 k].
Vector limit_residuals(const Task& task, ConstVec state, const Positions& step, const Controls& controls, Index u,
                       std::vector<Controls>* gradients);

}  // namespace weft
