#pragma once
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "session/environment.hpp"
#include "session/estimator.hpp"
#include "session/goal.hpp"
#include "session/observation.hpp"
#include "session/planner.hpp"
#include "simulation/task_config.hpp"

namespace weft {

/// A few iterations with a simulator as the predictor, after the network's plan.
struct RefinementParams {
  std::int64_t first = 0;
  std::int64_t plans = 0;
  std::int64_t iterations = 3;
  double scale = 0.1;
  ConfigNode predictor = ConfigNode::parse("{plugin: rollout}", "default");

  template <class Visitor>
  void visit(Visitor& v) {
    v("first", first, range(0, 1000),
      "Plans before those that are refined; with `knowledge: estimate` the first ones know nothing of the material.");
    v("plans", plans, range(0, 1000), "How many plans of a session are refined; 0: none.");
    v("iterations", iterations, range(0, 10000), "Optimiser iterations of a refinement.");
    v("scale", scale, range(1e-6, 1),
      "Typical change of a control in a refinement, as a part of its change in a first plan.");
    v("predictor", predictor, PluginSlot{"predictor"},
      "What is in the loop: the simulator, at the estimated material.");
  }
};

struct SessionParams {
  TaskParams task;
  ConfigNode predictor;
  ConfigNode optimiser = ConfigNode::parse("{plugin: rprop}", "default");
  ConfigNode estimation_optimiser = ConfigNode::parse("{plugin: rprop}", "default");
  PlannerParams planning;
  EstimatorParams estimation;
  RefinementParams refinement;
  EnvironmentParams environment;
  ObservationParams observation;
  GoalParams goal;
  std::vector<double> true_material;
  std::string knowledge = "true";
  std::vector<double> given_centre, given_width;
  double drawn_width = 0.1;
  std::int64_t knowledge_lag = 1;
  std::int64_t max_segments = 40;
  std::int64_t seed = 1;
  std::int64_t threads = 0;
  std::vector<std::string> plugin_path;
  std::string description;

  template <class Visitor>
  void visit(Visitor& v) {
    v("description", description, "What this task is, for people.", Decides::nothing);
    v("seed", seed, range(0, 9e18), "Seed of everything random.", Decides::examples);
    v("threads", threads, range(0, 1024), "Worker threads; 0: all cores.", Decides::nothing);
    v("plugin_path", plugin_path, "Folders searched for plugins first.", Decides::nothing);
    v.part(task, Decides::examples);
    v("predictor", predictor, PluginSlot{"predictor"}, "Predictor plugin that plans are made with.");
    v("optimiser", optimiser, PluginSlot{"optimiser"}, "Optimiser plugin.");
    v("estimation_optimiser", estimation_optimiser, PluginSlot{"optimiser"}, "Optimiser plugin of the estimates.");
    v.group("planning", planning, "Trajectory planning (section 4).");
    v.group("estimation", estimation, "Material estimation (section 5).");
    v.group("refinement", refinement, "The simulator in the loop, after the network's plan.");
    v.group("environment", environment, "Who executes the fold and sees the cloth.");
    v.group("observation", observation, "What is seen of the cloth.");
    v.group("goal", goal, "The shape to reach.");
    v("true_material", true_material, range(0, 1),
      "q of the executed fold; default: drawn from the seed, or, where a process executes it, unknown.",
      property_list());
    v("knowledge", knowledge, choice({"none", "true", "given", "drawn", "estimate"}),
      "What the planner knows of the material; estimate: what the session has shown so far.");
    v("given_centre", given_centre, range(0, 1), "knowledge: given: c.", property_list());
    v("given_width", given_width, range(0, 1), "knowledge: given: w.", property_list());
    v("drawn_width", drawn_width, range(0, 1),
      "knowledge: drawn: w of all properties; c is drawn uniformly from [q - w/2, q + w/2] (section 4).");
    v("knowledge_lag", knowledge_lag, range(0, 1000, "segments"),
      "knowledge: estimate: plan j uses what was seen up to segment j - knowledge_lag. From 1 on the estimate runs "
      "beside "
      "planning and execution; 0 waits for it.");
    v("max_segments", max_segments, range(1, 1000, "segments"),
      "End the session here even when no plan reached release.");
  }
};

/// Refuses what read_params() cannot see: lists that are missing, vertices that the garment lacks.
/// @param origin what params were read from. @throws ConfigError.
void check_session(const SessionParams& params, const ConfigNode& origin, const Task& task);

/// The task, and the refusals of check_session().
Task session_task(const SessionParams& params, const ConfigNode& origin, Host& host);
/// q of the executed fold: given, or drawn from the seed; nullopt where a process executes it and none is given.
std::optional<MaterialProperties> true_material_of(const SessionParams& params);
/// What is known before the first segment; `estimate`: nothing.
/// @throws ConfigError for knowledge `true` or `drawn` when the true material is not known.
MaterialKnowledge first_knowledge(const SessionParams& params, const ConfigNode& origin,
                                  const std::optional<MaterialProperties>& true_material);

/// Makes a predictor and binds it to the task. What is wrong with its model file is said of the key that names it.
/// @throws ConfigError, PluginError.
std::shared_ptr<Predictor> bound_predictor(const ConfigNode& slot, const Task& task, Host& host);

/// One round: plan, execute one segment, observe.
struct SessionRound {
  Plan plan;
  Vector state;                 ///< [S] before the segment
  MaterialKnowledge knowledge;  ///< what the plan was made with
  /// [V, 3] m, after the segment (settled if it was the last): as seen, what was not seen filled from the plan's
  /// prediction
  Positions observed;
  double refinement_seconds = 0.0;
};

/// Who plans and estimates in a session, what is known before it, and where it is to lead.
struct SessionSetup {
  Task task;
  std::unique_ptr<const Planner> planner;
  std::unique_ptr<const Planner> refiner;      ///< null: no plan is refined
  std::unique_ptr<const Estimator> estimator;  ///< null unless knowledge is `estimate`
  MaterialKnowledge knowledge;
  SessionGoal goal;
};

struct SessionResult {
  std::vector<SessionRound> rounds;
  /// Whether start, final_shape, frames and error_mm are true: the environment knows its shapes. false: they are what
  /// was observed. Vertices that were not seen are filled in the shapes, and do not count in error_mm.
  bool shapes_are_true = true;
  Positions start, goal, final_shape, default_shape;  ///< [V, 3] m
  Controls goal_controls;                             ///< [k, C] of a goal that was simulated, else 0 rows
  std::optional<MaterialProperties> true_material;
  /// [rounds]: from everything up to the end of that round's segment; beyond the predictor's max_segments() the last
  /// one stays. Empty unless knowledge is `estimate`.
  std::vector<Estimate> estimates;
  double error_mm = 0.0, default_error_mm = 0.0;
  bool released = false;
  SettleResult settle;
  double simulate_seconds = 0.0;  ///< s that the environment executed, the release included
  std::optional<double> max_grasp_strain;
  /// As Environment::frames(). Of an environment that sees nothing between two looks, each frame holds the look before
  /// it, and the settling is one frame.
  std::vector<std::vector<float>> frames;
  std::vector<std::string> warnings;
};

/// Called after every round, for progress.
using SessionProgress = std::function<void(const SessionRound&, Index round, double error_to_goal_mm)>;

/// Runs one whole session: plan, execute one segment, observe, re-plan, ..., release, settle (section 4); with
/// knowledge: estimate the material is estimated after every segment (section 5), beside planning and execution. Which
/// estimate a plan uses is fixed by knowledge_lag and never by timing.
/// @param environment at the start of a manipulation. @throws Error when planning or the environment fails.
SessionResult run_session(const SessionParams& params, const SessionSetup& setup, Environment& environment, Host& host,
                          const SessionProgress& progress = {});

/// The same with the environment, the goal and everybody else as the config says.
/// @param origin what params were read from. @throws ConfigError, PluginError before any work starts; as run_session().
SessionResult run_configured_session(const SessionParams& params, const ConfigNode& origin, Host& host,
                                     const SessionProgress& progress = {});

}  // namespace weft
