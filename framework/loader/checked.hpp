#pragma once
#include <memory>
#include <string>

#include "sdk/wrong_result.hpp"

namespace weft {

class Optimiser;
class Predictor;
class Simulator;
class Trajectory;

enum class PluginChecks {
  none,     ///< the plugin's own object: for its own tests
  results,  ///< what it returns: for conformance, which gives it wrong input on purpose
  all,      ///< also what it is given, to blame a wrong call on its caller, and that an optimiser keeps to its bounds
};

// A plugin's object behind checks. Everything that it returns is checked: null, sizes, numbers that are not finite.
// Everything that it throws names the plugin and the steps of the work (guard.hpp). Calls are recorded (where.hpp).
// What the object is given and returns is otherwise unchanged, bit for bit.
std::shared_ptr<Optimiser> checked(const std::string& name, std::shared_ptr<Optimiser> plugin, PluginChecks checks);
std::shared_ptr<Predictor> checked(const std::string& name, std::shared_ptr<Predictor> plugin, PluginChecks checks);
std::shared_ptr<Simulator> checked(const std::string& name, std::shared_ptr<Simulator> plugin, PluginChecks checks);
std::shared_ptr<Trajectory> checked(const std::string& name, std::shared_ptr<Trajectory> plugin, PluginChecks checks);

/// The same for PluginRegistry::create(): a pointer to the interface of that kind, without its type.
std::shared_ptr<void> checked(const std::string& kind, const std::string& name, std::shared_ptr<void> plugin,
                              PluginChecks checks);

}  // namespace weft
