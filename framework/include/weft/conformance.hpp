#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "weft/registry.hpp"

namespace weft {

/// Outcome of one law.
struct LawResult {
  std::string law;      ///< "restored_run_is_bit_exact"
  std::string text;     ///< what it demands, in one line
  double measured = 0;
  double bound = 0;     ///< measured <= bound passes
  bool passed = false;
  std::string detail;   ///< why it failed; for an undeclared capability: "not declared; throws Unsupported"
};

/// Checks a plugin against the laws of its kind. Laws follow declared capabilities, never plugin names: declared must hold,
/// undeclared must throw Unsupported.
/// @param slot {plugin, params}; @param tolerances mapping law -> {bound, reason} that replaces the default bound, and
/// `params:` to run with; null: defaults. @throws ConfigError for a tolerance without a reason or for an unknown law.
WEFT_API std::vector<LawResult> check_conformance(const PluginRegistry& registry, Host& host, const std::string& kind,
                                                  const ConfigNode& slot, const ConfigNode& tolerances = {});
/// The laws of a kind, without running them.
WEFT_API std::vector<LawResult> list_laws(const std::string& kind);

}  // namespace weft
