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

// Marks follow the text of a declaration, in any order:
//     v("gravity", gravity, range(-100, 100, "m/s^2"), "Gravity.", Length{3, "x, y, z"});

/// How many entries a list must have. A list that is empty by default may stay empty: "not given".
struct Length {
  std::size_t count = 0;  ///< 0: any number
  std::string entries;    ///< names of the entries, for messages: "x, y, z"
};
/// The numeric variants of a plugin: versions of its code that differ in the last digits of their numbers, such as those
/// for an instruction set. A choice among `auto` and their names. `auto` becomes the best one of this machine when a
/// config is resolved, so that every saved config and identity names a variant.
struct NumericVariant {
  std::vector<std::string> here;  ///< those that this machine can run, the best one last; not empty
};
/// A ConfigNode that holds a mapping or the path of a file with that mapping.
struct FileOrMapping {};
/// What a key can change. Examples can join a dataset, and rows a table, if the keys that decide them are equal.
enum class Decides {
  results,   ///< sessions and their measurements; the default
  examples,  ///< the examples of a dataset, and so every result
  nothing,   ///< no number of a result: texts for people, threads, plugin folders, the number of rows
};

WEFT_API std::string to_string(Decides decides);  ///< "results", ...

enum class ParamKind { number, integer, boolean, choice, text, numbers, texts, slot, node, file, file_or_mapping };

/// One declared parameter, for `weft describe`, the README tables and the functions below.
struct ParamInfo {
  std::string name;  ///< dotted: "estimation.method"
  std::string type, unit, range, default_value, text;
  ParamKind kind = ParamKind::node;
  std::string slot;                  ///< of a slot: its kind of plugin
  std::vector<std::string> choices;  ///< of a choice
  Length length;                     ///< of a list
  Decides decides = Decides::results;
  bool is_variant = false;  ///< a choice of a numeric variant
};

/// One parameter, as `visit` declares it.
struct Declaration {
  const char* name = "";
  const char* text = "";
  Decides decides = Decides::results;
  Range range;
  Choice choice;
  PluginSlot slot;
  Length length;
  bool is_file_or_mapping = false;
  NumericVariant variant;  ///< `here` is empty for any other parameter
};
using ParamValue = std::variant<double*, std::int64_t*, bool*, std::string*, std::vector<double>*,
                                std::vector<std::string>*, ConfigNode*, std::filesystem::path*>;

template <class Mark, class... Allowed>
concept MarkOf = (std::same_as<Mark, Allowed> || ...);

/// Visits the fields of a Params struct. Params is a plain struct with defaults in place and one member
///     template <class Visitor> void visit(Visitor& v) { v("dt_s", dt_s, range(1e-5, 0.1, "s"), "Time step."); ... }
/// The config reader, the resolved config, `weft describe`, the README table, the identity of datasets and the checks
/// of a command line all use that list.
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
                  const MarkOf<Decides, NumericVariant> auto&... marks) {
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
  /// A path, relative to the folder of the config file; empty = not given.
  void operator()(const char* name, std::filesystem::path& value, const char* text,
                  const MarkOf<Decides> auto&... marks) {
    declare(&value, name, text, marks...);
  }
  /// A nested Params struct under its own key. A mark applies to all keys in it that have no mark.
  template <class Group>
  void group(const char* name, Group& value, const char* text, const MarkOf<Decides> auto&... marks) {
    begin_group(name, text);
    part(value, marks...);
    end_group();
  }
  /// The keys of another Params struct, at the same level.
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
  static void add(Declaration& declared, const NumericVariant& variant) { declared.variant = variant; }
  static void add(Declaration& declared, Decides decides) { declared.decides = decides; }

  Decides decides_ = Decides::results;  // of the part that is being visited
};

/// Calls visit() of a Params struct whose type is erased.
using ParamVisit = void (*)(void* params, ParamVisitor& visitor);

/// Fills params from a mapping (null: all defaults).
/// @return the resolved mapping: every parameter with its value, in declared order.
/// @throws ConfigError with file and line for an unknown key or a wrong type, range or length.
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

/// A copy of the config with only those keys that `params` declares and `keep` accepts. Order and locations stay. A
/// mapping that loses all keys is removed.
WEFT_API ConfigNode keep_params(const ConfigNode& config, const std::vector<ParamInfo>& params,
                                const std::function<bool(const ParamInfo&)>& keep);

}  // namespace weft
