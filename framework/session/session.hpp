#pragma once
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <string>

#include "session/environment.hpp"
#include "session/estimate_chain.hpp"
#include "session/goal.hpp"
#include "session/observation.hpp"
#include "session/plan_chain.hpp"
#include "session/planner.hpp"
#include "session/shape_errors.hpp"
#include "session/world.hpp"
#include "simulation/hand_limits.hpp"
#include "simulation/task_config.hpp"

namespace weft {

struct SessionParams {
  TaskParams task;
  ConfigNode predictor;
  ConfigNode optimiser = ConfigNode::parse("{plugin: rprop}", "default");
  ConfigNode estimation_optimiser = ConfigNode::parse("{plugin: rprop}", "default");
  PlannerParams planning;
  EstimatorParams estimation;
  CorrectionParams correction;
  EnvironmentParams environment;
  ObservationParams observation;
  GoalParams goal;
  WorldParams world;
  std::vector<double> true_material;
  std::string knowledge = "true";
  std::string prior = "none";
  std::vector<double> given_centre, given_width;
  std::vector<std::string> unknown;
  double drawn_width = 0.1;
  std::int64_t knowledge_lag = 1;
  std::int64_t max_segments = 40;
  std::int64_t trials = 1;
  ConfigNode manipulations;
  std::int64_t seed = 1;
  std::int64_t threads = 0;
  std::vector<std::string> plugin_path;
  std::string description;

  template <class Visitor>
  void visit(Visitor& v) {
    v("description", description, "A description of the task for people.", Decides::nothing);
    v("seed", seed, range(0, 9e18), "Seed of all random numbers.", Decides::examples);
    v("threads", threads, range(0, 1024), "Worker threads; 0: as many as the processors that weft may use.",
      Decides::nothing);
    v("plugin_path", plugin_path, "Folders searched for plugins first.", Decides::nothing);
    v.part(task, Decides::examples);
    v("predictor", predictor, PluginSlot{"predictor"}, "Predictor plugin for plans and estimates.");
    v("optimiser", optimiser, PluginSlot{"optimiser"}, "Optimiser plugin of the plans.");
    v("estimation_optimiser", estimation_optimiser, PluginSlot{"optimiser"}, "Optimiser plugin of the estimates.");
    v.group("planning", planning, "Trajectory planning (section 4).");
    v.group("estimation", estimation, "Material estimation (section 5).");
    v.group("correction", correction, "Corrects plans by simulations.");
    v.group("environment", environment, "Executes the fold and observes the cloth.");
    v.group("observation", observation, "Errors and gaps of the observations.");
    v.group("goal", goal, "The shape to reach.");
    v.group("world", world, "Where the world differs from the task.");
    v("true_material", true_material, range(0, 1),
      "q of the executed fold; default: drawn from the seed, or unknown if a process executes it.", property_list());
    v("knowledge", knowledge, choice({"none", "true", "given", "drawn", "estimate"}),
      "Knowledge of the material for the plans; estimate: estimated from the session so far.");
    v("prior", prior, choice({"none", "given", "drawn"}),
      "knowledge: estimate: what is known before the first estimate. The plans use it until an estimate is narrower, and the "
      "estimates start from it; those of `weft evaluate estimation` start without.");
    v("given_centre", given_centre, range(0, 1), "knowledge or prior given: c.", property_list());
    v("given_width", given_width, range(0, 1), "knowledge or prior given: w.", property_list());
    v("unknown", unknown,
      "Properties of which the plans know nothing, such as [bend], while `knowledge` or `prior` holds for the others. "
      "Not where nothing is known anyway.");
    v("drawn_width", drawn_width, range(0, 1),
      "knowledge or prior drawn: w of all properties; c is drawn uniformly from [q - w/2, q + w/2] (section 4).");
    v("knowledge_lag", knowledge_lag, range(0, 1000, "segments"),
      "knowledge: estimate: plan j uses the observations up to segment j - knowledge_lag. From 1 on the estimate runs "
      "in parallel to planning and execution; 0 waits for it.");
    v("trials", trials, range(1, 1000),
      "Times that the same cloth is folded, flat at the beginning of each. With corrections a trial begins with the plan of the "
      "one before, and corrects it by what then happened, not only by the simulation. With knowledge: estimate it begins "
      "with the estimate of the one before. Results are those of the last one.");
    v("manipulations", manipulations,
      "Folds that follow one another: a list of mappings with the keys in which each differs from the session: manipulation, "
      "trajectory, goal, planning, correction, max_segments.");
    v("max_segments", max_segments, range(1, 1000, "segments"),
      "The session ends after this many segments, even without a release.");
  }
};

/// Checks that read_params() cannot make: missing lists, vertices that the garment does not have.
/// @param origin the node that params were read from. @throws ConfigError.
void check_session(const SessionParams& params, const ConfigNode& origin, const Task& task);

/// Makes the task and runs check_session().
Task session_task(const SessionParams& params, const ConfigNode& origin, Host& host,
                  std::shared_ptr<const StartShape> start = nullptr);
/// q of the executed fold: given, or drawn from the seed. nullopt if a process executes the fold and q is not given.
std::optional<MaterialProperties> true_material_of(const SessionParams& params);
/// The knowledge before the first segment; for `estimate` the prior.
/// @throws ConfigError for `true` or `drawn` if the true material is unknown.
MaterialKnowledge first_knowledge(const SessionParams& params, const ConfigNode& origin,
                                  const std::optional<MaterialProperties>& true_material);

/// Makes every part of a session of this config and drops it, so that errors show before any work.
/// @throws what making the parts throws.
void rehearse_session(const SessionParams& params, const ConfigNode& origin, Host& host);

/// Makes a predictor and binds it to the task.
/// @throws ConfigError, PluginError. Errors in a model file are reported at the config key that names the file.
std::shared_ptr<Predictor> bound_predictor(const ConfigNode& slot, const Task& task, Host& host);

/// How a trial, or a step of several folds, ended.
struct TrialRecord {
  double error_mm = 0.0, chamfer_mm = 0.0;  ///< as in SessionResult
  double coverage = 0.0;                    ///< ShapeErrors::coverage
  double predicted_error_mm = 0.0;          ///< of the last plan, before it was over
  Index segments = 0;
  bool released = false;
};

/// One round: plan, execute one segment, observe.
struct SessionRound {
  Plan plan;
  Vector state;                 ///< [S] before the segment
  MaterialKnowledge knowledge;  ///< the plan's input
  /// [V, 3] m, observed after the segment (settled if it was the last). Unseen vertices are the plan's prediction.
  Positions observed;
  std::optional<CorrectionRecord> correction;  ///< the correction that ended before this segment
  /// Wall time of all that made the plan.
  double seconds() const { return correction ? correction->seconds : plan.seconds; }
};

/// Planner, estimator, first knowledge and goal of a session.
struct SessionSetup {
  Task task;
  std::shared_ptr<const Planner> planner;
  std::shared_ptr<const Twin> twin;                   ///< null: no plan is corrected
  std::unique_ptr<const SessionEstimator> estimator;  ///< null unless knowledge is `estimate`
  MaterialKnowledge knowledge;
  SessionGoal goal;
};

struct SessionResult {
  std::vector<SessionRound> rounds;
  /// true: start, final_shape, frames and error_mm come from the environment's true shapes. false: they come from the
  /// observations. Unseen vertices are then filled in, and error_mm leaves them out.
  bool shapes_are_true = true;
  Positions start, final_shape, default_shape;  ///< [V, 3] m
  Positions goal;                               ///< [V, 3] m; 0 rows: the goal has no correspondence
  std::shared_ptr<const GoalSurface> surface;   ///< as SessionGoal::surface
  std::vector<bool> goal_counts;                ///< as SessionGoal::counts
  Controls goal_controls;                       ///< [k, C] of a goal that was simulated, else 0 rows
  std::optional<MaterialProperties> true_material;
  std::optional<WorldRecord> world;  ///< nullopt: the task's, or unknown
  /// [rounds]: the estimate after each round's segment. Beyond the predictor's max_segments() the last one stays. Empty
  /// unless knowledge is `estimate`.
  std::vector<Estimate> estimates;
  double error_mm = 0.0, default_error_mm = 0.0;  ///< mean vertex distance to the goal; NaN without correspondence
  /// GoalSurface::chamfer_mm() of final_shape and default_shape; NaN without a surface.
  double chamfer_mm = std::numeric_limits<double>::quiet_NaN();
  double default_chamfer_mm = std::numeric_limits<double>::quiet_NaN();
  ShapeErrors
      errors;  ///< of final_shape; NaN without correspondence, but for the IoU. Without true shapes the vertices count that the last observation saw.
  bool released = false;
  SettleResult settle;
  double simulate_seconds = 0.0;  ///< s in the environment's execute() and release()
  double cpu_seconds = 0.0;       ///< s of the whole session, without making its goal
  std::optional<double> max_grasp_strain;
  HandMotion hands;  ///< of the executed frames
  /// [G]: the number of segments after which each hand opened while others went on (Manipulation::opens_at); nullopt: it
  /// held to the end.
  std::vector<std::optional<Index>> opened_after;
  std::vector<TrialRecord> trials;  ///< all, this one too
  std::vector<TrialRecord> steps;   ///< of a sequence (run_sequence), this one too
  TrialRecord record() const;
  /// Segments, from 0, at whose beginning a correction started that was dropped (correction.time_budget_s).
  std::vector<Index> dropped_corrections;
  /// As Environment::frames(). If the environment has none, each frame holds the observation before it, and settling is
  /// one frame.
  std::vector<std::vector<float>> frames;
  std::vector<std::string> warnings;
};

/// Wall times of the plans against the time that there is: 2 s for the first plan, and for a later one the `lag` segments
/// that the hands move meanwhile, at least one.
struct PlanTimes {
  static constexpr double kFirst = 2.0;  ///< s
  double first = 0.0;                    ///< s, its correction included
  double later = 0.0;                    ///< s: 95th percentile of later plans or corrections
  double limit = 0.0;                    ///< s for a later one
  Index late = 0;                        ///< plans, the first included, that took longer
  Index plans = 0;
};
PlanTimes plan_times(const SessionResult& result, Index lag);

/// Called after every round, for progress. The error is error_mm; without correspondence chamfer_mm.
using SessionProgress = std::function<void(const SessionRound&, Index round, double error_to_goal_mm)>;

/// Runs one whole session: plan, execute one segment, observe, re-plan, ..., release, settle (section 4). With
/// `knowledge: estimate` the material is estimated after every segment (section 5), in parallel to planning and
/// execution. knowledge_lag, not timing, fixes which estimate a plan uses.
/// @param environment at the start of a manipulation. @throws Error if planning or the environment fails.
/// @param memory what the trial before taught; set to what this one taught if plans are corrected.
SessionResult run_session(const SessionParams& params, const SessionSetup& setup, Environment& environment, Host& host,
                          const SessionProgress& progress = {}, TrialMemory* memory = nullptr);

/// Makes the setup and the environment from the config and runs the session, as often as params.trials says, each time in a
/// new environment with the same cloth.
/// @param origin the node that params were read from.
/// @throws ConfigError, PluginError before any work starts; Error if it is cancelled before the first segment; as
/// run_session().
/// @param start where the cloth lies, in place of what the config says; null: as it says.
SessionResult run_configured_session(const SessionParams& params, const ConfigNode& origin, Host& host,
                                     const SessionProgress& progress = {},
                                     std::shared_ptr<const StartShape> start = nullptr);

}  // namespace weft
