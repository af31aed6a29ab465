#pragma once
#include <CLI/CLI.hpp>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "loader/checked.hpp"
#include "loader/registry.hpp"

namespace weft::app {

/// Set for a command that another weft started and follows: its process number.
inline constexpr const char* kParentVariable = "WEFT_PARENT";

/// The options that every command takes, and the objects that commands need to run. A command registers a CLI11
/// subcommand and, if it is chosen, runs in `Context::action`. main prints errors and turns them into exit codes (0
/// done, 1 failed, 2 wrong use).
struct Context {
  std::vector<std::string> overrides;  ///< --set key.path=value
  std::optional<std::uint64_t> seed;   ///< --seed
  std::string out;                     ///< --out
  int jobs = 0;                        ///< --jobs, 0: allowed_processors()
  bool accept_changed = false;         ///< --accept-changed
  bool quiet = false;
  bool json = false;
  bool is_step = false;            ///< of a command that speaks for it: only warnings and complaints are printed
  std::vector<std::string> words;  ///< of the command line, without the program
  std::function<int()> action;

  /// Loads CONFIG and applies --set and --seed.
  ConfigNode load(const std::string& file) const;
  /// Registry over `plugin_path` of the config, the environment and the default folders.
  std::shared_ptr<const PluginRegistry> registry(const ConfigNode& config = {}) const;
  std::unique_ptr<Host> host(std::shared_ptr<const PluginRegistry> registry, std::uint64_t seed,
                             PluginChecks checks = PluginChecks::all) const;
  /// Set when the user asks to stop, after host() or catch_signals() was called.
  const std::atomic<bool>* cancel_flag() const;
  static void catch_signals();
  /// Whether SIGTERM asked to stop.
  static bool is_terminated();
  /// Prints a line for people; nothing with --quiet or --json, or as a step.
  void say(const std::string& line) const;
  /// Keeps stdout for what is written to output(); what plugins print there goes to stderr from now on.
  static void keep_output();
  /// Where a command writes its result, such as JSON.
  static std::ostream& output();
  /// Writes what is buffered of output() and of stdout. @throws Error with the reason if any of it was not written.
  static void flush_output();
  /// Makes a SIGTERM reach this process when the weft that started it ends, as kParentVariable says; once, before threads begin.
  static void end_with_parent();
  /// Opens stdin, stdout and stderr that are closed, as nothing: a result file must not get their numbers.
  static void open_standard_streams();
  /// Prints a line about a failure to stderr; nothing with --quiet.
  void complain(const std::string& line) const;
};

/// Adds --accept-changed to a subcommand that adds to a folder or writes over one.
void add_accept_option(CLI::App& command, Context& context);

/// Adds --set, --seed, --out, --jobs, --quiet and --json to a subcommand.
void add_common_options(CLI::App& command, Context& context);

}  // namespace weft::app
