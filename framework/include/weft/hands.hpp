#pragma once
#include <vector>

#include "weft/simulator.hpp"
#include "weft/types.hpp"

/// The hands of a manipulation in a simulator, which holds the grasp vertices of those that have not opened yet.
namespace weft {

/// The grasp vertices of these hands, as set_state() wants them.
WEFT_API std::vector<Index> vertices_of(const Manipulation& manipulation, const std::vector<Index>& hands);

/// Advances one frame. The target of a hand that has opened has no effect.
/// @param targets [G, 3] m: a row per hand, as Trajectory::targets() returns them.
/// @throws as Simulator::step(); ShapeError unless there is a row for each hand.
WEFT_API void move_hands(Simulator& simulator, const Manipulation& manipulation, const Positions& targets);

/// Opens these hands (SegmentPath::opening). One that is open already stays so.
WEFT_API void open_hands(Simulator& simulator, const Manipulation& manipulation, const std::vector<Index>& hands);

}  // namespace weft
