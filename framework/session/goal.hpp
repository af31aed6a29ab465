#pragma once
#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

#include "simulation/random_controls.hpp"
#include "simulation/task_config.hpp"
#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/task.hpp"

namespace weft {

/// Goal of a session: exactly one of the four.
struct GoalParams {
  std::filesystem::path obj;
  std::filesystem::path example;
  ConfigNode controls;
  struct Random {
    double min_distance_mm = 45.0;
    std::int64_t attempts = 200;
    RandomControlsParams distribution;
    template <class Visitor>
    void visit(Visitor& v) {
      v("min_distance_mm", min_distance_mm, range(0, 1000, "mm"),
        "Least mean distance from what the default control gives.");
      v("attempts", attempts, range(1, 100000), "Random trajectories to try before giving up.");
      v.group("distribution", distribution, "The random trajectories.");
    }
  } random;
  std::vector<double> material;
  std::int64_t horizon = 25;

  template <class Visitor>
  void visit(Visitor& v) {
    v("obj", obj, "A mesh of the garment in its goal shape.");
    v("example", example, "A recorded session (session.h5): its final shape.");
    v("controls", controls, "Controls to simulate: a list of rows, or one row repeated until release.");
    v.group("random", random, "A random trajectory's result; used when nothing else is given.");
    v("material", material, range(0, 1),
      "Material under which controls are simulated; default: the true one; where nobody knows it, 0.5 of each.",
      property_list());
    v("horizon", horizon, range(1, 200, "segments"),
      "Longest trajectory of a simulated goal and of the default control; apart from planning.horizon, so that "
      "planners with another one get the same goal.");
  }
};

struct SessionGoal {
  Positions shape;          ///< [V, 3] m
  Positions default_shape;  ///< [V, 3] m: what the default control gives
  Controls controls;        ///< [k, C] of a goal that was simulated, else 0 rows
};

/// q from a list of a config. @throws ShapeError unless it has four numbers.
PropertyVector property_vector(const std::vector<double>& values);

/// Rows of controls from the config: a list of rows, or one row that is repeated `horizon` times.
/// @return [k, C]. @throws ConfigError for a row of another length, a number out of the control's bounds.
Controls read_controls(const ConfigNode& node, const Trajectory& trajectory, Index horizon);

/// The goal as far as it is given: a shape, or controls, or neither. Simulates nothing.
/// @param origin what holds `goal`, for messages. @throws ConfigError.
SessionGoal read_goal(const GoalParams& params, const ConfigNode& origin, const Task& task);

/// Simulates what read_goal() left open: the goal, and what the default control gives.
/// @param given from read_goal(). @param seed draws a random goal.
/// @param true_material nullopt: nobody knows it. goal.material takes its place, or else the middle of every range.
/// @throws Error when no random trajectory gives a goal; Diverged.
SessionGoal make_goal(SessionGoal given, const GoalParams& params, const Task& task, std::uint64_t seed,
                      const std::optional<MaterialProperties>& true_material, Host& host);

}  // namespace weft
