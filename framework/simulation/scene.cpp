#include "simulation/scene.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>

#include "meshes/garment_writer.hpp"
#include "meshes/intersections.hpp"
#include "simulation/simulator_warnings.hpp"
#include "simulation/surroundings.hpp"

namespace weft {
namespace {

// A keyframe this close after a frame boundary counts as on it, so that rounding cannot move 0.1 s off frame 6.
constexpr double kTimeSlack = 1e-9;

/// First frame boundary at or after a time.
Index frame_at(double time) { return static_cast<Index>(std::ceil(time / kFrameSeconds - kTimeSlack / kFrameSeconds)); }

// What a scene file may say. A number that is NaN and a node that is null have no default: they must be given.
constexpr double kNotGiven = std::numeric_limits<double>::quiet_NaN();
constexpr double kNever = std::numeric_limits<double>::infinity();

struct KeyframeParams {
  double time_s = kNotGiven;
  std::vector<double> offset_m;
  template <class Visitor>
  void visit(Visitor& v) {
    v("time_s", time_s, range(0, 1e6, "s"), "Ascending. At the first one the hand takes hold.");
    v("offset_m", offset_m, range(-1e3, 1e3, "m"),
      "Offset from where each vertex was when the hand took hold; linear between keyframes, constant after the last.",
      Length{3, "x, y, z"});
  }
};
struct GraspParams {
  std::vector<std::string> vertices;
  ConfigNode keyframes;
  double release_s = kNever;
  template <class Visitor>
  void visit(Visitor& v) {
    v("vertices", vertices, "What this hand holds: indices or names, each once, at least one.");
    v("keyframes", keyframes, "At least one.");
    v("release_s", release_s, range(0, 1e6, "s"), "When the hand lets go; left out, it holds to the end.");
  }
};
struct SceneParams {
  std::string description;
  ConfigNode simulator = ConfigNode::parse("{plugin: cloth}", "default");
  ConfigNode garment, fabric, ground, obstacles, grasps;
  std::vector<double> gravity_m_per_s2 = {0.0, 0.0, -9.81};
  std::vector<double> initial_velocity_m_per_s = {0.0, 0.0, 0.0};
  std::vector<std::string> pins;
  double duration_s = kNotGiven;
  std::int64_t output_every_frames = 12;
  std::int64_t seed = 0;
  std::vector<std::string> plugin_path;
  template <class Visitor>
  void visit(Visitor& v) {
    v("description", description, "What the scene shows, for people.", Decides::nothing);
    v("seed", seed, range(0, 9e18), "Seed of a simulator that draws random numbers.");
    v("plugin_path", plugin_path, "Folders searched for plugins first.", Decides::nothing);
    v("simulator", simulator, PluginSlot{"simulator"}, "Simulator plugin.");
    v("garment", garment, "The cloth: mesh and named vertices. Must be given.", FileOrMapping{});
    v("fabric", fabric, "One material, not a material space. Must be given.", FileOrMapping{});
    v("gravity_m_per_s2", gravity_m_per_s2, range(-1e3, 1e3, "m/s^2"), "Turn it to tilt the ground.",
      Length{3, "x, y, z"});
    v("ground", ground, "The ground.");
    v("obstacles", obstacles, "Bodies that stand still: a list of {box}, {cylinder}, {half_space} and {table}.");
    v("pins", pins, "Vertices that never move: indices, or names of the garment.");
    v("initial_velocity_m_per_s", initial_velocity_m_per_s, range(-1e3, 1e3, "m/s"),
      "Of every vertex that is not pinned.", Length{3, "x, y, z"});
    v("grasps", grasps, "Hands.");
    v("duration_s", duration_s, range(kFrameSeconds / 2.0, 36000.0, "s"),
      "Simulated time, rounded up to frames of 1/60 s. Must be given.");
    v("output_every_frames", output_every_frames, range(1, kNever, "frames"),
      "Every how many frames a mesh is written; the last frame always is.");
  }
};

/// "{time_s, offset_m}"
template <class Params>
std::string keys_text() {
  std::string text;
  for (const ParamInfo& info : describe_params<Params>()) text += (text.empty() ? "{" : ", ") + info.name;
  return text + "}";
}

/// @throws ConfigError when a number that has no default is missing.
void require_given(const ConfigNode& mapping, const char* key, double value) {
  if (std::isnan(value)) must_be(mapping.at(key), "a number");
}

Vec3 vec3_of(const std::vector<double>& values) { return Vec3(values.at(0), values.at(1), values.at(2)); }

/// A list of vertices without repetition, by index or by the garment's names.
std::vector<Index> vertices_in(const ConfigNode& node, const Garment& garment) {
  if (!node.is_sequence()) node.fail("must be a list of vertices");
  std::vector<Index> vertices;
  for (std::size_t i = 0; i < node.size(); ++i) {
    const ConfigNode item = node[i];
    if (!item.is_scalar()) item.fail("must be a vertex: an index or a name");
    const std::string text = item.as_string();
    const bool is_number = !text.empty() && text.find_first_not_of("+-0123456789") == std::string::npos;
    Index vertex = 0;
    if (is_number) {
      vertex = item.as_int();
      if (vertex < 0 || vertex >= garment.vertex_count()) {
        item.fail("= " + text + ", must be a vertex in [0, " + std::to_string(garment.vertex_count() - 1) + "]");
      }
    } else {
      try {
        vertex = garment.vertex(text);
      } catch (const ConfigError& error) {
        item.fail(std::string("= ") + text + ": " + error.what());
      }
    }
    if (std::find(vertices.begin(), vertices.end(), vertex) != vertices.end())
      item.fail("= " + text + " is listed twice");
    vertices.push_back(vertex);
  }
  return vertices;
}

SceneGrasp grasp_in(const ConfigNode& node, const Garment& garment) {
  if (!node.is_mapping()) node.fail("must be a mapping " + keys_text<GraspParams>());
  GraspParams params;
  read_params(node, params);
  SceneGrasp grasp;
  grasp.vertices = vertices_in(node.at("vertices"), garment);
  if (grasp.vertices.empty()) node.at("vertices").fail("is empty, must name at least one vertex");
  const ConfigNode keyframes = node.at("keyframes");
  if (!keyframes.is_sequence() || keyframes.size() == 0)
    keyframes.fail("must be a list of " + keys_text<KeyframeParams>());
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    const ConfigNode item = keyframes[k];
    if (!item.is_mapping()) item.fail("must be a mapping " + keys_text<KeyframeParams>());
    KeyframeParams keyframe;
    read_params(item, keyframe);
    require_given(item, "time_s", keyframe.time_s);
    if (keyframe.offset_m.empty()) must_be(item.at("offset_m"), "a list of 3 numbers (x, y, z)");
    if (k > 0 && keyframe.time_s <= grasp.keyframes.back().time) {
      item.at("time_s").fail("= " + item.at("time_s").as_string() + ", must be later than the keyframe before it");
    }
    grasp.keyframes.push_back({keyframe.time_s, vec3_of(keyframe.offset_m)});
  }
  if (params.release_s != kNever) {
    grasp.release = params.release_s;
    if (*grasp.release <= grasp.keyframes.front().time) {
      node.at("release_s").fail("= " + node.at("release_s").as_string() + ", must be later than the first keyframe");
    }
  }
  return grasp;
}

bool overlap(const SceneGrasp& a, const SceneGrasp& b) {
  const auto end = [](const SceneGrasp& g) { return g.release.value_or(std::numeric_limits<double>::infinity()); };
  return a.keyframes.front().time < end(b) && b.keyframes.front().time < end(a);
}

void check_holds(const ConfigNode& grasps_node, const SceneRun& run) {
  for (std::size_t g = 0; g < run.grasps.size(); ++g) {
    for (const Index vertex : run.grasps[g].vertices) {
      const auto& pins = run.scene.pins;
      if (std::find(pins.begin(), pins.end(), vertex) != pins.end()) {
        grasps_node[g].at("vertices").fail("holds vertex " + std::to_string(vertex) + ", which is pinned");
      }
      for (std::size_t other = 0; other < g; ++other) {
        const auto& held = run.grasps[other].vertices;
        if (std::find(held.begin(), held.end(), vertex) != held.end() && overlap(run.grasps[g], run.grasps[other])) {
          grasps_node[g]
              .at("vertices")
              .fail("holds vertex " + std::to_string(vertex) + ", which grasp " + std::to_string(other) +
                    " holds at the same time");
        }
      }
    }
  }
}

ConfigNode vector_node(const Vec3& v) {
  return ConfigNode::sequence({ConfigNode::number(v.x()), ConfigNode::number(v.y()), ConfigNode::number(v.z())});
}
ConfigNode vertices_node(const std::vector<Index>& vertices) {
  std::vector<ConfigNode> items;
  for (const Index vertex : vertices) items.push_back(ConfigNode::integer(vertex));
  return ConfigNode::sequence(std::move(items));
}

void add_warnings(SceneResult& result, std::vector<std::string> warnings) {
  for (auto& text : warnings) {
    if (std::find(result.warnings.begin(), result.warnings.end(), text) == result.warnings.end())
      result.warnings.push_back(std::move(text));
  }
}

/// The scripted hands: the held vertices and their targets.
class Hands {
 public:
  /// Releases and grasps the vertices that the script gives for the boundary before this frame.
  void update(Simulator& simulator, const std::vector<SceneGrasp>& grasps, Index frame) {
    for (std::size_t h = 0; h < holds_.size();) {
      const SceneGrasp& grasp = *holds_[h].grasp;
      if (grasp.release && frame_at(*grasp.release) <= frame) {
        simulator.release(grasp.vertices);
        holds_.erase(holds_.begin() + static_cast<std::ptrdiff_t>(h));
      } else {
        ++h;
      }
    }
    for (const SceneGrasp& grasp : grasps) {
      if (frame_at(grasp.keyframes.front().time) != frame) continue;
      // First keyframe and release fall into the same frame, so the grasp has no effect.
      if (grasp.release && frame_at(*grasp.release) <= frame) continue;
      Hold hold{&grasp, Positions(static_cast<Index>(grasp.vertices.size()), 3)};
      for (std::size_t i = 0; i < grasp.vertices.size(); ++i) {
        hold.origin.row(i) = simulator.positions().row(grasp.vertices[i]);
      }
      simulator.grasp(grasp.vertices);
      holds_.push_back(std::move(hold));
    }
  }
  /// Targets [held, 3] m at the end of the frame, in the simulator's order of held vertices.
  Positions targets(const Simulator& simulator, Index frame) const {
    const std::vector<Index> held = simulator.grasped();
    Positions targets(static_cast<Index>(held.size()), 3);
    const double time = static_cast<double>(frame + 1) * kFrameSeconds;
    for (const Hold& hold : holds_) {
      const Vec3 offset = hold.grasp->offset_at(time);
      for (std::size_t i = 0; i < hold.grasp->vertices.size(); ++i) {
        const auto at = std::find(held.begin(), held.end(), hold.grasp->vertices[i]);
        if (at == held.end()) throw Error("the simulator lost vertex " + std::to_string(hold.grasp->vertices[i]));
        targets.row(at - held.begin()) = hold.origin.row(i) + offset.transpose();
      }
    }
    return targets;
  }

 private:
  struct Hold {
    const SceneGrasp* grasp;
    Positions origin;  // [vertices, 3] m, when they were grasped
  };
  std::vector<Hold> holds_;
};

}  // namespace

Vec3 SceneGrasp::offset_at(double time) const {
  if (time <= keyframes.front().time) return keyframes.front().offset;
  for (std::size_t k = 1; k < keyframes.size(); ++k) {
    const Keyframe& a = keyframes[k - 1];
    const Keyframe& b = keyframes[k];
    if (time < b.time) return a.offset + (b.offset - a.offset) * ((time - a.time) / (b.time - a.time));
  }
  return keyframes.back().offset;
}

Index SceneRun::frames() const { return frame_at(duration); }

std::vector<ParamInfo> describe_scene() {
  std::vector<ParamInfo> scene;
  const auto add = [&scene](const std::string& prefix, const std::vector<ParamInfo>& params) {
    for (ParamInfo info : params) {
      info.name = prefix + info.name;
      scene.push_back(std::move(info));
    }
  };
  for (const ParamInfo& info : describe_params<SceneParams>()) {
    if (info.name == "ground") {
      add("ground.", describe_ground());
    } else if (info.name == "obstacles") {
      add("obstacles.N.", describe_obstacles());
    } else if (info.name == "grasps") {
      for (const ParamInfo& key : describe_params<GraspParams>()) {
        if (key.name == "keyframes")
          add("grasps.N.keyframes.N.", describe_params<KeyframeParams>());
        else
          add("grasps.N.", {key});
      }
    } else {
      scene.push_back(info);
    }
  }
  return scene;
}

SceneRun read_scene(const ConfigNode& config) {
  if (!config.is_mapping()) config.fail("must be a scene: a mapping");
  SceneParams params;
  read_params(config, params);
  SceneRun run;
  run.simulator = params.simulator;
  run.garment =
      std::make_shared<const Garment>(read_garment(params.garment.is_null() ? config.at("garment") : params.garment));
  run.fabric = read_fabric(params.fabric.is_null() ? config.at("fabric") : params.fabric);
  run.scene.gravity = vec3_of(params.gravity_m_per_s2);
  run.scene.ground_height = read_ground(params.ground);
  run.obstacles = params.obstacles;
  run.scene.obstacles = read_obstacles(params.obstacles, run.scene.ground_height);
  if (!params.pins.empty()) run.scene.pins = vertices_in(config.at("pins"), *run.garment);
  run.scene.initial_velocity = vec3_of(params.initial_velocity_m_per_s);
  if (const ConfigNode& grasps = params.grasps; !grasps.is_null()) {
    if (!grasps.is_sequence()) grasps.fail("must be a list of grasps");
    for (std::size_t g = 0; g < grasps.size(); ++g) run.grasps.push_back(grasp_in(grasps[g], *run.garment));
    check_holds(grasps, run);
  }
  require_given(config, "duration_s", params.duration_s);
  run.duration = params.duration_s;
  run.output_every_frames = params.output_every_frames;
  run.seed = static_cast<std::uint64_t>(params.seed);
  return run;
}

ConfigNode write_scene(const SceneRun& run, const std::string& garment_file) {
  std::vector<ConfigNode> grasps;
  for (const SceneGrasp& grasp : run.grasps) {
    std::vector<ConfigNode> keyframes;
    for (const auto& keyframe : grasp.keyframes) {
      keyframes.push_back(ConfigNode::mapping(
          {{"time_s", ConfigNode::number(keyframe.time)}, {"offset_m", vector_node(keyframe.offset)}}));
    }
    std::vector<std::pair<std::string, ConfigNode>> entries{{"vertices", vertices_node(grasp.vertices)},
                                                            {"keyframes", ConfigNode::sequence(std::move(keyframes))}};
    if (grasp.release) entries.emplace_back("release_s", ConfigNode::number(*grasp.release));
    grasps.push_back(ConfigNode::mapping(std::move(entries)));
  }
  return ConfigNode::mapping(
      {{"simulator", run.simulator},
       {"garment",
        run.garment->form.empty() ? ConfigNode::quoted(garment_file) : garment_node(garment_file, *run.garment)},
       {"fabric", write_fabric(run.fabric)},
       {"gravity_m_per_s2", vector_node(run.scene.gravity)},
       {"ground", run.scene.ground_height
                      ? ConfigNode::mapping({{"height_m", ConfigNode::number(*run.scene.ground_height)}})
                      : ConfigNode::scalar("none")},
       {"obstacles", run.obstacles},
       {"pins", vertices_node(run.scene.pins)},
       {"initial_velocity_m_per_s", vector_node(run.scene.initial_velocity)},
       {"grasps", ConfigNode::sequence(std::move(grasps))},
       {"duration_s", ConfigNode::number(run.duration)},
       {"output_every_frames", ConfigNode::integer(run.output_every_frames)},
       {"seed", ConfigNode::integer(static_cast<std::int64_t>(run.seed))}});
}

namespace {

/// @throws ConfigError for a scene that the simulator cannot have.
std::shared_ptr<Simulator> simulator_at_start(const SceneRun& run, Host& host) {
  auto simulator = host.create<Simulator>(run.simulator);
  if (!run.scene.pins.empty() && !simulator->capabilities().pins)
    throw ConfigError("the scene has pins, which this simulator does not declare (capability pins)");
  simulator->reset(run.garment, run.fabric, run.scene);
  return simulator;
}

}  // namespace

void check_scene(const SceneRun& run, Host& host) { simulator_at_start(run, host); }

SceneResult run_scene(const SceneRun& run, Host& host, const SceneObserver& observer) {
  const auto simulator = simulator_at_start(run, host);
  SceneResult result;
  result.warnings = garment_warnings(*run.garment);
  const auto look = [&](Index frame) {
    const SimulatorDiagnostics diagnostics = simulator->diagnostics();
    result.max_speed = diagnostics.max_speed;
    result.final_strain = diagnostics.max_strain;
    result.max_strain = std::max(result.max_strain, diagnostics.max_strain);
    result.max_grasp_strain = std::max(result.max_grasp_strain, diagnostics.max_grasp_strain);
    add_warnings(result, simulator_warnings(*simulator, run.fabric, run.scene));
    if (observer) observer(*simulator, frame);
  };
  look(0);

  Hands hands;
  const Index frames = run.frames();
  result.frame_seconds.reserve(frames);
  for (Index frame = 0; frame < frames; ++frame) {
    if (host.cancelled()) {
      result.cancelled = true;
      break;
    }
    hands.update(*simulator, run.grasps, frame);
    const Positions targets = hands.targets(*simulator, frame);
    const auto start = std::chrono::steady_clock::now();
    simulator->step(targets);
    result.frame_seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    ++result.frames;
    look(frame + 1);
  }
  result.positions = simulator->positions();
  result.intersections = count_intersections(result.positions, run.garment->faces);
  return result;
}

std::string scene_times_json(const SceneResult& result) {
  std::vector<double> sorted = result.frame_seconds;
  std::sort(sorted.begin(), sorted.end());
  // The quantile is a measured value, not an interpolated one.
  const auto nearest_rank_ms = [&sorted](double p) {
    if (sorted.empty()) return 0.0;
    const auto rank = static_cast<std::size_t>(std::ceil(p * static_cast<double>(sorted.size())));
    return 1e3 * sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1];
  };
  return nlohmann::ordered_json{{"frame_ms", {{"median", nearest_rank_ms(0.5)}, {"p95", nearest_rank_ms(0.95)}}}}.dump(
             2) +
         "\n";
}

std::string scene_summary_json(const SceneRun& run, const SceneResult& result) {
  nlohmann::ordered_json json{
      {"garment", run.garment->name},
      {"vertices", run.garment->vertex_count()},
      {"faces", run.garment->face_count()},
      {"fabric", run.fabric.name},
      {"frames", result.frames},
      {"seconds", static_cast<double>(result.frames) * kFrameSeconds},
      {"max_speed_m_per_s", result.max_speed},
      {"max_strain", result.final_strain},
      {"max_strain_of_run", result.max_strain},
      {"max_grasp_strain", result.max_grasp_strain},
      {"intersections", result.intersections},
      {"min_z_m", result.positions.col(2).minCoeff()},
      {"max_z_m", result.positions.col(2).maxCoeff()},
      {"cancelled", result.cancelled},
      {"warnings", result.warnings},
  };
  return json.dump(2) + "\n";
}

}  // namespace weft
