#pragma once
#include <algorithm>
#include <limits>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "context.hpp"

namespace weft::app {

/// Adds --out, --jobs, --quiet and --json: the common options of a subcommand that reads no config.
void add_output_options(CLI::App& command, Context& context);

/// Context::registry() for a command without a config: it takes only plugin_path from --set. @throws ConfigError for
/// other keys.
std::shared_ptr<const PluginRegistry> registry_of_overrides(const Context& context);

/// An option's check: a number in [lower, upper], and no NaN. The refusal says which numbers are allowed.
template <class Number>
CLI::Validator within(Number lower, Number upper) {
  const auto text = [](Number value) {
    if constexpr (std::is_floating_point_v<Number>)
      return ConfigNode::number(value).as_string();
    else
      return std::to_string(value);
  };
  const std::string wanted = upper == std::numeric_limits<Number>::max()
                                 ? "at least " + text(lower)
                                 : "in [" + text(lower) + ", " + text(upper) + "]";
  const auto check = [=](const std::string& given) -> std::string {
    Number value{};
    const bool fits = CLI::detail::lexical_cast(given, value) && value >= lower && value <= upper;
    return fits ? "" : given + ", must be " + wanted;
  };
  return CLI::Validator(check, wanted);
}

/// @throws ConfigError when an option names a value twice.
template <class Value>
void require_distinct(const std::string& option, std::vector<Value> values) {
  std::sort(values.begin(), values.end());
  const auto twice = std::adjacent_find(values.begin(), values.end());
  if (twice == values.end()) return;
  std::ostringstream text;
  text << option << " names " << *twice << " twice";
  throw ConfigError(text.str());
}

}  // namespace weft::app
