#include "simulation/task_config.hpp"

#include <cmath>

#include "simulation/simulator_warnings.hpp"
#include "simulation/surroundings.hpp"
#include "weft/config.hpp"

namespace weft {

Length property_list() {
  std::string entries;
  for (const char* name : kPropertyNames) entries += (entries.empty() ? "" : ", ") + std::string(name);
  return {kPropertyNames.size(), entries};
}

Task make_task(const TaskParams& params, const ConfigNode& origin, Host& host) {
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
  task.scene.obstacles = read_obstacles(params.scene.obstacles);

  auto& manipulation = task.manipulation;
  if (std::ssize(params.manipulation.grasp) != task.trajectory->hands()) {
    const auto hands = std::to_string(task.trajectory->hands());
    must_be(place(origin, "manipulation.grasp"), hands + " named vertices: the trajectory drives " + hands + " hands");
  }
  manipulation.grasp_points.resize(task.trajectory->hands(), 3);
  for (std::size_t i = 0; i < params.manipulation.grasp.size(); ++i) {
    manipulation.grasp_vertices.push_back(blaming(place(origin, "manipulation.grasp." + std::to_string(i)),
                                                  [&] { return task.garment->vertex(params.manipulation.grasp[i]); }));
    manipulation.grasp_points.row(i) = task.garment->positions.row(manipulation.grasp_vertices.back());
  }
  const ConfigNode displacement = place(origin, "manipulation.displacement_m");
  const std::string remedy = "; its direction is that of the fold, and `weft displacement` tunes its length";
  if (params.manipulation.displacement_m.empty()) must_be(displacement, "a list of 2 numbers, m" + remedy);
  require_shape("task: displacement", params.manipulation.displacement_m.size(), 2);
  manipulation.displacement = Eigen::Map<const Eigen::Vector2d>(params.manipulation.displacement_m.data());
  manipulation.drop_height = params.manipulation.drop_height_m;
  // All fabrics share one path, so the targets must clear the ground with the thickest one.
  const auto& thickness = task.material.ranges[3];
  const double thickest = std::max(thickness.low, thickness.high);
  manipulation.contact_height = task.scene.ground_height.value_or(0.0) + thickest;
  if (!task.scene.obstacles.empty()) {
    const Positions start =
        blaming(place(origin, "scene.obstacles"), [&] { return start_positions(*task.garment, task.scene, thickest); });
    manipulation.contact_height = start(manipulation.grasp_vertices.front(), 2);
    for (const Index vertex : manipulation.grasp_vertices)
      manipulation.contact_height = std::max(manipulation.contact_height, start(vertex, 2));
  }
  manipulation.grasp_points.col(2).setConstant(manipulation.contact_height);
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
