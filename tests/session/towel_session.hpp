#pragma once
// Sessions on a coarse towel, with the plugins that ship.
#include <memory>
#include <string>
#include <vector>

#include "loader/program_host.hpp"
#include "meshes/mesher.hpp"
#include "session/session.hpp"
#include "session/session_file.hpp"
#include "simulation/task_config.hpp"
#include "unit/test_support.hpp"

namespace weft {

/// A towel of 80 mm edges and a plan that costs a second.
inline std::string task_text() {
  return "garment: towel.yaml\n"
         "material: " WEFT_SOURCE_DIR
         "/configs/fabrics/basic.yaml\n"
         "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
         "simulator: {plugin: cloth}\n"
         "trajectory: {plugin: arc}\n"
         "predictor: {plugin: rollout}\n"
         "planning: {instances: 2, iterations: 3, replan_iterations: 1, horizon: 14}\n"
         "goal: {random: {min_distance_mm: 20}}\n"
         "settle: {max_frames: 60}\n"
         "seed: 4\n";
}

class Session : public testing::Test {
 protected:
  Session() {
    const auto towel = generate_mesh(towel_outline({}), {.edge_m = 0.08});
    write_obj(folder_ / "towel.obj", towel.mesh, true);
    std::string vertices;
    for (const auto& [name, index] : towel.vertices) vertices += "  " + name + ": " + std::to_string(index) + "\n";
    folder_.write("towel.yaml", "name: towel\nmesh: towel.obj\nvertices:\n" + vertices);
    config_ = ConfigNode::load(folder_.write("task.yaml", task_text()));
  }

  /// The task of the last run, or without any of task_text().
  Task task() {
    SessionParams params;
    read_params(config_, params);
    const auto registry = std::make_shared<PluginRegistry>();
    return make_task(params.task, config_, *make_host(registry, {.threads = 1}));
  }

  /// Writes the result of the last run.
  void record(const std::filesystem::path& file, const SessionResult& result) {
    SessionParams params;
    read_params(config_, params);
    const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});  // lives longer than the task
    write_session(file, result, make_task(params.task, config_, *host), resolved_, "{}");
  }

  /// @param overrides as for --set.
  SessionResult run(const std::vector<std::string>& overrides = {}, int threads = 2) {
    ConfigNode config = ConfigNode::load(folder_ / "task.yaml");
    for (const auto& assignment : overrides) config = apply_override(config, assignment);
    config_ = config;
    SessionParams params;
    resolved_ = read_params(config, params);
    const auto registry = std::make_shared<PluginRegistry>();
    const auto host = make_host(registry, {.threads = threads, .seed = 4});
    return run_configured_session(params, config, *host);
  }

  test::Folder folder_;
  ConfigNode config_, resolved_;
};

inline const std::vector<std::string> kEstimate = {"knowledge=estimate", "planning.iterations=1",
                                                   "planning.replan_iterations=0", "planning.instances=1",
                                                   "estimation={instances: 2, iterations: 3, later_iterations: 2}"};
inline std::vector<std::string> with(std::vector<std::string> list, const std::vector<std::string>& more) {
  list.insert(list.end(), more.begin(), more.end());
  return list;
}

}  // namespace weft
