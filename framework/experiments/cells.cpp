#include "experiments/cells.hpp"

#include <algorithm>

#include "experiments/physics/suite.hpp"
#include "experiments/statistics.hpp"
#include "sdk/cpu_time.hpp"
#include "sdk/fingerprint.hpp"
#include "simulation/task_config.hpp"

namespace weft {

SweepOutcome run_session_cell(const ConfigNode& config, Host& host) {
  SessionParams params;
  read_params(config, params);
  const double cpu_before = thread_cpu_seconds();
  const SessionResult result = run_sequence(params, config, host);
  // With one thread all work except the solvers' own arithmetic runs here, so other programs do not count.
  const double cpu_seconds = host.threads() == 1 ? thread_cpu_seconds() - cpu_before : kNaN;
  SweepOutcome outcome = session_outcome(result);
  const PlanTimes times = plan_times(result, params.correction.lag);
  outcome.times.emplace_back("first_plan_and_correction_seconds", times.first);
  outcome.times.emplace_back("later_correction_p95_seconds", times.later);
  outcome.times.emplace_back("late_plans", static_cast<double>(times.late));
  outcome.times.emplace_back("session_cpu_seconds", result.cpu_seconds);
  outcome.times.emplace_back("cpu_seconds", cpu_seconds);
  return outcome;
}

SweepOutcome run_physics_cell(const ConfigNode& config, Host& host) {
  PhysicsExperimentParams params;
  read_params(config, params);
  const auto task = std::make_shared<const Task>(make_task(params.task, config, host));
  const auto cases = physics_cases(params.physics, task, config);
  const PhysicsCase& one = cases.at(params.seed);
  std::vector<SimulatorVariant> variants{simulator_variant("arm", host, task->simulator)};
  const bool against_itself = task->simulator.to_yaml() == params.other.to_yaml();
  if (one.test == "paired folds" && !params.other.is_null() && !against_itself)
    variants.push_back(simulator_variant("other", host, params.other));

  SweepOutcome outcome;
  const auto worst = [](SweepMetrics& metrics, const std::string& name, double value) {
    for (auto& [known, largest] : metrics)
      if (known == name) return void(largest = std::max(largest, value));
    metrics.emplace_back(name, value);
  };
  double within = 1.0;
  for (const PhysicsRow& row : one.run(variants)) {
    if (row.variant != "arm") continue;
    worst(outcome.metrics, row.test + ": " + row.quantity + (row.reference == 0.0 ? "" : ", error"), row.error);
    if (row.cpu_ms_per_frame > 0.0) worst(outcome.times, row.test + ": CPU ms per frame", row.cpu_ms_per_frame);
    if (!row.passed) within = 0.0;
  }
  outcome.metrics.emplace_back(one.test + ": within bounds", within);
  outcome.paired_by = one.test + ", " + one.name;
  return outcome;
}

SweepOutcome session_outcome(const SessionResult& result) {
  SweepOutcome outcome;
  Fnv1a hash;
  hash.add(result.goal.data(), sizeof(double) * result.goal.size());
  if (result.goal.rows() == 0) {
    const Positions& goal = result.surface->positions();
    hash.add(goal.data(), sizeof(double) * goal.size());
  }
  hash.add(result.start.data(), sizeof(double) * result.start.size());
  if (result.true_material) hash.add(result.true_material->data(), sizeof(double) * 4);
  outcome.paired_by = hex_digits(hash.value());
  double evaluations = 0, iterations = 0, seconds = 0, estimate_seconds = 0, correction_seconds = 0, simulations = 0;
  for (const auto& round : result.rounds) {
    evaluations += static_cast<double>(round.plan.evaluations);
    iterations += static_cast<double>(round.plan.iterations);
    seconds += round.plan.seconds;
    if (!round.correction) continue;
    correction_seconds += round.correction->seconds;
    simulations += static_cast<double>(round.correction->steps.size());
  }
  for (const auto& estimate : result.estimates) estimate_seconds += estimate.seconds;
  const bool planned = !result.rounds.empty();
  const Plan first = planned ? result.rounds.front().plan : Plan();
  outcome.metrics = {
      {"error_mm", result.error_mm},
      {"default_error_mm", result.default_error_mm},
      {"max_error_mm", result.errors.max_mm},
      {"grasped_error_mm", result.errors.grasped_mm},
      {"named_error_mm", result.errors.named_mm},
      {"silhouette_iou", result.errors.iou},
      {"coverage", result.errors.coverage},
      {"released", result.released ? 1.0 : 0.0},
      {"segments", static_cast<double>(result.rounds.size())},
      {"first_plan_loss", planned ? first.loss : kNaN},
      {"first_plan_predicted_error_mm", planned ? first.predicted_error_mm : kNaN},
      {"first_plan_evaluations", planned ? static_cast<double>(first.evaluations) : kNaN},
      {"evaluations", evaluations},
      {"iterations", iterations},
      {"simulations", simulations},
  };
  for (const int limit : kSuccessLimitsMm)
    outcome.metrics.emplace_back(success_key(limit), std::isnan(result.error_mm)        ? kNaN
                                                     : succeeds(result.error_mm, limit) ? 1.0
                                                                                        : 0.0);
  if (result.trials.size() > 1) outcome.metrics.emplace_back("first_trial_error_mm", result.trials.front().error_mm);
  for (std::size_t k = 0; result.steps.size() > 1 && k < result.steps.size(); ++k)
    outcome.metrics.emplace_back("step_" + std::to_string(k + 1) + "_error_mm", result.steps[k].error_mm);
  if (result.surface) {
    outcome.metrics.emplace_back("chamfer_mm", result.chamfer_mm);
    outcome.metrics.emplace_back("default_chamfer_mm", result.default_chamfer_mm);
  }
  outcome.times = {
      {"first_plan_seconds", planned ? first.seconds : kNaN},
      {"plan_seconds", seconds},
      {"estimate_seconds", estimate_seconds},
      {"correction_seconds", correction_seconds},
      {"simulate_seconds", result.simulate_seconds},
  };
  return outcome;
}

}  // namespace weft
