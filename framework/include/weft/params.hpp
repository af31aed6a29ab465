#pragma once
#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "weft/config.hpp"
#include "weft/types.hpp"

namespace weft {

/// Allowed values of a number, both ends included, and its unit (empty: dimensionless).
struct Range {
  double lower = -std::numeric_limits<double>::infinity();
  double upper = std::numeric_limits<double>::infinity();
  std::string unit;
};
inline Range range(double lower, double upper, std::string unit = "") { return {lower, upper, std::move(unit)}; }
/// Allowed values of a text.
struct Choice {
  std::vector<std::string> values;
};
inline Choice choice(std::vector<std::string> values) { return {std::move(values)}; }
/// A slot for another plugin: `{plugin: NAME, params: {...}}`.
struct PluginSlot {
  std::string kind;  ///< "simulator", ...
};

/// One declared parameter, as `weft describe` and the README tables show it.
struct ParamInfo {
  std::string name, type, unit, range, default_value, text;
};

/// Visits the fields of a Params struct. Params is a plain struct with defaults in place and one member
///     template <class Visitor> void visit(Visitor& v) { v("dt_s", dt_s, range(1e-5, 0.1, "s"), "Time step."); ... }
/// From that one list come the config reader, the resolved config, `weft describe` and the README table.
class WEFT_API ParamVisitor {
 public:
  virtual ~ParamVisitor() = default;
  virtual void operator()(const char* name, double& value, const Range& range, const char* text) = 0;
  virtual void operator()(const char* name, std::int64_t& value, const Range& range, const char* text) = 0;
  virtual void operator()(const char* name, bool& value, const char* text) = 0;
  virtual void operator()(const char* name, std::string& value, const Choice& choice, const char* text) = 0;
  virtual void operator()(const char* name, std::string& value, const char* text) = 0;  ///< free text
  /// Every element must lie in the range; an empty default means "not given".
  virtual void operator()(const char* name, std::vector<double>& value, const Range& range, const char* text) = 0;
  virtual void operator()(const char* name, std::vector<std::string>& value, const char* text) = 0;
  /// Any nested configuration that the component reads itself; plugins in it are resolved by the loader.
  virtual void operator()(const char* name, ConfigNode& value, const PluginSlot& slot, const char* text) = 0;
  virtual void operator()(const char* name, ConfigNode& value, const char* text) = 0;
  /// A file, relative to the config file it stands in; empty = not given.
  virtual void operator()(const char* name, std::filesystem::path& value, const char* text) = 0;
  virtual void begin_group(const char* name, const char* text) = 0;
  virtual void end_group() = 0;
  /// A nested Params struct under its own key.
  template <class Group>
  void group(const char* name, Group& value, const char* text) {
    begin_group(name, text);
    value.visit(*this);
    end_group();
  }
};

/// Runs `visit` on the fields of some Params, erased.
using ParamVisit = void (*)(void* params, ParamVisitor& visitor);

/// Fills params from a mapping (null: all defaults). Unknown key, wrong type or range: ConfigError with file and line.
/// @return the resolved mapping: every parameter with the value it has now, in declared order.
WEFT_API ConfigNode read_params_erased(const ConfigNode& node, void* params, ParamVisit visit);
WEFT_API std::vector<ParamInfo> describe_params_erased(void* params, ParamVisit visit);

template <class Params>
ConfigNode read_params(const ConfigNode& node, Params& params) {
  return read_params_erased(node, &params, [](void* p, ParamVisitor& v) { static_cast<Params*>(p)->visit(v); });
}
template <class Params>
std::vector<ParamInfo> describe_params() {
  Params params;
  return describe_params_erased(&params, [](void* p, ParamVisitor& v) { static_cast<Params*>(p)->visit(v); });
}
/// The parameters as a Markdown table, for READMEs.
WEFT_API std::string params_markdown(const std::vector<ParamInfo>& params);

}  // namespace weft
