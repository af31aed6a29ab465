#include "session/sequence.hpp"

#include <memory>
#include <optional>
#include <string>

#include "loader/where.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

/// What differs from one fold to the next. Files are those of the whole session, so that a saved config finds them.
const std::vector<std::string> kStepKeys = {"description", "manipulation", "trajectory",  "goal",
                                            "planning",    "correction",   "max_segments"};
const std::vector<std::string> kGoalKeys = {"controls", "random", "flat", "edge", "material", "horizon"};

StartShape end_of(const SessionResult& result) {
  StartShape start{.shape = result.rounds.back().observed, .world = result.final_shape, .knowledge = std::nullopt};
  if (!result.estimates.empty()) start.knowledge = result.estimates.back().knowledge;
  return start;
}

}  // namespace

std::vector<SessionStep> session_steps(const SessionParams& params, const ConfigNode& config) {
  if (params.manipulations.is_null()) return {{params, config, {}}};
  const ConfigNode list = place(config, "manipulations");
  if (!list.is_sequence() || list.size() == 0) must_be(list, "a list of mappings, one for each fold");
  std::vector<SessionStep> steps;
  for (std::size_t k = 0; k < list.size(); ++k) {
    list[k].refuse_unknown_keys(kStepKeys);
    if (const auto goal = list[k].find("goal")) goal->refuse_unknown_keys(kGoalKeys);
    SessionStep step;
    step.config = config.without("manipulations").merged(list[k]);
    step.resolved = read_params(step.config, step.params);
    steps.push_back(std::move(step));
  }
  return steps;
}

void require_one_step(const SessionParams& params, const ConfigNode& config, const std::string& command) {
  if (params.manipulations.is_null()) return;
  place(config, "manipulations")
      .fail("has several folds, and " + command +
            " takes one; run the config of a step (step_1/config.yaml of a result)");
}

void rehearse_steps(const std::vector<SessionStep>& steps, Host& host) {
  for (std::size_t k = 0; k < steps.size(); ++k) {
    SessionParams params = steps[k].params;
    if (k > 0) params.task.manipulation.limits = {};
    rehearse_session(params, steps[k].config, host);
  }
}

SessionResult run_sequence(const SessionParams& params, const ConfigNode& config, Host& host,
                           const SessionProgress& progress, const StepDone& done) {
  const auto steps = session_steps(params, config);
  if (steps.size() > 1) rehearse_steps(steps, host);
  SessionResult result;
  std::vector<TrialRecord> records;
  std::shared_ptr<const StartShape> start;
  for (std::size_t k = 0; k < steps.size() && !host.cancelled(); ++k) {
    std::optional<Step> context;
    if (steps.size() > 1) context.emplace("fold", static_cast<std::int64_t>(k + 1));
    const SessionStep& step = steps[k];
    result = run_configured_session(step.params, step.config, host, progress, start);
    records.push_back(result.record());
    if (done) done(step, static_cast<Index>(k), session_task(step.params, step.config, host, start), result);
    if (!result.released || result.rounds.empty()) break;
    start = std::make_shared<const StartShape>(end_of(result));
  }
  result.steps = std::move(records);
  return result;
}

}  // namespace weft
