#pragma once
#include <CLI/CLI.hpp>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "loader/registry.hpp"

namespace weft::app {

/// The options that every command takes, and the objects that commands need to run. A command registers a CLI11
/// subcommand and, if it is chosen, runs in `Context::action`. main prints errors and turns them into exit codes (0
/// done, 1 failed, 2 wrong use).
struct Context {
  std::vector<std::string> overrides;  ///< --set key.path=value
  std::optional<std::uint64_t> seed;   ///< --seed
  std::string out;                     ///< --out
  int jobs = 0;                        ///< --jobs, 0: allowed_processors()
  bool quiet = false;
  bool json = false;
  std::function<int()> action;

  /// Loads CONFIG and applies --set and --seed.
  ConfigNode load(const std::string& file) const;
  /// Registry over `plugin_path` of the config, the environment and the default folders.
  std::shared_ptr<const PluginRegistry> registry(const ConfigNode& config = {}) const;
  std::unique_ptr<Host> host(std::shared_ptr<const PluginRegistry> registry, std::uint64_t seed) const;
  /// Set when the user asks to stop, after host() was called.
  const std::atomic<bool>* cancel_flag() const;
  /// Prints a line for people; nothing with --quiet or --json.
  void say(const std::string& line) const;
};

/// Adds --set, --seed, --out, --jobs, --quiet and --json to a subcommand.
void add_common_options(CLI::App& command, Context& context);

}  // namespace weft::app
