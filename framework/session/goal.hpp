#pragma once
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "session/goal_surface.hpp"
#include "session/planner.hpp"
#include "simulation/random_controls.hpp"
#include "simulation/task_config.hpp"
#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/task.hpp"

namespace weft {

/// Goal of a session: exactly one of obj, example, mesh, points, mask, flat, edge, controls and random.
struct GoalParams {
  std::filesystem::path obj;
  std::filesystem::path example;
  std::filesystem::path mesh, points;
  struct Mask {
    std::filesystem::path file;
    double metres_per_pixel = 0.001;
    std::vector<double> origin_m = {0.0, 0.0};
    template <class Visitor>
    void visit(Visitor& v) {
      v("file", file, "A PNG of the goal as seen along -z; white is cloth. x grows to the right, y upwards.");
      v("metres_per_pixel", metres_per_pixel, range(1e-6, 1, "m"), "Edge of a pixel.");
      v("origin_m", origin_m, range(-100, 100, "m"), "x and y of the lower left corner of the picture.");
    }
  } mask;
  struct Flat {
    std::vector<double> move_m;
    double turn_deg = 0.0;
    template <class Visitor>
    void visit(Visitor& v) {
      v("move_m", move_m, range(-10, 10, "m"), "x and y: how far the flat garment is moved from its start.",
        Length{2, "x, y"});
      v("turn_deg", turn_deg, range(-360, 360, "deg"), "By how much it is turned about its middle.");
    }
  } flat;
  struct Edge {
    std::vector<std::string> vertices;
    std::vector<double> to_m;
    template <class Visitor>
    void visit(Visitor& v) {
      v("vertices", vertices, "Names of the ends of an open edge of the garment, whose vertices alone count.");
      v("to_m", to_m, range(-10, 10, "m"), "Where its ends are to lie; it is straight between them.",
        Length{6, "x, y, z of the first end, x, y, z of the second"});
    }
  } edge;
  ConfigNode controls;
  struct Random {
    double min_distance_mm = 45.0;
    std::int64_t attempts = 200;
    RandomControlsParams distribution;
    template <class Visitor>
    void visit(Visitor& v) {
      v("min_distance_mm", min_distance_mm, range(0, 1000, "mm"),
        "Smallest mean distance from the result of the default control.");
      v("attempts", attempts, range(1, 100000), "Random trajectories to try before giving up.");
      v.group("distribution", distribution, "The random trajectories.");
    }
  } random;
  std::vector<double> material;
  std::int64_t horizon = 25;

  template <class Visitor>
  void visit(Visitor& v) {
    v("obj", obj, "A mesh of the garment in its goal shape.");
    v("example", example, "A recorded session (session.h5); its final shape is the goal.");
    v("mesh", mesh,
      "A mesh of the goal shape with vertices of its own, .obj in metres with z up. Needs planning.loss chamfer or "
      "silhouette.");
    v("points", points, "Points of the goal shape: a .ply in metres with z up. Needs planning.loss chamfer.");
    v.group("mask", mask, "The goal as a picture from above. Needs planning.loss silhouette.");
    v.group("flat", flat, "The flat garment, elsewhere on the work surface.");
    v.group("edge", edge, "Where an edge of the garment is to lie.");
    v("controls", controls, "Controls to simulate: a list of rows, or one row repeated until release.");
    v.group("random", random, "The result of a random trajectory; used if no other goal is given.");
    v("material", material, range(0, 1),
      "Material for the simulation of a goal; default: the true material, or 0.5 each if it is unknown.",
      property_list());
    v("horizon", horizon, range(1, 200, "segments"),
      "Longest trajectory of a simulated goal and of the default control. It is not planning.horizon, so that planners "
      "with different horizons get the same goal.");
  }
};

struct SessionGoal {
  Positions shape;  ///< [V, 3] m; 0 rows: the goal has no correspondence
  /// A goal without correspondence, or what planning.loss chamfer or silhouette sees of `shape`; else null.
  std::shared_ptr<const GoalSurface> surface;
  Positions default_shape;   ///< [V, 3] m: the result of the default control
  Controls controls;         ///< [k, C] of a goal that was simulated, else 0 rows
  std::vector<bool> counts;  ///< [V]: vertices that count in errors and, by default, in the loss; empty: all
};

/// The planning of a goal of which only some vertices count: without planning.vertices, those.
PlannerParams planning_for(PlannerParams params, const SessionGoal& goal);

/// q from a list in a config. @throws ShapeError unless it has four numbers.
PropertyVector property_vector(const std::vector<double>& values);

/// Rows of controls from the config: a list of rows, or one row that is repeated `horizon` times.
/// @return [k, C]. @throws ConfigError for a row of the wrong length or a number outside the control's bounds.
Controls read_controls(const ConfigNode& node, const Trajectory& trajectory, Index horizon);

/// Reads the goal's shape, surface or controls, if given. Simulates nothing.
/// @param loss of planning. @param origin the node with `goal`, for messages.
/// @throws ConfigError, also for a loss that the goal does not have.
SessionGoal read_goal(const GoalParams& params, const std::string& loss, const ConfigNode& origin, const Task& task);

/// Simulates the goal, unless read_goal() has it, and the result of the default control.
/// @param given from read_goal(). @param loss of planning. @param seed of a random goal.
/// @param true_material nullopt: unknown; goal.material replaces it, or else the middle of every range.
/// @throws Error if no random trajectory gives a goal; Diverged.
SessionGoal make_goal(SessionGoal given, const GoalParams& params, const std::string& loss, const Task& task,
                      std::uint64_t seed, const std::optional<MaterialProperties>& true_material, Host& host);

}  // namespace weft
