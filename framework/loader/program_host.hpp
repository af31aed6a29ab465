#pragma once
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "loader/checked.hpp"
#include "loader/registry.hpp"
#include "weft/host.hpp"

namespace weft {

struct HostOptions {
  int threads = 0;  ///< 0: allowed_processors()
  std::uint64_t seed = 0;
  std::function<void(LogLevel, const std::string&)> log;  ///< null: silent
  const std::atomic<bool>* cancel = nullptr;              ///< set by a signal handler
  PluginChecks checks = PluginChecks::all;                ///< of what plugins return and are given
};
/// The host for all plugins of the program. Must outlive them.
std::unique_ptr<Host> make_host(std::shared_ptr<const PluginRegistry> registry, const HostOptions& options);

}  // namespace weft
