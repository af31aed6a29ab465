#pragma once
#include <filesystem>
#include <functional>
#include <string>

#include "session/estimator.hpp"
#include "session/observation.hpp"
#include "session/planner.hpp"
#include "session/session_file.hpp"
#include "simulation/random_controls.hpp"
#include "simulation/task_config.hpp"

namespace weft {

/// Where a plan is carried out: a simulator, or a robot.
class Environment {
 public:
  virtual ~Environment() = default;
  virtual Observation observe() = 0;
  /// Moves the held vertices along the segment. @throws Diverged and the like.
  virtual void execute(const SegmentPath& path) = 0;
  /// Lets go and waits until the cloth lies still.
  virtual SettleResult release() = 0;
};

/// What a session sees of the cloth.
struct ObservationParams {
  double noise_m = 0.0;
  double height_bias_m = 0.0;
  double hidden_share = 0.0;
  double lost_share = 0.0;

  template <class Visitor>
  void visit(Visitor& v) {
    v("noise_m", noise_m, range(0, 1, "m"), "Standard deviation of Gaussian noise on every coordinate that is seen.");
    v("height_bias_m", height_bias_m, range(0, 1, "m"),
      "Standard deviation of an error that all heights of a session share: how well the sensor knows the table.");
    v("hidden_share", hidden_share, range(0, 0.99), "Share of the vertices that are never seen, drawn from the seed.");
    v("lost_share", lost_share, range(0, 0.99), "Share of the vertices that an observation misses, drawn each time.");
  }
};

/// A shape as it is seen. @param number of the observation in the session: it draws the same numbers whatever went
/// before. @param seed of noise and of what stays hidden.
Observation observe_shape(const Positions& shape, const ObservationParams& params, std::uint64_t seed,
                          std::uint64_t number);
/// The start shape, what was not seen filled from the flat garment at the height at which the rest lies.
std::shared_ptr<const Positions> filled_start(const Task& task, const Observation& seen);

/// The first environment: a simulator with the true material. Records every frame it simulates.
class SimulatorEnvironment final : public Environment {
 public:
  /// @param seed as in observe_shape.
  SimulatorEnvironment(std::shared_ptr<Simulator> simulator, const Task& task, const MaterialProperties& material,
                       const ObservationParams& params = {}, std::uint64_t seed = 0);
  Observation observe() override;
  const Positions& positions() const { return simulator_->positions(); }  ///< the truth
  void execute(const SegmentPath& path) override;
  SettleResult release() override;
  /// [frames][V * 3], single precision: the start, 12 per executed segment, and every frame of the settling.
  const std::vector<std::vector<float>>& frames() const { return frames_; }
  double seconds() const { return seconds_; }
  double max_grasp_strain() const { return max_grasp_strain_; }
  std::string warning() const { return simulator_->diagnostics().warning; }

 private:
  void record();
  std::shared_ptr<Simulator> simulator_;
  SettleCriterion settle_;
  ObservationParams params_;
  std::uint64_t seed_ = 0, observations_ = 0;
  std::vector<std::vector<float>> frames_;
  double seconds_ = 0.0;
  double max_grasp_strain_ = 0.0;
};

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
    v("material", material, range(0, 1), "Material under which controls are simulated; default: the true one.",
      property_list());
    v("horizon", horizon, range(1, 200, "segments"),
      "Longest trajectory of a simulated goal and of the default control; apart from planning.horizon, so that "
      "planners "
      "with another one get the same goal.");
  }
};

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
    v.group("observation", observation, "What is seen of the cloth.");
    v.group("goal", goal, "The shape to reach.");
    v("true_material", true_material, range(0, 1), "q of the executed fold; default: drawn from the seed.",
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

struct SessionResult {
  std::vector<SessionRound> rounds;
  Positions start, goal, final_shape, default_shape;  ///< [V, 3] m
  Controls goal_controls;                             ///< [k, C] of a goal that was simulated, else 0 rows
  MaterialProperties true_material = MaterialProperties::Zero();
  /// [rounds]: from everything up to the end of that round's segment; beyond the predictor's max_segments() the last
  /// one stays. Empty unless knowledge is `estimate`.
  std::vector<Estimate> estimates;
  double error_mm = 0.0, default_error_mm = 0.0;
  bool released = false;
  SettleResult settle;
  double simulate_seconds = 0.0;
  double max_grasp_strain = 0.0;
  std::vector<std::vector<float>> frames;
  std::vector<std::string> warnings;
};

/// Called after every round, for progress.
using SessionProgress = std::function<void(const SessionRound&, Index round, double error_to_goal_mm)>;

/// Runs one whole session: plan, execute one segment, observe, re-plan, ..., release, settle (section 4); with
/// knowledge: estimate the material is estimated after every segment (section 5), beside planning and execution. Which
/// estimate a plan uses is fixed by knowledge_lag and never by timing.
/// @throws ConfigError, PluginError before any work starts; Error when planning or the simulation fails.
SessionResult run_session(const SessionParams& params, const ConfigNode& origin, Host& host,
                          const SessionProgress& progress = {});

/// One plan, not executed.
struct LonePlan {
  Plan plan;
  MaterialKnowledge knowledge;  ///< what it was made with
  Positions goal;               ///< [V, 3] m
};
/// `weft plan`: the first plan of the session that `params` describe, or, of a recorded one, the plan before a segment
/// from what was seen by then, at the knowledge of then (knowledge: true: at the recorded material).
/// @param recorded null: a fresh one. @param segment 1-based.
/// @throws ConfigError for another garment or a segment that the session does not have; as run_session().
LonePlan plan_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded, Index segment,
                    Host& host);

/// A manipulation that was carried out: what is observed of it again.
struct Replay {
  std::vector<Positions> shapes;  ///< [k + 1] of [V, 3] m: at the start and after every segment
  Vector state;                   ///< [S] at the start
  Controls controls;              ///< [k, C]
};
/// Estimates after every segment, [k], as a session with `knowledge: estimate` makes them (section 5). Beyond the
/// predictor's max_segments() the last one stays.
/// @param seed of the observations' noise and of the searches. @throws ShapeError; as Estimator::estimate().
std::vector<Estimate> replay_estimates(const Estimator& estimator, const Task& task,
                                       const ObservationParams& observation, const Replay& replay, std::uint64_t seed,
                                       Host& host);
struct LoneEstimates {
  std::vector<Estimate> estimates;  ///< [segments]
  MaterialProperties true_material = MaterialProperties::Zero();
};
/// `weft estimate`: the material after every segment of a recorded session, or of the default control under the
/// session's true material. @param recorded null: the default control.
/// @throws ConfigError for another garment; as replay_estimates().
LoneEstimates estimate_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded,
                             Host& host);

/// summary.json: the keys of docs/file-formats.md.
std::string session_summary_json(const SessionResult& result);
/// session.h5. @param resolved the resolved config; @param provenance version, commit, plugins.
void write_session(const std::filesystem::path& file, const SessionResult& result, const Task& task,
                   const ConfigNode& resolved, const std::string& provenance);

}  // namespace weft
