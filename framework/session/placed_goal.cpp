#include "session/placed_goal.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <set>

#include "weft/error.hpp"
#include "weft/mesh.hpp"

namespace weft {
namespace {

constexpr double kUnreached = std::numeric_limits<double>::infinity();

/// The shortest way between two vertices along the open edges, and the distances from its start, m (Dijkstra).
std::vector<std::pair<Index, double>> way_along_edge(const Garment& garment, Index from, Index to) {
  std::map<Index, std::vector<Index>> neighbours;
  const Edges edges = open_edges(garment.faces);
  for (Index e = 0; e < edges.rows(); ++e) {
    neighbours[edges(e, 0)].push_back(edges(e, 1));
    neighbours[edges(e, 1)].push_back(edges(e, 0));
  }
  std::map<Index, double> distance{{from, 0.0}};
  std::map<Index, Index> before;
  std::set<std::pair<double, Index>> open{{0.0, from}};
  while (!open.empty()) {
    const auto [here, vertex] = *open.begin();
    open.erase(open.begin());
    for (const Index next : neighbours[vertex]) {
      const double there = here + (garment.positions.row(next) - garment.positions.row(vertex)).norm();
      const auto known = distance.find(next);
      if (there >= (known == distance.end() ? kUnreached : known->second)) continue;
      if (known != distance.end()) open.erase({known->second, next});
      distance[next] = there;
      before[next] = vertex;
      open.insert({there, next});
    }
  }
  if (from == to || !distance.contains(to)) return {};
  std::vector<std::pair<Index, double>> way;
  for (Index vertex = to; vertex != from; vertex = before[vertex]) way.emplace_back(vertex, distance[vertex]);
  way.emplace_back(from, 0.0);
  std::reverse(way.begin(), way.end());
  return way;
}

/// Turns all rows about the z axis.
void turn(Positions& shape, double cos, double sin) {
  const Positions old = shape;
  shape.col(0) = cos * old.col(0) - sin * old.col(1);
  shape.col(1) = sin * old.col(0) + cos * old.col(1);
}

}  // namespace

Positions flat_goal(const Task& task, const Vec2& move, double turn_deg, double thickness) {
  Positions shape = start_positions(*task.garment, task.scene, thickness);
  const Eigen::RowVector3d middle =
      (0.5 * (shape.colwise().minCoeff() + shape.colwise().maxCoeff())).cwiseProduct(Eigen::RowVector3d(1, 1, 0));
  shape.rowwise() -= middle;
  const double angle = turn_deg * std::numbers::pi / 180.0;
  turn(shape, std::cos(angle), std::sin(angle));
  shape.rowwise() += middle + Eigen::RowVector3d(move.x(), move.y(), 0.0);
  return shape;
}

EdgeGoal edge_goal(const Garment& garment, const std::array<std::string, 2>& ends, const Positions& places) {
  const auto way = way_along_edge(garment, garment.vertex(ends[0]), garment.vertex(ends[1]));
  if (way.empty()) throw ConfigError("no open edge of the garment joins " + ends[0] + " and " + ends[1]);
  EdgeGoal goal;
  goal.counts.assign(garment.vertex_count(), false);
  goal.shape = garment.positions;
  const Eigen::RowVector3d first = goal.shape.row(way.front().first), last = goal.shape.row(way.back().first);
  const Eigen::RowVector2d was = (last - first).head<2>(), is = (places.row(1) - places.row(0)).head<2>();
  const double scale = was.norm() * is.norm();
  goal.shape.rowwise() -= 0.5 * (first + last);
  if (scale > 0.0) turn(goal.shape, was.dot(is) / scale, (was.x() * is.y() - was.y() * is.x()) / scale);
  goal.shape.rowwise() += 0.5 * (places.row(0) + places.row(1));
  for (const auto& [vertex, distance] : way) {
    const double share = distance / way.back().second;
    goal.shape.row(vertex) = (1.0 - share) * places.row(0) + share * places.row(1);
    goal.counts[vertex] = true;
  }
  return goal;
}

}  // namespace weft
