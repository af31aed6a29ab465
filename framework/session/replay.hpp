#pragma once
#include "session/session.hpp"
#include "session/session_file.hpp"

namespace weft {

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
  std::vector<Estimate> estimates;                  ///< [segments]
  std::optional<MaterialProperties> true_material;  ///< nullopt: nobody knows it
};
/// `weft estimate`: the material after every segment of a recorded session, or of the default control under the
/// session's true material. @param recorded null: the default control.
/// @throws ConfigError for another garment; as replay_estimates().
LoneEstimates estimate_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded,
                             Host& host);

}  // namespace weft
