#pragma once
#include <concepts>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
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

// Marks stand behind the text of a declaration, in any order:
//     v("gravity", gravity, range(-100, 100, "m/s^2"), "Gravity.", Length{3, "x, y, z"});

/// How many entries a list must have. A list that is empty by default may stay empty: "not given".
struct Length {
  std::size_t count = 0;  ///< 0: any number
  std::string entries;    ///< for messages, which they are: "x, y, z"
};
/// A ConfigNode that is a file, or the mapping that such a file holds.
struct FileOrMapping {};
/// What a key decides. Results whose keys of a kind are equal belong together: examples are added to one dataset, rows
/// to one table.
enum class Decides {
  results,   ///< what sessions do and what is measured of them; the default
  examples,  ///< the examples of a dataset, and with them every result
  nothing,   ///< no number of a result: texts for people, threads, folders of plugins, how many rows there are
};

WEFT_API std::string to_string(Decides decides);  ///< "results", ...

enum class ParamKind { number, integer, boolean, choice, text, numbers, texts, slot, node, file, file_or_mapping };

/// One declared parameter, as `weft describe` and the README tables show it, and as the functions below use it.
struct ParamInfo {
  std::string name;  ///< dotted: "estimation.method"
  std::string type, unit, range, default_value, text;
  ParamKind kind = ParamKind::node;
  std::string slot;                  ///< of a slot: the kind of plugin that it takes
  std::vector<std::string> choices;  ///< of a choice
  Length length;                     ///< of a list
  Decides decides = Decides::results;
};

/// What `visit` says of one parameter.
struct Declaration {
  const char* name = "";
  const char* text = "";
  Decides decides = Decides::results;
  Range range;
  Choice choice;
  PluginSlot slot;
  Length length;
  bool is_file_or_mapping = false;
};
using ParamValue = std::variant<double*, std::int64_t*, bool*, std::string*, std::vector<double>*,
                                std::vector<std::string>*, ConfigNode*, std::filesystem::path*>;

template <class Mark, class... Allowed>
concept MarkOf = (std::same_as<Mark, Allowed> || ...);

/// Visits the fields of a Params struct. Params is a plain struct with defaults in place and one member
///     template <class Visitor> void visit(Visitor& v) { v("dt_s", dt_s, range(1e-5, 0.1, "s"), "Time step."); ... }
/// From that one list come the config reader, the resolved config, `weft describe`, the README table, the identity of
/// datasets, and the checks of a command line.
class WEFT_API ParamVisitor {
 public:
  virtual ~ParamVisitor() = default;

  void operator()(const char* name, double& value, const Range& range, const char* text,
                  const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, range, marks...);
  }
  void operator()(const char* name, std::int64_t& value, const Range& range, const char* text,
                  const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, range, marks...);
  }
  void operator()(const char* name, bool& value, const char* text, const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, marks...);
  }
  void operator()(const char* name, std::string& value, const Choice& choice, const char* text,
                  const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, choice, marks...);
  }
  /// Free text.
  void operator()(const char* name, std::string& value, const char* text, const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, marks...);
  }
  /// Every element must lie in the range; an empty default means "not given".
  void operator()(const char* name, std::vector<double>& value, const Range& range, const char* text,
                  const MarkOf<Decides, Length> auto&... marks) {
    declare(&value, name, text, range, marks...);
  }
  void operator()(const char* name, std::vector<std::string>& value, const char* text,
                  const MarkOf<Decides, Length> auto&... marks) {
    declare(&value, name, text, marks...);
  }
  /// A plugin. The resolved config of a result holds every default of its parameters.
  void operator()(const char* name, ConfigNode& value, const PluginSlot& slot, const char* text,
                  const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, slot, marks...);
  }
  /// Any nested configuration that the component reads itself.
  void operator()(const char* name, ConfigNode& value, const char* text,
                  const MarkOf<Decides, FileOrMapping> auto&... marks) {
    declare(&value, name, text, marks...);
  }
  /// A file, relative to the config file it stands in; empty = not given.
  void operator()(const char* name, std::filesystem::path& value, const char* text,
                  const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, marks...);
  }
  /// A nested Params struct under its own key. A mark holds for all of its keys that have none of their own.
  template <class Group>
  void group(const char* name, Group& value, const char* text, const MarkOf<Decides> auto&... marks) {
    begin_group(name, text);
    part(value, marks...);
    end_group();
  }
  /// The keys of another Params struct, beside one's own.
  template <class Part>
  void part(Part& value, const MarkOf<Decides> auto&... marks) {
    const Decides outer = decides_;
    ((decides_ = marks), ...);
    value.visit(*this);
    decides_ = outer;
  }

 private:
  virtual void visit(const Declaration& declared, const ParamValue& value) = 0;
  virtual void begin_group(const char* name, const char* text) = 0;
  virtual void end_group() = 0;

  void declare(const ParamValue& value, const char* name, const char* text, const auto&... said) {
    Declaration declared;
    declared.name = name;
    declared.text = text;
    declared.decides = decides_;
    (add(declared, said), ...);
    visit(declared, value);
  }
  static void add(Declaration& declared, const Range& range) { declared.range = range; }
  static void add(Declaration& declared, const Choice& choice) { declared.choice = choice; }
  static void add(Declaration& declared, const PluginSlot& slot) { declared.slot = slot; }
  static void add(Declaration& declared, const Length& length) { declared.length = length; }
  static void add(Declaration& declared, FileOrMapping) { declared.is_file_or_mapping = true; }
  static void add(Declaration& declared, Decides decides) { declared.decides = decides; }

  Decides decides_ = Decides::results;  // of the part that is being visited
};

/// Runs `visit` on the fields of some Params, erased.
using ParamVisit = void (*)(void* params, ParamVisitor& visitor);

/// Fills params from a mapping (null: all defaults). Unknown key, wrong type, range or length: ConfigError with file
/// and line.
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

/// The parameter with this dotted name. @throws ConfigError naming the nearest one.
WEFT_API const ParamInfo& param_named(const std::vector<ParamInfo>& params, std::string_view name);

/// A config without the keys that `params` does not declare, and without those that `keep` refuses. Order and places
/// stay; a mapping that loses all of its keys goes.
WEFT_API ConfigNode keep_params(const ConfigNode& config, const std::vector<ParamInfo>& params,
                                const std::function<bool(const ParamInfo&)>& keep);

}  // namespace weft
