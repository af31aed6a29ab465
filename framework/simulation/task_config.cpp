#include "simulation/task_config.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <sstream>
#include <string_view>

#include "simulation/hand_limits.hpp"
#include "simulation/seen_vertex.hpp"
#include "simulation/simulator_warnings.hpp"
#include "simulation/start_shape.hpp"
#include "simulation/surroundings.hpp"
#include "weft/config.hpp"

namespace weft {

Length property_list() {
  std::string entries;
  for (const char* name : kPropertyNames) entries += (entries.empty() ? "" : ", ") + std::string(name);
  return {kPropertyNames.size(), entries};
}

namespace {

HandLimits read_limits(const TaskParams::Hands::Limits& params, const ConfigNode& origin,
                       const Positions& grasp_points) {
  HandLimits limits;
  if (params.speed_m_per_s > 0.0) limits.speed = params.speed_m_per_s;
  if (params.acceleration_m_per_s2 > 0.0) limits.acceleration = params.acceleration_m_per_s2;
  limits.distance = params.distance_m;
  if (!params.workspace_m.empty()) {
    require_shape("task: workspace", params.workspace_m.size(), 6);
    limits.lower = Eigen::Map<const Eigen::Vector3d>(params.workspace_m.data());
    limits.upper = Eigen::Map<const Eigen::Vector3d>(params.workspace_m.data() + 3);
  }
  const HandMotion start = HandMotionMeter(limits, grasp_points, {}).motion();
  const auto number = [](double metres) { return ConfigNode::number(metres).as_string() + " m"; };
  if (start.outside > 0.0)
    place(origin, "workspace_m").fail("does not hold a grasped vertex: it is " + number(start.outside) + " outside");
  if (start.distance < limits.distance)
    must_be(place(origin, "distance_m"), "at most the distance of the grasped vertices, " + number(start.distance));
  return limits;
}

/// Where the cloth lies at the beginning, as it is known then, [V, 3] m. @param thickest of the material space, m.
Positions known_start(const Task& task, double thickest, const ConfigNode& origin) {
  if (task.start) return task.start->shape;
  return blaming(place(origin, "scene.obstacles"),
                 [&] { return start_positions(*task.garment, task.scene, thickest); });
}

/// The place of `nearest(x, y)`; nullopt: a name. @param key for messages.
std::optional<Vec2> nearest_place(const std::string& grasp, const ConfigNode& key) {
  constexpr std::string_view kBegin = "nearest(";
  if (!grasp.starts_with(kBegin)) return std::nullopt;
  std::istringstream text(grasp.substr(kBegin.size()));
  Vec2 at;
  char comma = ' ', bracket = ' ';
  if (!(text >> at.x() >> comma >> at.y() >> bracket) || comma != ',' || bracket != ')' || !(text >> std::ws).eof() ||
      !at.allFinite())
    must_be(key, "nearest(x, y) with two numbers, m, or a named vertex");
  return at;
}

/// The vertices that the hands take. @param start where the cloth lies.
std::vector<Index> grasped_vertices(const std::vector<std::string>& grasp, const ConfigNode& origin,
                                    const Garment& garment, const Positions& start) {
  std::vector<Index> vertices;
  for (std::size_t i = 0; i < grasp.size(); ++i) {
    const ConfigNode key = place(origin, "manipulation.grasp." + std::to_string(i));
    const auto at = nearest_place(grasp[i], key);
    const Index vertex =
        at ? nearest_seen_vertex(start, garment.faces, *at) : blaming(key, [&] { return garment.vertex(grasp[i]); });
    if (std::find(vertices.begin(), vertices.end(), vertex) != vertices.end())
      key.fail("= " + grasp[i] + " is vertex " + std::to_string(vertex) + ", which another hand holds already");
    vertices.push_back(vertex);
  }
  return vertices;
}

/// Manipulation::opens_at, of so many hands.
Vector opening(const std::vector<double>& opens_at, const ConfigNode& origin, Index hands) {
  if (opens_at.empty()) return {};
  const auto at_the_end = std::count(opens_at.begin(), opens_at.end(), 1.0);
  if (std::ssize(opens_at) != hands || at_the_end == 0)
    must_be(place(origin, "manipulation.opens_at"),
            "one number for each of the hands (" + std::to_string(hands) + "), at least one of which is 1");
  if (at_the_end == hands) return {};
  return Eigen::Map<const Vector>(opens_at.data(), std::ssize(opens_at));
}

}  // namespace

Task make_task(const TaskParams& params, const ConfigNode& origin, Host& host,
               std::shared_ptr<const StartShape> start) {
  Task task;
  task.garment =
      std::make_shared<const Garment>(read_garment(params.garment.is_null() ? origin.at("garment") : params.garment));
  task.material = read_material_space(params.material.is_null() ? origin.at("material") : params.material);
  task.trajectory = host.create<Trajectory>(params.trajectory);
  task.simulator = params.simulator;
  task.settle = {params.settle.speed_m_per_s, params.settle.hold_frames, params.settle.max_frames};
  require_shape("task: gravity", params.scene.gravity_m_per_s2.size(), 3);
  task.scene.gravity = Eigen::Map<const Eigen::Vector3d>(params.scene.gravity_m_per_s2.data());
  task.scene.ground_height = read_ground(params.scene.ground);
  task.scene.obstacles = read_obstacles(params.scene.obstacles, task.scene.ground_height);

  task.start = std::move(start);
  if (!task.start && !params.start.session.empty())
    task.start = blaming(place(origin, "start.session"), [&] {
      return std::make_shared<const StartShape>(read_start(params.start.session, *task.garment));
    });

  auto& manipulation = task.manipulation;
  if (std::ssize(params.manipulation.grasp) != task.trajectory->hands()) {
    const auto hands = std::to_string(task.trajectory->hands());
    must_be(place(origin, "manipulation.grasp"),
            hands == "1" ? "1 named vertex: the trajectory drives 1 hand"
                         : hands + " named vertices: the trajectory drives " + hands + " hands");
  }
  // All fabrics share one path, so the targets must clear the ground with the thickest one.
  const auto& thickness = task.material.ranges[3];
  const double thickest = std::max(thickness.low, thickness.high);
  const Positions lying = known_start(task, thickest, origin);
  manipulation.grasp_vertices = grasped_vertices(params.manipulation.grasp, origin, *task.garment, lying);
  manipulation.opens_at = opening(params.manipulation.opens_at, origin, task.trajectory->hands());
  manipulation.grasp_points.resize(task.trajectory->hands(), 3);
  const Positions& shape = task.start ? task.start->shape : task.garment->positions;
  for (Index hand = 0; hand < task.trajectory->hands(); ++hand)
    manipulation.grasp_points.row(hand) = shape.row(manipulation.grasp_vertices[hand]);
  const ConfigNode displacement = place(origin, "manipulation.displacement_m");
  const std::string remedy = "; its direction is that of the fold, and `weft displacement` tunes its length";
  if (params.manipulation.displacement_m.empty()) must_be(displacement, "a list of 2 numbers, m" + remedy);
  require_shape("task: displacement", params.manipulation.displacement_m.size(), 2);
  manipulation.displacement = Eigen::Map<const Eigen::Vector2d>(params.manipulation.displacement_m.data());
  manipulation.drop_height = params.manipulation.drop_height_m;
  manipulation.contact_height = task.scene.ground_height.value_or(0.0) + thickest;
  if (task.start) {
    manipulation.contact_height = std::max(manipulation.contact_height, manipulation.grasp_points.col(2).maxCoeff());
  } else if (!task.scene.obstacles.empty()) {
    manipulation.contact_height = lying(manipulation.grasp_vertices.front(), 2);
    for (const Index vertex : manipulation.grasp_vertices)
      manipulation.contact_height = std::max(manipulation.contact_height, lying(vertex, 2));
  }
  manipulation.grasp_points.col(2).setConstant(manipulation.contact_height);
  task.hands = read_limits(params.manipulation.limits, place(origin, "manipulation.limits"), manipulation.grasp_points);
  try {
    task.trajectory->initial_state(manipulation);  // refuses a bad manipulation, such as |d| = 0, before any work
  } catch (const ConfigError& error) {
    fail_because(displacement, error.what() + remedy);
  }
  return task;
}

void check_simulator(const ConfigNode& slot, const Task& task, Host& host) {
  for (const auto& warning : garment_warnings(*task.garment)) host.log(LogLevel::warning, warning);
  const auto simulator = host.create<Simulator>(slot);
  const Fabric fabric = task.material.at(MaterialProperties::Constant(0.5));
  simulator->reset(task.garment, fabric, task.scene);
  for (const auto& warning : simulator_warnings(*simulator, fabric, task.scene))
    host.log(LogLevel::warning, warning + " (fabric in the middle of its range)");
}

}  // namespace weft
