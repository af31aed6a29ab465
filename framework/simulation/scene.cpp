#include "simulation/scene.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>

#include "meshes/intersections.hpp"

namespace weft {
namespace {

// A keyframe this close after a frame boundary counts as on it, so that rounding cannot move 0.1 s off frame 6.
constexpr double kTimeSlack = 1e-9;

/// First frame boundary at or after a time.
Index frame_at(double time) { return static_cast<Index>(std::ceil(time / kFrameSeconds - kTimeSlack / kFrameSeconds)); }

double number_in(const ConfigNode& node, double low, double high) {
  const double value = node.as_double();
  if (!(value >= low && value <= high)) {
    node.fail("= " + node.as_string() + ", must be in [" + ConfigNode::number(low).as_string() + ", " +
              ConfigNode::number(high).as_string() + "]");
  }
  return value;
}

Vec3 vector_in(const ConfigNode& node, double limit) {
  if (!node.is_sequence() || node.size() != 3) node.fail("must be a list of 3 numbers");
  Vec3 value;
  for (std::size_t k = 0; k < 3; ++k) value[k] = number_in(node[k], -limit, limit);
  return value;
}

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
  if (!node.is_mapping()) node.fail("must be a mapping {vertices, keyframes, release_s}");
  node.refuse_unknown_keys({"vertices", "keyframes", "release_s"});
  SceneGrasp grasp;
  grasp.vertices = vertices_in(node.at("vertices"), garment);
  if (grasp.vertices.empty()) node.at("vertices").fail("is empty, must name at least one vertex");
  const ConfigNode keyframes = node.at("keyframes");
  if (!keyframes.is_sequence() || keyframes.size() == 0) keyframes.fail("must be a list of {time_s, offset_m}");
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    const ConfigNode item = keyframes[k];
    if (!item.is_mapping()) item.fail("must be a mapping {time_s, offset_m}");
    item.refuse_unknown_keys({"time_s", "offset_m"});
    SceneGrasp::Keyframe keyframe;
    keyframe.time = number_in(item.at("time_s"), 0.0, 1e6);
    keyframe.offset = vector_in(item.at("offset_m"), 1e3);
    if (k > 0 && keyframe.time <= grasp.keyframes.back().time) {
      item.at("time_s").fail("= " + item.at("time_s").as_string() + ", must be later than the keyframe before it");
    }
    grasp.keyframes.push_back(keyframe);
  }
  if (const auto release = node.find("release_s")) {
    if (!release->is_null()) grasp.release = number_in(*release, 0.0, 1e6);
    if (grasp.release && *grasp.release <= grasp.keyframes.front().time) {
      release->fail("= " + release->as_string() + ", must be later than the first keyframe");
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

void add_warning(SceneResult& result, const std::string& text) {
  if (!text.empty() && std::find(result.warnings.begin(), result.warnings.end(), text) == result.warnings.end()) {
    result.warnings.push_back(text);
  }
}

/// Adds a warning for each ability that the scene needs and the simulator does not declare.
/// @throws ConfigError if the simulator cannot run the scene at all.
void check_capabilities(const SceneRun& run, const SimulatorCapabilities& capabilities, SceneResult& result) {
  if (!run.scene.pins.empty() && !capabilities.pins) {
    throw ConfigError("the scene has pins, which this simulator does not declare (capability pins)");
  }
  if (run.scene.ground_height && run.fabric.friction > 0.0 && !capabilities.ground_friction) {
    add_warning(result,
                "the fabric has ground friction, which this simulator does not declare (capability ground_friction)");
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
        hold.origin.row(static_cast<Index>(i)) = simulator.positions().row(grasp.vertices[i]);
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
        targets.row(at - held.begin()) = hold.origin.row(static_cast<Index>(i)) + offset.transpose();
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

SceneRun read_scene(const ConfigNode& config) {
  if (!config.is_mapping()) config.fail("must be a scene: a mapping");
  config.refuse_unknown_keys({"simulator", "garment", "fabric", "gravity_m_per_s2", "ground", "pins",
                              "initial_velocity_m_per_s", "grasps", "duration_s", "output_every_frames", "seed",
                              "plugin_path", "description"});
  SceneRun run;
  run.simulator = config.find("simulator").value_or(ConfigNode::parse("{plugin: cloth}", "default"));
  run.garment = std::make_shared<const Garment>(read_garment(config.at("garment")));
  run.fabric = read_fabric(config.at("fabric"));
  if (const auto gravity = config.find("gravity_m_per_s2")) run.scene.gravity = vector_in(*gravity, 1e3);
  if (const auto ground = config.find("ground")) {
    if (ground->is_scalar()) {
      if (ground->as_string() != "none") ground->fail("= " + ground->as_string() + ", must be none or {height_m: ...}");
      run.scene.ground_height = std::nullopt;
    } else {
      ground->refuse_unknown_keys({"height_m"});
      run.scene.ground_height = number_in(ground->at("height_m"), -1e3, 1e3);
    }
  }
  if (const auto pins = config.find("pins")) run.scene.pins = vertices_in(*pins, *run.garment);
  if (const auto velocity = config.find("initial_velocity_m_per_s")) {
    run.scene.initial_velocity = vector_in(*velocity, 1e3);
  }
  if (const auto grasps = config.find("grasps")) {
    if (!grasps->is_sequence() && !grasps->is_null()) grasps->fail("must be a list of grasps");
    for (std::size_t g = 0; g < grasps->size(); ++g) run.grasps.push_back(grasp_in((*grasps)[g], *run.garment));
    check_holds(*grasps, run);
  }
  run.duration = number_in(config.at("duration_s"), kFrameSeconds / 2.0, 36000.0);
  if (const auto every = config.find("output_every_frames")) {
    run.output_every_frames = every->as_int();
    if (run.output_every_frames < 1) every->fail("= " + every->as_string() + ", must be at least 1");
  }
  if (const auto seed = config.find("seed")) {
    if (seed->as_int() < 0) seed->fail("= " + seed->as_string() + ", must be at least 0");
    run.seed = static_cast<std::uint64_t>(seed->as_int());
  }
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
       {"garment", ConfigNode::quoted(garment_file)},
       {"fabric", write_fabric(run.fabric)},
       {"gravity_m_per_s2", vector_node(run.scene.gravity)},
       {"ground", run.scene.ground_height
                      ? ConfigNode::mapping({{"height_m", ConfigNode::number(*run.scene.ground_height)}})
                      : ConfigNode::scalar("none")},
       {"pins", vertices_node(run.scene.pins)},
       {"initial_velocity_m_per_s", vector_node(run.scene.initial_velocity)},
       {"grasps", ConfigNode::sequence(std::move(grasps))},
       {"duration_s", ConfigNode::number(run.duration)},
       {"output_every_frames", ConfigNode::integer(run.output_every_frames)},
       {"seed", ConfigNode::integer(static_cast<std::int64_t>(run.seed))}});
}

SceneResult run_scene(const SceneRun& run, Host& host, const SceneObserver& observer) {
  const auto simulator = host.create<Simulator>(run.simulator);
  SceneResult result;
  check_capabilities(run, simulator->capabilities(), result);
  simulator->reset(run.garment, run.fabric, run.scene);
  const auto look = [&](Index frame) {
    const SimulatorDiagnostics diagnostics = simulator->diagnostics();
    result.max_speed = diagnostics.max_speed;
    result.final_strain = diagnostics.max_strain;
    result.max_strain = std::max(result.max_strain, diagnostics.max_strain);
    result.max_grasp_strain = std::max(result.max_grasp_strain, diagnostics.max_grasp_strain);
    add_warning(result, diagnostics.warning);
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

std::string scene_summary_json(const SceneRun& run, const SceneResult& result) {
  std::vector<double> sorted = result.frame_seconds;
  std::sort(sorted.begin(), sorted.end());
  // The quantile is a measured value, not an interpolated one.
  const auto nearest_rank_ms = [&sorted](double p) {
    if (sorted.empty()) return 0.0;
    const auto rank = static_cast<std::size_t>(std::ceil(p * static_cast<double>(sorted.size())));
    return 1e3 * sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1];
  };
  nlohmann::ordered_json json{
      {"garment", run.garment->name},
      {"vertices", run.garment->vertex_count()},
      {"faces", run.garment->face_count()},
      {"fabric", run.fabric.name},
      {"frames", result.frames},
      {"seconds", static_cast<double>(result.frames) * kFrameSeconds},
      {"frame_ms", {{"median", nearest_rank_ms(0.5)}, {"p95", nearest_rank_ms(0.95)}}},
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
