#pragma once
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "session/goal_surface.hpp"
#include "session/search_end.hpp"
#include "weft/host.hpp"
#include "weft/optimiser.hpp"
#include "weft/params.hpp"
#include "weft/predictor.hpp"

namespace weft {

struct PlannerParams {
  std::int64_t instances = 16;
  std::int64_t iterations = 80;
  std::int64_t halvings = 3;
  bool replan = true;
  std::int64_t replan_iterations = 30;
  std::int64_t horizon = 25;
  std::int64_t leeway = 5;
  double noise = 1.0;
  double replan_noise = 0.3;
  double replan_scale = 1.0;
  double activity_weight = 1.0;
  double slowness_weight = 10.0;
  std::string loss = "mean";
  std::vector<double> vertices, vertex_weights;
  double time_budget_s = 0.0;
  std::int64_t max_evaluations = 0;
  double difference_step = 0.1;
  std::vector<double> replay_iterations;

  template <class Visitor>
  void visit(Visitor& v) {
    v("instances", instances, range(1, 4096), "Parallel searches; the one with the lowest residual loss wins.");
    v("iterations", iterations, range(0, 100000), "Optimiser iterations of the first plan.");
    v("halvings", halvings, range(0, 30),
      "How many times the worse half of the searches ends, after 1/2, 1/4, 1/8, ... of the iterations. 0: all go on to the end.");
    v("replan", replan, "false: the first plan is executed to its end, whatever is observed (open loop).");
    v("replan_iterations", replan_iterations, range(0, 100000), "Optimiser iterations of every later plan.");
    v("horizon", horizon, range(1, 200, "segments"),
      "b of the first plan. For every plan b is at most the predictor's limit (Predictor::max_segments).");
    v("leeway", leeway, range(0, 200, "segments"), "Later plans: b = length of the previous plan + leeway.");
    v("noise", noise, range(0, 100), "Gaussian noise on the first plan's starts, in units of each control's scale.");
    v("replan_noise", replan_noise, range(0, 100), "The same for later plans.");
    v("replan_scale", replan_scale, range(1e-6, 1),
      "Scales the optimiser's steps: the typical change of a control in a later plan, relative to the first plan.");
    v("activity_weight", activity_weight, range(0, 1e6, "mm^2"), "beta of eq. 4.");
    v("slowness_weight", slowness_weight, range(0, 1e6),
      "Weight in L_act of segments that are too slow to finish within the horizon.");
    v("loss", loss, choice({"mean", "expected", "chamfer", "silhouette", "coverage"}),
      "mean: squared error of the predicted mean, as in eq. 4. expected: expected squared error, which adds sigma^2. "
      "chamfer: squared distances from the nearest points of the goal, and back. silhouette: the same as seen along -z. "
      "coverage: 10^4 (1 - c)^2, c being the area that the cloth covers seen from above, as a share of the flat garment's; it "
      "has no gradient.");
    v("vertices", vertices, range(0, 1e9), "Vertices that count in the error; default: all.");
    v("vertex_weights", vertex_weights, range(0, 1e9), "Weights of these vertices, scaled to mean 1; default: equal.");
    v("time_budget_s", time_budget_s, range(0, 1e6, "s"), "Stop a plan after this time; 0: never.");
    v("max_evaluations", max_evaluations, range(0, 1e9), "Most points that one instance evaluates; 0: no limit.");
    v("difference_step", difference_step, range(1e-6, 10),
      "Step of the central differences for a least squares optimiser if the predictor has no directional derivatives, "
      "in units of each control's scale.");
    v("replay_iterations", replay_iterations, range(0, 1e9),
      "Number of batches for each plan: plan_iterations of a run with time_budget_s, to repeat that run without a "
      "clock.");
  }
};

/// Start and goal of a plan.
struct PlanRequest {
  std::shared_ptr<const Positions> shape;     ///< [V, 3] m: s_i
  std::shared_ptr<const Positions> previous;  ///< one segment earlier, or null
  Vector state;                               ///< [S]
  Positions hand_step;                        ///< [G, 3] m: way of the hands in the frame before; 0 rows: at rest
  std::shared_ptr<const Positions> goal;      ///< [V, 3] m: s*; null: the goal has no correspondence
  /// The goal of planning.loss chamfer and silhouette, which then decides alone; null with the other losses.
  std::shared_ptr<const GoalSurface> surface;
  std::vector<bool> counts;  ///< [V]: vertices whose distance from `goal` counts as error; empty: all
  /// [V, 3] m: added to the predicted mean, with `surface` and with planning.loss coverage; null: none.
  std::shared_ptr<const Positions> offset;
  MaterialKnowledge knowledge;
  Controls warm_start;  ///< the rest of the previous plan; 0 rows: the default trajectory
  Index release = 0;    ///< 1-based segment at whose end the cloth is released; 0: the search chooses it
  Index round = 0;      ///< number of the plan in the session; keys the noise
  std::uint64_t seed = 0;
};

/// How far a shape is from the goal, mm: as far as the vertices are known, their mean distance, else
/// GoalSurface::chamfer_mm().
double goal_distance_mm(const PlanRequest& request, const Positions& shape);

/// A plan as the optimiser sees it.
struct PlanPoint {
  Vector x;                                                ///< [D] decision vector of `horizon` segments
  Index horizon = 0;                                       ///< b
  Index release = 0;                                       ///< u of eq. 5
  double loss = std::numeric_limits<double>::quiet_NaN();  ///< planning loss, mm^2; NaN: nobody has evaluated it
};

struct Plan {
  Controls controls;                        ///< [u, C], truncated after the release segment u
  Index horizon = 0;                        ///< b of the search, at most the predictor's max_segments()
  bool releases = false;                    ///< false: progress is still below 1 after b segments
  double loss = 0.0;                        ///< residual planning loss of the winner, mm^2
  double predicted_error_mm = 0.0;          ///< goal_distance_mm() of the predicted final shape
  Index instance = 0;                       ///< the winner
  std::vector<double> losses;               ///< [instances], residual
  std::vector<std::vector<double>> curves;  ///< [iterations] of [instances]: best loss so far
  std::vector<ShapeDistribution> shapes;    ///< [u]: the winner's prediction after every segment
  std::vector<PlanPoint> points;            ///< the best instance of every release segment, by ascending loss
  SearchEnd ended;                          ///< why the optimiser stopped
  Index iterations = 0;
  Index evaluations = 0;  ///< predicted points over all instances, finite differences included
  double seconds = 0.0;
};

/// Weight of every vertex in the planning loss, [V], with mean 1, from `vertices` and `vertex_weights`.
/// @param origin the node with `planning`, for messages.
/// @throws ConfigError for an index out of range or repeated, for a wrong number of weights, or if their sum is 0.
Vector vertex_weights(const PlannerParams& params, Index vertices, const ConfigNode& origin = {});

/// A search in the neighbourhood of one plan, with a predictor whose mean is shifted.
struct LocalSearch {
  PlanPoint anchor;
  Positions offset;        ///< [V, 3] m: added to the predicted mean
  double radius = 1.0;     ///< |x - anchor| in units of the scales; no variable moves by more than twice its mean share
  Index iterations = 20;   ///< of the optimiser
  std::uint64_t seed = 0;  ///< of a stochastic optimiser
};

/// Trajectory planning (section 4). Uses the predictor for shapes and gradients, the optimiser for the search.
class Planner {
 public:
  /// @throws Unsupported if the optimiser needs gradients that the predictor lacks; ConfigError as vertex_weights().
  Planner(const Task& task, std::shared_ptr<const Predictor> predictor, std::shared_ptr<const Optimiser> optimiser,
          const PlannerParams& params, Host& host);
  /// @throws Error if no instance reached a finite loss.
  Plan plan(const PlanRequest& request) const;

  // For corrections of plans by a simulator (corrector.hpp).

  /// The point whose controls are nearest to the given ones, as plan() would begin with them.
  /// @param controls [u, C], u its release segment.
  PlanPoint point_of(const PlanRequest& request, const Controls& controls) const;
  /// [u, C], within the predictor's control range and the limits of the hands.
  Controls controls_of(const PlanRequest& request, const PlanPoint& point) const;
  /// The best point near an anchor, with the anchor's release segment and with its loss by the shifted predictor.
  PlanPoint search_near(const PlanRequest& request, const LocalSearch& search) const;
  /// Whether the point keeps the limits of the hands from the first frame on (LimitedControls::kept).
  bool keeps_limits(const PlanRequest& request, const PlanPoint& point) const;
  /// Length of the step between two points of one horizon, in units of the scales, over the variables up to the release.
  double distance(const PlanPoint& a, const PlanPoint& b) const;
  /// The planning loss of a point (eq. 4) if the cloth ends in this shape. @param shape [V, 3] m.
  double loss_of(const PlanRequest& request, const PlanPoint& point, const Positions& shape) const;
  /// The prediction after every segment, [u]. @throws Error if the point cannot be predicted.
  std::vector<ShapeDistribution> predict(const PlanRequest& request, const PlanPoint& point) const;
  /// What becomes of controls that are not those of a point, such as the rest of a plan. @param controls [u, C].
  Plan plan_of_controls(const PlanRequest& request, const Controls& controls) const;
  /// A plan of this point: controls, release, prediction and predicted error.
  Plan plan_of(const PlanRequest& request, const PlanPoint& point) const;
  Index horizon_of(const Controls& warm_start) const;

 private:
  std::vector<ShapeDistribution> predict(const PlanRequest& request, const Controls& controls) const;
  Task task_;
  std::shared_ptr<const Predictor> predictor_;
  std::shared_ptr<const Optimiser> optimiser_;
  PlannerParams params_;
  PlannerParams mean_params_;  ///< with loss: mean
  Vector weights_;             ///< [V]
  Host& host_;
};

}  // namespace weft
