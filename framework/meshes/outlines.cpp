#include "meshes/outlines.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "meshes/plane.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

void require(bool condition, const std::string& message) {
  if (!condition) throw ConfigError(message);
}

/// Adds to each point its mirror image on the other side of x = 0, with left_/right_ names.
/// The outline runs counter-clockwise: up on the right side, down on the left.
/// @param bottom_open the side between the first point and its image is an opening.
Outline mirrored(const std::vector<Outline::Point>& right_side, bool bottom_open) {
  Outline outline;
  for (const Outline::Point& p : right_side) {
    outline.points.push_back(p);
    if (!p.name.empty() && p.at.x() != 0.0) outline.points.back().name = "right_" + p.name;
  }
  for (auto p = right_side.rbegin(); p != right_side.rend(); ++p) {
    if (p->at.x() == 0.0) continue;
    outline.points.push_back(*p);
    outline.points.back().at.x() = -p->at.x();
    if (!p->name.empty()) outline.points.back().name = "left_" + p->name;
    // The side from here on is the image of the one that ends in the point on the right.
    const auto before = std::next(p);
    outline.points.back().open = before == right_side.rend() ? bottom_open : before->open;
  }
  return outline;
}

}  // namespace

double signed_area(const Outline& outline) {
  const auto& points = outline.points;
  double area = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) area += cross(points[i].at, points[(i + 1) % points.size()].at);
  return area / 2.0;
}

void check_outline(const Outline& outline) {
  const auto& points = outline.points;
  require(points.size() >= 3, "outline: " + std::to_string(points.size()) + " points, must be at least 3");
  std::vector<Vec2> polygon;
  for (const auto& p : points) {
    require(p.at.allFinite(), "outline: point " + std::to_string(polygon.size()) + " is not finite");
    polygon.push_back(p.at);
  }
  require(std::count_if(points.begin(), points.end(), [](const auto& p) { return p.corner; }) >= 3,
          "outline: fewer than 3 corners");
  const std::size_t n = polygon.size();
  for (std::size_t i = 0; i < n; ++i) {
    const Vec2& a = polygon[i];
    const Vec2& b = polygon[(i + 1) % n];
    require((b - a).norm() > 1e-6,
            "outline: points " + std::to_string(i) + " and " + std::to_string((i + 1) % n) + " coincide");
    for (std::size_t j = i + 2; j < n; ++j) {
      if (i == 0 && j == n - 1) continue;
      const Vec2& c = polygon[j];
      const Vec2& d = polygon[(j + 1) % n];
      const bool apart =
          cross(b - a, c - a) * cross(b - a, d - a) > 0.0 || cross(d - c, a - c) * cross(d - c, b - c) > 0.0;
      const bool boxes =
          std::max(a.x(), b.x()) >= std::min(c.x(), d.x()) && std::max(c.x(), d.x()) >= std::min(a.x(), b.x()) &&
          std::max(a.y(), b.y()) >= std::min(c.y(), d.y()) && std::max(c.y(), d.y()) >= std::min(a.y(), b.y());
      require(apart || !boxes, "outline: side " + std::to_string(i) + " crosses side " + std::to_string(j) +
                                   ": the sizes contradict each other");
    }
  }
  require(signed_area(outline) > 0.0, "outline: runs clockwise, must run counter-clockwise");
}

Outline towel_outline(const TowelSize& size) {
  const double x = size.width_m / 2.0;
  const double y = size.length_m;
  return mirrored({{{x, 0.0}, "bottom"}, {{x, y}, "top", true, true}}, false);
}

Outline shirt_outline(const ShirtSize& size) {
  const double sleeve = size.sleeve_angle_deg * kDegree;
  const double shoulder = size.shoulder_angle_deg * kDegree;
  const Vec2 along(std::cos(sleeve), -std::sin(sleeve));
  const Vec2 across(-std::sin(sleeve), -std::cos(sleeve));
  const double body = size.width_m / 2.0 - size.sleeve_length_m * along.x();
  const double neck = size.neck_width_m / 2.0;
  require(body > neck,
          "width_m = " + std::to_string(size.width_m) + " leaves a body of " + std::to_string(2.0 * body) +
              " m between the sleeves, must be wider than neck_width_m = " + std::to_string(size.neck_width_m));
  const Vec2 shoulder_point(body, size.length_m - (body - neck) * std::tan(shoulder));
  const Vec2 sleeve_top = shoulder_point + size.sleeve_length_m * along;
  const Vec2 sleeve_bottom = sleeve_top + size.sleeve_width_m * across;
  const Vec2 armpit(body, shoulder_point.y() - size.armhole_m);
  require(armpit.y() > 0.0, "armhole_m = " + std::to_string(size.armhole_m) + " reaches below the bottom hem");
  require(sleeve_bottom.x() > body,
          "sleeve_width_m = " + std::to_string(size.sleeve_width_m) +
              " reaches into the body; make the sleeves longer or narrower, or sleeve_angle_deg smaller");
  require(size.neck_depth_m < size.length_m, "neck_depth_m reaches below the bottom hem");
  std::vector<Outline::Point> right{{{body, 0.0}, "body_bottom"},
                                    {armpit, "armpit"},
                                    {sleeve_bottom, "sleeve_bottom", true, true},
                                    {sleeve_top, "sleeve_top"}};
  // A bend in the shoulder line needs a corner; a straight line does not.
  if (std::abs(size.sleeve_angle_deg - size.shoulder_angle_deg) > 1.0) right.push_back({shoulder_point, "shoulder"});
  right.push_back({{neck, size.length_m}, "collar", true, true});
  constexpr int kCurve = 16;
  for (int k = 1; k <= kCurve; ++k) {
    const double angle = 90.0 * kDegree * k / kCurve;
    const bool last = k == kCurve;
    right.push_back({{last ? 0.0 : neck * std::cos(angle), size.length_m - size.neck_depth_m * std::sin(angle)},
                     last ? "collar" : "",
                     last,
                     true});
  }
  return mirrored(right, true);
}

ShirtSize long_sleeve_size() {
  ShirtSize size;
  size.width_m = 1.06;
  size.sleeve_length_m = 0.48;
  size.sleeve_width_m = 0.11;
  size.sleeve_angle_deg = 45.0;
  return size;
}

Outline trousers_outline(const TrousersSize& size) {
  require(size.inseam_m < size.length_m, "inseam_m = " + std::to_string(size.inseam_m) +
                                             ", must be less than length_m = " + std::to_string(size.length_m));
  require(size.gap_m > 0.0, "gap_m = 0: the legs would touch, must be greater than 0");
  const double inner = size.gap_m / 2.0;
  return mirrored({{{0.0, size.inseam_m}, "crotch"},
                   {{inner, 0.0}, "hem_inner", true, true},
                   {{inner + size.leg_width_m, 0.0}, "hem_outer"},
                   {{size.hip_m / 2.0, size.inseam_m}, "hip"},
                   {{size.waist_m / 2.0, size.length_m}, "waist", true, true}},
                  false);
}

}  // namespace weft
