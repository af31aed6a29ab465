#include "session/session_file.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "meshes/obstacle_mesh.hpp"
#include "sdk/garment_arrays.hpp"
#include "sdk/json_text.hpp"
#include "session/search_end.hpp"
#include "session/session.hpp"
#include "session/shape_errors.hpp"
#include "simulation/surroundings.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

/// Reads a session file. Every error message names the file.
class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : name_(path.string()), file_(Hdf5File::open(path)) {}

  [[noreturn]] void fail(const std::string& path, const std::string& message) const {
    throw ConfigError(name_ + ": " + path + " " + message);
  }
  bool has(const std::string& path) const { return file_.has(path); }
  std::vector<std::string> list(const std::string& group) const { return file_.list(group); }
  std::string text(const std::string& path) const { return file_.read_text(path); }
  std::string optional_text(const std::string& path) const { return has(path) ? text(path) : std::string(); }
  std::vector<std::int64_t> integers(const std::string& path) const { return file_.read_int(path); }

  Vector vector(const std::string& path, Index wanted = -1) const {
    const auto values = file_.read(path);
    const Index size = values.size();
    if (wanted >= 0 && size != wanted) {
      fail(path, "has " + std::to_string(size) + " numbers, must have " + std::to_string(wanted));
    }
    return Eigen::Map<const Vector>(values.data(), size);
  }
  Controls matrix(const std::string& path, Index columns = -1) const {
    const auto dims = file_.shape(path);
    if (dims.size() != 2 || (columns >= 0 && dims[1] != columns)) {
      fail(path, "must have the shape [n, " + (columns < 0 ? std::string("m") : std::to_string(columns)) + "]");
    }
    const auto values = file_.read(path);
    return Eigen::Map<const Controls>(values.data(), dims[0], dims[1]);
  }
  Positions all_positions(const std::string& path) const { return file_.read_positions(path); }
  GarmentForm garment_form(Index vertices) const { return read_garment_form(file_, name_, vertices); }
  Positions positions(const std::string& path, Index vertices) const {
    Positions result = file_.read_positions(path);
    if (result.rows() != vertices) {
      fail(path, "has " + std::to_string(result.rows()) + " vertices, must have " + std::to_string(vertices));
    }
    return result;
  }
  /// [n, vertices, 3].
  std::vector<Positions> shapes(const std::string& path, Index vertices) const {
    const auto dims = file_.shape(path);
    if (dims.size() != 3 || dims[2] != 3 || (dims[0] > 0 && dims[1] != vertices)) {
      fail(path, "must have the shape [n, " + std::to_string(vertices) + ", 3]");
    }
    const auto values = file_.read_float(path);
    for (const float value : values) {
      if (!std::isfinite(value)) fail(path, "holds a number that is not finite");
    }
    using SingleMatrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
    std::vector<Positions> result;
    for (Index i = 0; i < dims[0]; ++i) {
      result.push_back(Eigen::Map<const SingleMatrix>(values.data() + i * vertices * 3, vertices, 3).cast<double>());
    }
    return result;
  }

 private:
  std::string name_;
  Hdf5File file_;
};

constexpr const char* kSessionSchema = "weft session 1";
/// Of garments with rest frames or layers.
constexpr const char* kSessionSchemaOfForms = "weft session 2";

/// Checks what pages and exports take from the texts.
void check_texts(const Reader& in, const SessionRecord& record) {
  using nlohmann::ordered_json;
  for (const auto& [path, text] :
       {std::pair("/summary", &record.summary), std::pair("/provenance", &record.provenance)})
    if (!parse_json_if_valid(*text).is_object()) in.fail(path, "must be a JSON object");
  const auto summary = parse_json_if_valid(record.summary);
  for (const char* key : {"plan_seconds", "estimate_seconds", "predicted_error_mm"}) {
    const ordered_json list = summary.value(key, ordered_json::array());
    const auto is_number = [](const ordered_json& value) { return value.is_number() || value.is_null(); };
    if (!list.is_array() || !std::all_of(list.begin(), list.end(), is_number))
      in.fail("/summary", std::string(key) + " must be a list of numbers");
  }
  if (record.trajectory.empty()) return;
  const auto trajectory = parse_json_if_valid(record.trajectory);
  for (const char* kind : {"controls", "state"}) {
    const ordered_json list = trajectory.is_object() ? trajectory.value(kind, ordered_json()) : ordered_json();
    const auto is_variable = [](const ordered_json& one) {
      return one.is_object() && one.contains("name") && one["name"].is_string() && one.contains("unit") &&
             one["unit"].is_string();
    };
    if (!list.is_array() || !std::all_of(list.begin(), list.end(), is_variable))
      in.fail("/trajectory", "must have " + std::string(kind) + ": [{name, unit}]");
  }
}

/// The obstacles of the task, from the resolved config.
std::vector<Obstacle> obstacles_in(const Reader& in, const std::string& config) {
  try {
    const ConfigNode root = ConfigNode::parse(config, "/config");
    const auto scene = root.is_mapping() ? root.find("scene") : std::nullopt;
    const auto list = scene && scene->is_mapping() ? scene->find("obstacles") : std::nullopt;
    return list ? read_obstacles(*list) : std::vector<Obstacle>();
  } catch (const ConfigError& error) {
    in.fail("/config", std::string("is damaged: ") + error.what());
  }
}

RoundRecord read_round(const Reader& in, const std::string& group, Index vertices, Index hands) {
  RoundRecord round;
  round.controls = in.matrix(group + "/controls");
  if (round.controls.rows() == 0 || round.controls.cols() == 0) in.fail(group + "/controls", "holds no segment");
  round.state = in.vector(group + "/state");
  round.knowledge.centre = in.vector(group + "/knowledge_centre", 4);
  round.knowledge.width = in.vector(group + "/knowledge_width", 4);
  round.observed = in.positions(group + "/observed", vertices);
  round.losses = in.vector(group + "/losses");
  if (in.has(group + "/loss_curves")) round.curves = in.matrix(group + "/loss_curves", round.losses.size());
  round.mean = in.shapes(group + "/predicted_mean", vertices);
  const std::string sigma = group + "/predicted_sigma";
  round.sigma = in.shapes(sigma, vertices);
  if (!round.sigma.empty() && round.sigma.size() != round.mean.size())
    in.fail(sigma, "must be as long as predicted_mean");
  if (in.has(group + "/planned_targets")) round.targets = in.shapes(group + "/planned_targets", hands);
  return round;
}

/// Names and units of the control and state variables.
std::string trajectory_json(const Trajectory& trajectory) {
  const auto list = [](const std::vector<Variable>& variables) {
    auto items = nlohmann::ordered_json::array();
    for (const auto& variable : variables) items.push_back({{"name", variable.name}, {"unit", variable.unit}});
    return items;
  };
  return nlohmann::ordered_json{{"controls", list(trajectory.controls())}, {"state", list(trajectory.state())}}.dump();
}

void write_round(Hdf5File& file, const std::string& group, const SessionRound& round, const Task& task) {
  file.write(group + "/controls", round.plan.controls);
  file.write(group + "/state", round.state);
  file.write(group + "/observed", round.observed);
  const Vector centre = round.knowledge.centre, width = round.knowledge.width;
  file.write(group + "/knowledge_centre", centre);
  file.write(group + "/knowledge_width", width);
  const Vector losses = Eigen::Map<const Vector>(round.plan.losses.data(), round.plan.losses.size());
  file.write(group + "/losses", losses);
  if (!round.plan.curves.empty()) {
    Controls curves(round.plan.curves.size(), losses.size());
    for (Index r = 0; r < curves.rows(); ++r) {
      const auto& row = round.plan.curves[r];
      for (Index c = 0; c < curves.cols(); ++c) curves(r, c) = row[c];
    }
    file.write(group + "/loss_curves", curves);
  }
  // Single precision is enough: the error of a prediction is a fraction of a millimetre at best.
  std::vector<float> mean, sigma;
  for (const auto& shape : round.plan.shapes) {
    const auto m = to_frame(shape.mean), s = to_frame(shape.sigma);
    mean.insert(mean.end(), m.begin(), m.end());
    sigma.insert(sigma.end(), s.begin(), s.end());
  }
  // Planned targets of the hands. With them a page can draw the plan without the trajectory plugin. The path of a hand ends
  // where it opens.
  std::vector<float> targets;
  Positions at = task.trajectory->targets(task.manipulation, round.state);
  Vector state = round.state;
  for (Index j = 0; j < round.plan.controls.rows(); ++j) {
    const SegmentPath segment =
        task.trajectory->segment(task.manipulation, state, round.plan.controls.row(j).transpose());
    const auto holding = task.trajectory->holding(task.manipulation, state);
    for (const auto& points : segment.targets) {
      for (const Index hand : holding) at.row(hand) = points.row(hand);
      const auto p = to_frame(at);
      targets.insert(targets.end(), p.begin(), p.end());
    }
    state = segment.end_state;
  }
  file.write(
      group + "/planned_targets",
      {round.plan.controls.rows() * kFramesPerSegment, static_cast<Index>(task.manipulation.grasp_vertices.size()), 3},
      targets.data());
  const std::vector<Index> shape = {static_cast<Index>(round.plan.shapes.size()), task.garment->vertex_count(), 3};
  file.write(group + "/predicted_mean", shape, mean.data());
  file.write(group + "/predicted_sigma", shape, sigma.data());
}

using WideFaces = Eigen::Matrix<std::int64_t, Eigen::Dynamic, 3, Eigen::RowMajor>;

constexpr std::pair<GoalKind, const char*> kGoalKinds[] = {
    {GoalKind::surface, "surface"}, {GoalKind::points, "points"}, {GoalKind::silhouette, "silhouette"}};

void write_goal_surface(Hdf5File& file, const GoalSurface& goal) {
  for (const auto& [kind, name] : kGoalKinds)
    if (kind == goal.kind()) file.write("/goal_surface/kind", std::string(name));
  file.write("/goal_surface/positions", goal.positions());
  if (goal.faces().rows() > 0) file.write("/goal_surface/faces", WideFaces(goal.faces().cast<std::int64_t>()));
}

/// @param counts [V]: the vertices that count; empty: all.
void write_goal(Hdf5File& file, const Positions& goal, const std::vector<bool>& counts) {
  file.write("/goal", goal);
  std::vector<std::int64_t> vertices;
  for (std::size_t v = 0; v < counts.size(); ++v)
    if (counts[v]) vertices.push_back(static_cast<std::int64_t>(v));
  if (!vertices.empty()) file.write("/goal_vertices", {std::ssize(vertices)}, vertices.data());
}

std::vector<bool> read_goal_vertices(const Reader& in, Index vertices) {
  std::vector<bool> counts(vertices, false);
  const auto listed = in.integers("/goal_vertices");
  if (listed.empty()) in.fail("/goal_vertices", "must list at least one vertex");
  for (const auto vertex : listed) {
    if (vertex < 0 || vertex >= vertices) in.fail("/goal_vertices", "names a vertex that does not exist");
    counts[vertex] = true;
  }
  return counts;
}

void read_goal_surface(const Reader& in, SessionRecord& record) {
  record.has_correspondence = false;
  const std::string name = in.text("/goal_surface/kind");
  bool is_known = false;
  for (const auto& [kind, known] : kGoalKinds) {
    if (name != known) continue;
    record.goal_kind = kind;
    is_known = true;
  }
  if (!is_known) in.fail("/goal_surface/kind", "must be surface, points or silhouette");
  record.goal = in.all_positions("/goal_surface/positions");
  if (record.goal.rows() == 0) in.fail("/goal_surface/positions", "holds no point");
  if (record.goal_kind == GoalKind::points) return;
  const auto corners = in.integers("/goal_surface/faces");
  if (corners.empty() || corners.size() % 3 != 0) in.fail("/goal_surface/faces", "must have the shape [n, 3]");
  for (const auto corner : corners)
    if (corner < 0 || corner >= record.goal.rows()) in.fail("/goal_surface/faces", "names a point that does not exist");
  record.goal_faces = Eigen::Map<const WideFaces>(corners.data(), corners.size() / 3, 3).cast<int>();
}

/// Whether a hand opened before the others.
bool opens_early(const SessionResult& result) {
  return std::any_of(result.opened_after.begin(), result.opened_after.end(), [](const auto& after) { return !!after; });
}

/// JSON has no number for what is not finite.
nlohmann::ordered_json number(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
}

nlohmann::ordered_json trials_json(const std::vector<TrialRecord>& trials) {
  auto list = nlohmann::ordered_json::array();
  for (const auto& trial : trials)
    list.push_back({{"error_mm", number(trial.error_mm)},
                    {"chamfer_mm", number(trial.chamfer_mm)},
                    {"coverage", number(trial.coverage)},
                    {"predicted_error_mm", number(trial.predicted_error_mm)},
                    {"segments", trial.segments},
                    {"released", trial.released}});
  return list;
}

/// The garment as far as distances from a goal need it.
Garment drawn_garment(const SessionRecord& session) {
  Garment garment;
  garment.positions = session.start;
  garment.faces = session.faces;
  return garment;
}

}  // namespace

nlohmann::ordered_json to_json(const CorrectionRecord& record, Index in_force) {
  auto steps = nlohmann::ordered_json::array();
  for (const auto& step : record.steps) {
    steps.push_back({{"release", step.release},
                     {"found", step.is_candidate ? "candidate" : "search"},
                     {"radius", step.radius},
                     {"expected_mm2", number(step.expected)},
                     {"loss_mm2", number(step.loss)},
                     {"error_mm", number(step.error_mm)},
                     {"best", step.best}});
  }
  return {{"started", record.started},
          {"in_force", in_force},
          {"dropped", record.dropped},
          {"forecast_mm", number(record.forecast_mm)},
          {"corrected_mm", number(record.corrected_mm)},
          {"simulations", steps}};
}

double SessionRecord::goal_distance_mm(const Positions& shape) const {
  if (has_correspondence) return mean_distance_mm(shape, goal, goal_counts);
  return GoalSurface(goal_kind, goal, goal_faces, drawn_garment(*this)).chamfer_mm(shape);
}

Vector SessionRecord::vertex_distances_mm(const Positions& shape) const {
  if (has_correspondence) return 1000.0 * (shape - goal).rowwise().norm();
  return GoalSurface(goal_kind, goal, goal_faces, drawn_garment(*this)).distances_mm(shape);
}

Mesh SessionRecord::drawn_goal() const {
  Mesh mesh{.positions = goal, .faces = has_correspondence ? faces : goal_faces, .rest = {}, .source = ""};
  mesh.rest.resize(0, 2);
  if (has_correspondence || goal_kind != GoalKind::points) return mesh;
  constexpr double kHalf = 0.0015;  // m
  mesh.positions.resize(4 * goal.rows(), 3);
  mesh.faces.resize(2 * goal.rows(), 3);
  for (Index i = 0; i < goal.rows(); ++i) {
    const int first = static_cast<int>(4 * i);
    for (int k = 0; k < 4; ++k)
      mesh.positions.row(first + k) =
          goal.row(i) + Eigen::RowVector3d(k == 0 || k == 3 ? -kHalf : kHalf, k < 2 ? -kHalf : kHalf, 0.0);
    mesh.faces.row(2 * i) << first, first + 1, first + 2;
    mesh.faces.row(2 * i + 1) << first, first + 2, first + 3;
  }
  return mesh;
}

Mesh SessionRecord::drawn_obstacle(std::size_t k) const {
  Mesh mesh = obstacle_mesh(obstacles.at(k), start.colwise().mean().transpose());
  mesh.source = "obstacle_" + std::to_string(k) + "_" + obstacles[k].name;
  return mesh;
}

std::shared_ptr<const GoalSurface> SessionRecord::goal_surface(const Garment& garment, const std::string& loss) const {
  const GoalKind seen_as = loss == "silhouette" ? GoalKind::silhouette : GoalKind::surface;
  return std::make_shared<const GoalSurface>(has_correspondence ? seen_as : goal_kind, goal, goal_faces, garment);
}

std::string sequence_summary_json(const SessionResult& result) {
  auto steps = trials_json(result.steps);
  for (std::size_t k = 0; k < steps.size(); ++k) steps[k]["folder"] = "step_" + std::to_string(k + 1);
  const nlohmann::ordered_json summary = {{"schema", "weft sequence 1"}, {"steps", steps}};
  return summary.dump(2) + "\n";
}

std::string session_summary_json(const SessionResult& result) {
  using nlohmann::ordered_json;
  const auto list = [](const auto& v) { return std::vector<double>(v.data(), v.data() + v.size()); };
  ordered_json summary;
  const bool has_correspondence = result.goal.rows() > 0;
  summary["error_mm"] = number(result.error_mm);
  summary["default_error_mm"] = number(result.default_error_mm);
  if (result.surface) {
    summary["chamfer_mm"] = result.chamfer_mm;
    summary["default_chamfer_mm"] = result.default_chamfer_mm;
  }
  summary["max_error_mm"] = number(result.errors.max_mm);
  summary["grasped_error_mm"] = number(result.errors.grasped_mm);
  summary["named_error_mm"] = number(result.errors.named_mm);
  summary["silhouette_iou"] = number(result.errors.iou);
  summary["coverage"] = number(result.errors.coverage);
  for (const int limit : kSuccessLimitsMm)
    summary[success_key(limit)] = has_correspondence ? ordered_json(succeeds(result.error_mm, limit)) : ordered_json();
  summary["segments"] = result.rounds.size();
  summary["released"] = result.released;
  summary["settled"] = result.settle.settled;
  summary["settle_frames"] = result.settle.frames;
  auto iterations = ordered_json::array();
  auto plan_ended = ordered_json::array();
  auto predicted = ordered_json::array();
  auto knowledge = ordered_json::array();
  for (const auto& round : result.rounds) {
    iterations.push_back(round.plan.iterations);
    plan_ended.push_back(to_json(round.plan.ended));
    predicted.push_back(round.plan.predicted_error_mm);
    knowledge.push_back({{"centre", list(round.knowledge.centre)}, {"width", list(round.knowledge.width)}});
  }
  summary["plan_iterations"] = iterations;
  summary["plan_ended"] = plan_ended;
  summary["predicted_error_mm"] = predicted;
  auto corrections = ordered_json::array();
  for (std::size_t j = 0; j < result.rounds.size(); ++j) {
    if (const auto& done = result.rounds[j].correction) corrections.push_back(to_json(*done, j));
  }
  if (!corrections.empty()) summary["corrections"] = corrections;
  auto estimate_ended = ordered_json::array();
  for (const auto& estimate : result.estimates) estimate_ended.push_back(to_json(estimate.ended));
  summary["estimate_ended"] = estimate_ended;
  summary["max_grasp_strain"] = result.max_grasp_strain ? ordered_json(*result.max_grasp_strain) : ordered_json();
  const HandMotion& hands = result.hands;
  summary["hands"] = {{"speed_m_per_s", hands.speed},
                      {"acceleration_m_per_s2", hands.acceleration},
                      {"distance_m", std::isfinite(hands.distance) ? ordered_json(hands.distance) : ordered_json()},
                      {"outside_m", hands.outside}};
  if (opens_early(result)) {
    auto& opened = summary["hands"]["opened_after"] = ordered_json::array();
    for (const auto& after : result.opened_after) opened.push_back(after ? ordered_json(*after) : ordered_json());
  }
  summary["knowledge"] = knowledge;
  if (!result.estimates.empty()) {
    const auto& last = result.estimates.back().knowledge;
    summary["final_knowledge"] = {{"centre", list(last.centre)}, {"width", list(last.width)}};
  }
  summary["true_material"] = result.true_material ? ordered_json(list(*result.true_material)) : ordered_json();
  if (result.trials.size() > 1) summary["trials"] = trials_json(result.trials);
  summary["world"] = nullptr;
  if (result.world) {
    auto factors = ordered_json::object();
    for (const auto& [name, factor] : result.world->factors) factors[name] = factor;
    summary["world"] = {{"spread", result.world->spread}, {"simulator", result.world->simulator}, {"factors", factors}};
  }
  summary["shapes"] = result.shapes_are_true ? "true" : "observed";
  summary["warnings"] = result.warnings;
  return summary.dump(2) + "\n";
}

std::string session_times_json(const SessionResult& result) {
  using nlohmann::ordered_json;
  auto plans = ordered_json::array(), estimates = ordered_json::array();
  auto corrections = ordered_json::array();
  for (const auto& round : result.rounds) {
    plans.push_back(round.plan.seconds);
    if (round.correction) corrections.push_back(round.correction->seconds);
  }
  for (const auto& estimate : result.estimates) estimates.push_back(estimate.seconds);
  ordered_json times{{"plan_seconds", plans}, {"estimate_seconds", estimates}};
  if (!corrections.empty()) times["correction_seconds"] = corrections;
  times["simulate_seconds"] = result.simulate_seconds;
  times["cpu_seconds"] = result.cpu_seconds;
  return times.dump(2) + "\n";
}

void write_session(const std::filesystem::path& path, const SessionResult& result, const Task& task,
                   const ConfigNode& resolved, const std::string& provenance) {
  auto file = Hdf5File::create(path);
  const auto& garment = *task.garment;
  file.write("/schema", std::string(garment.form.empty() ? kSessionSchema : kSessionSchemaOfForms));
  file.write("/config", resolved.to_yaml());
  file.write("/provenance", provenance);
  file.write("/summary", session_summary_json(result));
  file.write("/garment/name", garment.name);
  file.write("/garment/hash", std::to_string(garment.hash));
  file.write("/garment/rest", garment.rest);
  file.write("/garment/faces", WideFaces(garment.faces.cast<std::int64_t>()));
  write_garment_form(file, garment.form);
  const std::vector<std::int64_t> held(task.manipulation.grasp_vertices.begin(),
                                       task.manipulation.grasp_vertices.end());
  file.write("/garment/grasp_vertices", {static_cast<Index>(held.size())}, held.data());
  if (opens_early(result)) {
    std::vector<std::int64_t> opened;
    for (const auto& after : result.opened_after) opened.push_back(after.value_or(std::ssize(result.rounds)));
    file.write("/garment/opened_after", {std::ssize(opened)}, opened.data());
  }
  file.write("/start", result.start);
  if (result.goal.rows() > 0)
    write_goal(file, result.goal, result.goal_counts);
  else
    write_goal_surface(file, *result.surface);
  file.write("/default_shape", result.default_shape);
  file.write("/final_shape", result.final_shape);
  if (result.goal_controls.rows() > 0) file.write("/goal_controls", result.goal_controls);
  if (result.true_material) file.write("/true_material", Vector(*result.true_material));
  if (!result.estimates.empty()) {
    Controls centre(result.estimates.size(), 4), width = centre;
    for (Index j = 0; j < centre.rows(); ++j) {
      centre.row(j) = result.estimates[j].knowledge.centre.transpose();
      width.row(j) = result.estimates[j].knowledge.width.transpose();
    }
    file.write("/estimates/centre", centre);
    file.write("/estimates/width", width);
  }
  file.write("/trajectory", trajectory_json(*task.trajectory));
  std::vector<float> frames;
  for (const auto& frame : result.frames) frames.insert(frames.end(), frame.begin(), frame.end());
  file.write("/frames", {static_cast<Index>(result.frames.size()), garment.vertex_count(), 3}, frames.data());
  for (std::size_t i = 0; i < result.rounds.size(); ++i) {
    const std::string group = "/rounds/" + std::string(i < 10 ? "00" : i < 100 ? "0" : "") + std::to_string(i);
    write_round(file, group, result.rounds[i], task);
  }
  file.commit();
}

SessionRecord read_session(const std::filesystem::path& path) {
  const Reader in(path);
  if (!in.has("/schema") || (in.text("/schema") != kSessionSchema && in.text("/schema") != kSessionSchemaOfForms))
    in.fail("/schema", "must be 'weft session 1' or 'weft session 2': this is not a recorded session");
  SessionRecord record;
  record.config = in.text("/config");
  record.obstacles = obstacles_in(in, record.config);
  record.provenance = in.text("/provenance");
  record.summary = in.text("/summary");
  record.trajectory = in.optional_text("/trajectory");
  check_texts(in, record);
  record.garment_name = in.text("/garment/name");
  const Index vertices = in.matrix("/start", 3).rows();
  record.rest = in.matrix("/garment/rest", 2);
  if (record.rest.rows() != vertices) in.fail("/garment/rest", "must have one row per vertex");
  const auto checked = [&](const std::string& name, const std::vector<std::int64_t>& indices) {
    for (const auto index : indices) {
      if (index < 0 || index >= vertices)
        in.fail(name, "names vertex " + std::to_string(index) + " of " + std::to_string(vertices));
    }
    return indices;
  };
  const auto corners = checked("/garment/faces", in.integers("/garment/faces"));
  if (corners.size() % 3 != 0) in.fail("/garment/faces", "must have the shape [n, 3]");
  record.faces = Eigen::Map<const WideFaces>(corners.data(), corners.size() / 3, 3).cast<int>();
  record.form = in.garment_form(vertices);
  if (record.form.frames.rows() != 0 && record.form.frames.rows() != record.faces.rows())
    in.fail("/garment/frames", "must have the shape [faces, 2, 2]");
  const auto held = checked("/garment/grasp_vertices", in.integers("/garment/grasp_vertices"));
  record.grasp_vertices.assign(held.begin(), held.end());
  if (in.has("/garment/opened_after")) {
    for (const auto after : in.integers("/garment/opened_after")) record.opened_after.push_back(after);
    if (record.opened_after.size() != held.size())
      in.fail("/garment/opened_after", "must have one entry per grasp vertex");
  }
  record.start = in.positions("/start", vertices);
  if (in.has("/goal")) {
    record.goal = in.positions("/goal", vertices);
    if (in.has("/goal_vertices")) record.goal_counts = read_goal_vertices(in, vertices);
    record.goal_faces = record.faces;
  } else {
    read_goal_surface(in, record);
  }
  record.default_shape = in.positions("/default_shape", vertices);
  record.final_shape = in.positions("/final_shape", vertices);
  if (in.has("/true_material")) record.true_material = in.vector("/true_material", 4);
  record.frames = in.shapes("/frames", vertices);
  if (record.frames.empty()) in.fail("/frames", "holds no frame");
  if (in.has("/rounds")) {
    for (const auto& name : in.list("/rounds")) {
      record.rounds.push_back(read_round(in, "/rounds/" + name, vertices, held.size()));
      const auto &first = record.rounds.front(), &last = record.rounds.back();
      if (last.controls.cols() != first.controls.cols() || last.state.size() != first.state.size())
        in.fail("/rounds/" + name, "has other controls or another state than the first round");
    }
  }
  for (const Index after : record.opened_after)
    if (after < 1 || after > record.segments())
      in.fail("/garment/opened_after",
              "holds " + std::to_string(after) + ", must be in [1, " + std::to_string(record.segments()) + "]");
  if (in.has("/estimates")) {
    const Controls centre = in.matrix("/estimates/centre", 4), width = in.matrix("/estimates/width", 4);
    if (centre.rows() != record.segments() || width.rows() != centre.rows())
      in.fail("/estimates", "must have one row per segment");
    for (Index j = 0; j < centre.rows(); ++j)
      record.estimates.push_back({centre.row(j).transpose(), width.row(j).transpose()});
  }
  if (record.settle_frames() < 0) {
    in.fail("/frames", "has " + std::to_string(record.frames.size()) + " frames for " +
                           std::to_string(record.segments()) + " segments, must have " +
                           std::to_string(record.segment_frame(record.segments()) + 1) + " or more");
  }
  return record;
}

}  // namespace weft
