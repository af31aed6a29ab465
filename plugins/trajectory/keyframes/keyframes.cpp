#include "keyframes.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>

namespace weft::keyframes {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kRadians = kPi / 180.0;
// Weight in encode() of a segment that starts after release, when the cloth lies already.
constexpr double kReleasedWeight = 1e-3;

/// Progress per frame at a duration. Rounding must not cost another segment, so it is larger by a billionth.
double pace(double duration_s) { return (1.0 + 1e-9) * kFrameSeconds / duration_s; }

void check(const Trajectory& trajectory, const Manipulation& m) {
  check_manipulation("keyframes", trajectory, m);
  if (!(m.displacement.norm() > 0.0))
    throw ConfigError("keyframes: |d| = 0 (displacement of the grasp points), must be above 0: d is the direction");
}

Vec2 turned(const Vec2& v, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {c * v.x() - s * v.y(), s * v.x() + c * v.y()};
}
Vec2 quarter(const Vec2& v) { return {-v.y(), v.x()}; }  // z x v
Vec2 midpoint(const Manipulation& m) { return m.grasp_points.leftCols<2>().colwise().mean().transpose(); }

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
  if (i == 0) {  // without the differences that cancel: the cubic that targets() divides by s
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

/// Where the hands are in the frame of d, the derivatives with respect to s, and what the sums are multiplied by.
struct Keyframes::Place {
  Eigen::Vector4d at, slope;  // along m, across m, up m, turn rad
  Vector mean;                // [K + 1]: phi_j(s) / s
};

Keyframes::Keyframes(const Params& params) : p_(params), times_(read_times()), splines_(times_) {
  if (p_.turn && p_.hands == 1) throw ConfigError("keyframes: turn = true needs two hands, hands = 1");
  if (p_.duration_min_s <= p_.duration_s && p_.duration_s <= p_.duration_max_s) return;
  std::ostringstream text;
  text << "keyframes: duration_s = " << p_.duration_s << " s, must be in [duration_min_s, duration_max_s] = ["
       << p_.duration_min_s << ", " << p_.duration_max_s << "]";
  throw ConfigError(text.str());
}

std::vector<double> Keyframes::read_times() const {
  for (const auto& [name, list] :
       {std::pair{"times", &p_.times}, {"along_m", &p_.along_m}, {"across_m", &p_.across_m}, {"up_m", &p_.up_m}}) {
    if (!list->empty() && std::ssize(*list) != p_.poses) {
      throw ConfigError("keyframes: " + std::string(name) + " has " + std::to_string(list->size()) +
                        " numbers, must have poses = " + std::to_string(p_.poses));
    }
  }
  if (std::adjacent_find(p_.times.begin(), p_.times.end(), std::greater_equal<>()) != p_.times.end())
    throw ConfigError("keyframes: times must ascend");
  if (!p_.times.empty()) return p_.times;
  std::vector<double> even;
  for (Index k = 1; k <= p_.poses; ++k) even.push_back(static_cast<double>(k) / static_cast<double>(p_.poses + 1));
  return even;
}

std::vector<Variable> Keyframes::controls() const {
  const double usual = pace(p_.duration_s), fastest = pace(p_.duration_min_s);
  std::vector<Variable> all = {{"ds", "1/frame", pace(p_.duration_max_s), fastest, usual, usual * p_.pace_scale}};
  const auto add = [&](const std::string& name, const char* unit, double change) {
    all.push_back(
        {"d" + name, unit, -fastest * change, fastest * change, 0.0, usual * p_.shape_scale * std::max(change, 1e-6)});
  };
  for (Index k = 1; k <= p_.poses; ++k)
    for (const char* name : {"along_", "across_", "up_"}) add(name + std::to_string(k), "m/frame", p_.pose_change_m);
  for (const char* name : {"along_end", "across_end"}) add(name, "m/frame", p_.end_change_m);
  if (!p_.turn) return all;
  for (Index k = 1; k <= p_.poses; ++k) add("turn_" + std::to_string(k), "deg/frame", p_.heading_change_deg);
  add("turn_end", "deg/frame", p_.heading_change_deg);
  return all;
}

std::vector<Variable> Keyframes::state() const {
  // These bounds cover a workspace of 10 m, ten turns and a hundred paths.
  std::vector<Variable> all = {{"s", "1", 0.0, 100.0, 0.0, 0.1}};
  const auto changes = controls();
  for (std::size_t i = 1; i < changes.size(); ++i) {
    const bool is_angle = changes[i].unit == "deg/frame";
    const double bound = is_angle ? 3600.0 : 10.0;
    all.push_back({changes[i].name.substr(1), is_angle ? "deg" : "m", -bound, bound, 0.0, is_angle ? 10.0 : 0.1});
  }
  return all;
}

Vector Keyframes::initial_state(const Manipulation& m) const {
  check(*this, m);
  return Vector::Zero(size());
}

double Keyframes::progress(ConstVec state) const {
  check_state("keyframes", *this, state);
  return state[0];
}

Keyframes::Place Keyframes::place(const Manipulation& m, ConstVec state) const {
  const double s = state[0], length = m.displacement.norm();
  Vector value, slope;
  splines_.evaluate(s, value, slope);
  Place q;
  q.at.setZero();
  q.slope.setZero();
  q.mean = s > 0.0 ? Vector(value / s) : Vector(Vector::Zero(value.size()));
  const Vector mean_slope = s > 0.0 ? Vector((slope - q.mean) / s) : Vector(Vector::Zero(value.size()));
  for (Index j = 0; j <= p_.poses; ++j) {
    const bool is_end = j == p_.poses;
    const double angle = is_end ? kPi : kPi * times_[j], share = 0.5 * (1.0 - std::cos(angle));
    Eigen::Vector4d pose(share * length, 0.0, share * m.drop_height + p_.height * length * std::sin(angle), 0.0);
    if (is_end) pose[2] = m.drop_height;
    if (!is_end && !p_.along_m.empty()) pose[0] = p_.along_m[j];
    if (!is_end && !p_.across_m.empty()) pose[1] = p_.across_m[j];
    if (!is_end && !p_.up_m.empty()) pose[2] = p_.up_m[j];
    Eigen::Vector4d sum = Eigen::Vector4d::Zero();
    sum.head(is_end ? 2 : 3) = state.segment(1 + 3 * j, is_end ? 2 : 3);
    if (p_.turn) sum[3] = kRadians * state[3 + 3 * p_.poses + j];
    q.at += value[j] * pose + q.mean[j] * sum;
    q.slope += slope[j] * pose + mean_slope[j] * sum;
  }
  return q;
}

Positions Keyframes::targets(const Manipulation& m, ConstVec state) const {
  check_state("keyframes", *this, state);
  check(*this, m);
  const Place q = place(m, state);
  const Vec2 centre = midpoint(m), d = m.displacement.normalized();
  Positions g(hands(), 3);
  for (Index i = 0; i < g.rows(); ++i) {
    const Vec2 offset = m.grasp_points.row(i).head<2>().transpose() - centre;
    g.row(i).head<2>() = (centre + q.at[0] * d + q.at[1] * quarter(d) + turned(offset, q.at[3])).transpose();
    g(i, 2) = std::max(m.grasp_points(i, 2) + q.at[2], m.contact_height);
  }
  return g;
}

Vector Keyframes::targets_pullback(const Manipulation& m, ConstVec state, const Positions& d_targets) const {
  check_state("keyframes", *this, state);
  require_shape("keyframes: d_targets rows", d_targets.rows(), hands());
  check(*this, m);
  const Place q = place(m, state);
  const Vec2 centre = midpoint(m), d = m.displacement.normalized();
  Eigen::Vector4d w = Eigen::Vector4d::Zero();  // dL/d (along, across, up, turn)
  for (Index i = 0; i < d_targets.rows(); ++i) {
    const Vec2 offset = m.grasp_points.row(i).head<2>().transpose() - centre;
    const Vec2 xy = d_targets.row(i).head<2>().transpose();
    const bool is_free = m.grasp_points(i, 2) + q.at[2] >= m.contact_height;
    w += Eigen::Vector4d(d.dot(xy), quarter(d).dot(xy), is_free ? d_targets(i, 2) : 0.0,
                         quarter(turned(offset, q.at[3])).dot(xy));
  }
  Vector out = Vector::Zero(size());
  out[0] = q.slope.dot(w);
  for (Index j = 0; j <= p_.poses; ++j) {
    const Index directions = j == p_.poses ? 2 : 3;
    out.segment(1 + 3 * j, directions) = q.mean[j] * w.head(directions);
    if (p_.turn) out[3 + 3 * p_.poses + j] = kRadians * q.mean[j] * w[3];
  }
  return out;
}

Index Keyframes::decision_size(Index horizon) const {
  if (horizon < 0) throw ShapeError("keyframes: horizon = " + std::to_string(horizon) + ", must be >= 0");
  return size();
}

Controls Keyframes::decode(ConstVec x, Index horizon, ConstVec state) const {
  require_shape("keyframes: x", x.size(), decision_size(horizon));
  check_state("keyframes", *this, state);
  Vector row = x[0] * x;
  row[0] = x[0];
  return row.transpose().replicate(horizon, 1);
}

Vector Keyframes::decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const {
  require_shape("keyframes: x", x.size(), decision_size(horizon));
  check_state("keyframes", *this, state);
  require_shape("keyframes: d_controls rows", d_controls.rows(), horizon);
  require_shape("keyframes: d_controls columns", d_controls.cols(), size());
  const Vector sums = d_controls.colwise().sum().transpose();
  Vector gradient = x[0] * sums;
  gradient[0] = sums[0] + x.tail(size() - 1).dot(sums.tail(size() - 1));
  return gradient;
}

Vector Keyframes::encode(const Controls& controls, ConstVec state) const {
  require_shape("keyframes: controls columns", controls.cols(), size());
  check_state("keyframes", *this, state);
  Vector sum = Vector::Zero(size());
  double weights = 0.0, s = state[0];
  for (Index j = 0; j < controls.rows(); ++j) {
    const double weight = j > 0 && s >= 1.0 ? kReleasedWeight : 1.0;
    sum += weight * controls.row(j).transpose();
    weights += weight;
    s += static_cast<double>(kFramesPerSegment) * controls(j, 0);
  }
  Vector x = Vector::Zero(size());
  if (sum[0] > 0.0) x = sum / sum[0];
  x[0] = weights > 0.0 ? sum[0] / weights : pace(p_.duration_s);
  return x;
}

Box Keyframes::decision_bounds(Index horizon) const {
  Box box = Trajectory::decision_bounds(horizon);
  box.lower.tail(size() - 1) /= box.upper[0];
  box.upper.tail(size() - 1) /= box.upper[0];
  return box;
}

Vector Keyframes::decision_scale(Index horizon) const {
  Vector scale = Trajectory::decision_scale(horizon);
  scale.tail(size() - 1) /= pace(p_.duration_s);
  return scale;
}

}  // namespace weft::keyframes
