#include "obstacles.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "contact.hpp"
#include "weft/rest_shape.hpp"

namespace weft::bullet {
namespace {

// m: how far vertices move until the points that can touch are chosen again.
constexpr double kStay = 0.004;
// What starts deeper than the thickness rises at this speed, m/s.
constexpr double kRiseFromObstacle = 0.05;

}  // namespace

ObstacleContact::ObstacleContact(const Garment& garment, std::vector<Obstacle> obstacles, double thickness,
                                 double friction)
    : obstacles_(std::move(obstacles)),
      thickness_(thickness),
      friction_(friction),
      faces_(garment.faces),
      edges_(edges_of(garment.faces)) {}

void ObstacleContact::begin(const Substep& substep) {
  if (obstacles_.empty()) return;
  double way = 0.0, strayed = anchor_.empty() ? 1.0 : 0.0;
  for (std::size_t i = 0; i < substep.end.size(); ++i) {
    way = std::max(way, (substep.end[i] - substep.start[i]).squaredNorm());
    if (!anchor_.empty()) strayed = std::max(strayed, (substep.end[i] - anchor_[i]).squaredNorm());
  }
  // Corrections move vertices further than predicted.
  if (strayed > kStay * kStay) choose(substep, 2.0 * kStay + 3.0 * std::sqrt(way));
  for (Point& point : points_) point.push = 0.0;
}

void ObstacleContact::choose(const Substep& substep, double reach) {
  anchor_ = substep.start;
  points_.clear();
  const std::size_t n = anchor_.size();
  std::vector<double> distance(n);
  std::vector<int> side(n);
  for (std::size_t o = 0; o < obstacles_.size(); ++o) {
    const Obstacle& obstacle = obstacles_[o];
    const auto number = static_cast<std::int32_t>(o);
    for (std::size_t i = 0; i < n; ++i) {
      distance[i] = obstacle_distance(obstacle, anchor_[i]).distance;
      side[i] = flat_side(obstacle, anchor_[i], reach);
      if (distance[i] < thickness_ + reach) points_.push_back({number, {static_cast<std::int32_t>(i), 0, 0}, 1});
    }
    if (obstacle.kind == Obstacle::Kind::half_space) continue;
    const auto consider = [&](const auto& rows, int corners) {
      for (Index r = 0; r < rows.rows(); ++r) {
        const int first = rows(r, 0);
        bool flat = side[first] != 0;
        double least = distance[first], longest = 0.0;
        for (int k = 0; k < corners; ++k) {
          const int v = rows(r, k);
          flat = flat && side[v] == side[first];
          least = std::min(least, distance[v]);
          longest = std::max(longest, (anchor_[v] - anchor_[rows(r, (k + 1) % corners)]).norm());
        }
        if (flat || least - 0.6 * longest > thickness_ + reach) continue;
        points_.push_back({number, {first, rows(r, 1), corners > 2 ? rows(r, corners - 1) : 0}, corners});
      }
    };
    consider(edges_, 2);
    consider(faces_, 3);
  }
}

bool ObstacleContact::measure(const Point& point, const std::vector<Eigen::Vector3d>& x, double (&weight)[3],
                              ObstacleDistance& at) const {
  const Obstacle& obstacle = obstacles_[point.obstacle];
  const auto place = [&](int k) { return Vec3(x[point.v[k]]); };
  if (point.corners == 1) {
    at = obstacle_distance(obstacle, place(0));
    weight[0] = 1.0, weight[1] = weight[2] = 0.0;
    return true;
  }
  const auto contact = point.corners == 2
                           ? nearest_in_edge(obstacle, place(0), place(1), obstacle_distance(obstacle, place(0)),
                                             obstacle_distance(obstacle, place(1)))
                           : nearest_in_face(obstacle, place(0), place(1), place(2));
  if (!contact) return false;
  std::copy(std::begin(contact->weight), std::end(contact->weight), std::begin(weight));
  at = contact->at;
  return true;
}

void ObstacleContact::push(Substep& substep) {
  const auto& w = *substep.inverse_mass;
  for (Point& point : points_) {
    double weight[3];
    ObstacleDistance at;
    if (!measure(point, substep.end, weight, at) || at.distance >= thickness_) continue;
    double inverse = 0.0;
    Vec3 start = Vec3::Zero();
    for (int k = 0; k < point.corners; ++k) {
      inverse += weight[k] * weight[k] * w[point.v[k]];
      start += weight[k] * substep.start[point.v[k]];
    }
    const double before = obstacle_distance(obstacles_[point.obstacle], start).distance;
    const double lack = std::min(thickness_, before + kRiseFromObstacle * substep.seconds) - at.distance;
    if (lack <= 0.0 || inverse <= 0.0) continue;
    for (int k = 0; k < point.corners; ++k)
      substep.end[point.v[k]] += (lack / inverse * weight[k] * w[point.v[k]]) * at.normal;
    point.push += lack;
    point.normal = at.normal;
    std::copy(std::begin(weight), std::end(weight), std::begin(point.weight));
  }
}

void ObstacleContact::rub(Substep& substep) const {
  const auto& w = *substep.inverse_mass;
  for (const Point& point : points_) {
    if (point.push <= 0.0) continue;
    Eigen::Vector3d slip = Eigen::Vector3d::Zero();
    double inverse = 0.0;
    for (int k = 0; k < point.corners; ++k) {
      slip += point.weight[k] * (substep.end[point.v[k]] - substep.start[point.v[k]]);
      inverse += point.weight[k] * point.weight[k] * w[point.v[k]];
    }
    slip -= point.normal.dot(slip) * point.normal;
    const double size = slip.norm(), mu = obstacles_[point.obstacle].friction.value_or(friction_);
    if (size == 0.0) continue;
    const double part = std::min(1.0, mu * point.push / size);
    for (int k = 0; k < point.corners; ++k)
      substep.end[point.v[k]] -= (part / inverse * point.weight[k] * w[point.v[k]]) * slip;
  }
}

}  // namespace weft::bullet
