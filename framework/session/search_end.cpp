#include "session/search_end.hpp"

#include <nlohmann/json.hpp>

namespace weft {

SearchEnd search_end(const std::vector<OptimiserResult>& results, Index winner) {
  const auto& best = results.at(winner);
  SearchEnd end{best.status, best.message, {}};
  for (const auto& result : results) ++end.instances[result.status];
  return end;
}

nlohmann::ordered_json to_json(const SearchEnd& end) {
  if (end.instances.empty()) return nullptr;
  nlohmann::ordered_json instances;
  for (const auto& [status, number] : end.instances) instances[to_string(status)] = number;
  return {{"status", to_string(end.status)}, {"message", end.message}, {"instances", instances}};
}

}  // namespace weft
