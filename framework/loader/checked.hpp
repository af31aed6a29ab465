#pragma once
#include <memory>
#include <string>

namespace weft {

class Optimiser;
class Predictor;
class Simulator;
class Trajectory;

// A plugin's object behind checks. Everything that it returns is checked: null, sizes, numbers that are not finite.
// Everything that it throws names the plugin and the steps of the work (guard.hpp). Calls are recorded (where.hpp).
// What the object is given and returns is otherwise unchanged, bit for bit.
std::shared_ptr<Optimiser> checked(const std::string& name, std::shared_ptr<Optimiser> plugin);
std::shared_ptr<Predictor> checked(const std::string& name, std::shared_ptr<Predictor> plugin);
std::shared_ptr<Simulator> checked(const std::string& name, std::shared_ptr<Simulator> plugin);
std::shared_ptr<Trajectory> checked(const std::string& name, std::shared_ptr<Trajectory> plugin);

/// The same for PluginRegistry::create(): a pointer to the interface of that kind, without its type.
std::shared_ptr<void> checked(const std::string& kind, const std::string& name, std::shared_ptr<void> plugin);

}  // namespace weft
