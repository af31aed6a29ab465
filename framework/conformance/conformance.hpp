#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "loader/registry.hpp"

namespace weft {

/// Outcome of one law.
struct LawResult {
  std::string law;   ///< "restored_run_is_bit_exact"
  std::string text;  ///< the law in one line
  double measured = 0;
  double bound = 0;  ///< measured <= bound passes
  bool passed = false;
  std::string detail;  ///< why it failed; for an undeclared capability: "not declared; throws Unsupported"
};

/// The laws of a kind that are to be checked, with their bounds; nothing has been run.
/// @param tolerances, only as for check_conformance(). All of `tolerances` is checked.
/// @throws ConfigError for a tolerance without a reason, or for an unknown law.
std::vector<LawResult> planned_laws(const std::string& kind, const ConfigNode& tolerances,
                                    const std::vector<std::string>& only = {});

/// Checks a plugin against the laws of its kind. Laws follow declared capabilities, never plugin names: a declared
/// capability must work, an undeclared one must throw Unsupported.
/// @param host makes the plugin (and the simulator and trajectory of a predictor's task) from its registry, with
/// PluginChecks::results: a result of the wrong size, or with a number that is not finite, fails whatever law meets it.
/// @param slot {plugin, params}, or a bare name or library file.
/// @param tolerances mapping law -> {bound, reason} that replaces the default bound; `params:` to run with; for
/// predictors `task:` to bind with (docs/conformance.md); null: defaults.
/// @param only laws to run; empty: all of them.
/// @throws ConfigError for a tolerance without a reason, for an unknown law or for a bad `params:` or `task:`;
/// PluginError.
std::vector<LawResult> check_conformance(Host& host, const std::string& kind, const ConfigNode& slot,
                                         const ConfigNode& tolerances = {}, const std::vector<std::string>& only = {});
/// The laws of a kind, without running them.
std::vector<LawResult> list_laws(const std::string& kind);

}  // namespace weft
