#include "drag.hpp"

#include <numbers>

namespace weft::drag {
namespace {

enum : Index { kHeight, kArrival, kOvershoot, kLength, kHeading };
constexpr double kRadians = std::numbers::pi / 180.0;

constexpr double kOverlap = 0.1;    // the move starts this much before the end of the lift
constexpr double kLowering = 0.15;  // the hands go down so much before and after the end of the move

}  // namespace

Drag::Drag(const Params& params)
    : ParametricPath("drag", params.path,
                     {{"height", "m", params.height_change_m},
                      {"arrival_height", "m", params.arrival_height_change_m},
                      {"overshoot", "m", params.overshoot_change_m},
                      {"length", "m", params.length_change_m},
                      {"heading", "deg", params.heading_change_deg}}),
      p_(params) {}

void Drag::path(const Manipulation& m, double s, ConstVec x, PathPoint& q) const {
  const Profile lift = minimum_jerk(s, 0.0, p_.lift_end), move = minimum_jerk(s, p_.lift_end - kOverlap, p_.move_end);
  const Profile lower = minimum_jerk(s, p_.move_end - kLowering, p_.move_end + kLowering);
  const Profile back = minimum_jerk(s, p_.move_end, 1.0);
  const double height = p_.height_m + x[kHeight], arrival = p_.arrival_height_m + x[kArrival];
  const double overshoot = p_.overshoot_m + x[kOvershoot];

  q.along.at = (m.displacement.norm() + x[kLength] + overshoot) * move - overshoot * back;
  q.along.by_shape[kOvershoot] = move.value - back.value;
  q.along.by_shape[kLength] = move.value;

  q.up.at = height * lift + (arrival - height) * move + (m.drop_height - arrival) * lower;
  q.up.by_shape[kHeight] = lift.value - move.value;
  q.up.by_shape[kArrival] = move.value - lower.value;

  q.heading.at = kRadians * x[kHeading] * move;
  q.heading.by_shape[kHeading] = kRadians * move.value;
  q.turn = q.heading;  // the hands turn with their path
}

}  // namespace weft::drag
