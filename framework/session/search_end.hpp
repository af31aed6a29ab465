#pragma once
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "weft/optimiser.hpp"

namespace weft {

/// Why a search ended.
struct SearchEnd {
  OptimiserStatus status = OptimiserStatus::diverged;  ///< of the winning instance
  std::string message;                                 ///< the solver's message; may be empty
  std::map<OptimiserStatus, Index> instances;          ///< number of instances per status; empty without a search
};

/// @param winner its index in `results`.
SearchEnd search_end(const std::vector<OptimiserResult>& results, Index winner);

/// {status, message, instances: {STATUS: number}}, or null without a search (docs/file-formats.md).
nlohmann::ordered_json to_json(const SearchEnd& end);

}  // namespace weft
