#include "session/replay.hpp"

#include <tuple>

#include "session/estimate_chain.hpp"
#include "session/plan_chain.hpp"
#include "session/sequence.hpp"
#include "simulation/fold.hpp"
#include "simulation/hand_limits.hpp"

namespace weft {
namespace {

void require_same_garment(const SessionRecord& recorded, const Garment& garment) {
  const auto equal = [](const auto& a, const auto& b) { return a.rows() == b.rows() && a == b; };
  if (!equal(recorded.rest, garment.rest) || !equal(recorded.faces, garment.faces) ||
      !equal(recorded.form.frames, garment.form.frames) || recorded.form.layers != garment.form.layers ||
      !equal(recorded.form.seams, garment.form.seams))
    throw ConfigError("the session was recorded with another garment (" + recorded.garment_name + ")");
}

}  // namespace

LonePlan plan_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded, Index segment,
                    Host& host) {
  require_one_step(params, origin, "weft plan");
  const Task task = session_task(params, origin, host);
  const auto seed = static_cast<std::uint64_t>(params.seed);
  SessionGoal goal = read_goal(params.goal, params.planning.loss, origin, task);
  LonePlan result;
  PlanRequest request{.seed = seed};
  if (recorded != nullptr) {
    require_same_garment(*recorded, *task.garment);
    if (segment < 1 || segment > recorded->segments())
      throw ConfigError("weft plan: segment = " + std::to_string(segment) + ", the session has 1 to " +
                        std::to_string(recorded->segments()));
    const std::size_t at = segment - 1;
    const auto& round = recorded->rounds[at];
    // The observation after segment `number`; 0: the start, which is recorded as its true shape.
    const auto seen = [&](Index number) -> std::shared_ptr<const Positions> {
      if (number == 0) return filled_start(task, observe_shape(recorded->start, params.observation, seed, 0));
      return std::make_shared<const Positions>(recorded->rounds[number - 1].observed);
    };
    request.shape = seen(segment - 1);
    if (segment > 1) {
      request.previous = seen(segment - 2);
      const auto& before = recorded->rounds[at - 1].controls;
      request.warm_start =
          before.rows() > 1 ? Controls(before.bottomRows(before.rows() - 1)) : task.trajectory->default_controls(1);
    }
    request.state = round.state;
    request.knowledge = round.knowledge;
    if (params.knowledge == "true") request.knowledge = first_knowledge(params, origin, recorded->true_material);
    request.round = segment - 1;
    goal.counts = recorded->goal_counts;
    if (segment > 1)
      request.hand_step =
          last_step(task, recorded->rounds[at - 1].state, recorded->rounds[at - 1].controls.row(0).transpose());
    if (recorded->has_correspondence) result.goal = recorded->goal;
    if (!recorded->has_correspondence || is_surface_loss(params.planning.loss))
      request.surface = recorded->goal_surface(*task.garment, params.planning.loss);
  } else {
    const auto material = true_material_of(params);
    request.knowledge = first_knowledge(params, origin, material);
    const Task world = world_task(task, params.world, seed);
    const auto environment =
        make_environment(params.environment, origin, world, material, params.observation, seed, host);
    goal = make_goal(std::move(goal), params.goal, params.planning.loss, world, seed, material, host);
    result.goal = goal.shape;
    request.surface = goal.surface;
    request.shape = filled_start(task, environment->observe());
    request.state = task.trajectory->initial_state(task.manipulation);
  }
  if (result.goal.rows() > 0) request.goal = std::make_shared<const Positions>(result.goal);
  result.knowledge = request.knowledge;
  request.counts = goal.counts;
  const auto planner = std::make_shared<const Planner>(task, bound_predictor(place(origin, "predictor"), task, host),
                                                       host.create<Optimiser>(params.optimiser),
                                                       planning_for(params.planning, goal), host);
  if (params.correction.simulations == 0 || request.round > 0) {
    result.plan = planner->plan(request);
    return result;
  }
  PlanChain plans(planner, std::make_shared<const Twin>(task, params.correction.simulator, host), params.correction,
                  host);
  std::tie(result.plan, result.correction) = plans.first(request);
  return result;
}

std::vector<Estimate> replay_estimates(const SessionEstimator& estimator, const Task& task,
                                       const ObservationParams& observation, const Replay& replay, std::uint64_t seed,
                                       Host& host, const MaterialKnowledge& prior) {
  require_shape("replay: shapes", replay.shapes.size(), replay.controls.rows() + 1);
  EstimateRequest request;
  set_start(request, task, observe_shape(replay.shapes.front(), observation, seed, 0), prior);
  request.state = replay.state;
  request.seed = seed;
  std::vector<Estimate> estimates;
  for (Index j = 1; j <= replay.controls.rows(); ++j) {
    if (host.cancelled()) throw Error("cancelled");
    request.controls = replay.controls.topRows(j);
    request.observations.push_back(std::make_shared<const Observation>(
        observe_shape(replay.shapes[j], observation, seed, static_cast<std::uint64_t>(j))));
    request.round = j - 1;
    estimates.push_back(estimator.next(request, estimates.empty() ? nullptr : &estimates.back()));
  }
  for (auto& one : estimates) one.sequence.reset();  // snapshots of a plugin must not outlive the host
  return estimates;
}

LoneEstimates estimate_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded,
                             Host& host) {
  require_one_step(params, origin, "weft estimate");
  const Task task = session_task(params, origin, host);
  const SessionEstimator estimator(task, bound_predictor(place(origin, "predictor"), task, host),
                                   host.create<Optimiser>(params.estimation_optimiser), params.estimation,
                                   params.correction.simulator, host);
  const auto seed = static_cast<std::uint64_t>(params.seed);
  LoneEstimates result;
  Replay replay;
  if (recorded != nullptr) {
    require_same_garment(*recorded, *task.garment);
    if (recorded->rounds.empty()) throw ConfigError("weft estimate: the session has no segment");
    result.true_material = recorded->true_material;
    replay.state = recorded->rounds.front().state;
    replay.controls.resize(recorded->segments(), recorded->rounds.front().controls.cols());
    replay.shapes.push_back(recorded->start);
    for (Index j = 0; j < recorded->segments(); ++j) {
      replay.controls.row(j) = recorded->rounds[j].controls.row(0);
      replay.shapes.push_back(recorded->shape_after(j));
    }
  } else {
    result.true_material = true_material_of(params);
    if (!result.true_material) {
      place(origin, "environment.command")
          .fail("executes the fold, so the material is unknown; the simulated default fold needs true_material");
    }
    const Controls controls = within_limits(task, task.trajectory->initial_state(task.manipulation), {},
                                            task.trajectory->default_controls(params.goal.horizon))
                                  .controls;
    const Task world = world_task(task, params.world, seed);
    FoldResult fold = simulate_fold(*host.create<Simulator>(world.simulator), world, *result.true_material, controls,
                                    [&host] { return host.cancelled(); });
    replay.state = fold.states.row(0).transpose();
    replay.controls = controls.topRows(fold.segments);
    replay.shapes = std::move(fold.shapes);
  }
  const auto prior = params.knowledge == "estimate" ? first_knowledge(params, origin, result.true_material)
                                                    : MaterialKnowledge::none();
  result.estimates = replay_estimates(estimator, task, params.observation, replay, seed, host, prior);
  return result;
}

}  // namespace weft
