#include "session/session.hpp"

#include <chrono>
#include <cmath>
#include <future>
#include <nlohmann/json.hpp>
#include <numeric>

#include "simulation/fold.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

// Keys of the random streams of a session; each purpose draws from its own.
constexpr std::uint64_t kMaterialStream = 0x71;
constexpr std::uint64_t kGoalStream = 0x676f616c;
constexpr std::uint64_t kKnowledgeStream = 0x6b6e6f77;
constexpr std::uint64_t kHiddenStream = 0x68696465;
constexpr std::uint64_t kNoiseStream = 0x6e6f6973;
constexpr std::uint64_t kBiasStream = 0x62696173;

std::vector<float> to_frame(const Positions& positions) {
  const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> single = positions.cast<float>();
  return {single.data(), single.data() + single.size()};
}

/// Of a list that check_session() passed.
PropertyVector property_vector(const std::vector<double>& values) {
  require_shape("material properties", static_cast<Index>(values.size()), 4);
  return Eigen::Map<const Eigen::Vector4d>(values.data());
}

/// What was seen, the rest from what was expected.
std::shared_ptr<const Positions> filled(const Observation& seen, const Positions& expected) {
  Positions shape = seen.positions;
  for (Index v = 0; v < shape.rows(); ++v) {
    if (!seen.sees(v)) shape.row(v) = expected.row(v);
  }
  return std::make_shared<const Positions>(std::move(shape));
}

void set_start(EstimateRequest& request, const Task& task, const Observation& seen) {
  request.start = filled_start(task, seen);
  request.start_sigma = seen.sigma;
  request.start_height_sigma = seen.height_sigma;
}

/// Estimates after every segment, each one from everything up to then and the estimate before it. With more than one
/// thread they run beside the session; what they are does not depend on that.
class EstimateChain {
 public:
  EstimateChain(const Estimator* estimator, Host& host, std::uint64_t seed) : estimator_(estimator), host_(host) {
    history_.seed = seed;
  }
  void start(const Task& task, const Observation& seen, const Vector& state, Index controls) {
    set_start(history_, task, seen);
    history_.state = state;
    history_.controls.resize(0, controls);
  }
  /// One more segment was executed and seen. Beyond what the predictor takes the last estimate stays.
  void add(ConstVec control, Observation seen) {
    history_.controls.conservativeResize(history_.controls.rows() + 1, Eigen::NoChange);
    history_.controls.bottomRows(1) = control.transpose();
    history_.observations.push_back(std::make_shared<const Observation>(std::move(seen)));
    history_.round = history_.controls.rows() - 1;
    if (history_.controls.rows() > estimator_->max_segments().value_or(history_.controls.rows())) {
      estimates_.push_back(estimates_.back());
      return;
    }
    const auto before = estimates_.empty() ? std::shared_future<Estimate>() : estimates_.back();
    const auto policy = host_.threads() > 1 ? std::launch::async : std::launch::deferred;
    estimates_.push_back(std::async(policy, [this, before, request = history_]() mutable {
                           if (before.valid()) request.previous = before.get().knowledge;
                           return estimator_->estimate(request);
                         }).share());
  }
  /// After `segments` segments; before the first one nothing is known. Waits for it.
  MaterialKnowledge knowledge(std::int64_t segments) const {
    if (segments <= 0) return MaterialKnowledge::none();
    return estimates_.at(static_cast<std::size_t>(segments - 1)).get().knowledge;
  }
  std::vector<Estimate> all() const {
    std::vector<Estimate> list;
    for (const auto& one : estimates_) list.push_back(one.get());
    return list;
  }

 private:
  const Estimator* estimator_;
  Host& host_;
  EstimateRequest history_;
  std::vector<std::shared_future<Estimate>> estimates_;
};

/// Rows of controls from the config: a list of rows, or one row that is repeated until release.
Controls read_controls(const ConfigNode& node, const Trajectory& trajectory, Index horizon) {
  const auto variables = trajectory.controls();
  const auto columns = static_cast<Index>(variables.size());
  if (!node.is_sequence() || node.size() == 0)
    must_be(node, "a list of rows of " + std::to_string(columns) + " numbers");
  const auto read_row = [&](const ConfigNode& row) {
    if (static_cast<Index>(row.size()) != columns) {
      row.fail("has " + std::to_string(row.size()) + " numbers, must have " + std::to_string(columns));
    }
    Vector values(columns);
    for (Index c = 0; c < columns; ++c) {
      const auto& variable = variables[static_cast<std::size_t>(c)];
      const ConfigNode entry = row[static_cast<std::size_t>(c)];
      values(c) = entry.as_double();
      if (!(values(c) >= variable.lower && values(c) <= variable.upper)) {
        must_be(entry, "in [" + ConfigNode::number(variable.lower).as_string() + ", " +
                           ConfigNode::number(variable.upper).as_string() + "] " + variable.unit + " (" +
                           variable.name + ")");
      }
    }
    return values;
  };
  if (node[0].is_scalar()) {
    Controls controls(horizon, columns);
    controls.rowwise() = read_row(node).transpose();
    return controls;
  }
  Controls controls(static_cast<Index>(node.size()), columns);
  for (Index j = 0; j < controls.rows(); ++j) controls.row(j) = read_row(node[static_cast<std::size_t>(j)]).transpose();
  return controls;
}

/// Names and units of what the controls and the state are made of.
std::string trajectory_json(const Trajectory& trajectory) {
  const auto list = [](const std::vector<Variable>& variables) {
    auto items = nlohmann::ordered_json::array();
    for (const auto& variable : variables) items.push_back({{"name", variable.name}, {"unit", variable.unit}});
    return items;
  };
  return nlohmann::ordered_json{{"controls", list(trajectory.controls())}, {"state", list(trajectory.state())}}.dump();
}

Positions final_shape_of(const std::filesystem::path& session_file, const Garment& garment) {
  const auto file = Hdf5File::open(session_file);
  const auto hash = file.read_text("/garment/hash");
  if (hash != std::to_string(garment.hash)) {
    throw ConfigError(session_file.string() + ": was recorded with another garment (hash " + hash + ", this one has " +
                      std::to_string(garment.hash) + ")");
  }
  return file.read_positions("/final_shape");
}

void require_same_garment(const SessionRecord& recorded, const Garment& garment) {
  if (recorded.rest.rows() != garment.rest.rows() || recorded.rest != garment.rest || recorded.faces != garment.faces)
    throw ConfigError("the session was recorded with another garment (" + recorded.garment_name + ")");
}

}  // namespace

SimulatorEnvironment::SimulatorEnvironment(std::shared_ptr<Simulator> simulator, const Task& task,
                                           const MaterialProperties& material, const ObservationParams& params,
                                           std::uint64_t seed)
    : simulator_(std::move(simulator)), settle_(task.settle), params_(params), seed_(seed) {
  simulator_->reset(task.garment, task.material.at(material), task.scene);
  simulator_->grasp(task.manipulation.grasp_vertices);
  record();
}

void SimulatorEnvironment::record() { frames_.push_back(to_frame(simulator_->positions())); }

Observation observe_shape(const Positions& shape, const ObservationParams& params, std::uint64_t seed,
                          std::uint64_t number) {
  Observation seen{.positions = shape, .sigma = params.noise_m, .height_sigma = params.height_bias_m};
  if (params.height_bias_m > 0.0)
    seen.positions.col(2).array() += params.height_bias_m * RandomStream(seed, kBiasStream).normal();
  const RandomStream streams(seed, kNoiseStream, number);
  if (params.noise_m > 0.0) {
    RandomStream random = streams.child(0);
    for (Index k = 0; k < seen.positions.size(); ++k) seen.positions.data()[k] += params.noise_m * random.normal();
  }
  if (params.hidden_share > 0.0 || params.lost_share > 0.0) {
    RandomStream hidden(seed, kHiddenStream);
    RandomStream lost = streams.child(1);
    seen.observed.resize(static_cast<std::size_t>(shape.rows()));
    for (std::size_t v = 0; v < seen.observed.size(); ++v) {
      const bool is_hidden = hidden.uniform() < params.hidden_share, is_lost = lost.uniform() < params.lost_share;
      seen.observed[v] = !is_hidden && !is_lost;
    }
  }
  return seen;
}

std::shared_ptr<const Positions> filled_start(const Task& task, const Observation& seen) {
  Positions expected = task.garment->positions;
  double height = 0.0;
  Index count = 0;
  for (Index v = 0; v < expected.rows(); ++v) {
    if (!seen.sees(v)) continue;
    height += seen.positions(v, 2);
    ++count;
  }
  if (count > 0) expected.col(2).setConstant(height / static_cast<double>(count));
  return filled(seen, expected);
}

Observation SimulatorEnvironment::observe() {
  Observation seen = observe_shape(simulator_->positions(), params_, seed_, observations_++);
  seen.time_s = static_cast<double>(simulator_->frame()) * kFrameSeconds;
  return seen;
}

void SimulatorEnvironment::execute(const SegmentPath& path) {
  const auto started = std::chrono::steady_clock::now();
  for (const auto& targets : path.targets) {
    simulator_->step(targets);
    record();
  }
  max_grasp_strain_ = std::max(max_grasp_strain_, simulator_->diagnostics().max_grasp_strain);
  seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
}

SettleResult SimulatorEnvironment::release() {
  const auto started = std::chrono::steady_clock::now();
  simulator_->release();
  // A frame at a time, to record each: the same states as in one go (Simulator::settle).
  const SettleCriterion one_frame{settle_.speed, 1, 1};
  SettleResult result;
  for (Index calm = 0; result.frames < settle_.max_frames && calm < settle_.hold_frames; ++result.frames) {
    const SettleResult now = simulator_->settle(one_frame);
    calm = now.settled ? calm + 1 : 0;
    result.max_speed = now.max_speed;
    result.settled = calm >= settle_.hold_frames;
    record();
  }
  seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  return result;
}

namespace {

struct SessionGoal {
  Positions shape, default_shape;  // [V, 3] m; default_shape: what the default control gives
  Controls controls;               // of a goal that was simulated, else 0 rows
};

MaterialProperties true_material_of(const SessionParams& params) {
  if (!params.true_material.empty()) return property_vector(params.true_material);
  RandomStream random(static_cast<std::uint64_t>(params.seed), kMaterialStream);
  MaterialProperties q;
  for (Index p = 0; p < 4; ++p) q(p) = random.uniform();
  return q;
}

/// What is known before the first segment; `estimate`: nothing.
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

/// The goal as far as it is given: a shape, or controls, or neither.
SessionGoal read_goal(const GoalParams& params, const ConfigNode& origin, const Task& task) {
  SessionGoal goal;
  std::vector<std::string> given;
  if (!params.obj.empty()) given.push_back("goal.obj");
  if (!params.example.empty()) given.push_back("goal.example");
  if (!params.controls.is_null()) given.push_back("goal.controls");
  if (given.empty()) return goal;
  const ConfigNode node = place(origin, given.back());
  if (given.size() > 1) node.fail("is given beside " + given.front() + "; at most one of obj, example and controls");
  if (!params.controls.is_null()) {
    goal.controls = read_controls(params.controls, *task.trajectory, params.horizon);
    return goal;
  }
  goal.shape = blaming(node, [&] {
    return params.obj.empty() ? final_shape_of(params.example, *task.garment) : read_obj(params.obj).positions;
  });
  if (goal.shape.rows() != task.garment->vertex_count()) {
    fail_because(node, "has " + std::to_string(goal.shape.rows()) + " vertices, must have the garment's " +
                           std::to_string(task.garment->vertex_count()));
  }
  return goal;
}

/// What the default control gives, and the goal. What is given is read first: simulating takes its time.
SessionGoal make_goal(const SessionParams& params, const ConfigNode& origin, const Task& task,
                      const MaterialProperties& true_material, Host& host) {
  const auto& trajectory = *task.trajectory;
  SessionGoal goal = read_goal(params.goal, origin, task);
  const auto reference = host.create<Simulator>(task.simulator);
  const Index horizon = params.goal.horizon;
  goal.default_shape =
      simulate_fold(*reference, task, true_material, trajectory.default_controls(horizon)).shapes.back();
  const MaterialProperties goal_material =
      params.goal.material.empty() ? true_material : property_vector(params.goal.material);
  if (goal.controls.rows() > 0) {
    goal.shape = simulate_fold(*reference, task, goal_material, goal.controls).shapes.back();
  } else if (goal.shape.rows() == 0) {
    const auto& random_goal = params.goal.random;
    for (std::int64_t attempt = 0; attempt < random_goal.attempts && goal.shape.rows() == 0; ++attempt) {
      RandomStream random =
          RandomStream(static_cast<std::uint64_t>(params.seed), kGoalStream).child(static_cast<std::uint64_t>(attempt));
      const Controls controls = random_controls(trajectory, horizon, random_goal.distribution, random);
      FoldResult fold;
      try {
        fold = simulate_fold(*reference, task, goal_material, controls);
      } catch (const Diverged& error) {
        host.log(LogLevel::warning, std::string("a goal candidate was skipped: ") + error.what());
        continue;
      }
      if (!fold.released || mean_distance_mm(fold.shapes.back(), goal.default_shape) < random_goal.min_distance_mm)
        continue;
      goal.shape = fold.shapes.back();
      goal.controls = controls.topRows(fold.segments);
    }
    if (goal.shape.rows() == 0) {
      throw Error("goal: none of " + std::to_string(random_goal.attempts) + " random trajectories ended " +
                  std::to_string(random_goal.min_distance_mm) + " mm or more from what the default control gives");
    }
  }
  return goal;
}

}  // namespace

void check_session(const SessionParams& params, const ConfigNode& origin, const Task& task) {
  if (params.knowledge == "given" && (params.given_centre.empty() || params.given_width.empty()))
    place(origin, "knowledge").fail("= given, which needs given_centre and given_width, lists of 4 numbers in [0, 1]");
  vertex_weights(params.planning, task.garment->vertex_count(), origin);
}

std::shared_ptr<Predictor> bound_predictor(const ConfigNode& slot, const Task& task, Host& host) {
  if (slot.is_null()) must_be(slot, "a predictor plugin, such as {plugin: rollout}");
  const auto predictor = host.create<Predictor>(slot);
  const auto files = host.files(Predictor::kKind, slot);
  blaming(files.empty() ? slot : files.front(), [&] { predictor->bind(task); });
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

  SessionGoal made = make_goal(params, origin, task, result.true_material, host);
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

LonePlan plan_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded, Index segment,
                    Host& host) {
  const Task task = session_task(params, origin, host);
  const auto seed = static_cast<std::uint64_t>(params.seed);
  const Planner planner(task, bound_predictor(place(origin, "predictor"), task, host),
                        host.create<Optimiser>(params.optimiser), params.planning, host);
  LonePlan result;
  PlanRequest request{.seed = seed};
  if (recorded != nullptr) {
    require_same_garment(*recorded, *task.garment);
    if (segment < 1 || segment > recorded->segments())
      throw ConfigError("weft plan: segment = " + std::to_string(segment) + ", the session has 1 to " +
                        std::to_string(recorded->segments()));
    const auto at = static_cast<std::size_t>(segment - 1);
    const auto& round = recorded->rounds[at];
    // After segment `number`; 0: the start, which is recorded as it was and not as it was seen.
    const auto seen = [&](Index number) -> std::shared_ptr<const Positions> {
      if (number == 0) return filled_start(task, observe_shape(recorded->start, params.observation, seed, 0));
      return std::make_shared<const Positions>(recorded->rounds[static_cast<std::size_t>(number - 1)].observed);
    };
    request.shape = seen(segment - 1);
    if (segment > 1) {
      request.previous = seen(segment - 2);
      const auto& before = recorded->rounds[at - 1].controls;
      request.warm_start =
          before.rows() > 1 ? Controls(before.bottomRows(before.rows() - 1)) : task.trajectory->default_controls(1);
    }
    request.state = round.state;
    request.knowledge =
        params.knowledge == "true" ? MaterialKnowledge::certain(recorded->true_material) : round.knowledge;
    request.round = segment - 1;
    result.goal = recorded->goal;
  } else {
    const MaterialProperties q = true_material_of(params);
    request.knowledge = first_knowledge(params, q);
    result.goal = make_goal(params, origin, task, q, host).shape;
    const SimulatorEnvironment at_start(host.create<Simulator>(task.simulator), task, q);
    request.shape = filled_start(task, observe_shape(at_start.positions(), params.observation, seed, 0));
    request.state = task.trajectory->initial_state(task.manipulation);
  }
  request.goal = std::make_shared<const Positions>(result.goal);
  result.knowledge = request.knowledge;
  result.plan = planner.plan(request);
  return result;
}

std::vector<Estimate> replay_estimates(const Estimator& estimator, const Task& task,
                                       const ObservationParams& observation, const Replay& replay, std::uint64_t seed,
                                       Host& host) {
  require_shape("replay: shapes", static_cast<Index>(replay.shapes.size()), replay.controls.rows() + 1);
  EstimateRequest request;
  set_start(request, task, observe_shape(replay.shapes.front(), observation, seed, 0));
  request.state = replay.state;
  request.seed = seed;
  std::vector<Estimate> estimates;
  for (Index j = 1; j <= replay.controls.rows(); ++j) {
    if (host.cancelled()) throw Error("cancelled");
    request.controls = replay.controls.topRows(j);
    request.observations.push_back(std::make_shared<const Observation>(
        observe_shape(replay.shapes[static_cast<std::size_t>(j)], observation, seed, static_cast<std::uint64_t>(j))));
    request.round = j - 1;
    const bool too_long = j > estimator.max_segments().value_or(j);
    estimates.push_back(too_long ? estimates.back() : estimator.estimate(request));
    request.previous = estimates.back().knowledge;
  }
  return estimates;
}

LoneEstimates estimate_alone(const SessionParams& params, const ConfigNode& origin, const SessionRecord* recorded,
                             Host& host) {
  const Task task = session_task(params, origin, host);
  const Estimator estimator(task, bound_predictor(place(origin, "predictor"), task, host),
                            host.create<Optimiser>(params.estimation_optimiser), params.estimation, host);
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
      replay.controls.row(j) = recorded->rounds[static_cast<std::size_t>(j)].controls.row(0);
      replay.shapes.push_back(recorded->shape_after(j));
    }
  } else {
    result.true_material = true_material_of(params);
    const Controls controls = task.trajectory->default_controls(params.goal.horizon);
    FoldResult fold = simulate_fold(*host.create<Simulator>(task.simulator), task, result.true_material, controls);
    replay.state = fold.states.row(0).transpose();
    replay.controls = controls.topRows(fold.segments);
    replay.shapes = std::move(fold.shapes);
  }
  result.estimates =
      replay_estimates(estimator, task, params.observation, replay, static_cast<std::uint64_t>(params.seed), host);
  return result;
}

std::string session_summary_json(const SessionResult& result) {
  using nlohmann::ordered_json;
  const auto list = [](const auto& v) { return std::vector<double>(v.data(), v.data() + v.size()); };
  ordered_json summary;
  summary["error_mm"] = result.error_mm;
  summary["default_error_mm"] = result.default_error_mm;
  summary["segments"] = result.rounds.size();
  summary["released"] = result.released;
  summary["settled"] = result.settle.settled;
  summary["settle_frames"] = result.settle.frames;
  auto plan_seconds = ordered_json::array();
  auto iterations = ordered_json::array();
  auto predicted = ordered_json::array();
  auto knowledge = ordered_json::array();
  for (const auto& round : result.rounds) {
    plan_seconds.push_back(round.plan.seconds);
    iterations.push_back(round.plan.iterations);
    predicted.push_back(round.plan.predicted_error_mm);
    knowledge.push_back({{"centre", list(round.knowledge.centre)}, {"width", list(round.knowledge.width)}});
  }
  summary["plan_seconds"] = plan_seconds;
  summary["plan_iterations"] = iterations;
  summary["predicted_error_mm"] = predicted;
  auto estimate_seconds = ordered_json::array();
  for (const auto& estimate : result.estimates) estimate_seconds.push_back(estimate.seconds);
  summary["estimate_seconds"] = estimate_seconds;
  double refinement_seconds = 0.0;
  for (const auto& round : result.rounds) refinement_seconds += round.refinement_seconds;
  if (refinement_seconds > 0.0) summary["refinement_seconds"] = refinement_seconds;
  summary["simulate_seconds"] = result.simulate_seconds;
  summary["max_grasp_strain"] = result.max_grasp_strain;
  summary["knowledge"] = knowledge;
  if (!result.estimates.empty()) {
    const auto& last = result.estimates.back().knowledge;
    summary["final_knowledge"] = {{"centre", list(last.centre)}, {"width", list(last.width)}};
  }
  summary["true_material"] = list(result.true_material);
  summary["warnings"] = result.warnings;
  return summary.dump(2) + "\n";
}

void write_session(const std::filesystem::path& path, const SessionResult& result, const Task& task,
                   const ConfigNode& resolved, const std::string& provenance) {
  auto file = Hdf5File::create(path);
  file.write("/schema", std::string("weft session 1"));
  file.write("/config", resolved.to_yaml());
  file.write("/provenance", provenance);
  file.write("/summary", session_summary_json(result));
  const auto& garment = *task.garment;
  file.write("/garment/name", garment.name);
  file.write("/garment/hash", std::to_string(garment.hash));
  file.write("/garment/rest", garment.rest);
  const Eigen::Matrix<std::int64_t, Eigen::Dynamic, 3, Eigen::RowMajor> faces = garment.faces.cast<std::int64_t>();
  file.write("/garment/faces", faces);
  const std::vector<std::int64_t> held(task.manipulation.grasp_vertices.begin(),
                                       task.manipulation.grasp_vertices.end());
  file.write("/garment/grasp_vertices", {static_cast<Index>(held.size())}, held.data());
  file.write("/start", result.start);
  file.write("/goal", result.goal);
  file.write("/default_shape", result.default_shape);
  file.write("/final_shape", result.final_shape);
  if (result.goal_controls.rows() > 0) file.write("/goal_controls", result.goal_controls);
  const Eigen::VectorXd material = result.true_material;
  file.write("/true_material", material);
  if (!result.estimates.empty()) {
    Controls centre(static_cast<Index>(result.estimates.size()), 4), width = centre;
    for (Index j = 0; j < centre.rows(); ++j) {
      centre.row(j) = result.estimates[static_cast<std::size_t>(j)].knowledge.centre.transpose();
      width.row(j) = result.estimates[static_cast<std::size_t>(j)].knowledge.width.transpose();
    }
    file.write("/estimates/centre", centre);
    file.write("/estimates/width", width);
  }
  file.write("/trajectory", trajectory_json(*task.trajectory));
  std::vector<float> frames;
  for (const auto& frame : result.frames) frames.insert(frames.end(), frame.begin(), frame.end());
  file.write("/frames", {static_cast<Index>(result.frames.size()), garment.vertex_count(), 3}, frames.data());
  for (std::size_t i = 0; i < result.rounds.size(); ++i) {
    const auto& round = result.rounds[i];
    std::string group = "/rounds/" + std::string(i < 10 ? "00" : i < 100 ? "0" : "") + std::to_string(i);
    file.write(group + "/controls", round.plan.controls);
    file.write(group + "/state", round.state);
    file.write(group + "/observed", round.observed);
    const Vector centre = round.knowledge.centre, width = round.knowledge.width;
    file.write(group + "/knowledge_centre", centre);
    file.write(group + "/knowledge_width", width);
    const Vector losses =
        Eigen::Map<const Vector>(round.plan.losses.data(), static_cast<Index>(round.plan.losses.size()));
    file.write(group + "/losses", losses);
    if (!round.plan.curves.empty()) {
      Controls curves(static_cast<Index>(round.plan.curves.size()), losses.size());
      for (Index r = 0; r < curves.rows(); ++r) {
        const auto& row = round.plan.curves[static_cast<std::size_t>(r)];
        for (Index c = 0; c < curves.cols(); ++c) curves(r, c) = row[static_cast<std::size_t>(c)];
      }
      file.write(group + "/loss_curves", curves);
    }
    // Single precision: a prediction is good to a fraction of a millimetre at best.
    std::vector<float> mean, sigma;
    for (const auto& shape : round.plan.shapes) {
      const auto m = to_frame(shape.mean), s = to_frame(shape.sigma);
      mean.insert(mean.end(), m.begin(), m.end());
      sigma.insert(sigma.end(), s.begin(), s.end());
    }
    // Where the plan would take the hands: what a page needs to draw it without the trajectory plugin.
    std::vector<float> targets;
    Vector state = round.state;
    for (Index j = 0; j < round.plan.controls.rows(); ++j) {
      const SegmentPath segment =
          task.trajectory->segment(task.manipulation, state, round.plan.controls.row(j).transpose());
      for (const auto& points : segment.targets) {
        const auto p = to_frame(points);
        targets.insert(targets.end(), p.begin(), p.end());
      }
      state = segment.end_state;
    }
    file.write(group + "/planned_targets",
               {round.plan.controls.rows() * kFramesPerSegment, static_cast<Index>(held.size()), 3}, targets.data());
    const std::vector<Index> shape = {static_cast<Index>(round.plan.shapes.size()), garment.vertex_count(), 3};
    file.write(group + "/predicted_mean", shape, mean.data());
    file.write(group + "/predicted_sigma", shape, sigma.data());
  }
  file.commit();
}

}  // namespace weft
