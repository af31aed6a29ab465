#include "session/session.hpp"

#include <cmath>

#include "session/estimate_chain.hpp"
#include "weft/config.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kMaterialStream = 0x71;
constexpr std::uint64_t kKnowledgeStream = stream_key("know");

}  // namespace

MaterialProperties true_material_of(const SessionParams& params) {
  if (!params.true_material.empty()) return property_vector(params.true_material);
  RandomStream random(static_cast<std::uint64_t>(params.seed), kMaterialStream);
  MaterialProperties q;
  for (Index p = 0; p < 4; ++p) q(p) = random.uniform();
  return q;
}

MaterialKnowledge first_knowledge(const SessionParams& params, const MaterialProperties& q) {
  MaterialKnowledge knowledge;
  if (params.knowledge == "true") knowledge = MaterialKnowledge::certain(q);
  if (params.knowledge == "given") {
    knowledge.centre = property_vector(params.given_centre);
    knowledge.width = property_vector(params.given_width);
  }
  if (params.knowledge == "drawn") {
    RandomStream random(static_cast<std::uint64_t>(params.seed), kKnowledgeStream);
    knowledge.width.setConstant(params.drawn_width);
    for (Index p = 0; p < 4; ++p) {
      const double offset = params.drawn_width * (random.uniform() - 0.5);
      knowledge.centre(p) = std::clamp(q(p) + offset, 0.0, 1.0);
    }
  }
  return knowledge;
}

Task session_task(const SessionParams& params, const ConfigNode& origin, Host& host) {
  Task task = make_task(params.task, origin, host);
  check_session(params, origin, task);
  return task;
}

void check_session(const SessionParams& params, const ConfigNode& origin, const Task& task) {
  const std::pair<const char*, const std::vector<double>*> lists[] = {
      {"true_material", &params.true_material},
      {"given_centre", &params.given_centre},
      {"given_width", &params.given_width},
      {"goal.material", &params.goal.material},
      {"estimation.deviation_scale", &params.estimation.deviation_scale}};
  for (const auto& [key, values] : lists) {
    if (!values->empty() && values->size() != 4)
      must_be(place(origin, key), "a list of 4 numbers: friction, bend, stretch, thickness");
  }
  if (params.knowledge == "given" && (params.given_centre.empty() || params.given_width.empty()))
    place(origin, "knowledge").fail("= given, which needs given_centre and given_width, lists of 4 numbers in [0, 1]");
  vertex_weights(params.planning, task.garment->vertex_count(), origin);
}

std::shared_ptr<Predictor> bound_predictor(const ConfigNode& slot, const Task& task, Host& host) {
  if (slot.is_null()) must_be(slot, "a predictor plugin, such as {plugin: rollout}");
  const auto predictor = host.create<Predictor>(slot);
  ConfigNode blamed = slot;
  for (const char* file : {"params.model", "params.module"}) {
    if (const ConfigNode given = place(slot, file); !given.is_null()) blamed = given;
  }
  blaming(blamed, [&] { predictor->bind(task); });
  return predictor;
}

SessionResult run_session(const SessionParams& params, const ConfigNode& origin, Host& host,
                          const SessionProgress& progress) {
  const Task task = session_task(params, origin, host);
  const auto seed = static_cast<std::uint64_t>(params.seed);
  const auto& trajectory = *task.trajectory;
  SessionResult result;
  result.true_material = true_material_of(params);
  MaterialKnowledge knowledge = first_knowledge(params, result.true_material);
  const auto predictor = bound_predictor(place(origin, "predictor"), task, host);
  const Planner planner(task, predictor, host.create<Optimiser>(params.optimiser), params.planning, host);
  std::unique_ptr<const Estimator> estimator;
  if (params.knowledge == "estimate") {
    estimator = std::make_unique<const Estimator>(task, predictor, host.create<Optimiser>(params.estimation_optimiser),
                                                  params.estimation, host);
  }
  std::unique_ptr<const Planner> refiner;
  if (params.refinement.plans > 0) {
    const auto simulation = bound_predictor(params.refinement.predictor, task, host);
    PlannerParams refinement = params.planning;
    refinement.instances = 1;
    refinement.replan_iterations = params.refinement.iterations;
    refinement.replan_scale = params.refinement.scale;
    refinement.leeway = 0;
    refinement.time_budget_s = 0.0;
    refinement.replay_iterations.clear();
    refiner =
        std::make_unique<const Planner>(task, simulation, host.create<Optimiser>(params.optimiser), refinement, host);
  }

  SessionGoal made = make_goal(params.goal, origin, task, seed, result.true_material, host);
  result.goal = std::move(made.shape);
  result.goal_controls = std::move(made.controls);
  result.default_shape = std::move(made.default_shape);
  result.default_error_mm = mean_distance_mm(result.default_shape, result.goal);

  // Plan, execute one segment, observe, re-plan, ..., release.
  SimulatorEnvironment environment(host.create<Simulator>(task.simulator), task, result.true_material,
                                   params.observation, seed);
  EstimateChain chain(estimator.get(), host, seed);
  Vector state = trajectory.initial_state(task.manipulation);
  const Observation first = environment.observe();
  auto current = filled_start(task, first);
  std::shared_ptr<const Positions> previous;
  const auto goal = std::make_shared<const Positions>(result.goal);
  result.start = environment.positions();
  chain.start(task, first, state, static_cast<Index>(trajectory.controls().size()));
  Controls warm_start;
  while (!result.released && static_cast<std::int64_t>(result.rounds.size()) < params.max_segments &&
         !host.cancelled()) {
    const auto number = static_cast<std::int64_t>(result.rounds.size());
    if (estimator) knowledge = chain.knowledge(number - params.knowledge_lag);
    PlanRequest request{.shape = current, .previous = previous, .state = state, .goal = goal, .knowledge = knowledge};
    request.warm_start = warm_start;
    request.round = static_cast<Index>(number);
    request.seed = seed;
    SessionRound round;
    round.state = state;
    round.knowledge = knowledge;
    round.plan = planner.plan(request);
    if (refiner && number >= params.refinement.first && number - params.refinement.first < params.refinement.plans) {
      request.warm_start = round.plan.controls;
      Plan refined = refiner->plan(request);
      round.refinement_seconds = refined.seconds;
      // Its seconds are told apart; its curves and losses are in the simulator's terms, as its prediction is.
      refined.seconds = round.plan.seconds;
      refined.iterations = round.plan.iterations;
      round.plan = std::move(refined);
    }
    const Vector control = round.plan.controls.row(0).transpose();
    const SegmentPath path = trajectory.segment(task.manipulation, state, control);
    environment.execute(path);
    state = path.end_state;
    if (trajectory.released(state)) {
      result.settle = environment.release();
      result.released = true;
    }
    Observation seen = environment.observe();
    previous = current;
    current = filled(seen, round.plan.shapes.front().mean);
    round.observed = *current;
    if (estimator) chain.add(control, std::move(seen));
    warm_start = round.plan.controls.bottomRows(round.plan.controls.rows() - 1);
    if (warm_start.rows() == 0) warm_start = trajectory.default_controls(1);
    if (progress) progress(round, request.round, mean_distance_mm(environment.positions(), result.goal));
    result.rounds.push_back(std::move(round));
  }
  result.estimates = chain.all();
  result.final_shape = environment.positions();
  result.error_mm = mean_distance_mm(result.final_shape, result.goal);
  result.simulate_seconds = environment.seconds();
  result.max_grasp_strain = environment.max_grasp_strain();
  result.frames = environment.frames();
  if (const std::string warning = environment.warning(); !warning.empty()) result.warnings.push_back(warning);
  const auto segments = static_cast<Index>(result.rounds.size());
  if (const Index most = estimator ? estimator->max_segments().value_or(segments) : segments; most < segments) {
    result.warnings.push_back("the predictor takes " + std::to_string(most) +
                              " segments: later estimates repeat the one after that many");
  }
  if (!result.released) {
    result.warnings.push_back("the session ended after " + std::to_string(result.rounds.size()) +
                              " segments without release");
  } else if (!result.settle.settled) {
    result.warnings.push_back("the released cloth did not settle within " + std::to_string(result.settle.frames) +
                              " frames");
  }
  return result;
}

}  // namespace weft
