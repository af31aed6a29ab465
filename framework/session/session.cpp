#include "session/session.hpp"

#include <algorithm>
#include <chrono>
#include <tuple>

#include "loader/where.hpp"
#include "sdk/cpu_time.hpp"
#include "sdk/quantile.hpp"
#include "session/estimate_chain.hpp"
#include "session/shape_errors.hpp"
#include "weft/config.hpp"
#include "weft/hash.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kMaterialStream = 0x71;
constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
constexpr std::uint64_t kTrialStream = stream_key("tria");
constexpr std::uint64_t kKnowledgeStream = stream_key("know");

std::uint64_t hash_of(const Positions& shape) {
  Fnv1a hash;
  hash.add(shape.data(), sizeof(double) * shape.size());
  return hash.value();
}

/// Index of a property. @param origin where it is named. @throws ConfigError for another name.
Index property_of(const std::string& name, const ConfigNode& origin) {
  const std::vector<std::string> names(std::begin(kPropertyNames), std::end(kPropertyNames));
  const auto found = std::find(names.begin(), names.end(), name);
  if (found == names.end()) must_be(origin, one_of(names) + ", not '" + name + "'" + nearest_hint(name, names));
  return found - names.begin();
}

/// Frames of a session that was observed only at the ends of segments: each holds the observation before it.
std::vector<std::vector<float>> held_frames(const SessionResult& result) {
  std::vector<std::vector<float>> frames{to_frame(result.start)};
  for (const auto& round : result.rounds) {
    frames.insert(frames.end(), kFramesPerSegment - 1, frames.back());
    frames.push_back(to_frame(round.observed));
  }
  // The cloth was observed after it had settled, and not at the release.
  if (result.released) frames.insert(frames.end() - 1, frames[frames.size() - 2]);
  return frames;
}

std::vector<std::string> session_warnings(const SessionResult& result, const SessionEstimator* estimator) {
  std::vector<std::string> warnings;
  const Index segments = result.rounds.size();
  if (const Index most = estimator ? estimator->network().max_segments().value_or(segments) : segments;
      most < segments) {
    warnings.push_back("the predictor takes at most " + std::to_string(most) +
                       " segments; later estimates repeat the one after segment " + std::to_string(most));
  }
  if (!result.released) {
    warnings.push_back("the session ended after " + std::to_string(segments) + " segments without release");
  } else if (!result.settle.settled) {
    warnings.push_back("the released cloth did not settle within " + std::to_string(result.settle.frames) + " frames");
  }
  return warnings;
}

/// A prior, or an earlier fold of the same cloth, may tell more than this fold has shown yet.
MaterialKnowledge narrower(const MaterialKnowledge& now, const MaterialKnowledge& before) {
  return now.width.mean() <= before.width.mean() ? now : before;
}

SessionSetup make_setup(const SessionParams& params, const ConfigNode& origin, Host& host,
                        std::shared_ptr<const StartShape> start = nullptr) {
  SessionSetup setup;
  setup.task = session_task(params, origin, host, std::move(start));
  const Task& task = setup.task;
  setup.knowledge = first_knowledge(params, origin, true_material_of(params));
  if (params.knowledge == "estimate" && task.start && task.start->knowledge)
    setup.knowledge = narrower(*task.start->knowledge, setup.knowledge);
  const auto predictor = bound_predictor(place(origin, "predictor"), task, host);
  setup.goal = read_goal(params.goal, params.planning.loss, origin, task);
  setup.planner = std::make_shared<const Planner>(task, predictor, host.create<Optimiser>(params.optimiser),
                                                  planning_for(params.planning, setup.goal), host);
  if (params.knowledge == "estimate") {
    setup.estimator =
        std::make_unique<const SessionEstimator>(task, predictor, host.create<Optimiser>(params.estimation_optimiser),
                                                 params.estimation, params.correction.simulator, host);
  }
  if (params.correction.simulations > 0)
    setup.twin = std::make_shared<const Twin>(task, params.correction.simulator, host);
  return setup;
}

}  // namespace

std::optional<MaterialProperties> true_material_of(const SessionParams& params) {
  if (!params.true_material.empty()) return property_vector(params.true_material);
  if (!params.environment.simulated()) return std::nullopt;
  RandomStream random(params.seed, kMaterialStream);
  MaterialProperties q;
  for (Index p = 0; p < 4; ++p) q(p) = random.uniform();
  return q;
}

namespace {

/// The key that says what is known before the first segment, and its value: none, true, given or drawn.
std::pair<const char*, std::string> what_is_known(const SessionParams& params) {
  return params.knowledge == "estimate" ? std::pair("prior", params.prior) : std::pair("knowledge", params.knowledge);
}

}  // namespace

MaterialKnowledge first_knowledge(const SessionParams& params, const ConfigNode& origin,
                                  const std::optional<MaterialProperties>& true_material) {
  MaterialKnowledge knowledge;
  const auto& [key, known] = what_is_known(params);
  if ((known == "true" || known == "drawn") && !true_material) {
    // `true` is the default, so that the key may be missing.
    place(origin, key)
        .fail("= " + known +
              ", which needs true_material if a process executes the fold; without it use none, given or estimate");
  }
  if (known == "true") knowledge = MaterialKnowledge::certain(*true_material);
  if (known == "given") {
    knowledge.centre = property_vector(params.given_centre);
    knowledge.width = property_vector(params.given_width);
  }
  if (known == "drawn") {
    RandomStream random(params.seed, kKnowledgeStream);
    knowledge.width.setConstant(params.drawn_width);
    for (Index p = 0; p < 4; ++p) {
      const double offset = params.drawn_width * (random.uniform() - 0.5);
      knowledge.centre(p) = std::clamp((*true_material)(p) + offset, 0.0, 1.0);
    }
  }
  for (const auto& name : params.unknown) {
    const Index p = property_of(name, place(origin, "unknown"));
    knowledge.centre(p) = MaterialKnowledge::none().centre(p);
    knowledge.width(p) = MaterialKnowledge::none().width(p);
  }
  return knowledge;
}

Task session_task(const SessionParams& params, const ConfigNode& origin, Host& host,
                  std::shared_ptr<const StartShape> start) {
  Task task = make_task(params.task, origin, host, std::move(start));
  check_session(params, origin, task);
  return task;
}

void check_session(const SessionParams& params, const ConfigNode& origin, const Task& task) {
  if (params.prior != "none" && params.knowledge != "estimate")
    must_be(place(origin, "prior"),
            "left out with knowledge: " + params.knowledge + "; only estimate starts from a prior");
  const auto& [knows, known] = what_is_known(params);
  if (known == "given" && (params.given_centre.empty() || params.given_width.empty()))
    place(origin, knows).fail("= given, which needs given_centre and given_width, lists of 4 numbers in [0, 1]");
  if (!params.environment.simulated() && !params.world.is_the_tasks()) {
    must_be(place(origin, params.world.spread > 0.0 ? "world.spread" : "world.simulator"),
            "left out with environment.command: the process is the world");
  }
  if (!params.unknown.empty() && known == "none")
    must_be(place(origin, "unknown"),
            "left out with knowledge: " + params.knowledge + ", which knows nothing at first");
  for (const auto& name : params.unknown) property_of(name, place(origin, "unknown"));
  if (params.trials > 1 && params.correction.simulations == 0 && params.knowledge != "estimate")
    must_be(place(origin, "trials"),
            "1 without correction.simulations and without knowledge: estimate: nothing would be learned");
  if (params.trials > 1 && (params.correction.time_budget_s > 0.0 || params.planning.time_budget_s > 0.0))
    must_be(place(origin, "trials"),
            "1 with a time budget: the session records what the clock decided in its last trial only");
  vertex_weights(params.planning, task.garment->vertex_count(), origin);
  if (is_surface_loss(params.planning.loss)) {
    for (const auto& [key, list] : {std::pair("planning.vertices", &params.planning.vertices),
                                    std::pair("planning.vertex_weights", &params.planning.vertex_weights)})
      if (!list->empty())
        must_be(place(origin, key), "left out with planning.loss = " + params.planning.loss +
                                        ", which compares nearest points; mean and expected have it");
  }
}

std::shared_ptr<Predictor> bound_predictor(const ConfigNode& slot, const Task& task, Host& host) {
  if (slot.is_null()) must_be(slot, "a predictor plugin, such as {plugin: rollout}");
  const auto predictor = host.create<Predictor>(slot);
  const auto files = host.files(Predictor::kKind, slot);
  blaming(files.empty() ? slot : files.front(), [&] { predictor->bind(task); });
  if (!task.scene.obstacles.empty() && !predictor->capabilities().obstacles)
    host.log(LogLevel::warning,
             "the predictor does not know the task's obstacles (capability obstacles): it predicts what its examples "
             "were, and a plan is right only where the simulator corrects it (correction)");
  if (task.manipulation.opens_at.size() > 0 && !predictor->capabilities().opening_hands)
    host.log(LogLevel::warning,
             "the predictor does not know that a hand opens before the others (manipulation.opens_at, capability "
             "opening_hands): a plan is right only where the simulator corrects it (correction)");
  if (task.start && predictor->trainable() != nullptr)
    host.log(
        LogLevel::warning,
        "the task starts from a recorded session (start.session): a trained predictor predicts what its examples were, "
        "and a plan is right only where they started there, too, or the simulator corrects it (correction)");
  return predictor;
}

void rehearse_session(const SessionParams& params, const ConfigNode& origin, Host& host) {
  check_world(params.world, make_setup(params, origin, host).task, origin, host);
}

PlanTimes plan_times(const SessionResult& result, Index lag) {
  PlanTimes times;
  times.limit = static_cast<double>(std::max<Index>(1, lag) * kFramesPerSegment) * kFrameSeconds;
  std::vector<double> later;
  for (std::size_t j = 0; j < result.rounds.size(); ++j) {
    const double seconds = result.rounds[j].seconds();
    if (j == 0)
      times.first = seconds;
    else if (seconds > 0.0)
      later.push_back(seconds);
  }
  times.plans = std::ssize(later) + (result.rounds.empty() ? 0 : 1);
  times.late = times.first > PlanTimes::kFirst ? 1 : 0;
  for (const double seconds : later) times.late += seconds > times.limit ? 1 : 0;
  std::sort(later.begin(), later.end());
  if (!later.empty()) times.later = quantile(later, 0.95);
  return times;
}

namespace {

/// One session while it runs.
class SessionRun {
 public:
  SessionRun(const SessionParams& params, const SessionSetup& setup, Environment& environment, Host& host,
             const TrialMemory& memory)
      : params_(params),
        setup_(setup),
        environment_(environment),
        host_(host),
        trajectory_(*setup.task.trajectory),
        estimator_(setup.estimator.get()),
        chain_(estimator_, host, static_cast<std::uint64_t>(params.seed)),
        state_(trajectory_.initial_state(setup.task.manipulation)),
        hands_(setup.task.hands, trajectory_.targets(setup.task.manipulation, state_), {}) {
    result_.true_material = environment.true_material();
    result_.goal = setup.goal.shape;
    result_.goal_counts = setup.goal.counts;
    result_.goal_controls = setup.goal.controls;
    result_.default_shape = setup.goal.default_shape;
    result_.surface = setup.goal.surface;
    result_.opened_after.resize(trajectory_.hands());
    if (result_.goal.rows() > 0) goal_ = std::make_shared<const Positions>(result_.goal);
    result_.default_error_mm = goal_ ? mean_distance_mm(result_.default_shape, *goal_, result_.goal_counts) : kUnknown;
    if (result_.surface) result_.default_chamfer_mm = result_.surface->chamfer_mm(result_.default_shape);
    const Observation first = environment.observe();
    current_ = filled_start(setup.task, first);
    result_.shapes_are_true = environment.true_shape().has_value();
    result_.start = environment.true_shape().value_or(*current_);
    result_.error_mm = error_mm(first);
    last_seen_ = first.observed;
    chain_.start(setup.task, first, state_, std::ssize(trajectory_.controls()), setup.knowledge);
    if (setup.twin) plans_.emplace(setup.planner, setup.twin, params.correction, host, memory);
  }

  bool goes_on() const {
    return !result_.released && std::ssize(result_.rounds) < params_.max_segments && !host_.cancelled();
  }

  /// Plans, executes one segment, observes.
  void round(const SessionProgress& progress) {
    const Index number = std::ssize(result_.rounds);
    SessionRound round = planned(number);
    const Step segment("segment", number + 1);
    const Step execution("execution");
    const Vector control = round.plan.controls.row(0).transpose();
    execute(control);
    Observation seen = environment_.observe();
    previous_ = current_;
    current_ = filled(seen, round.plan.shapes.front().mean);
    round.observed = *current_;
    result_.error_mm = error_mm(seen);
    if (plans_) plans_->add(control, seen);
    last_seen_ = seen.observed;
    if (estimator_) chain_.add(control, std::move(seen));
    warm_start_ = round.plan.controls.bottomRows(round.plan.controls.rows() - 1);
    if (warm_start_.rows() == 0) warm_start_ = trajectory_.default_controls(1);
    if (progress) progress(round, number, goal_ ? result_.error_mm : result_.surface->chamfer_mm(*current_));
    result_.rounds.push_back(std::move(round));
  }

  TrialMemory memory() {
    TrialMemory memory = plans_ ? plans_->memory(result_.released) : TrialMemory();
    if (const auto all = chain_.all(); !all.empty()) memory.knowledge = all.back().knowledge;
    return memory;
  }

  SessionResult finished() {
    result_.estimates = chain_.all();
    if (plans_) result_.dropped_corrections = plans_->dropped();
    result_.final_shape = environment_.true_shape().value_or(*current_);
    std::vector<bool> counting = result_.goal_counts;
    if (!result_.shapes_are_true) {
      if (counting.empty()) counting.assign(last_seen_.size(), true);
      for (std::size_t v = 0; v < counting.size(); ++v) counting[v] = counting[v] && last_seen_[v];
    }
    if (goal_)
      result_.errors = shape_errors(result_.final_shape, *goal_, setup_.task, counting);
    else
      result_.errors = {kUnknown, kUnknown, kUnknown, result_.surface->iou(result_.final_shape),
                        coverage(result_.final_shape, *setup_.task.garment)};
    if (result_.surface) result_.chamfer_mm = result_.surface->chamfer_mm(result_.final_shape);
    result_.max_grasp_strain = environment_.max_grasp_strain();
    result_.hands = hands_.motion();
    if (auto frames = environment_.frames()) result_.frames = std::move(*frames);
    if (result_.frames.empty()) result_.frames = held_frames(result_);
    result_.warnings = environment_.warnings();
    for (auto& warning : session_warnings(result_, estimator_)) result_.warnings.push_back(std::move(warning));
    return std::move(result_);
  }

 private:
  double error_mm(const Observation& seen) const {
    if (!goal_) return kUnknown;
    const auto truth = environment_.true_shape();
    return truth ? mean_distance_mm(*truth, result_.goal, result_.goal_counts)
                 : seen_distance_mm(seen, result_.goal, result_.goal_counts);
  }

  SessionRound planned(Index number) {
    SessionRound round;
    round.state = state_;
    if (!params_.planning.replan && number > 0 && result_.rounds.back().plan.controls.rows() > 1) {
      round.plan = plans_ ? plans_->rest() : rest_of(result_.rounds.back().plan);
      round.knowledge = result_.rounds.back().knowledge;
      return round;
    }
    PlanRequest request{.shape = current_,
                        .previous = previous_,
                        .state = state_,
                        .hand_step = hand_step_,
                        .goal = goal_,
                        .surface = result_.surface,
                        .counts = result_.goal_counts,
                        .offset = nullptr,
                        .knowledge = setup_.knowledge,
                        .warm_start = warm_start_,
                        .round = number,
                        .seed = static_cast<std::uint64_t>(params_.seed)};
    if (!plans_) {
      if (estimator_) request.knowledge = narrower(chain_.knowledge(number - params_.knowledge_lag), setup_.knowledge);
      round.plan = setup_.planner->plan(request);
      round.knowledge = request.knowledge;
      return round;
    }
    // The correction that starts now makes the plan of segment number + lag.
    const Index seen = std::min<Index>(number, number + params_.correction.lag - params_.knowledge_lag);
    const auto known = [this, later = estimator_ ? chain_.knowledge_later(seen) : nullptr] {
      return later ? narrower(later(), setup_.knowledge) : setup_.knowledge;
    };
    std::tie(round.plan, round.correction) = number == 0 ? plans_->first(request) : plans_->next(request, known);
    round.knowledge = plans_->knowledge();
    return round;
  }

  void execute(const Vector& control) {
    const auto started = std::chrono::steady_clock::now();
    const SegmentPath path = trajectory_.segment(setup_.task.manipulation, state_, control);
    environment_.execute(path);
    for (const auto& targets : path.targets) hands_.add(targets);
    hands_.open(path.opening);
    for (const Index hand : path.opening) result_.opened_after[hand] = std::ssize(result_.rounds) + 1;
    hand_step_ = hands_.last_step();
    state_ = path.end_state;
    if (trajectory_.released(state_)) {
      result_.settle = environment_.release();
      result_.released = true;
    }
    result_.simulate_seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  }

  const SessionParams& params_;
  const SessionSetup& setup_;
  Environment& environment_;
  Host& host_;
  const Trajectory& trajectory_;
  const SessionEstimator* estimator_;
  EstimateChain chain_;
  std::optional<PlanChain> plans_;
  SessionResult result_;
  std::shared_ptr<const Positions> goal_, current_, previous_;
  std::vector<bool> last_seen_;
  Vector state_;
  HandMotionMeter hands_;
  Positions hand_step_;  // of the last frame
  Controls warm_start_;
};

}  // namespace

SessionResult run_session(const SessionParams& params, const SessionSetup& setup, Environment& environment, Host& host,
                          const SessionProgress& progress, TrialMemory* memory) {
  // With one thread all work except the solvers' own arithmetic runs here, so other sessions of this process do not count.
  const auto cpu_seconds = [&] { return host.threads() == 1 ? thread_cpu_seconds() : process_cpu_seconds(); };
  const double cpu_before = cpu_seconds();
  SessionRun run(params, setup, environment, host, memory ? *memory : TrialMemory());
  while (run.goes_on()) run.round(progress);
  if (memory) *memory = run.memory();
  SessionResult result = run.finished();
  result.cpu_seconds = cpu_seconds() - cpu_before;
  return result;
}

TrialRecord SessionResult::record() const {
  return {.error_mm = error_mm,
          .chamfer_mm = chamfer_mm,
          .coverage = errors.coverage,
          .predicted_error_mm = rounds.empty() ? kUnknown : rounds.back().plan.predicted_error_mm,
          .segments = std::ssize(rounds),
          .released = released};
}

SessionResult run_configured_session(const SessionParams& params, const ConfigNode& origin, Host& host,
                                     const SessionProgress& progress, std::shared_ptr<const StartShape> start) {
  SessionSetup setup = make_setup(params, origin, host, std::move(start));
  const auto seed = static_cast<std::uint64_t>(params.seed);
  const auto material = true_material_of(params);
  const Task world = world_task(setup.task, params.world, seed);
  const auto new_environment = [&](std::uint64_t observation_seed) {
    const Step step("making the environment");
    return make_environment(params.environment, origin, world, material, params.observation, observation_seed, host);
  };
  // A fold that follows another one has errors of observation of its own.
  const std::uint64_t noise = setup.task.start ? RandomStream(seed, hash_of(setup.task.start->world)).bits64() : seed;
  auto environment = new_environment(noise);
  setup.goal = make_goal(std::move(setup.goal), params.goal, params.planning.loss, world, seed, material, host);
  TrialMemory memory;
  SessionResult result;
  std::vector<TrialRecord> trials;
  for (Index trial = 0; trial < params.trials && !host.cancelled(); ++trial) {
    if (trial > 0) {
      environment.reset();  // a process ends before the next one starts
      environment = new_environment(RandomStream(noise, kTrialStream, static_cast<std::uint64_t>(trial)).bits64());
      if (params.knowledge == "estimate") setup.knowledge = narrower(memory.knowledge, setup.knowledge);
    }
    result = run_session(params, setup, *environment, host, progress, params.trials > 1 ? &memory : nullptr);
    trials.push_back(result.record());
  }
  if (trials.empty()) throw Error("interrupted before the first segment");
  result.trials = std::move(trials);
  result.world = world_record(setup.task, params.world, seed);
  return result;
}

}  // namespace weft
