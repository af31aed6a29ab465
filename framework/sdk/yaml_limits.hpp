#pragma once
#include <cstddef>
#include <functional>
#include <string>
#include <string_view>

namespace YAML {
struct Mark;
}

namespace weft {

/// Refuses a YAML text with too many values or open brackets before yaml-cpp makes a tree of it, which takes a few
/// hundred bytes for each.
/// @param most of each. @param fail throws; its mark is null where no line is to blame.
/// @throws YAML::Exception for text that is not YAML; what `fail` throws.
void limit_yaml(std::string_view text, std::size_t most,
                const std::function<void(const YAML::Mark* mark, const std::string& message)>& fail);

/// How many documents a YAML text begins: 0, 1, or 2 for more. YAML::LoadAll() would read some texts that are not YAML as
/// documents without end. @throws YAML::Exception for text that is not YAML.
int yaml_documents(std::string_view text);

}  // namespace weft
