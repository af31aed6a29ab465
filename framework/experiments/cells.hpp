#pragma once
#include "experiments/sweep.hpp"
#include "session/sequence.hpp"

/// The cells of `weft ablate`.
namespace weft {

/// Runs a session. Returns session_outcome() with the time `cpu_seconds` added. @throws as the session.
SweepOutcome run_session_cell(const ConfigNode& session, Host& host);
/// The metrics of a session.
SweepOutcome session_outcome(const SessionResult& result);
/// Runs case number `seed` of a physics experiment in its `simulator`. The metric "test: quantity" is the error as its
/// bound counts it, or the largest of several. "test: within bounds" is 1 if all errors of the case are in bounds.
SweepOutcome run_physics_cell(const ConfigNode& experiment, Host& host);

}  // namespace weft
