#pragma once
#include <array>
#include <string>
#include <utility>
#include <vector>

#include "weft/task.hpp"

namespace weft {

/// The flat garment somewhere else on the work surface: its start, turned about its middle and moved.
/// @param move x, y, m. @param thickness of the cloth, m. @return [V, 3] m. @throws ConfigError as start_positions().
Positions flat_goal(const Task& task, const Vec2& move, double turn_deg, double thickness);

/// Where an edge of the garment is to lie.
struct EdgeGoal {
  /// [V, 3] m: the vertices of the edge on the line between the two places, in proportion to their distances along the edge;
  /// the others as the flat garment would lie if it were moved there.
  Positions shape;
  std::vector<bool> counts;  ///< [V]: the vertices of the edge
};
/// @param ends names of two vertices on one open edge of the garment; the edge is the shorter way between them.
/// @param places [2, 3] m: of the ends. @throws ConfigError for a name that is none, or ends that no open edge joins.
EdgeGoal edge_goal(const Garment& garment, const std::array<std::string, 2>& ends, const Positions& places);

}  // namespace weft
