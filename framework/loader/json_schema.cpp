#include "loader/json_schema.hpp"

#include <algorithm>
#include <cmath>

namespace weft {
namespace {

using nlohmann::ordered_json;

/// A key may be given as null, which leaves its default.
ordered_json type_or_null(std::initializer_list<const char*> types) {
  ordered_json all = ordered_json::array();
  for (const char* type : types) all.push_back(type);
  all.push_back("null");
  return {{"type", all}};
}

ordered_json number_value(double value) {
  constexpr double kWhole = 9e15;  // below it every whole number is exact
  if (std::abs(value) < kWhole && value == std::floor(value)) return static_cast<std::int64_t>(value);
  return value;
}

void add_range(ordered_json& schema, const Range& range) {
  if (std::isfinite(range.lower)) schema["minimum"] = number_value(range.lower);
  if (std::isfinite(range.upper)) schema["maximum"] = number_value(range.upper);
}

/// A list that is empty by default may be given empty.
void add_length(ordered_json& schema, const Length& length, bool may_be_empty) {
  if (length.count == 0) return;
  schema["maxItems"] = length.count;
  if (may_be_empty)
    schema["anyOf"] = {{{"minItems", length.count}}, {{"maxItems", 0}}};
  else
    schema["minItems"] = length.count;
}

std::string description_of(const Declaration& declared) {
  std::string text = declared.text;
  if (!declared.length.entries.empty()) text += " Entries: " + declared.length.entries + ".";
  if (!declared.range.unit.empty()) text += " Unit: " + declared.range.unit + ".";
  return text;
}

/// The schemas of slots and of the parameters of plugins, by name: "slot.trajectory", "trajectory.arc".
class Definitions {
 public:
  explicit Definitions(const PluginRegistry& registry) : registry_(registry), entries_(registry.list()) {}

  /// A reference to the schema of a slot of this kind.
  ordered_json slot(const std::string& kind);
  ordered_json take() { return std::move(all_); }

 private:
  const PluginRegistry& registry_;
  const std::vector<PluginEntry> entries_;
  ordered_json all_ = ordered_json::object();
};

/// Collects the keys of one mapping, and of the groups in it.
class SchemaWriter final : public ParamVisitor {
 public:
  explicit SchemaWriter(Definitions& definitions) : definitions_(definitions) { begin_group("", ""); }

  ordered_json take() {
    ordered_json schema = std::move(levels_.back().schema);
    schema["properties"] = std::move(levels_.back().keys);
    schema["additionalProperties"] = false;
    levels_.pop_back();
    return schema;
  }

 private:
  struct Level {
    std::string name;
    ordered_json schema = type_or_null({"object"}), keys = ordered_json::object();
  };

  void visit(const Declaration& declared, const ParamValue& value) override {
    ordered_json schema = std::visit([&](const auto* field) { return of(declared, *field); }, value);
    schema["description"] = description_of(declared);
    levels_.back().keys[declared.name] = std::move(schema);
  }
  void begin_group(const char* name, const char* text) override {
    levels_.push_back({name});
    if (*text != '\0') levels_.back().schema["description"] = text;
  }
  void end_group() override {
    const std::string name = levels_.back().name;
    ordered_json schema = take();
    levels_.back().keys[name] = std::move(schema);
  }

  static ordered_json of(const Declaration& declared, double value) {
    ordered_json schema = type_or_null({"number"});
    add_range(schema, declared.range);
    if (!std::isnan(value)) schema["default"] = number_value(value);  // NaN: it must be given
    return schema;
  }
  static ordered_json of(const Declaration& declared, std::int64_t value) {
    ordered_json schema = type_or_null({"integer"});
    add_range(schema, declared.range);
    schema["default"] = value;
    return schema;
  }
  static ordered_json of(const Declaration&, bool value) {
    ordered_json schema = type_or_null({"boolean"});
    schema["default"] = value;
    return schema;
  }
  static ordered_json of(const Declaration& declared, const std::string& value) {
    ordered_json schema;
    if (declared.choice.values.empty()) {
      schema = type_or_null({"string", "number", "boolean"});  // a scalar without quotes is a text as well
    } else {
      schema["enum"] = declared.choice.values;
      for (const auto& choice : declared.choice.values)
        if (choice == "true" || choice == "false") schema["enum"].push_back(choice == "true");
      schema["enum"].push_back(nullptr);
    }
    schema["default"] = value;
    return schema;
  }
  static ordered_json of(const Declaration& declared, const std::vector<double>& value) {
    ordered_json schema = type_or_null({"array"});
    schema["items"] = {{"type", "number"}};
    add_range(schema["items"], declared.range);
    add_length(schema, declared.length, value.empty());
    schema["default"] = ordered_json::array();
    for (const double item : value) schema["default"].push_back(number_value(item));
    return schema;
  }
  static ordered_json of(const Declaration& declared, const std::vector<std::string>& value) {
    ordered_json schema = type_or_null({"array"});
    schema["items"] = {{"type", {"string", "number", "boolean"}}};
    add_length(schema, declared.length, value.empty());
    schema["default"] = value;
    return schema;
  }
  ordered_json of(const Declaration& declared, const ConfigNode& value) const {
    if (declared.slot.kind.empty())
      return declared.is_file_or_mapping ? type_or_null({"string", "object"}) : ordered_json::object();
    ordered_json schema = definitions_.slot(declared.slot.kind);
    if (value.is_mapping() && value.has("plugin")) schema["default"] = value.at("plugin").as_string();
    return schema;
  }
  static ordered_json of(const Declaration&, const std::filesystem::path&) { return type_or_null({"string"}); }

  Definitions& definitions_;
  std::vector<Level> levels_;
};

ordered_json Definitions::slot(const std::string& kind) {
  const std::string slot_name = "slot." + kind;
  const ordered_json reference = {{"$ref", "#/$defs/" + slot_name}};
  if (all_.contains(slot_name)) return reference;
  all_[slot_name] = nullptr;  // a plugin of this kind may have slots of the same kind
  ordered_json names = ordered_json::array(), conditions = ordered_json::array();
  for (const auto& entry : entries_) {
    if (entry.kind != kind || !entry.refusal.empty()) continue;
    SchemaWriter writer(*this);
    registry_.visit_params(entry, writer);
    const std::string name = kind + "." + entry.name;
    all_[name] = writer.take();
    names.push_back(entry.name);
    names.push_back(kind + "/" + entry.name);
    ordered_json condition;
    condition["if"]["properties"]["plugin"]["enum"] = {entry.name, kind + "/" + entry.name};
    condition["if"]["required"] = ordered_json::array({"plugin"});
    condition["then"]["properties"]["params"]["$ref"] = "#/$defs/" + name;
    conditions.push_back(std::move(condition));
  }
  const ordered_json file = {{"type", "string"}, {"pattern", R"(\.so$|^/|^\.\.?/)"}};
  const ordered_json plugin = {{"anyOf", {{{"enum", names}}, file}}};
  ordered_json mapping = {
      {"type", "object"},
      {"properties", {{"plugin", plugin}, {"params", type_or_null({"object"})}, {"version", type_or_null({"string"})}}},
      {"additionalProperties", false}};
  if (!conditions.empty()) mapping["allOf"] = std::move(conditions);
  // Not anyOf: so that an error inside a mapping is reported where it is.
  all_[slot_name] = {
      {"if", {{"type", "object"}}}, {"then", std::move(mapping)}, {"else", {{"anyOf", {{{"type", "null"}}, plugin}}}}};
  return reference;
}

}  // namespace

ordered_json json_schema(const std::string& title, const std::function<void(ParamVisitor&)>& visit, bool is_file,
                         const PluginRegistry& registry) {
  Definitions definitions(registry);
  SchemaWriter writer(definitions);
  visit(writer);
  ordered_json keys = writer.take();
  ordered_json schema = {{"$schema", "https://json-schema.org/draft/2020-12/schema"},
                         {"$comment", "Made by weft " WEFT_VERSION ", with the plugins that it finds."},
                         {"title", title}};
  schema.update(keys);
  if (is_file) {
    const ordered_json base = {{"type", "string"},
                               {"description", "Another file, from which all keys come that are not given here."}};
    schema["properties"]["extends"] = base;
  }
  schema["$defs"] = definitions.take();
  return schema;
}

}  // namespace weft
