#include "weft/params.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "sdk/files.hpp"
#include "sdk/listed.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

// Whole numbers in full: 100000, not 1e+05. NaN is the default of a number that must be given: there is none to show.
std::string number_text(double value) {
  if (std::isnan(value)) return "";
  if (value == std::round(value) && std::abs(value) < 1e9) return std::to_string(static_cast<std::int64_t>(value));
  return ConfigNode::number(value).as_string();
}

std::string range_text(const Range& range) {
  const bool low = std::isfinite(range.lower);
  const bool high = std::isfinite(range.upper);
  if (low && high) return "in [" + number_text(range.lower) + ", " + number_text(range.upper) + "]";
  if (low) return "at least " + number_text(range.lower);
  if (high) return "at most " + number_text(range.upper);
  return "a number";
}

/// "3 numbers (x, y, z)" for a list that must have three; "numbers" for a list of any length.
std::string entries_text(const Length& length, const char* what) {
  if (length.count == 0) return what;
  return std::to_string(length.count) + " " + what + (length.entries.empty() ? "" : " (" + length.entries + ")");
}

// Paths in a config are relative to it, but a resolved config may be saved anywhere.
std::filesystem::path resolved_path(const ConfigNode& node) {
  return node.as_string().empty() ? std::filesystem::path() : std::filesystem::absolute(node.as_path());
}

/// Reads the fields from a mapping and builds the resolved mapping at the same time.
class Reader final : public ParamVisitor {
 public:
  explicit Reader(const ConfigNode& node) { levels_.push_back({node, {}, {}, {}}); }

  /// Refuses unknown keys. @return the resolved mapping of the innermost level.
  ConfigNode finish() {
    levels_.back().node.refuse_unknown_keys(levels_.back().known);
    return ConfigNode::mapping(levels_.back().resolved);
  }

 private:
  struct Level {
    ConfigNode node;
    std::string name;
    std::vector<std::string> known;
    std::vector<std::pair<std::string, ConfigNode>> resolved;
  };

  void visit(const Declaration& declared, const ParamValue& value) override {
    const auto node = take(declared.name);
    keep(declared.name, std::visit([&](auto* field) { return read(declared, node, *field); }, value));
  }
  void begin_group(const char* name, const char*) override {
    auto node = take(name).value_or(ConfigNode());
    if (!node.is_null() && !node.is_mapping()) must_be(node, "a mapping");
    levels_.push_back({std::move(node), name, {}, {}});
  }
  void end_group() override {
    ConfigNode resolved = finish();
    const std::string name = levels_.back().name;
    levels_.pop_back();
    keep(name, std::move(resolved));
  }

  // A key that is absent, or given as null, keeps its default.
  std::optional<ConfigNode> take(const char* name) {
    levels_.back().known.emplace_back(name);
    auto node = levels_.back().node.find(name);
    if (node && node->is_null()) return std::nullopt;
    return node;
  }
  void keep(const std::string& name, ConfigNode value) { levels_.back().resolved.emplace_back(name, std::move(value)); }

  // Each sets the field when the key is given, and returns the field's value as a node.
  using Given = std::optional<ConfigNode>;
  static ConfigNode read(const Declaration& declared, const Given& node, double& value) {
    if (node) value = checked(*node, node->as_double(), declared.range);
    return ConfigNode::number(value);
  }
  static ConfigNode read(const Declaration& declared, const Given& node, std::int64_t& value) {
    if (node) {
      value = node->as_int();
      checked(*node, static_cast<double>(value), declared.range);
    }
    return ConfigNode::integer(value);
  }
  static ConfigNode read(const Declaration&, const Given& node, bool& value) {
    if (node) value = node->as_bool();
    return ConfigNode::boolean(value);
  }
  static ConfigNode read(const Declaration& declared, const Given& node, std::string& value) {
    if (node) {
      value = node->as_string();
      const auto& allowed = declared.choice.values;
      if (!allowed.empty() && std::find(allowed.begin(), allowed.end(), value) == allowed.end())
        node->fail("= " + shown(*node) + ", must be " + one_of(allowed) + nearest_hint(value, allowed));
    }
    if (const auto& here = declared.variant.here; !here.empty()) {
      if (value == "auto") value = here.back();
      if (node && std::find(here.begin(), here.end(), value) == here.end())
        node->fail("= " + value + ", a numeric variant that this machine cannot run; it has " + listed(here));
    }
    return ConfigNode::quoted(value);
  }
  static ConfigNode read(const Declaration& declared, const Given& node, std::vector<double>& value) {
    if (node) {
      check_list(declared, *node, value.empty(), "numbers", ", each " + range_text(declared.range));
      value.clear();
      for (std::size_t i = 0; i < node->size(); ++i)
        value.push_back(checked((*node)[i], (*node)[i].as_double(), declared.range));
    }
    std::vector<ConfigNode> items;
    for (const double v : value) items.push_back(ConfigNode::number(v));
    return ConfigNode::sequence(std::move(items));
  }
  static ConfigNode read(const Declaration& declared, const Given& node, std::vector<std::string>& value) {
    if (node) {
      check_list(declared, *node, value.empty(), "texts", "");
      value.clear();
      for (std::size_t i = 0; i < node->size(); ++i) value.push_back((*node)[i].as_string());
    }
    std::vector<ConfigNode> items;
    for (const auto& v : value) items.push_back(ConfigNode::quoted(v));
    return ConfigNode::sequence(std::move(items));
  }
  static ConfigNode read(const Declaration& declared, const Given& node, ConfigNode& value) {
    if (node) value = *node;
    if (declared.is_file_or_mapping && value.is_scalar()) return ConfigNode::quoted(resolved_path(value).string());
    return value;
  }
  static ConfigNode read(const Declaration&, const Given& node, std::filesystem::path& value) {
    if (node) value = resolved_path(*node);
    if (node && is_lfs_pointer_file(value)) node->fail("= " + value.string() + " " + kLfsPointer);
    return ConfigNode::quoted(value.string());
  }

  /// @param may_be_empty the default is empty, so an empty list means "not given".
  static void check_list(const Declaration& declared, const ConfigNode& node, bool may_be_empty, const char* what,
                         const std::string& each) {
    const std::size_t count = declared.length.count;
    const bool fits = count == 0 || node.size() == count || (may_be_empty && node.size() == 0);
    if (!node.is_sequence() || !fits) must_be(node, "a list of " + entries_text(declared.length, what) + each);
  }
  static double checked(const ConfigNode& node, double value, const Range& range) {
    if (!(value >= range.lower && value <= range.upper)) {
      must_be(node, range_text(range) + (range.unit.empty() ? "" : " " + range.unit));
    }
    return value;
  }

  std::vector<Level> levels_;
};

/// Collects the declarations.
class Describer final : public ParamVisitor {
 public:
  std::vector<ParamInfo> take() { return std::move(infos_); }

 private:
  void visit(const Declaration& declared, const ParamValue& value) override {
    ParamInfo info;
    info.name = prefix_ + declared.name;
    info.unit = declared.range.unit;
    info.text = declared.text;
    info.slot = declared.slot.kind;
    info.choices = declared.choice.values;
    info.length = declared.length;
    info.decides = declared.decides;
    info.is_variant = !declared.variant.here.empty();
    std::visit([&](const auto* field) { show(declared, *field, info); }, value);
    infos_.push_back(std::move(info));
  }
  void begin_group(const char* name, const char*) override { prefix_ += std::string(name) + "."; }
  void end_group() override {
    prefix_.pop_back();
    const auto dot = prefix_.rfind('.');
    prefix_.resize(dot == std::string::npos ? 0 : dot + 1);
  }

  static void set(ParamInfo& info, ParamKind kind, std::string type, std::string range, std::string value) {
    info.kind = kind;
    info.type = std::move(type);
    info.range = std::move(range);
    info.default_value = std::move(value);
  }
  static void show(const Declaration& declared, double value, ParamInfo& info) {
    set(info, ParamKind::number, "number", range_text(declared.range), number_text(value));
  }
  static void show(const Declaration& declared, std::int64_t value, ParamInfo& info) {
    set(info, ParamKind::integer, "integer", range_text(declared.range), std::to_string(value));
  }
  static void show(const Declaration&, bool value, ParamInfo& info) {
    set(info, ParamKind::boolean, "bool", "true or false", value ? "true" : "false");
  }
  static void show(const Declaration& declared, const std::string& value, ParamInfo& info) {
    if (declared.choice.values.empty())
      set(info, ParamKind::text, "text", "", value);
    else
      set(info, ParamKind::choice, "text", one_of(declared.choice.values), value);
  }
  static void show(const Declaration& declared, const std::vector<double>& value, ParamInfo& info) {
    std::string shown;
    for (const double v : value) shown += (shown.empty() ? "" : ", ") + number_text(v);
    set(info, ParamKind::numbers, "list of " + entries_text(declared.length, "numbers"), range_text(declared.range),
        "[" + shown + "]");
  }
  static void show(const Declaration& declared, const std::vector<std::string>& value, ParamInfo& info) {
    set(info, ParamKind::texts, "list of " + entries_text(declared.length, "texts"), "", "[" + listed(value) + "]");
  }
  static void show(const Declaration& declared, const ConfigNode& value, ParamInfo& info) {
    const auto plugin = value.is_mapping() ? value.find("plugin") : std::nullopt;
    const std::string given = value.is_null() ? "" : "given";
    if (!declared.slot.kind.empty())
      set(info, ParamKind::slot, declared.slot.kind + " plugin", "{plugin, params}", plugin ? plugin->as_string() : "");
    else if (declared.is_file_or_mapping)
      set(info, ParamKind::file_or_mapping, "file or mapping", "", given);
    else
      set(info, ParamKind::node, "mapping", "", given);
  }
  static void show(const Declaration&, const std::filesystem::path& value, ParamInfo& info) {
    set(info, ParamKind::file, "file", "", value.string());
  }

  std::string prefix_;
  std::vector<ParamInfo> infos_;
};

}  // namespace

std::string to_string(Decides decides) {
  switch (decides) {
    case Decides::results:
      return "results";
    case Decides::examples:
      return "examples";
    case Decides::nothing:
      return "nothing";
  }
  return "";
}

ConfigNode read_params_erased(const ConfigNode& node, void* params, ParamVisit visit) {
  if (!node.is_null() && !node.is_mapping()) must_be(node, "a mapping of parameters");
  Reader reader(node);
  visit(params, reader);
  return reader.finish();
}

std::vector<ParamInfo> describe_params_erased(void* params, ParamVisit visit) {
  Describer describer;
  visit(params, describer);
  return describer.take();
}

std::string params_markdown(const std::vector<ParamInfo>& params) {
  std::ostringstream out;
  out << "| parameter | type | unit | range | default | meaning |\n|---|---|---|---|---|---|\n";
  for (const auto& p : params) {
    out << "| `" << p.name << "` | " << p.type << " | " << p.unit << " | " << p.range << " | " << p.default_value
        << " | " << p.text << " |\n";
  }
  return out.str();
}

const ParamInfo& param_named(const std::vector<ParamInfo>& params, std::string_view name) {
  std::vector<std::string> names;
  for (const auto& info : params) {
    if (info.name == name) return info;
    names.push_back(info.name);
  }
  throw ConfigError(std::string(name) + " is not a known key" + nearest_hint(name, names));
}

namespace {

/// @param prefix of the keys of `node`: empty, or a group's name and a dot.
ConfigNode keep_below(const ConfigNode& node, const std::string& prefix, const std::vector<ParamInfo>& params,
                      const std::function<bool(const ParamInfo&)>& keep) {
  ConfigNode kept = node;
  for (const auto& key : node.keys()) {
    const std::string name = prefix + key, inside = name + ".";
    const auto declared =
        std::find_if(params.begin(), params.end(), [&](const ParamInfo& info) { return info.name == name; });
    bool stays = declared != params.end() && keep(*declared);
    if (declared == params.end()) {
      // A group stays if one of its keys stays. A null group has all keys, with their defaults.
      const ConfigNode group = node.at(key);
      std::vector<ParamInfo> members;
      std::copy_if(params.begin(), params.end(), std::back_inserter(members),
                   [&](const ParamInfo& info) { return info.name.starts_with(inside); });
      if (group.is_mapping() && !members.empty()) {
        const ConfigNode rest = keep_below(group, inside, members, keep);
        stays = group.size() > 0 ? rest.size() > 0 : std::any_of(members.begin(), members.end(), keep);
        if (stays) kept = kept.with(key, rest);
      } else {
        stays = std::any_of(members.begin(), members.end(), keep);
      }
    }
    if (!stays) kept = kept.without(key);
  }
  return kept;
}

}  // namespace

ConfigNode keep_params(const ConfigNode& config, const std::vector<ParamInfo>& params,
                       const std::function<bool(const ParamInfo&)>& keep) {
  return keep_below(config, "", params, keep);
}

}  // namespace weft
