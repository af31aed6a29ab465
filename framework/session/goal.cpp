#include "session/goal.hpp"

#include <algorithm>

#include "loader/where.hpp"
#include "meshes/import/mesh_file.hpp"
#include "meshes/import/triangulate.hpp"
#include "simulation/fold.hpp"
#include "weft/config.hpp"
#include "weft/hdf5_file.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kGoalStream = stream_key("goal");

Positions final_shape_of(const std::filesystem::path& session_file, const Garment& garment) {
  const auto file = Hdf5File::open(session_file);
  const auto hash = file.read_text("/garment/hash");
  if (hash != std::to_string(garment.hash)) {
    throw ConfigError(session_file.string() + ": was recorded with another garment (hash " + hash + ", this one has " +
                      std::to_string(garment.hash) + ")");
  }
  return file.read_positions("/final_shape");
}

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
    const Mesh mesh = to_mesh(triangulate_file(file.polygons, params.mesh.string(), findings));
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
  std::vector<std::string> possible = {"mean", "expected", "chamfer", "silhouette"};
  if (given == "goal.mesh") possible = {"chamfer", "silhouette"};
  if (given == "goal.points") possible = {"chamfer"};
  if (given == "goal.mask") possible = {"silhouette"};
  if (std::find(possible.begin(), possible.end(), loss) != possible.end()) return;
  const std::string wanted = possible.size() == 1 ? possible[0] : "chamfer or silhouette";
  place(origin, "planning.loss")
      .fail("= " + loss + " cannot compare the cloth with " + given + ", whose points are not the garment's; use " +
            wanted);
}

}  // namespace

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
  if (!params.controls.is_null()) given.push_back("goal.controls");
  if (given.empty()) return goal;
  const ConfigNode node = place(origin, given.back() == "goal.mask" ? "goal.mask.file" : given.back());
  if (given.size() > 1) {
    node.fail("is given together with " + given.front() +
              "; give at most one of obj, example, mesh, points, mask and controls");
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
  goal.shape = blaming(node, [&] {
    return params.obj.empty() ? final_shape_of(params.example, *task.garment) : read_obj(params.obj).positions;
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
  const Index horizon = params.horizon;
  goal.default_shape = simulate_fold(*reference, task, material, trajectory.default_controls(horizon)).shapes.back();
  if (goal.controls.rows() > 0) {
    goal.shape = simulate_fold(*reference, task, goal_material, goal.controls).shapes.back();
  } else if (goal.shape.rows() == 0 && !goal.surface) {
    const auto& random_goal = params.random;
    for (std::int64_t attempt = 0; attempt < random_goal.attempts && goal.shape.rows() == 0; ++attempt) {
      RandomStream random = RandomStream(seed, kGoalStream).child(static_cast<std::uint64_t>(attempt));
      const Controls controls = random_controls(trajectory, horizon, random_goal.distribution, random);
      FoldResult fold;
      try {
        fold = simulate_fold(*reference, task, goal_material, controls);
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
