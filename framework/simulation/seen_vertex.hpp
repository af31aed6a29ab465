#pragma once
#include "weft/types.hpp"

namespace weft {

/// The vertex that is nearest to a place in XY, of those that no face covers: those that are seen from above.
/// @param shape [V, 3] m, V >= 1; @param faces [F, 3].
Index nearest_seen_vertex(const Positions& shape, const Faces& faces, const Vec2& at);

}  // namespace weft
