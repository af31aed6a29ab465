#pragma once
#include <functional>
#include <future>
#include <limits>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <vector>

#include "session/corrector.hpp"
#include "session/shape_filter.hpp"

namespace weft {

/// What became of one correction of a session.
struct CorrectionRecord {
  Index started = 0;  ///< segments executed when it started
  /// Simulated error of the plan that it started from; NaN: the plan could not be simulated, or was not.
  double forecast_mm = std::numeric_limits<double>::quiet_NaN();
  double corrected_mm =
      std::numeric_limits<double>::quiet_NaN();  ///< simulated error of its best plan; NaN: there is none
  std::vector<CorrectionStep> steps;
  double seconds = 0.0;  ///< wall time, the plans of the network included
  bool dropped = false;  ///< it took longer than the budget; the plan before it stayed in force
};
/// An entry of `corrections` (docs/file-formats.md). @param in_force the first segment of the plan that it made.
nlohmann::ordered_json to_json(const CorrectionRecord& record, Index in_force);

/// What a trial teaches the next one on the same cloth: iterative learning control [Arimoto, Kawamura & Miyazaki 1984,
/// "Bettering operation of robots by learning"] with the simulator as model.
struct TrialMemory {
  Controls controls;            ///< [u, C]: executed; 0 rows: there was no trial
  MaterialKnowledge knowledge;  ///< at the end
  /// [u]: the final shape that was observed, minus the one that the twin forecasts before segment j for these controls; 0 for
  /// vertices that were not seen. [V, 3] m. Empty if the cloth was not released.
  std::vector<std::shared_ptr<const Positions>> learned;
};

/// The plans of a session, corrected by a simulation that runs beside the execution. The simulated cloth (the twin) is
/// carried along: it executes what the hands execute, and is pulled to every observation. A correction starts at the
/// beginning of a segment from what is known then. It forecasts the cloth `lag` segments later with the controls that
/// are already in force, corrects the rest of the plan from there, and is in force from there on. Counts, not times, fix
/// what it does.
class PlanChain {
 public:
  PlanChain(std::shared_ptr<const Planner> planner, std::shared_ptr<const Twin> twin, const CorrectionParams& params,
            Host& host, const TrialMemory& memory = {});
  ~PlanChain();

  /// The plan before the first segment. @param request of round 0.
  /// @return the plan in force, and its correction if there was one.
  std::pair<Plan, std::optional<CorrectionRecord>> first(const PlanRequest& request);
  /// The plan before a later segment: the rest of the plan in force, or the corrected plan that is due now. Starts the
  /// next correction if none runs. A plan that ended without a release is followed by one of the network.
  /// @param request of this round, for such a plan.
  /// @param knowledge of the correction; called on another thread if the host has several.
  std::pair<Plan, std::optional<CorrectionRecord>> next(const PlanRequest& request,
                                                        const std::function<MaterialKnowledge()>& knowledge);
  /// Adds an executed segment and what was seen after it.
  void add(ConstVec control, const Observation& seen);
  /// What this trial taught, once all its segments are added. @param released whether the cloth was. @throws Diverged.
  TrialMemory memory(bool released);
  /// What is left of the plan in force after one more segment, without a new plan: open loop.
  const Plan& rest();
  /// The knowledge that the plan in force was made with.
  const MaterialKnowledge& knowledge() const { return knowledge_; }
  /// Segments at whose beginning a correction started that was dropped.
  const std::vector<Index>& dropped() const { return dropped_; }

 private:
  /// A correction that runs, or has run.
  struct Work {
    Index started = 0, due = 0;
    PlanRequest base;  // goal, seed
    Controls rest;     // of the plan in force, from `started` on
    Controls executed;
    std::vector<std::shared_ptr<const Observation>> seen;  // after each executed segment
    std::function<MaterialKnowledge()> knowledge;
    double error_mm = 0.0;  // of the plan in force, when last simulated; infinity: never
    double radius = 0.0;
    bool stalled = false;
  };
  struct Outcome {
    std::optional<Plan> plan;  // none: the plan in force stays
    MaterialKnowledge knowledge;
    CorrectionRecord record;
    bool corrected = false;
    double radius = 0.0;
    bool stalled = false;  // hardly better than the plan that it started from
  };
  Outcome work(const Work& work);
  /// @param due the segment in which the plan begins.
  Outcome corrected(const PlanRequest& request, CorrectionRequest correction, const TwinState& start, Index started,
                    Index due);
  TwinState twin_at(const Work& work, const MaterialProperties& material);
  void start(const std::function<MaterialKnowledge()>& knowledge);
  std::optional<CorrectionRecord> finish();

  std::shared_ptr<const Planner> planner_;
  std::shared_ptr<const Twin> twin_;
  CorrectionParams params_;
  Host& host_;
  TrialMemory before_;  // of the trial before
  Corrector corrector_;
  ShapeFilter filter_;
  PlanRequest base_;  // round 0
  Plan plan_;         // in force
  MaterialKnowledge knowledge_;
  double error_mm_, radius_;  // of the plan in force
  bool stalled_ = false;
  Controls executed_;
  std::vector<std::shared_ptr<const Observation>> seen_;
  std::optional<Work> pending_;
  std::future<Outcome> outcome_;
  std::vector<TwinState> track_;  // at the start of every segment, at the material of its entries
  std::vector<Index> dropped_;
};

/// What is left of a plan after its first segment.
Plan rest_of(const Plan& plan);

}  // namespace weft
