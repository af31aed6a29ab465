#include "session/goal.hpp"

#include <algorithm>

#include "loader/where.hpp"
#include "meshes/import/mesh_file.hpp"
#include "meshes/import/triangulate.hpp"
#include "meshes/import/units.hpp"
#include "session/placed_goal.hpp"
#include "simulation/fold.hpp"
#include "simulation/hand_limits.hpp"
#include "simulation/start_shape.hpp"
#include "weft/config.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kGoalStream = stream_key("goal");

std::shared_ptr<const GoalSurface> surface_of(const Positions& shape, const std::string& loss, const Task& task) {
  const GoalKind kind = loss == "silhouette" ? GoalKind::silhouette : GoalKind::surface;
  return std::make_shared<const GoalSurface>(kind, shape, task.garment->faces, *task.garment);
}

/// A goal that is a file without correspondence.
std::shared_ptr<const GoalSurface> read_surface(const GoalParams& params, const std::string& loss, const Task& task) {
  Positions positions;
  Faces faces;
  GoalKind kind = loss == "silhouette" ? GoalKind::silhouette : GoalKind::surface;
  if (!params.mask.file.empty()) {
    require_shape("goal.mask.origin_m", params.mask.origin_m.size(), 2);
    read_mask(params.mask.file, params.mask.metres_per_pixel,
              Eigen::Map<const Eigen::Vector2d>(params.mask.origin_m.data()), positions, faces);
  } else if (!params.points.empty()) {
    kind = GoalKind::points;
    positions = read_points(params.points);
  } else {
    Findings findings;
    const MeshFile file = read_mesh_file(params.mesh, findings);
    ImportMesh triangles = triangulate_file(file.polygons, params.mesh.string(), findings);
    // A goal lies where it is wanted: metres, z up, but for glTF, which is y up by its definition.
    to_metres_z_up(triangles, {file.frame.units.value_or("m"), file.frame.up.value_or("z"), "a goal"}, findings);
    const Mesh mesh = to_mesh(triangles);
    positions = mesh.positions;
    faces = mesh.faces;
  }
  constexpr double kFar = 10.0;  // m
  if (positions.cwiseAbs().maxCoeff() > kFar)
    throw ConfigError("reaches " + ConfigNode::number(positions.cwiseAbs().maxCoeff()).as_string() +
                      " m from the origin, must be within 10 m: are its units metres?");
  return std::make_shared<const GoalSurface>(kind, positions, faces, *task.garment);
}

/// Refuses a loss that cannot compare a cloth with this goal. @param given key of the goal.
void check_loss(const std::string& loss, const std::string& given, const ConfigNode& origin) {
  std::vector<std::string> possible = {"mean", "expected", "chamfer", "silhouette", "coverage"};
  if (given == "goal.edge") possible = {"mean", "expected"};
  if (given == "goal.mesh") possible = {"chamfer", "silhouette"};
  if (given == "goal.points") possible = {"chamfer"};
  if (given == "goal.mask") possible = {"silhouette"};
  if (std::find(possible.begin(), possible.end(), loss) != possible.end()) return;
  const std::string wanted = possible.size() == 1 ? possible[0] : possible[0] + " or " + possible[1];
  const std::string reason =
      given == "goal.edge" ? ", of which only the edge counts" : ", whose points are not the garment's";
  place(origin, "planning.loss")
      .fail("= " + loss + " cannot compare the cloth with " + given + reason + "; use " + wanted);
}

}  // namespace

PlannerParams planning_for(PlannerParams params, const SessionGoal& goal) {
  if (!params.vertices.empty() || !params.vertex_weights.empty()) return params;
  for (std::size_t v = 0; v < goal.counts.size(); ++v)
    if (goal.counts[v]) params.vertices.push_back(static_cast<double>(v));
  return params;
}

PropertyVector property_vector(const std::vector<double>& values) {
  require_shape("material properties", values.size(), 4);
  return Eigen::Map<const Eigen::Vector4d>(values.data());
}

Controls read_controls(const ConfigNode& node, const Trajectory& trajectory, Index horizon) {
  const auto variables = trajectory.controls();
  const Index columns = variables.size();
  if (!node.is_sequence() || node.size() == 0)
    must_be(node, "a list of rows of " + std::to_string(columns) + " numbers");
  const auto read_row = [&](const ConfigNode& row) {
    if (std::ssize(row) != columns) {
      row.fail("has " + std::to_string(row.size()) + " numbers, must have " + std::to_string(columns));
    }
    Vector values(columns);
    for (Index c = 0; c < columns; ++c) {
      const auto& variable = variables[c];
      const ConfigNode entry = row[c];
      values(c) = entry.as_double();
      if (!(values(c) >= variable.lower && values(c) <= variable.upper)) {
        must_be(entry, "in [" + ConfigNode::number(variable.lower).as_string() + ", " +
                           ConfigNode::number(variable.upper).as_string() + "] " + variable.unit + " (" +
                           variable.name + ")");
      }
    }
    return values;
  };
  if (node[0].is_scalar()) {
    Controls controls(horizon, columns);
    controls.rowwise() = read_row(node).transpose();
    return controls;
  }
  Controls controls(node.size(), columns);
  for (Index j = 0; j < controls.rows(); ++j) controls.row(j) = read_row(node[j]).transpose();
  return controls;
}

SessionGoal read_goal(const GoalParams& params, const std::string& loss, const ConfigNode& origin, const Task& task) {
  SessionGoal goal;
  std::vector<std::string> given;
  if (!params.obj.empty()) given.push_back("goal.obj");
  if (!params.example.empty()) given.push_back("goal.example");
  if (!params.mesh.empty()) given.push_back("goal.mesh");
  if (!params.points.empty()) given.push_back("goal.points");
  if (!params.mask.file.empty()) given.push_back("goal.mask");
  if (!params.flat.move_m.empty()) given.push_back("goal.flat");
  if (!params.edge.vertices.empty()) given.push_back("goal.edge");
  if (!params.controls.is_null()) given.push_back("goal.controls");
  const GoalParams::Mask unset;
  if (params.mask.file.empty() &&
      (params.mask.metres_per_pixel != unset.metres_per_pixel || params.mask.origin_m != unset.origin_m))
    place(origin, "goal.mask").fail("has no file: goal.mask.file names the PNG");
  if (given.empty()) return goal;
  const ConfigNode node = place(origin, given.back() == "goal.mask" ? "goal.mask.file" : given.back());
  if (given.size() > 1) {
    node.fail("is given together with " + given.front() +
              "; give at most one of obj, example, mesh, points, mask, flat, edge and controls");
  }
  check_loss(loss, given.front(), origin);
  if (!params.mesh.empty() || !params.points.empty() || !params.mask.file.empty()) {
    goal.surface = blaming(node, [&] { return read_surface(params, loss, task); });
    return goal;
  }
  if (!params.controls.is_null()) {
    goal.controls = read_controls(params.controls, *task.trajectory, params.horizon);
    return goal;
  }
  if (!params.flat.move_m.empty()) return goal;  // its height is that of the cloth, which is not known yet
  if (!params.edge.vertices.empty()) {
    if (params.edge.vertices.size() != 2) must_be(place(origin, "goal.edge.vertices"), "2 names of vertices");
    if (params.edge.to_m.empty()) must_be(place(origin, "goal.edge.to_m"), "a list of 6 numbers, m");
    EdgeGoal edge = blaming(place(origin, "goal.edge.vertices"), [&] {
      return edge_goal(*task.garment, {params.edge.vertices[0], params.edge.vertices[1]},
                       Eigen::Map<const Positions>(params.edge.to_m.data(), 2, 3));
    });
    goal.shape = std::move(edge.shape);
    goal.counts = std::move(edge.counts);
    return goal;
  }
  goal.shape = blaming(node, [&] {
    return params.obj.empty() ? open_recorded(params.example, *task.garment).read_positions("/final_shape")
                              : read_obj(params.obj).positions;
  });
  if (goal.shape.rows() != task.garment->vertex_count()) {
    fail_because(node, "has " + std::to_string(goal.shape.rows()) + " vertices, must have the garment's " +
                           std::to_string(task.garment->vertex_count()));
  }
  return goal;
}

SessionGoal make_goal(SessionGoal given, const GoalParams& params, const std::string& loss, const Task& task,
                      std::uint64_t seed, const std::optional<MaterialProperties>& true_material, Host& host) {
  const Step step("making the goal");
  const auto& trajectory = *task.trajectory;
  SessionGoal goal = std::move(given);
  std::optional<MaterialProperties> chosen;
  if (!params.material.empty()) chosen = property_vector(params.material);
  const MaterialProperties fallback = chosen.value_or(MaterialProperties::Constant(0.5));
  const MaterialProperties material = true_material.value_or(fallback);
  const MaterialProperties goal_material = chosen.value_or(material);
  const auto reference = host.create<Simulator>(task.simulator);
  const auto fold_with = [&](const MaterialProperties& properties, const Controls& controls) {
    return simulate_fold(*reference, task, properties, controls, [&host] { return host.cancelled(); });
  };
  const Index horizon = params.horizon;
  const Vector initial = trajectory.initial_state(task.manipulation);
  const Controls default_controls = within_limits(task, initial, {}, trajectory.default_controls(horizon)).controls;
  goal.default_shape = fold_with(material, default_controls).shapes.back();
  if (!params.flat.move_m.empty()) {
    goal.shape = flat_goal(task, {params.flat.move_m[0], params.flat.move_m[1]}, params.flat.turn_deg,
                           task.material.at(goal_material).thickness_m);
  } else if (goal.controls.rows() > 0) {
    goal.shape = fold_with(goal_material, goal.controls).shapes.back();
  } else if (goal.shape.rows() == 0 && !goal.surface) {
    const auto& random_goal = params.random;
    for (std::int64_t attempt = 0; attempt < random_goal.attempts && goal.shape.rows() == 0; ++attempt) {
      RandomStream random = RandomStream(seed, kGoalStream).child(static_cast<std::uint64_t>(attempt));
      const Controls controls =
          within_limits(task, initial, {}, random_controls(trajectory, horizon, random_goal.distribution, random))
              .controls;
      FoldResult fold;
      try {
        fold = fold_with(goal_material, controls);
      } catch (const Diverged& error) {
        host.log(LogLevel::warning, std::string("a goal candidate was skipped: ") + error.what());
        continue;
      }
      if (!fold.released || mean_distance_mm(fold.shapes.back(), goal.default_shape) < random_goal.min_distance_mm)
        continue;
      goal.shape = fold.shapes.back();
      goal.controls = controls.topRows(fold.segments);
    }
    if (goal.shape.rows() == 0) {
      throw Error("goal: none of " + std::to_string(random_goal.attempts) + " random trajectories ended " +
                  std::to_string(random_goal.min_distance_mm) + " mm or more from the result of the default control");
    }
  }
  if (!goal.surface && is_surface_loss(loss)) goal.surface = surface_of(goal.shape, loss, task);
  return goal;
}

}  // namespace weft
