#include "fling.hpp"

#include <numbers>

namespace weft::fling {
namespace {

enum : Index { kHeight, kReach, kPull, kLength, kHeading };
constexpr double kRadians = std::numbers::pi / 180.0;

// The swing starts this much before the end of the lift, and the pull before that of laying down.
constexpr double kOverlap = 0.1;

}  // namespace

Fling::Fling(const Params& params)
    : ParametricPath("fling", params.path,
                     {{"height", "m", params.height_change_m},
                      {"reach", "m", params.reach_change_m},
                      {"pull", "m", params.pull_change_m},
                      {"length", "m", params.length_change_m},
                      {"heading", "deg", params.heading_change_deg}}),
      p_(params) {}

void Fling::path(const Manipulation& m, double s, ConstVec x, PathPoint& q) const {
  const Profile lift = minimum_jerk(s, 0.0, p_.lift_end), swing = minimum_jerk(s, p_.lift_end - kOverlap, p_.swing_end);
  const Profile lay = minimum_jerk(s, p_.swing_end, p_.lay_end), pull = minimum_jerk(s, p_.lay_end - kOverlap, 1.0);
  const double reach = p_.reach_m + x[kReach], back = p_.pull_m + x[kPull];

  q.along.at = (m.displacement.norm() + x[kLength] + reach) * swing - (reach - back) * lay - back * pull;
  q.along.by_shape[kReach] = swing.value - lay.value;
  q.along.by_shape[kPull] = lay.value - pull.value;
  q.along.by_shape[kLength] = swing.value;

  q.up.at = (p_.height_m + x[kHeight]) * (lift - lay) + m.drop_height * lay;
  q.up.by_shape[kHeight] = lift.value - lay.value;

  q.heading.at = kRadians * x[kHeading] * swing;
  q.heading.by_shape[kHeading] = kRadians * swing.value;
  q.turn = q.heading;  // the hands turn with their path
  q.spread.at = p_.stretch * lift;
}

}  // namespace weft::fling
