#include "keyframes.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace weft::keyframes {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kRadians = kPi / 180.0;

void check_lists(const Params& p) {
  for (const auto& [name, list] :
       {std::pair{"times", &p.times}, {"along_m", &p.along_m}, {"across_m", &p.across_m}, {"up_m", &p.up_m}}) {
    if (!list->empty() && std::ssize(*list) != p.poses) {
      throw ConfigError("keyframes: " + std::string(name) + " has " + std::to_string(list->size()) +
                        " numbers, must have poses = " + std::to_string(p.poses));
    }
  }
  if (std::adjacent_find(p.times.begin(), p.times.end(), std::greater_equal<>()) != p.times.end())
    throw ConfigError("keyframes: times must ascend");
  if (p.turn && p.path.hands == 1) throw ConfigError("keyframes: turn = true needs two hands, hands = 1");
}

/// [K] times of the poses.
std::vector<double> times_of(const Params& p) {
  check_lists(p);
  if (!p.times.empty()) return p.times;
  std::vector<double> even;
  for (Index k = 1; k <= p.poses; ++k) even.push_back(static_cast<double>(k) / static_cast<double>(p.poses + 1));
  return even;
}

/// Three per pose, two of the end, and with `turn` one more for each of them.
std::vector<ShapeParameter> shape_of(const Params& p) {
  std::vector<ShapeParameter> all;
  for (Index k = 1; k <= p.poses; ++k)
    for (const char* name : {"along_", "across_", "up_"})
      all.push_back({name + std::to_string(k), "m", p.pose_change_m});
  for (const char* name : {"along_end", "across_end"}) all.push_back({name, "m", p.end_change_m});
  if (!p.turn) return all;
  for (Index k = 1; k <= p.poses; ++k) all.push_back({"turn_" + std::to_string(k), "deg", p.heading_change_deg});
  all.push_back({"turn_end", "deg", p.heading_change_deg});
  return all;
}

}  // namespace

Splines::Splines(const std::vector<double>& times) {
  knots_ = {0.0, 0.5 * times.front()};
  knots_.insert(knots_.end(), times.begin(), times.end());
  knots_.insert(knots_.end(), {0.5 * (times.back() + 1.0), 1.0});
  const Index n = std::ssize(knots_) - 1, functions = std::ssize(times) + 1;
  const auto width = [&](Index i) { return knots_[i + 1] - knots_[i]; };
  heights_ = Matrix::Zero(n + 1, functions);
  for (Index j = 0; j + 1 < functions; ++j) heights_(j + 2, j) = 1.0;
  heights_(n, functions - 1) = heights_(n - 1, functions - 1) = 1.0;

  // Continuity of the slope at knot i, the bends M as unknowns:
  //     h_{i-1} M_{i-1} + 2 (h_{i-1} + h_i) M_i + h_i M_{i+1} = 6 [(y_{i+1} - y_i) / h_i - (y_i - y_{i-1}) / h_{i-1}]
  // With M = 0 and slope 0 at the ends, y_1 = M_1 h_0^2 / 6 and y_{n-1} = y_n + M_{n-1} h_{n-1}^2 / 6: these parts of y
  // go to the left side.
  Vector below = Vector::Zero(n + 1), middle = below, above = below;
  bends_ = Matrix::Zero(n + 1, functions);
  for (Index i = 1; i < n; ++i) {
    below[i] = width(i - 1);
    middle[i] = 2.0 * (width(i - 1) + width(i));
    above[i] = width(i);
    bends_.row(i) = 6.0 * ((heights_.row(i + 1) - heights_.row(i)) / width(i) -
                           (heights_.row(i) - heights_.row(i - 1)) / width(i - 1));
  }
  const double first = width(0) * width(0), last = width(n - 1) * width(n - 1);
  middle[1] += first * (1.0 / width(0) + 1.0 / width(1));
  below[2] -= first / width(1);
  middle[n - 1] += last * (1.0 / width(n - 1) + 1.0 / width(n - 2));
  above[n - 2] -= last / width(n - 2);
  for (Index i = 2; i < n; ++i) {  // elimination; the rows are diagonally dominant
    const double factor = below[i] / middle[i - 1];
    middle[i] -= factor * above[i - 1];
    bends_.row(i) -= factor * bends_.row(i - 1);
  }
  for (Index i = n - 1; i > 0; --i) {
    if (i + 1 < n) bends_.row(i) -= above[i] * bends_.row(i + 1);
    bends_.row(i) /= middle[i];
  }
  heights_.row(1) = first / 6.0 * bends_.row(1);
  heights_.row(n - 1) += last / 6.0 * bends_.row(n - 1);
}

void Splines::evaluate(double s, Vector& value, Vector& slope) const {
  slope = Vector::Zero(heights_.cols());
  if (s <= 0.0 || s >= 1.0) {
    value = heights_.row(s <= 0.0 ? 0 : heights_.rows() - 1).transpose();
    return;
  }
  const Index i = std::upper_bound(knots_.begin(), knots_.end(), s) - knots_.begin() - 1;
  const double h = knots_[i + 1] - knots_[i], left = knots_[i + 1] - s, right = s - knots_[i];
  const Vector bend_0 = bends_.row(i).transpose(), bend_1 = bends_.row(i + 1).transpose();
  if (i == 0) {  // without the differences that cancel: a shape can be as large as 1 / s
    value = right * right * right / (6.0 * h) * bend_1;
    slope = right * right / (2.0 * h) * bend_1;
    return;
  }
  const Vector line_0 = heights_.row(i).transpose() / h - h / 6.0 * bend_0;
  const Vector line_1 = heights_.row(i + 1).transpose() / h - h / 6.0 * bend_1;
  value = left * left * left / (6.0 * h) * bend_0 + right * right * right / (6.0 * h) * bend_1 + left * line_0 +
          right * line_1;
  slope = right * right / (2.0 * h) * bend_1 - left * left / (2.0 * h) * bend_0 + line_1 - line_0;
}

Keyframes::Keyframes(const Params& params)
    : ParametricPath("keyframes", params.path, shape_of(params)),
      p_(params),
      times_(times_of(params)),
      splines_(times_) {}

void Keyframes::path(const Manipulation& m, double s, ConstVec x, PathPoint& q) const {
  Vector value, slope;
  splines_.evaluate(s, value, slope);
  const double length = m.displacement.norm();
  for (Index j = 0; j <= p_.poses; ++j) {
    const Profile phi{value[j], slope[j]};
    const auto add = [&](PathCoordinate& coordinate, double pose, Index parameter, double unit = 1.0) {
      coordinate.at = coordinate.at + (pose + unit * x[parameter]) * phi;
      coordinate.by_shape[parameter] = unit * phi.value;
    };
    if (p_.turn) add(q.turn, 0.0, 3 * p_.poses + 2 + j, kRadians);
    if (j == p_.poses) {
      add(q.along, length, 3 * j);
      add(q.across, 0.0, 3 * j + 1);
      q.up.at = q.up.at + m.drop_height * phi;
      continue;
    }
    const double angle = kPi * times_[j], share = 0.5 * (1.0 - std::cos(angle));
    add(q.along, p_.along_m.empty() ? share * length : p_.along_m[j], 3 * j);
    add(q.across, p_.across_m.empty() ? 0.0 : p_.across_m[j], 3 * j + 1);
    const double ellipse = share * m.drop_height + p_.height * length * std::sin(angle);
    add(q.up, p_.up_m.empty() ? ellipse : p_.up_m[j], 3 * j + 2);
  }
}

}  // namespace weft::keyframes
