#pragma once
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "session/planner.hpp"
#include "session/twin.hpp"

namespace weft {

/// Corrects the network's plans by simulations of the cloth at the believed material.
struct CorrectionParams {
  std::int64_t simulations = 0;
  std::int64_t later_simulations = 4;
  std::int64_t candidates = 2;
  std::int64_t iterations = 20;
  double radius = 2.0;
  double enough_mm = 0.2;
  double pool_mm = 2.0;
  double max_width = 0.5;
  std::int64_t lag = 1;
  double time_budget_s = 0.0;
  std::vector<double> dropped;
  ConfigNode simulator;

  template <class Visitor>
  void visit(Visitor& v) {
    v("simulations", simulations, range(0, 1000), "Simulated plans of the first correction; 0: no plan is corrected.");
    v("later_simulations", later_simulations, range(0, 1000),
      "Simulated plans of every later correction, the plan in force included.");
    v("candidates", candidates, range(1, 64), "Plans that are simulated side by side. Results depend on it.");
    v("iterations", iterations, range(1, 10000), "Optimiser iterations of the search near a simulated plan.");
    v("radius", radius, range(1e-3, 100),
      "First radius of that search: length of the step in the controls, in units of their scales.");
    v("enough_mm", enough_mm, range(0, 1000, "mm"), "No further simulations once the simulated error is below this.");
    v("pool_mm", pool_mm, range(0, 1000, "mm"),
      "Above this simulated error other plans are tried too: the network's with other release segments, and its later "
      "plans.");
    v("max_width", max_width, range(0, 1), "Plans are corrected once the mean width of the knowledge is at most this.");
    v("lag", lag, range(0, 100, "segments"),
      "A later correction starts at the beginning of a segment, from the forecast of the cloth `lag` segments later, and "
      "replaces the rest of the plan there. It runs beside the execution; 0: the execution waits for it.");
    v("time_budget_s", time_budget_s, range(0, 1e6, "s"),
      "A later correction that took longer is dropped; 0: none is. With a budget results depend on the clock.");
    v("dropped", dropped, range(0, 1e9),
      "Segments, from 0, at whose beginning a correction starts whose result is dropped: what a session with "
      "time_budget_s recorded, to repeat it without a clock.");
    v("simulator", simulator, PluginSlot{"simulator"}, "Simulator of the corrections; default: the task's.");
  }
};

/// One simulated plan of a correction.
struct CorrectionStep {
  Index release = 0;          ///< u
  bool is_candidate = false;  ///< a plan of the network, or the plan in force; false: found near a simulated plan
  double radius = 0.0;        ///< of the search that found it
  double expected = 0.0;  ///< mm^2: loss by the predictor with the offset of its neighbour; NaN: it was in force before
  double loss =
      0.0;  ///< mm^2, simulated; infinity: the simulation diverged, did not release there, or the hands cannot do it
  /// Simulated mean vertex distance to the goal, with planning.loss chamfer or silhouette GoalSurface::chamfer_mm(); NaN:
  /// as `loss` is infinite.
  double error_mm = std::numeric_limits<double>::quiet_NaN();
  bool best = false;  ///< better than all simulated before
};

struct CorrectionRequest {
  PlanRequest plan;                   ///< as the network sees it
  TwinState start;                    ///< the simulated cloth where the plan starts
  std::vector<PlanPoint> candidates;  ///< at least one, in the order in which they are tried
  Index simulations = 1;
  double radius = 2.0;
  /// The first candidate is the plan in force, and is simulated alone: the others are tried only where it is poor.
  bool keeps_plan = false;
  bool is_new = false;     ///< the first candidate was never corrected: the others are tried wherever it is not enough
  double enough_mm = 0.0;  ///< as in the parameters, if it is larger
  /// [V, 3] m: added to the simulated final shapes: what earlier trials showed that the simulation misses; null: nothing.
  std::shared_ptr<const Positions> learned;
  /// More candidates, asked for once, where the simulated plans are poor; may be empty.
  std::function<std::vector<PlanPoint>()> more;
};

struct Correction {
  PlanPoint point;                                                   ///< the best simulated plan
  std::vector<Positions> shapes;                                     ///< [u]: simulated, after every segment
  double loss = std::numeric_limits<double>::infinity();             ///< mm^2, simulated
  double error_mm = std::numeric_limits<double>::quiet_NaN();        ///< NaN: no plan could be simulated
  double first_error_mm = std::numeric_limits<double>::quiet_NaN();  ///< of the first candidate
  double radius = 0.0;                                               ///< where the next correction of this plan begins
  std::vector<CorrectionStep> steps;
};

/// The network's gradient is good, its value is off by some millimetres. So a plan m_a is simulated at the believed
/// material, and the offset sim(m_a) - net(m_a), a field over the vertices, is added to the network's mean. A search near
/// m_a with the shifted network gives the next plan, which is simulated too, and kept if its simulated loss is lower.
/// This is a trust region method with an additive correction of a cheap model [Alexandrov & Lewis 2001, "An overview of
/// first-order model management for engineering optimization"]; here the correction is of order zero, as the simulator
/// has no gradient. Where the error stays high, it goes on from the best of all simulated plans, and from other plans of
/// the network.
class Corrector {
 public:
  Corrector(std::shared_ptr<const Planner> planner, std::shared_ptr<const Twin> twin, const CorrectionParams& params,
            Host& host);
  /// @throws ShapeError without a candidate. A candidate that diverges is skipped; if all do, `loss` is infinite.
  Correction correct(const CorrectionRequest& request) const;

 private:
  struct Simulated;
  struct Proposal;
  class Pool;
  Simulated simulate(const CorrectionRequest& request, const PlanPoint& point) const;
  std::shared_ptr<const Planner> planner_;
  std::shared_ptr<const Twin> twin_;
  CorrectionParams params_;
  Host& host_;
};

}  // namespace weft
