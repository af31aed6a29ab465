#pragma once
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/simulator.hpp"

namespace weft {

/// Vertices that are held from the first keyframe on. The target of a vertex is its position when it was grasped plus
/// the offset. The offset is linear between keyframes and constant after the last.
struct SceneGrasp {
  struct Keyframe {
    double time = 0.0;           ///< s, ascending
    Vec3 offset = Vec3::Zero();  ///< m
  };
  std::vector<Index> vertices;
  std::vector<Keyframe> keyframes;
  std::optional<double> release;  ///< s; nullopt: held to the end

  Vec3 offset_at(double time) const;
};

/// A scene file (docs/scenes.md): one simulator, one mesh, a world and scripted hands.
struct SceneRun {
  ConfigNode simulator;  ///< {plugin, params}
  std::shared_ptr<const Garment> garment;
  Fabric fabric;
  Scene scene;
  ConfigNode obstacles;  ///< those of `scene`, as they were given; null: none
  std::vector<SceneGrasp> grasps;
  double duration = 0.0;  ///< s
  Index output_every_frames = 12;
  std::uint64_t seed = 0;

  /// Frames to simulate: the duration rounded up to whole frames.
  Index frames() const;
};

/// The keys of a scene file, as `weft describe scene` shows them. N stands for the place in a list: 0, 1, ...
std::vector<ParamInfo> describe_scene();
/// Reads and checks a whole scene; loads no plugin. @throws ConfigError with file, line and key.
SceneRun read_scene(const ConfigNode& config);
/// The scene as a mapping. read_scene reads the same run from it. Its garment is `garment_file`.
ConfigNode write_scene(const SceneRun& run, const std::string& garment_file);

struct SceneResult {
  Index frames = 0;                   ///< simulated
  std::vector<double> frame_seconds;  ///< wall time of each frame
  Positions positions;                ///< [V, 3] m, at the end
  double max_speed = 0.0;             ///< m/s, at the end
  double max_strain = 0.0;            ///< largest over the whole run, at frame ends
  double final_strain = 0.0;          ///< at the end
  double max_grasp_strain = 0.0;      ///< largest over the run
  Index intersections = 0;            ///< edge/triangle, at the end
  std::vector<std::string> warnings;
  bool cancelled = false;
};

/// Called for frame 0 and after every frame, for output and progress.
using SceneObserver = std::function<void(const Simulator& simulator, Index frame)>;

/// What run_scene() refuses, before any work. @throws ConfigError, PluginError.
void check_scene(const SceneRun& run, Host& host);
/// Runs the scene. A grasp begins at the first frame boundary at or after its first keyframe, and ends at the first one
/// at or after its release.
/// @throws ConfigError, PluginError before any work; Diverged naming the frame.
SceneResult run_scene(const SceneRun& run, Host& host, const SceneObserver& observer = {});

/// summary.json: the keys of docs/file-formats.md.
std::string scene_summary_json(const SceneRun& run, const SceneResult& result);
/// Its times, for times.json.
std::string scene_times_json(const SceneResult& result);

}  // namespace weft
