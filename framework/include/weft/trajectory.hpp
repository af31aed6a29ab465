#pragma once
#include <string>
#include <vector>

#include "weft/error.hpp"
#include "weft/types.hpp"

namespace weft {

/// One control or state variable of a trajectory.
struct Variable {
  std::string name;    ///< "dtheta"
  std::string unit;    ///< "deg/frame"
  double lower = 0.0;  ///< hard bounds; finite
  double upper = 0.0;
  double default_value = 0.0;  ///< controls: the planner's default trajectory (section 4); state: value at the start
  double scale = 1.0;  ///< > 0: a typical change, in the variable's unit; noise and optimiser steps are multiples of it
};

/// Positions of the grasp points over one segment and the state after it.
struct SegmentPath {
  std::vector<Positions> targets;  ///< [kFramesPerSegment] of [G, 3] m, after each frame
  Vector end_state;                ///< [S]
};

/// Maps controls to gripper paths (section 2.1). Stateless and immutable: safe to call from many threads.
///
/// A control row [C] holds per-frame deltas that are constant within a segment. The control state [S] accumulates them;
/// grasp targets are a function of the state alone. An optimiser searches over a decision vector x [D], which `decode`
/// maps to controls [k, C]; for most trajectories x is the controls themselves, row by row.
class WEFT_API Trajectory {
 public:
  static constexpr const char* kKind = "trajectory";
  static constexpr int kVersion = 1;  // bump on any change to this class
  virtual ~Trajectory() = default;

  virtual std::vector<Variable> controls() const = 0;  ///< C >= 1 entries
  virtual std::vector<Variable> state() const = 0;     ///< S >= 1 entries
  virtual Index hands() const = 0;                     ///< G, grasp points driven

  /// @throws ConfigError for a manipulation that this trajectory cannot do (such as |d| = 0).
  virtual Vector initial_state(const Manipulation& manipulation) const = 0;

  /// State one frame later. @param state [S]; @param control [C]. @throws ShapeError.
  virtual Vector advance(const Manipulation& manipulation, ConstVec state, ConstVec control) const = 0;
  /// Grasp targets at a state, [G, 3] m. At initial_state they are the grasp points.
  virtual Positions targets(const Manipulation& manipulation, ConstVec state) const = 0;

  /// Vector-Jacobian products of the two maps above, exact.
  /// @param d_next [S]: dL/d advance(...). Adds nothing: the outputs are overwritten. d_state [S], d_control [C].
  virtual void advance_pullback(const Manipulation& manipulation, ConstVec state, ConstVec control, ConstVec d_next,
                                Vector& d_state, Vector& d_control) const = 0;
  /// @param d_targets [G, 3]: dL/d targets(...). @return dL/d state [S].
  virtual Vector targets_pullback(const Manipulation& manipulation, ConstVec state,
                                  const Positions& d_targets) const = 0;

  /// Progress towards release: 0 at the start, >= 1 once the cloth is to be released at the end of the segment (eq. 5;
  /// for the arc theta / 180 deg).
  virtual double progress(ConstVec state) const = 0;
  bool released(ConstVec state) const { return progress(state) >= 1.0; }

  /// Decision vector for `horizon` segments starting at `state`.
  virtual Index decision_size(Index horizon) const = 0;
  virtual Controls decode(ConstVec x, Index horizon, ConstVec state) const = 0;  ///< @return [horizon, C]
  /// dL/dx from dL/d controls [horizon, C].
  virtual Vector decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const = 0;
  /// The x whose decoded controls are nearest (least squares) to the given ones; exact where decode is one-to-one.
  virtual Vector encode(const Controls& controls, ConstVec state) const = 0;
  virtual Box decision_bounds(Index horizon) const = 0;
  virtual Vector decision_scale(Index horizon) const = 0;  ///< [D], > 0, as Variable::scale

  // What follows is the same for every trajectory.
  /// The default trajectory (section 4): the default control on every segment.
  WEFT_API Controls default_controls(Index horizon) const;
  WEFT_API SegmentPath segment(const Manipulation& manipulation, ConstVec state, ConstVec control) const;
  /// States after every segment, [k, S].
  WEFT_API Controls segment_states(const Manipulation& manipulation, ConstVec state, const Controls& controls) const;
  /// u of eq. 5, 1-based: the first segment after which the cloth is released, or the last one.
  WEFT_API Index release_segment(const Manipulation& manipulation, ConstVec state, const Controls& controls) const;
};

}  // namespace weft
