#include "sdk/listed.hpp"

namespace weft {

std::string listed(const std::vector<std::string>& texts, const std::string& between) {
  std::string all;
  for (std::size_t i = 0; i < texts.size(); ++i) all += (i > 0 ? between : "") + texts[i];
  return all;
}

}  // namespace weft
