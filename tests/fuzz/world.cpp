#include <hdf5.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>

#include "experiments/ablation.hpp"
#include "experiments/experiment_config.hpp"
#include "experiments/physics/physics.hpp"
#include "fuzz.hpp"
#include "loader/program_host.hpp"
#include "simulation/scene.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"

namespace weft::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr const char* kSquare =
    "v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nv 0 0.1 0\nv 0.1 0.1 0\nv 0.2 0.1 0\nv 0 0.2 0\nv 0.1 0.2 0\nv 0.2 0.2 0\n"
    "f 1 2 4\nf 2 5 4\nf 2 3 5\nf 3 6 5\nf 4 5 7\nf 5 8 7\nf 5 6 8\nf 6 9 8\n";
constexpr const char* kGarment =
    "name: square\nmesh: square.obj\nvertices: {left_sleeve_top: 6, left_body_bottom: 0, right: 5}\n";
constexpr const char* kFabric =
    "{density_kg_per_m2: 0.15, stretch_n_per_m: {warp: 110, weft: 165, shear: 55}, poisson: 0.2,\n"
    " bend_n_m: {warp: 1.6e-5, weft: 2.4e-5, bias: 1.8e-5}, friction: 0.5, self_friction: 0.3, thickness_m: 0.001}\n";
constexpr const char* kSpace =
    "nominal: fabric.yaml\nproperties:\n  friction: {low: 0.1, high: 1.0, scale: log}\n"
    "  bend: {low: 0.1, high: 10, scale: log}\n  stretch: {low: 0.2, high: 4, scale: log}\n"
    "  thickness: {low: 0.0005, high: 0.004}\n";
constexpr const char* kTask =
    "garment: square.yaml\nmaterial: space.yaml\nsimulator: {plugin: mass_spring}\ntrajectory: {plugin: arc}\n"
    "predictor: {plugin: rollout}\nmanipulation: {displacement_m: [0.2, 0]}\nplanning: {instances: 2, horizon: 8}\n";
constexpr const char* kArcsim =
    R"({"density": 0.2, "stretching": [[30, 10, 30, 20], [30, 10, 30, 20], [30, 10, 30, 20], [30, 10, 30, 20],)"
    R"( [30, 10, 30, 20], [30, 10, 30, 20]], "bending": [[1e-5, 1e-5, 1e-5, 1e-5, 1e-5],)"
    R"( [1e-5, 1e-5, 1e-5, 1e-5, 1e-5], [1e-5, 1e-5, 1e-5, 1e-5, 1e-5]]})";

/// A folder in memory, so that a million files cost no disk.
fs::path memory_folder() {
  std::error_code ignored;
  const fs::path root = fs::is_directory("/dev/shm", ignored) ? "/dev/shm" : fs::temp_directory_path();
  return root / ("weft-fuzz-" + std::to_string(::getpid()));
}

template <class Params>
void add_names(std::vector<std::string>& words) {
  for (const ParamInfo& info : describe_params<Params>()) {
    words.push_back(info.name.substr(info.name.rfind('.') + 1));
    words.insert(words.end(), info.choices.begin(), info.choices.end());
  }
}

}  // namespace

World::World() : folder_(memory_folder()) {
  // libhdf5 keeps what it frees. Each open file has a table of half a megabyte, for which the kernel else finds new pages every time.
  H5set_free_list_limits(64 << 20, 4 << 20, -1, -1, -1, -1);
  fs::create_directories(folder_);
  write("square.obj", kSquare);
  write("square.yaml", kGarment);
  write("fabric.yaml", kFabric);
  write("fabric.json", kArcsim);
  write("space.yaml", kSpace);
  write("base.yaml", kTask);
  write("experiment.yaml", std::string("extends: base.yaml\n") + "data: {max_segments: 4}\n");
  registry = std::make_shared<PluginRegistry>(std::vector<fs::path>{WEFT_FUZZ_PLUGINS});
  host = make_host(registry, {.threads = 1});
  const ConfigNode config = ConfigNode::load(file("base.yaml"));
  SessionParams params;
  read_params(config, params);
  task = make_task(params.task, config, *host);
}

World::~World() {
  std::error_code ignored;
  fs::remove_all(folder_, ignored);
}

fs::path World::write(const std::string& name, std::string_view bytes) const {
  fs::path path = file(name);
  std::ofstream stream(path, std::ios::binary);
  stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!stream.flush()) throw std::runtime_error(path.string() + ": cannot be written");
  return path;
}

World& world() {
  static World the_world;
  return the_world;
}

void finding(const std::string& message) {
  std::fprintf(stderr, "finding: %s\n", message.c_str());
  std::abort();
}

std::vector<std::string> words_of_target(std::string_view target) {
  std::vector<std::string> words = {"plugin", "params", "extends", "1e9", "-1", ".nan", ".inf", "null", "[]", "{}"};
  if (target == "task" || target == "experiment") add_names<ExperimentParams>(words);
  if (target == "experiment") {
    add_names<AblationParams>(words);
    add_names<PhysicsExperimentParams>(words);
  }
  if (target == "scene") {
    for (const ParamInfo& info : describe_scene()) words.push_back(info.name.substr(info.name.rfind('.') + 1));
  }
  for (const char* name : {"square.obj", "square.yaml", "fabric.yaml", "fabric.json", "space.yaml", "base.yaml",
                           "experiment.yaml", "arc", "spline", "rollout", "rprop", "mass_spring", "emd"})
    words.emplace_back(name);
  if (target == "obj") words = {"v ", "vt ", "vn ", "f ", "1/1/1", "\\\n", "-1", "1e308", "l ", "p ", "o ", "\xff\xfe"};
  if (target == "fabric")
    words = {"density", "stretching", "bending", "name", "stretch_multiplier", "bend_multiplier", "1e999", "[[", "]]"};
  return words;
}

}  // namespace weft::fuzz
