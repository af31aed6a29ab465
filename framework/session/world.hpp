#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/task.hpp"

namespace weft {

/// How the world differs from the task that planner and estimator know: other constants of the fabric, another simulator.
struct WorldParams {
  double spread = 0.0;
  std::vector<std::string> known;
  ConfigNode simulator;

  template <class Visitor>
  void visit(Visitor& v) {
    v("spread", spread, range(0, 0.9),
      "The world's fabric has other constants than the task's: Poisson's ratio, bias bending, self friction, dampings, "
      "air drag and density are each multiplied by a factor from [1 - spread, 1 + spread], drawn from the seed. "
      "Planner and estimator do not know it.");
    v("known", known,
      "Constants that keep the task's value, as if they had been measured before the fold: poisson, bend_bias, "
      "self_friction, damping_stretch, damping_bend, damping_air, density.");
    v("simulator", simulator, PluginSlot{"simulator"}, "Simulator plugin of the world; default: the task's.");
  }
  bool is_the_tasks() const { return spread == 0.0 && simulator.is_null(); }
};

/// What a world was, for the record.
struct WorldRecord {
  double spread = 0.0;
  std::string simulator;  ///< name of the plugin
  /// Factor of each constant. Where a value would not be valid the nearest valid one is taken, and the factor is that of
  /// the value. Empty if spread = 0.
  std::vector<std::pair<std::string, double>> factors;
};

/// The task as it is in the world: its nominal fabric and its simulator are the world's. The cloth
/// starts where it is (StartShape::world). With the default parameters all else is that of `task`. The properties friction, bend, stretch and thickness keep their ranges.
Task world_task(const Task& task, const WorldParams& params, std::uint64_t seed);
/// What world_task() changed; nullopt: nothing.
std::optional<WorldRecord> world_record(const Task& task, const WorldParams& params, std::uint64_t seed);
/// check_simulator() for the world's own simulator, if it has one. @param config of the session, which messages name.
/// @throws ConfigError also for a name in `known` that is no constant.
void check_world(const WorldParams& params, const Task& task, const ConfigNode& config, Host& host);

}  // namespace weft
