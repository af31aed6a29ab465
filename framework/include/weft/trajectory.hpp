#pragma once
#include <functional>
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
  std::vector<Positions>
      targets;                 ///< [kFramesPerSegment] of [G, 3] m, after each frame; of an open hand without effect
  std::vector<Index> opening;  ///< hands that open at its end while others go on (Manipulation::opens_at); ascending
  Vector end_state;            ///< [S]
};

/// Maps controls to gripper paths (section 2.1). Stateless and immutable: safe to call from many threads.
///
/// A control row [C] holds per-frame deltas that are constant within a segment. The control state [S] accumulates them.
/// Grasp targets are a function of the state alone. An optimiser searches over a decision vector x [D]; decode() maps
/// it to controls [k, C].
///
/// Seven functions are pure virtual. The defaults of the others are for a trajectory whose state is the sum of its
/// controls (S = C) and whose x is the controls, row by row.
class WEFT_API Trajectory {
 public:
  static constexpr const char* kKind = "trajectory";
  static constexpr int kVersion = 3;  // bump on any change to this class
  static constexpr TypeSize kCrossing[] = {{"Variable", sizeof(Variable)},         {"SegmentPath", sizeof(SegmentPath)},
                                           {"Manipulation", sizeof(Manipulation)}, {"Box", sizeof(Box)},
                                           {"Controls", sizeof(Controls)},         {"ConstVec", sizeof(ConstVec)}};
  virtual ~Trajectory() = default;

  virtual std::vector<Variable> controls() const = 0;  ///< C >= 1 entries
  virtual std::vector<Variable> state() const = 0;     ///< S >= 1 entries
  virtual Index hands() const = 0;                     ///< G, grasp points driven

  /// @throws ConfigError for a manipulation that this trajectory cannot do (such as |d| = 0).
  virtual Vector initial_state(const Manipulation& manipulation) const = 0;
  /// Grasp targets at a state, [G, 3] m. At initial_state they are the grasp points.
  virtual Positions targets(const Manipulation& manipulation, ConstVec state) const = 0;
  /// The exact vector-Jacobian product of targets().
  /// @param d_targets [G, 3]: dL/d targets(...). @return dL/d state [S].
  virtual Vector targets_pullback(const Manipulation& manipulation, ConstVec state,
                                  const Positions& d_targets) const = 0;
  /// Progress towards release (eq. 5): 0 at the start. At >= 1 the cloth is released at the end of the segment. For the
  /// arc it is theta / 180 deg.
  virtual double progress(ConstVec state) const = 0;
  bool released(ConstVec state) const { return progress(state) >= 1.0; }

  /// State one frame later, [S]; by default state + control. Override it together with advance_pullback().
  /// @param state [S]; @param control [C]. @throws ShapeError.
  virtual Vector advance(const Manipulation& manipulation, ConstVec state, ConstVec control) const;
  /// The exact vector-Jacobian product of advance(). The outputs are overwritten.
  /// @param d_next [S]: dL/d advance(...). @param d_state, d_control set to [S] and [C].
  virtual void advance_pullback(const Manipulation& manipulation, ConstVec state, ConstVec control, ConstVec d_next,
                                Vector& d_state, Vector& d_control) const;

  /// Length D of a decision vector for `horizon` segments that start at `state`; by default horizon * C.
  /// @throws ShapeError for a negative horizon.
  virtual Index decision_size(Index horizon) const;
  virtual Controls decode(ConstVec x, Index horizon, ConstVec state) const;  ///< @return [horizon, C]
  /// dL/dx from dL/d controls [horizon, C].
  virtual Vector decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const;
  /// The x whose decoded controls are nearest (least squares) to the given ones; exact if decode() is one-to-one.
  virtual Vector encode(const Controls& controls, ConstVec state) const;
  /// Bounds and scales of x, [D]. By default those of the controls, repeated. That is right for any decision_size() if
  /// entry i of x stands for control i modulo C.
  virtual Box decision_bounds(Index horizon) const;
  virtual Vector decision_scale(Index horizon) const;  ///< > 0, as Variable::scale

  // The functions below are the same for every trajectory.
  /// The hands that hold the cloth in a segment that starts at `state`, ascending: those whose Manipulation::opens_at is
  /// above progress(). A hand that has opened stays open, so this is right where progress() does not fall.
  std::vector<Index> holding(const Manipulation& manipulation, ConstVec state) const;
  /// The default trajectory (section 4): the default control on every segment.
  Controls default_controls(Index horizon) const;
  SegmentPath segment(const Manipulation& manipulation, ConstVec state, ConstVec control) const;
  /// States after every segment, [k, S].
  Controls segment_states(const Manipulation& manipulation, ConstVec state, const Controls& controls) const;
  /// u of eq. 5, 1-based: the first segment after which the cloth is released, or the last one.
  Index release_segment(const Manipulation& manipulation, ConstVec state, const Controls& controls) const;

  /// Adds dL/d state after segment j = 0 ... k - 1 to `d_state` [S].
  using AddStateGradient = std::function<void(Index j, Vector& d_state)>;
  /// The chain rule through all frames of segment_states(), backwards.
  /// @param state [S] at the start; @param controls [k, C].
  /// @param add is called for j = k - 1 ... 0. By then `d_state` holds the contribution of the later segments, and row
  /// j + 1 of d_controls that of its segment.
  /// @param d_controls [k or more, C]: dL/d controls through the states is added to its first k rows.
  /// @return dL/d state [S] at the start, through the states after the segments.
  /// @throws ShapeError.
  Vector pullback_states(const Manipulation& manipulation, ConstVec state, const Controls& controls,
                         const AddStateGradient& add, Controls& d_controls) const;
};

/// The checks that most trajectories make of a manipulation. Messages start with `who`.
/// @throws ShapeError unless it has hands() grasp points; ConfigError for non-finite grasp points or displacement.
WEFT_API void check_manipulation(const std::string& who, const Trajectory& trajectory,
                                 const Manipulation& manipulation);
/// @throws ShapeError unless `state` is [S]. The message starts with `who`.
WEFT_API void check_state(const std::string& who, const Trajectory& trajectory, ConstVec state);

}  // namespace weft
