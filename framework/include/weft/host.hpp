#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "weft/config.hpp"
#include "weft/export.hpp"
#include "weft/random.hpp"

namespace weft {

enum class LogLevel { debug, info, warning, error };

/// The program that loaded a plugin, as the plugin sees it. Plugins never print; they log here.
class WEFT_API Host {
 public:
  virtual ~Host();

  /// Makes any other plugin from `{plugin: NAME, params: {...}}`. The object keeps its library loaded.
  /// @throws ConfigError, PluginError.
  template <class Interface>
  std::shared_ptr<Interface> create(const ConfigNode& slot) {
    auto object = create_erased(Interface::kKind, slot);
    return {object, static_cast<Interface*>(object.get())};
  }

  /// The nodes of a slot that name files, as declared by the plugin's parameters and by the slots in them. Messages
  /// about the contents of a file point there. By default empty. @throws ConfigError, PluginError.
  virtual std::vector<ConfigNode> files(const std::string& kind, const ConfigNode& slot);

  virtual int threads() const = 0;  ///< worker threads, >= 1; part of the resolved config
  /// Runs body(i) for i in [0, count) on up to threads() threads, and waits. Which thread runs which i is not fixed, so
  /// bodies must not depend on one another. The first exception (lowest i) is rethrown here. Calls from inside a body
  /// run on the calling thread.
  virtual void parallel_for(std::int64_t count, const std::function<void(std::int64_t)>& body) = 0;
  /// True when the user asked to stop (SIGINT) or the time budget is spent; long loops check it and return early.
  virtual bool cancelled() const = 0;
  virtual void log(LogLevel level, const std::string& message) = 0;
  virtual std::uint64_t seed() const = 0;
  RandomStream random(std::uint64_t key) const { return RandomStream(seed(), key); }

 protected:
  virtual std::shared_ptr<void> create_erased(const std::string& kind, const ConfigNode& slot) = 0;
};

}  // namespace weft
