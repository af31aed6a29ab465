// Tasks, experiments, scenes and the metadata of modules: YAML.
#include "experiments/ablation.hpp"
#include "experiments/experiment_config.hpp"
#include "experiments/physics/suite.hpp"
#include "fuzz.hpp"
#include "identity/identity.hpp"
#include "predictor/torchscript/metadata.hpp"
#include "session/session.hpp"
#include "simulation/scene.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"
#include "weft/material.hpp"
#include "weft/simulator.hpp"

namespace weft::fuzz {
namespace {

/// A saved config reads back as what was saved.
void require_round_trip(const ConfigNode& config) {
  const std::string yaml = config.to_yaml();
  const std::string again = ConfigNode::parse(yaml, "saved").to_yaml();
  if (yaml != again) finding("a saved config reads back as another one:\n" + yaml + "---\n" + again);
  config.to_json();
}

/// What every command does with a config before it begins.
template <class Params>
Task prepare(const ConfigNode& config, Params& params) {
  const ConfigNode resolved = read_params(config, params);
  World& w = world();
  Task task = make_task(params.task, config, *w.host);
  check_session(params, config, task);
  const auto described = describe_params<Params>();
  require_round_trip(w.registry->resolve_slots(resolved, described));
  make_identity({config, resolved, described, task, *w.registry});
  return task;
}

/// What `weft run` does before its first segment, but for starting the process of environment.command.
void rehearse(const ConfigNode& config) {
  SessionParams params;
  const Task task = prepare(config, params);
  check_simulator(task.simulator, task, *world().host);
  rehearse_session(params, config, *world().host);
}

}  // namespace

void task(std::string_view yaml) {
  const auto file = world().write("input.yaml", yaml);
  refusal([&] { rehearse(ConfigNode::load(file)); });
}

void experiment(std::string_view yaml) {
  const auto file = world().write("input.yaml", yaml);
  refusal([&] {
    const ConfigNode config = ConfigNode::load(file);
    if (config.is_mapping() && config.has("factors")) {
      AblationPlan plan = read_ablation(config);
      refusal([&] { rehearse(plan.arms.front().config); });
    } else if (config.is_mapping() && config.has("physics")) {
      PhysicsExperimentParams params;
      const auto task = std::make_shared<const Task>(prepare(config, params));
      physics_cases(params.physics, task, config);
    } else {
      ExperimentParams params;
      prepare(config, params);
    }
  });
}

void scene(std::string_view yaml) {
  const auto file = world().write("input.yaml", yaml);
  refusal([&] {
    SceneRun run = read_scene(ConfigNode::load(file));
    run.simulator = world().registry->resolve(Simulator::kKind, run.simulator);
    const ConfigNode saved = write_scene(run, "square.obj");
    require_round_trip(saved);
    run.frames();
  });
}

void torchscript(std::string_view yaml) {
  const auto file = world().write("input.yaml", yaml);
  refusal([&] {
    const auto metadata = weft::torchscript::read_metadata(file);
    if (!metadata.material.is_null()) refusal([&] { read_material_space(metadata.material); });
    weft::torchscript::require_task(metadata, file.string(), world().task);
  });
}

}  // namespace weft::fuzz
