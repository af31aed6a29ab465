#pragma once
#include <numbers>

#include "weft/types.hpp"

namespace weft {

constexpr double kDegree = std::numbers::pi / 180.0;

/// z of the cross product: positive where b lies counter-clockwise of a.
inline double cross(const Vec2& a, const Vec2& b) { return a.x() * b.y() - a.y() * b.x(); }

}  // namespace weft
