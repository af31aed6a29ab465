#include "loader/checked.hpp"

#include "weft/optimiser.hpp"
#include "weft/predictor.hpp"
#include "weft/simulator.hpp"
#include "weft/trajectory.hpp"

namespace weft {
namespace {

template <class Interface>
std::shared_ptr<void> checked_as(const std::string& name, std::shared_ptr<void> plugin) {
  auto* const object = static_cast<Interface*>(plugin.get());
  std::shared_ptr<Interface> guarded = checked(name, std::shared_ptr<Interface>(std::move(plugin), object));
  auto* const interface = guarded.get();
  return {std::move(guarded), interface};
}

}  // namespace

std::shared_ptr<void> checked(const std::string& kind, const std::string& name, std::shared_ptr<void> plugin) {
  if (kind == Simulator::kKind) return checked_as<Simulator>(name, std::move(plugin));
  if (kind == Predictor::kKind) return checked_as<Predictor>(name, std::move(plugin));
  if (kind == Trajectory::kKind) return checked_as<Trajectory>(name, std::move(plugin));
  return checked_as<Optimiser>(name, std::move(plugin));
}

}  // namespace weft
