#include "simulation/surroundings.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "weft/error.hpp"

namespace weft {
namespace {

// A number or list without a default: it must be given, or what stands in its place is computed.
constexpr double kUnset = std::numeric_limits<double>::quiet_NaN();
// m; without `edge_radius_m` edges have this radius, or half of the smallest size.
constexpr double kUsualRadius = 0.005;

constexpr const char* kFrictionText = "Of cloth on it; left out, the fabric's with the ground.";
constexpr const char* kRadiusText = "Radius of its rounded edges; left out, 0.005 or half of its smallest size.";

struct GroundKeys {
  double height_m = kUnset;
  template <class Visitor>
  void visit(Visitor& v) {
    v("height_m", height_m, range(-1e3, 1e3, "m"),
      "Height of the ground. Without `ground` it lies at 0; with `ground: none` there is none.");
  }
};
struct BoxKeys {
  std::vector<double> centre_m, size_m;
  std::vector<double> turn_deg = {0.0, 0.0, 0.0};
  double edge_radius_m = kUnset, friction = kUnset;
  template <class Visitor>
  void visit(Visitor& v) {
    v("centre_m", centre_m, range(-1e3, 1e3, "m"), "Its middle. Must be given.", Length{3, "x, y, z"});
    v("size_m", size_m, range(1e-4, 1e3, "m"), "Its edges along its axes. Must be given.", Length{3, "x, y, z"});
    v("turn_deg", turn_deg, range(-360, 360, "degrees"), "It is turned about the world's x, then y, then z.",
      Length{3, "x, y, z"});
    v("edge_radius_m", edge_radius_m, range(0, 1e3, "m"), kRadiusText);
    v("friction", friction, range(0, 100), kFrictionText);
  }
};
struct CylinderKeys {
  std::vector<double> centre_m;
  std::vector<double> axis = {1.0, 0.0, 0.0};
  double radius_m = kUnset, length_m = kUnset, edge_radius_m = kUnset, friction = kUnset;
  template <class Visitor>
  void visit(Visitor& v) {
    v("centre_m", centre_m, range(-1e3, 1e3, "m"), "Its middle. Must be given.", Length{3, "x, y, z"});
    v("axis", axis, range(-1e3, 1e3), "Direction of its axis, of any length but 0.", Length{3, "x, y, z"});
    v("radius_m", radius_m, range(1e-4, 1e3, "m"), "Must be given.");
    v("length_m", length_m, range(1e-4, 1e3, "m"), "Along the axis. Must be given.");
    v("edge_radius_m", edge_radius_m, range(0, 1e3, "m"), kRadiusText);
    v("friction", friction, range(0, 100), kFrictionText);
  }
};
struct HalfSpaceKeys {
  std::vector<double> point_m;
  std::vector<double> normal = {0.0, 0.0, 1.0};
  double friction = kUnset;
  template <class Visitor>
  void visit(Visitor& v) {
    v("point_m", point_m, range(-1e3, 1e3, "m"), "A point of its surface. Must be given.", Length{3, "x, y, z"});
    v("normal", normal, range(-1e3, 1e3), "Out of it, of any length but 0.", Length{3, "x, y, z"});
    v("friction", friction, range(0, 100), kFrictionText);
  }
};
struct TableKeys {
  std::vector<double> size_m;
  std::vector<double> centre_m = {0.0, 0.0};
  double top_m = 0.0, thickness_m = 0.03, turn_deg = 0.0, edge_radius_m = kUnset, friction = kUnset;
  template <class Visitor>
  void visit(Visitor& v) {
    v("size_m", size_m, range(1e-3, 1e3, "m"), "Of its top. Must be given.", Length{2, "x, y"});
    v("centre_m", centre_m, range(-1e3, 1e3, "m"), "Middle of its top.", Length{2, "x, y"});
    v("top_m", top_m, range(-1e3, 1e3, "m"), "Height of its top. The ground must be lower, or none.");
    v("thickness_m", thickness_m, range(1e-3, 1e3, "m"), "Of its board.");
    v("turn_deg", turn_deg, range(-360, 360, "degrees"), "About the vertical.");
    v("edge_radius_m", edge_radius_m, range(0, 1e3, "m"), kRadiusText);
    v("friction", friction, range(0, 100), kFrictionText);
  }
};

constexpr double kRadians = std::numbers::pi / 180.0;

void require_number(const ConfigNode& node, const char* key, double value) {
  if (std::isnan(value)) must_be(place(node, key), "a number");
}
Eigen::Vector3d require_vector(const ConfigNode& node, const char* key, const std::vector<double>& value,
                               const char* entries) {
  if (value.empty()) must_be(place(node, key), std::string("a list of numbers (") + entries + ")");
  Eigen::Vector3d out = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < value.size(); ++k) out[k] = value[k];
  return out;
}
/// Orthonormal axes, the last of which points along `direction`.
Eigen::Matrix3d axes_along(const ConfigNode& node, const char* key, const std::vector<double>& direction) {
  const Eigen::Vector3d z(direction.at(0), direction.at(1), direction.at(2));
  if (!(z.norm() > 0.0)) must_be(place(node, key), "a direction: not all zero");
  return Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), z).toRotationMatrix();
}

void set_surface(Obstacle& obstacle, const ConfigNode& node, double radius, double friction) {
  const double most = obstacle.half_size.minCoeff();
  if (radius > most)
    must_be(place(node, "edge_radius_m"),
            "at most " + ConfigNode::number(most).as_string() + ", half of its smallest size");
  obstacle.rounding = std::isnan(radius) ? std::min(kUsualRadius, most) : radius;
  if (!std::isnan(friction)) obstacle.friction = friction;
}

Obstacle read_box(const ConfigNode& node) {
  BoxKeys keys;
  read_params(node, keys);
  Obstacle o;
  o.kind = Obstacle::Kind::box;
  o.centre = require_vector(node, "centre_m", keys.centre_m, "x, y, z");
  o.half_size = 0.5 * require_vector(node, "size_m", keys.size_m, "x, y, z");
  const auto turn = [&](int k) {
    return Eigen::AngleAxisd(kRadians * keys.turn_deg[k], Eigen::Vector3d::Unit(k)).toRotationMatrix();
  };
  o.axes = turn(2) * turn(1) * turn(0);
  set_surface(o, node, keys.edge_radius_m, keys.friction);
  return o;
}

Obstacle read_cylinder(const ConfigNode& node) {
  CylinderKeys keys;
  read_params(node, keys);
  require_number(node, "radius_m", keys.radius_m);
  require_number(node, "length_m", keys.length_m);
  Obstacle o;
  o.kind = Obstacle::Kind::cylinder;
  o.centre = require_vector(node, "centre_m", keys.centre_m, "x, y, z");
  o.axes = axes_along(node, "axis", keys.axis);
  o.half_size = {keys.radius_m, keys.radius_m, 0.5 * keys.length_m};
  set_surface(o, node, keys.edge_radius_m, keys.friction);
  return o;
}

Obstacle read_half_space(const ConfigNode& node) {
  HalfSpaceKeys keys;
  read_params(node, keys);
  Obstacle o;
  o.centre = require_vector(node, "point_m", keys.point_m, "x, y, z");
  o.axes = axes_along(node, "normal", keys.normal);
  if (!std::isnan(keys.friction)) o.friction = keys.friction;
  return o;
}

Obstacle read_table(const ConfigNode& node) {
  TableKeys keys;
  read_params(node, keys);
  const Eigen::Vector3d size = require_vector(node, "size_m", keys.size_m, "x, y");
  Obstacle o;
  o.kind = Obstacle::Kind::box;
  o.centre = {keys.centre_m[0], keys.centre_m[1], keys.top_m - 0.5 * keys.thickness_m};
  o.half_size = 0.5 * Eigen::Vector3d(size.x(), size.y(), keys.thickness_m);
  o.axes = Eigen::AngleAxisd(kRadians * keys.turn_deg, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  set_surface(o, node, keys.edge_radius_m, keys.friction);
  return o;
}

struct ObstacleReader {
  const char* kind;
  Obstacle (*read)(const ConfigNode&);
  std::vector<ParamInfo> (*keys)();
};
constexpr ObstacleReader kObstacleReaders[] = {{"box", read_box, describe_params<BoxKeys>},
                                               {"cylinder", read_cylinder, describe_params<CylinderKeys>},
                                               {"half_space", read_half_space, describe_params<HalfSpaceKeys>},
                                               {"table", read_table, describe_params<TableKeys>}};

Obstacle read_obstacle(const ConfigNode& item) {
  std::vector<std::string> kinds;
  for (const auto& reader : kObstacleReaders) kinds.emplace_back(reader.kind);
  if (!item.is_mapping() || item.size() != 1) must_be(item, "a mapping with one key, " + one_of(kinds));
  item.refuse_unknown_keys(kinds);
  for (const auto& reader : kObstacleReaders) {
    const auto node = item.find(reader.kind);
    if (!node) continue;
    Obstacle obstacle = reader.read(*node);
    obstacle.name = reader.kind;
    return obstacle;
  }
  must_be(item, one_of(kinds));
}

}  // namespace

std::optional<double> read_ground(const ConfigNode& node) {
  if (node.is_null()) return 0.0;
  if (node.is_scalar()) {
    if (node.as_string() != "none") node.fail("= " + node.as_string() + ", must be none or {height_m: ...}");
    return std::nullopt;
  }
  GroundKeys keys;
  read_params(node, keys);
  require_number(node, "height_m", keys.height_m);
  return keys.height_m;
}

std::vector<Obstacle> read_obstacles(const ConfigNode& node, std::optional<double> ground) {
  std::vector<Obstacle> obstacles;
  if (node.is_null()) return obstacles;
  if (!node.is_sequence()) must_be(node, "a list of obstacles");
  for (std::size_t k = 0; k < node.size(); ++k) {
    obstacles.push_back(read_obstacle(node[k]));
    const auto table = node[k].find("table");
    if (!table || !ground) continue;
    // Else the cloth would lie on the ground, with its friction.
    const double top = obstacles.back().centre.z() + obstacles.back().half_size.z();
    if (top < *ground + 1e-6)
      table->fail("has its top at " + ConfigNode::number(top).as_string() + " m, must be above the ground at " +
                  ConfigNode::number(*ground).as_string() + " m: set ground: none, or its height_m lower");
  }
  return obstacles;
}

std::vector<ParamInfo> describe_ground() { return describe_params<GroundKeys>(); }

std::vector<ParamInfo> describe_obstacles() {
  std::vector<ParamInfo> all;
  for (const auto& reader : kObstacleReaders)
    for (ParamInfo info : reader.keys()) {
      info.name = std::string(reader.kind) + "." + info.name;
      all.push_back(std::move(info));
    }
  return all;
}

double work_surface(const Task& task) {
  if (task.scene.obstacles.empty()) return task.scene.ground_height.value_or(0.0);
  const auto& thickness = task.material.ranges[3];
  return task.manipulation.contact_height - std::max(thickness.low, thickness.high);
}

}  // namespace weft
