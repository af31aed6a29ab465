#pragma once
#include <functional>
#include <vector>

#include "session/session.hpp"

namespace weft {

/// One of the folds that follow one another (SessionParams::manipulations).
struct SessionStep {
  SessionParams params;
  ConfigNode
      config;  ///< what `params` were read from: the session's config, without `manipulations`, and the step's keys
  ConfigNode resolved;  ///< as read_params() returns it
};

/// The steps of a session; without `manipulations` the session itself.
/// @param config the node that params were read from. @throws ConfigError for a key that a step cannot have.
std::vector<SessionStep> session_steps(const SessionParams& params, const ConfigNode& config);

/// Refuses a session of several steps, for commands that take one fold. @param command for the message.
void require_one_step(const SessionParams& params, const ConfigNode& config, const std::string& command);

/// rehearse_session() of every step. The limits of the hands of a later step are not checked: where they begin is known only
/// when the cloth lies there.
void rehearse_steps(const std::vector<SessionStep>& steps, Host& host);

/// Called after every step. @param task the step's.
using StepDone =
    std::function<void(const SessionStep& step, Index number, const Task& task, const SessionResult& result)>;

/// Runs all steps, each from where the one before left the cloth: the world from its true shape, planner and estimator from
/// the shape that was seen last, and with `knowledge: estimate` from what was known of the material. Ends early after a step
/// in which the cloth was not released.
/// @return the last step's, with all of them in SessionResult::steps. @throws as run_configured_session(); a wrong config of
/// any step before any work.
SessionResult run_sequence(const SessionParams& params, const ConfigNode& config, Host& host,
                           const SessionProgress& progress = {}, const StepDone& done = {});

}  // namespace weft
