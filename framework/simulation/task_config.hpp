#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/task.hpp"

namespace weft {

/// Length of a list with a number for each material property.
Length property_list();

/// The keys of a task file about the cloth, the hands and the world. Every command has them. Each command declares its
/// other keys (planning, goal, ...) itself.
struct TaskParams {
  ConfigNode garment;
  ConfigNode material;
  ConfigNode simulator = ConfigNode::parse("{plugin: cloth}", "default");
  ConfigNode trajectory = ConfigNode::parse("{plugin: arc}", "default");
  struct Hands {
    std::vector<std::string> grasp = {"left_sleeve_top", "left_body_bottom"};
    std::vector<double> displacement_m, opens_at;
    double drop_height_m = 0.05;
    struct Limits {
      double speed_m_per_s = 0.0, acceleration_m_per_s2 = 0.0, distance_m = 0.0;
      std::vector<double> workspace_m;
      template <class Visitor>
      void visit(Visitor& v) {
        v("speed_m_per_s", speed_m_per_s, range(0, 100, "m/s"), "Largest speed of a hand; 0: any.");
        v("acceleration_m_per_s2", acceleration_m_per_s2, range(0, 1e4, "m/s^2"),
          "Largest acceleration of a hand, from frame to frame; 0: any. The hands start at rest.");
        v("distance_m", distance_m, range(0, 10, "m"), "Least distance of the two hands.");
        v("workspace_m", workspace_m, range(-100, 100, "m"),
          "Corners of the box that the hands stay in; default: none.", Length{6, "least x, y, z, largest x, y, z"});
      }
    } limits;
    template <class Visitor>
    void visit(Visitor& v) {
      v("grasp", grasp,
        "The held vertices, one for each hand: a name, or nearest(x, y), which is the vertex nearest to that place (m) of "
        "those that are seen from above. The paper's g_0.");
      v("displacement_m", displacement_m, range(-10, 10, "m"),
        "d: displacement of the grasp points' midpoint; `weft displacement` tunes its length.", Length{2, "x, y"});
      v("drop_height_m", drop_height_m, range(0, 1, "m"),
        "h: height of the grasp points above contact at 180 degrees.");
      v("opens_at", opens_at, range(0.01, 1),
        "Share of the path (the trajectory's progress) at which each hand opens, at the end of that segment, while the "
        "others go on; 1: at the release, which at least one hand has. Default: all at the release.");
      v.group("limits", limits,
              "What the hands can do. Plans are penalised for more, and what still exceeds is slowed or moved.");
    }
  } manipulation;
  struct Start {
    std::filesystem::path session;
    template <class Visitor>
    void visit(Visitor& v) {
      v("session", session, "A recorded session (session.h5) of the same garment: the cloth starts where it ended.");
    }
  } start;
  struct World {
    std::vector<double> gravity_m_per_s2 = {0.0, 0.0, -9.81};
    ConfigNode ground, obstacles;
    template <class Visitor>
    void visit(Visitor& v) {
      v("gravity_m_per_s2", gravity_m_per_s2, range(-100, 100, "m/s^2"), "Gravity.", Length{3, "x, y, z"});
      v("ground", ground, "{height_m: ...}, or none. Without it the ground lies at 0.");
      v("obstacles", obstacles,
        "Bodies that stand still: a list of {box}, {cylinder}, {half_space} and {table}; `weft describe obstacles`.");
    }
  } scene;
  struct Settle {
    double speed_m_per_s = 0.005;
    std::int64_t hold_frames = 6;
    std::int64_t max_frames = 900;  // stiff, slippery loops unroll for up to ten seconds
    template <class Visitor>
    void visit(Visitor& v) {
      v("speed_m_per_s", speed_m_per_s, range(1e-5, 1, "m/s"), "Largest vertex speed of a settled cloth.");
      v("hold_frames", hold_frames, range(1, 1000, "frames"), "Frames in a row below that speed.");
      v("max_frames", max_frames, range(1, 100000, "frames"), "Stop waiting after this many frames.");
    }
  } settle;

  template <class Visitor>
  void visit(Visitor& v) {
    v("garment", garment, "The cloth: mesh and named vertices.", FileOrMapping{});
    v("material", material, "Material space: maps normalised properties to a fabric.", FileOrMapping{});
    v("simulator", simulator, PluginSlot{"simulator"}, "Simulator plugin of the executed fold.");
    v("trajectory", trajectory, PluginSlot{"trajectory"}, "Trajectory plugin.");
    v.group("manipulation", manipulation, "What the hands hold and where they move it.");
    v.group("start", start, "Where the cloth lies at the beginning; default: flat.");
    v.group("scene", scene, "The world around the cloth.");
    v.group("settle", settle, "When the released cloth counts as settled.");
  }
};

/// Builds the task: loads the garment and the material space, makes the trajectory.
/// The manipulation's contact height is that of the thickest cloth in the material space.
/// @param params from read_params(); @param origin the node they were read from, for messages.
/// @param start where the cloth lies, in place of `params.start`; null: as that says.
/// @throws ConfigError, PluginError; also for hands that are outside their limits where they grasp.
Task make_task(const TaskParams& params, const ConfigNode& origin, Host& host,
               std::shared_ptr<const StartShape> start = nullptr);

/// Makes the simulator, resets it with the task's garment and the fabric in the middle of its range, and logs its
/// warnings. So a wrong or unsuitable simulator is reported before any work.
/// @throws what creating or resetting the simulator throws.
void check_simulator(const ConfigNode& slot, const Task& task, Host& host);

}  // namespace weft
