#include "weft/params.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "weft/config.hpp"

namespace weft {
namespace {

// Whole numbers in full: 100000, not 1e+05.
std::string number_text(double value) {
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

/// Reads the fields from a mapping and builds the resolved mapping at the same time.
class Reader final : public ParamVisitor {
 public:
  explicit Reader(const ConfigNode& node) { levels_.push_back({node, {}, {}, {}}); }

  void operator()(const char* name, double& value, const Range& range, const char*) override {
    if (const auto node = take(name)) value = checked(*node, node->as_double(), range);
    keep(name, ConfigNode::number(value));
  }
  void operator()(const char* name, std::int64_t& value, const Range& range, const char*) override {
    if (const auto node = take(name)) {
      value = node->as_int();
      checked(*node, static_cast<double>(value), range);
    }
    keep(name, ConfigNode::integer(value));
  }
  void operator()(const char* name, bool& value, const char*) override {
    if (const auto node = take(name)) value = node->as_bool();
    keep(name, ConfigNode::boolean(value));
  }
  void operator()(const char* name, std::string& value, const Choice& choice, const char*) override {
    if (const auto node = take(name)) {
      value = node->as_string();
      if (std::find(choice.values.begin(), choice.values.end(), value) == choice.values.end()) {
        node->fail("= " + shown(*node) + ", must be " + one_of(choice.values) + nearest_hint(value, choice.values));
      }
    }
    keep(name, ConfigNode::quoted(value));
  }
  void operator()(const char* name, std::string& value, const char*) override {
    if (const auto node = take(name)) value = node->as_string();
    keep(name, ConfigNode::quoted(value));
  }
  void operator()(const char* name, std::vector<double>& value, const Range& range, const char*) override {
    if (const auto node = take(name)) {
      if (!node->is_sequence()) must_be(*node, "a list of numbers, each " + range_text(range));
      value.clear();
      for (std::size_t i = 0; i < node->size(); ++i)
        value.push_back(checked((*node)[i], (*node)[i].as_double(), range));
    }
    std::vector<ConfigNode> items;
    for (const double v : value) items.push_back(ConfigNode::number(v));
    keep(name, ConfigNode::sequence(std::move(items)));
  }
  void operator()(const char* name, std::vector<std::string>& value, const char*) override {
    if (const auto node = take(name)) {
      if (!node->is_sequence()) must_be(*node, "a list of texts");
      value.clear();
      for (std::size_t i = 0; i < node->size(); ++i) value.push_back((*node)[i].as_string());
    }
    std::vector<ConfigNode> items;
    for (const auto& v : value) items.push_back(ConfigNode::quoted(v));
    keep(name, ConfigNode::sequence(std::move(items)));
  }
  void operator()(const char* name, ConfigNode& value, const PluginSlot&, const char*) override {
    take_node(name, value);
  }
  void operator()(const char* name, ConfigNode& value, const char*) override { take_node(name, value); }
  void operator()(const char* name, std::filesystem::path& value, const char*) override {
    if (const auto node = take(name)) {
      value = node->as_string().empty() ? std::filesystem::path() : std::filesystem::absolute(node->as_path());
    }
    keep(name, ConfigNode::quoted(value.string()));
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
  /// Refuses leftovers. @return the resolved mapping of the innermost level.
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

  // A key that is absent, or given as null, keeps its default.
  std::optional<ConfigNode> take(const char* name) {
    levels_.back().known.emplace_back(name);
    auto node = levels_.back().node.find(name);
    if (node && node->is_null()) return std::nullopt;
    return node;
  }
  void take_node(const char* name, ConfigNode& value) {
    if (const auto node = take(name)) value = *node;
    keep(name, value);
  }
  void keep(const std::string& name, ConfigNode value) { levels_.back().resolved.emplace_back(name, std::move(value)); }
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
  void operator()(const char* name, double& value, const Range& range, const char* text) override {
    add(name, "number", range.unit, range_text(range), number_text(value), text);
  }
  void operator()(const char* name, std::int64_t& value, const Range& range, const char* text) override {
    add(name, "integer", range.unit, range_text(range), std::to_string(value), text);
  }
  void operator()(const char* name, bool& value, const char* text) override {
    add(name, "bool", "", "true or false", value ? "true" : "false", text);
  }
  void operator()(const char* name, std::string& value, const Choice& choice, const char* text) override {
    add(name, "text", "", one_of(choice.values), value, text);
  }
  void operator()(const char* name, std::string& value, const char* text) override {
    add(name, "text", "", "", value, text);
  }
  void operator()(const char* name, std::vector<double>& value, const Range& range, const char* text) override {
    std::string shown;
    for (const double v : value) shown += (shown.empty() ? "" : ", ") + number_text(v);
    add(name, "list of numbers", range.unit, range_text(range), "[" + shown + "]", text);
  }
  void operator()(const char* name, std::vector<std::string>& value, const char* text) override {
    std::string shown;
    for (const auto& v : value) shown += (shown.empty() ? "" : ", ") + v;
    add(name, "list of texts", "", "", "[" + shown + "]", text);
  }
  void operator()(const char* name, ConfigNode& value, const PluginSlot& slot, const char* text) override {
    const auto plugin = value.is_mapping() ? value.find("plugin") : std::nullopt;
    add(name, slot.kind + " plugin", "", "{plugin, params}", plugin ? plugin->as_string() : "", text);
  }
  void operator()(const char* name, ConfigNode& value, const char* text) override {
    add(name, "mapping", "", "", value.is_null() ? "" : "given", text);
  }
  void operator()(const char* name, std::filesystem::path& value, const char* text) override {
    add(name, "file", "", "", value.string(), text);
  }
  void begin_group(const char* name, const char*) override { prefix_ += std::string(name) + "."; }
  void end_group() override {
    prefix_.pop_back();
    const auto dot = prefix_.rfind('.');
    prefix_.resize(dot == std::string::npos ? 0 : dot + 1);
  }
  std::vector<ParamInfo> take() { return std::move(infos_); }

 private:
  void add(const char* name, std::string type, std::string unit, std::string range, std::string value,
           const char* text) {
    infos_.push_back({prefix_ + name, std::move(type), std::move(unit), std::move(range), std::move(value), text});
  }
  std::string prefix_;
  std::vector<ParamInfo> infos_;
};

}  // namespace

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

}  // namespace weft
