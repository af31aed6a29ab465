#include "weft/session.hpp"

#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>

#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

// Keys of the random streams of a session; each purpose draws from its own.
constexpr std::uint64_t kMaterialStream = 0x71;
constexpr std::uint64_t kGoalStream = 0x676f616c;

std::vector<float> to_frame(const Positions& positions) {
  const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> single = positions.cast<float>();
  return {single.data(), single.data() + single.size()};
}

PropertyVector read_property_vector(const ConfigNode& origin, const char* key, const std::vector<double>& values) {
  if (values.size() != 4) {
    origin.fail(std::string(key) + " must be a list of 4 numbers in [0, 1]: friction, bend, stretch, thickness");
  }
  return Eigen::Map<const Eigen::Vector4d>(values.data());
}

/// Rows of controls from the config: a list of rows, or one row that is repeated until release.
Controls read_controls(const ConfigNode& node, const Trajectory& trajectory, Index horizon) {
  const auto columns = static_cast<Index>(trajectory.controls().size());
  if (!node.is_sequence() || node.size() == 0)
    node.fail("must be a list of rows of " + std::to_string(columns) + " numbers");
  const auto read_row = [&](const ConfigNode& row) {
    if (static_cast<Index>(row.size()) != columns) {
      row.fail("has " + std::to_string(row.size()) + " numbers, must have " + std::to_string(columns));
    }
    Vector values(columns);
    for (Index c = 0; c < columns; ++c) values(c) = row[static_cast<std::size_t>(c)].as_double();
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

Positions final_shape_of(const std::filesystem::path& session_file, const Garment& garment) {
  const auto file = Hdf5File::open(session_file);
  const auto hash = file.read_text("/garment/hash");
  if (hash != std::to_string(garment.hash)) {
    throw ConfigError(session_file.string() + ": was recorded with another garment (hash " + hash + ", this one has " +
                      std::to_string(garment.hash) + ")");
  }
  return file.read_positions("/final_shape");
}

}  // namespace

SimulatorEnvironment::SimulatorEnvironment(std::shared_ptr<Simulator> simulator, const Task& task,
                                           const MaterialProperties& material)
    : simulator_(std::move(simulator)), settle_(task.settle) {
  simulator_->reset(task.garment, task.material.at(material), task.scene);
  simulator_->grasp(task.manipulation.grasp_vertices);
  record();
}

void SimulatorEnvironment::record() { frames_.push_back(to_frame(simulator_->positions())); }

Observation SimulatorEnvironment::observe() {
  return {.positions = simulator_->positions(), .time_s = static_cast<double>(simulator_->frame()) * kFrameSeconds};
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
  const SettleResult result = simulator_->settle(settle_);
  record();
  seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  return result;
}

SessionResult run_session(const SessionParams& params, const ConfigNode& origin, Host& host,
                          const SessionProgress& progress) {
  const Task task = make_task(params.task, origin, host);
  const auto seed = static_cast<std::uint64_t>(params.seed);
  const auto& trajectory = *task.trajectory;
  SessionResult result;

  if (params.true_material.empty()) {
    RandomStream random(seed, kMaterialStream);
    for (Index p = 0; p < 4; ++p) result.true_material(p) = random.uniform();
  } else {
    result.true_material = read_property_vector(origin, "true_material", params.true_material);
  }
  MaterialKnowledge knowledge;
  if (params.knowledge == "true") knowledge = MaterialKnowledge::certain(result.true_material);
  if (params.knowledge == "given") {
    knowledge.centre = read_property_vector(origin, "given_centre", params.given_centre);
    knowledge.width = read_property_vector(origin, "given_width", params.given_width);
  }
  if (params.predictor.is_null()) origin.fail("predictor is missing; name one, such as {plugin: rollout}");
  const auto predictor = host.create<Predictor>(params.predictor);
  predictor->bind(task);
  const Planner planner(task, predictor, host.create<Optimiser>(params.optimiser), params.planning, host);

  // What the default control gives, and the goal.
  const auto reference = host.create<Simulator>(task.simulator);
  const Index horizon = params.goal.horizon;
  result.default_shape =
      simulate_fold(*reference, task, result.true_material, trajectory.default_controls(horizon)).shapes.back();
  const MaterialProperties goal_material = params.goal.material.empty()
                                               ? result.true_material
                                               : read_property_vector(origin, "goal.material", params.goal.material);
  const int given = !params.goal.obj.empty() + !params.goal.example.empty() + !params.goal.controls.is_null();
  if (given > 1) origin.fail("goal: give at most one of obj, example and controls");
  if (!params.goal.obj.empty()) {
    result.goal = read_obj(params.goal.obj).positions;
  } else if (!params.goal.example.empty()) {
    result.goal = final_shape_of(params.goal.example, *task.garment);
  } else if (!params.goal.controls.is_null()) {
    result.goal_controls = read_controls(params.goal.controls, trajectory, horizon);
    result.goal = simulate_fold(*reference, task, goal_material, result.goal_controls).shapes.back();
  } else {
    const auto& random_goal = params.goal.random;
    for (std::int64_t attempt = 0; attempt < random_goal.attempts && result.goal.rows() == 0; ++attempt) {
      RandomStream random = RandomStream(seed, kGoalStream).child(static_cast<std::uint64_t>(attempt));
      const Controls controls = random_controls(trajectory, horizon, random_goal.distribution, random);
      FoldResult fold;
      try {
        fold = simulate_fold(*reference, task, goal_material, controls);
      } catch (const Diverged& error) {
        host.log(LogLevel::warning, std::string("a goal candidate was skipped: ") + error.what());
        continue;
      }
      if (!fold.released || mean_distance_mm(fold.shapes.back(), result.default_shape) < random_goal.min_distance_mm)
        continue;
      result.goal = fold.shapes.back();
      result.goal_controls = controls.topRows(fold.segments);
    }
    if (result.goal.rows() == 0) {
      throw Error("goal: none of " + std::to_string(random_goal.attempts) + " random trajectories ended " +
                  std::to_string(random_goal.min_distance_mm) + " mm or more from what the default control gives");
    }
  }
  if (result.goal.rows() != task.garment->vertex_count()) {
    origin.fail("goal has " + std::to_string(result.goal.rows()) + " vertices, the garment has " +
                std::to_string(task.garment->vertex_count()));
  }
  result.default_error_mm = mean_distance_mm(result.default_shape, result.goal);

  // Plan, execute one segment, observe, re-plan, ..., release.
  SimulatorEnvironment environment(host.create<Simulator>(task.simulator), task, result.true_material);
  Vector state = trajectory.initial_state(task.manipulation);
  auto current = std::make_shared<const Positions>(environment.observe().positions);
  std::shared_ptr<const Positions> previous;
  const auto goal = std::make_shared<const Positions>(result.goal);
  result.start = *current;
  Controls warm_start;
  while (!result.released && static_cast<std::int64_t>(result.rounds.size()) < params.max_segments &&
         !host.cancelled()) {
    PlanRequest request{.shape = current, .previous = previous, .state = state, .goal = goal, .knowledge = knowledge};
    request.warm_start = warm_start;
    request.round = static_cast<Index>(result.rounds.size());
    request.seed = seed;
    SessionRound round;
    round.state = state;
    round.knowledge = knowledge;
    round.plan = planner.plan(request);
    const SegmentPath path = trajectory.segment(task.manipulation, state, round.plan.controls.row(0).transpose());
    environment.execute(path);
    state = path.end_state;
    if (trajectory.released(state)) {
      result.settle = environment.release();
      result.released = true;
    }
    round.observed = environment.observe().positions;
    previous = current;
    current = std::make_shared<const Positions>(round.observed);
    warm_start = round.plan.controls.bottomRows(round.plan.controls.rows() - 1);
    if (warm_start.rows() == 0) warm_start = trajectory.default_controls(1);
    if (progress) progress(round, request.round, mean_distance_mm(*current, result.goal));
    result.rounds.push_back(std::move(round));
  }
  result.final_shape = *current;
  result.error_mm = mean_distance_mm(result.final_shape, result.goal);
  result.simulate_seconds = environment.seconds();
  result.max_grasp_strain = environment.max_grasp_strain();
  result.frames = environment.frames();
  if (!result.released) {
    result.warnings.push_back("the session ended after " + std::to_string(result.rounds.size()) +
                              " segments without release");
  } else if (!result.settle.settled) {
    result.warnings.push_back("the released cloth did not settle within " + std::to_string(result.settle.frames) +
                              " frames");
  }
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
  summary["estimate_seconds"] = ordered_json::array();
  summary["simulate_seconds"] = result.simulate_seconds;
  summary["max_grasp_strain"] = result.max_grasp_strain;
  summary["knowledge"] = knowledge;
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
    const std::vector<Index> shape = {static_cast<Index>(round.plan.shapes.size()), garment.vertex_count(), 3};
    file.write(group + "/predicted_mean", shape, mean.data());
    file.write(group + "/predicted_sigma", shape, sigma.data());
  }
  file.commit();
}

}  // namespace weft
