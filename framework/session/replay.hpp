#pragma once
#include "session/session.hpp"
#include "session/session_file.hpp"

namespace weft {

/// One plan that is not executed.
struct LonePlan {
  Plan plan;
  std::optional<CorrectionRecord> correction;  ///< of a first plan
  MaterialKnowledge knowledge;                 ///< the plan's input
  Positions goal;                              ///< [V, 3] m
};
/// `weft plan`: the first plan of the session in `params`, corrected as in a session, or the plan before one segment of a
/// recorded session. Only that before the first segment is corrected: later ones follow from those before. A recorded session gives
/// the observations and the knowledge that it had then (knowledge: true: the recorded material).
/// @param recorded null: a new session. @param segment 1-based.
/// @throws ConfigError for another garment or a segment beyond the end of the session; as run_session().
LonePlan plan_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded, Index segment,
                    Host& host);

/// An executed manipulation that is observed again.
struct Replay {
  std::vector<Positions> shapes;  ///< [k + 1] of [V, 3] m: at the start and after every segment
  Vector state;                   ///< [S] at the start
  Controls controls;              ///< [k, C]
};
/// Estimates after every segment, [k], as in a session with `knowledge: estimate` (section 5). Beyond the predictor's
/// max_segments() the last one stays.
/// @param seed of the observations' noise and of the searches. @param prior what is known before the first segment.
/// @throws ShapeError; as SessionEstimator::next().
std::vector<Estimate> replay_estimates(const SessionEstimator& estimator, const Task& task,
                                       const ObservationParams& observation, const Replay& replay, std::uint64_t seed,
                                       Host& host, const MaterialKnowledge& prior = MaterialKnowledge::none());
struct LoneEstimates {
  std::vector<Estimate> estimates;                  ///< [segments]
  std::optional<MaterialProperties> true_material;  ///< nullopt: unknown
};
/// `weft estimate`: the material after every segment of a recorded session, or of the default control with the
/// session's true material; from the prior, as a session with `knowledge: estimate`. @param recorded null: the default control.
/// @throws ConfigError for another garment; as replay_estimates().
LoneEstimates estimate_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded,
                             Host& host);

}  // namespace weft
