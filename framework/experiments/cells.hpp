#pragma once
#include "experiments/sweep.hpp"
#include "session/session.hpp"

/// What the cells of `weft ablate` run.
namespace weft {

/// Runs a session. Metrics of session_outcome, and `cpu_seconds`. @throws what a session throws.
SweepOutcome run_session_cell(const ConfigNode& session, Host& host);
/// What a session measured.
SweepOutcome session_outcome(const SessionResult& result);
/// Runs case number `seed` of a physics experiment in its `simulator`. Metrics, named "test: quantity": the error as
/// its bound counts it, the largest where a case has several; and "test: within bounds", 1 if all of the case are.
SweepOutcome run_physics_cell(const ConfigNode& experiment, Host& host);

}  // namespace weft
