#pragma once
#include <memory>
#include <string>
#include <vector>

#include "experiments/physics/physics.hpp"
#include "weft/host.hpp"

/// The physics suite: a simulator against closed forms. Knows only the Simulator interface; makes its own meshes.
namespace weft {

/// The simulator of a slot, such as `simulator` of a task. The host must outlive it.
SimulatorVariant simulator_variant(std::string name, Host& host, const ConfigNode& slot);

/// @param task optional: adds the crease of the task's fold, random folds and what its material properties do. Only the
/// cases' run() looks into it: without running, an empty Task gives the same list.
/// @param origin what params were read from, for messages. @throws ConfigError for an unknown test name, and for a
/// choice that leaves no case.
std::vector<PhysicsCase> physics_cases(const PhysicsParams& params, std::shared_ptr<const Task> task = nullptr,
                                       const ConfigNode& origin = {});
std::vector<std::string> physics_test_names();
/// Runs one case; an exception becomes a failed row.
std::vector<PhysicsRow> run_physics_case(const PhysicsCase& physics_case,
                                         const std::vector<SimulatorVariant>& variants);

}  // namespace weft
