// `weft describe NAME --json-schema`: the shipped configs are valid, and configs that weft refuses are not.
#include <algorithm>
#include <nlohmann/json.hpp>
#include <regex>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

ordered_json schema_of(const std::string& name) {
  const test::Outcome told =
      test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' describe " + name + " --json-schema");
  EXPECT_EQ(told.code, 0) << told.output;
  return ordered_json::parse(told.output, nullptr, false);
}

/// As much of draft 2020-12 as json_schema() writes. An unknown keyword is an error, so that none goes unchecked.
class Validator {
 public:
  explicit Validator(const ordered_json& root) : root_(root) {}

  /// @return what is wrong with the value, with its path; empty if it is valid.
  std::string check(const ordered_json& value) const { return check(root_, value, "config"); }

 private:
  std::string check(const ordered_json& schema, const ordered_json& value, const std::string& at) const {
    for (const auto& [keyword, rule] : schema.items()) {
      const std::string wrong = check_keyword(schema, keyword, rule, value, at);
      if (!wrong.empty()) return wrong;
    }
    return "";
  }
  bool is_valid(const ordered_json& schema, const ordered_json& value) const {
    return check(schema, value, "").empty();
  }
  std::string check_keyword(const ordered_json& schema, const std::string& keyword, const ordered_json& rule,
                            const ordered_json& value, const std::string& at) const {
    const auto fits = [&](const auto& one) { return is_valid(one, value); };
    bool good = true;
    if (keyword == "$ref")
      return check(root_.at(ordered_json::json_pointer(rule.get<std::string>().substr(1))), value, at);
    else if (keyword == "type")
      good = rule.is_string() ? has_type(value, rule)
                              : std::any_of(rule.begin(), rule.end(), [&](auto& one) { return has_type(value, one); });
    else if (keyword == "enum")
      good = std::find(rule.begin(), rule.end(), value) != rule.end();
    else if (keyword == "minimum")
      good = !value.is_number() || value.get<double>() >= rule.get<double>();
    else if (keyword == "maximum")
      good = !value.is_number() || value.get<double>() <= rule.get<double>();
    else if (keyword == "minItems")
      good = !value.is_array() || value.size() >= rule.get<std::size_t>();
    else if (keyword == "maxItems")
      good = !value.is_array() || value.size() <= rule.get<std::size_t>();
    else if (keyword == "pattern")
      good = !value.is_string() || std::regex_search(value.get<std::string>(), std::regex(rule.get<std::string>()));
    else if (keyword == "required")
      good = !value.is_object() || std::all_of(rule.begin(), rule.end(), [&](auto& one) {
        return value.contains(one.template get<std::string>());
      });
    else if (keyword == "anyOf")
      good = std::any_of(rule.begin(), rule.end(), fits);
    else if (keyword == "if")
      return check_branch(schema, is_valid(rule, value) ? "then" : "else", value, at);
    else if (keyword == "allOf" || keyword == "items" || keyword == "properties" || keyword == "additionalProperties")
      return check_parts(schema, keyword, rule, value, at);
    else if (keyword[0] != '$' && keyword != "then" && keyword != "else" && keyword != "title" &&
             keyword != "description" && keyword != "default")
      return "unknown keyword " + keyword;
    return good ? "" : at + ": " + keyword;
  }
  std::string check_branch(const ordered_json& schema, const char* branch, const ordered_json& value,
                           const std::string& at) const {
    return schema.contains(branch) ? check(schema.at(branch), value, at) : "";
  }
  std::string check_parts(const ordered_json& schema, const std::string& keyword, const ordered_json& rule,
                          const ordered_json& value, const std::string& at) const {
    std::string wrong;
    const auto need = [&](const ordered_json& part, const ordered_json& member, const std::string& name) {
      if (wrong.empty()) wrong = check(part, member, name.empty() ? at : at + "." + name);
    };
    if (keyword == "allOf")
      for (const auto& one : rule) need(one, value, "");
    if (keyword == "items" && value.is_array())
      for (const auto& item : value) need(rule, item, "item");
    if (!value.is_object()) return wrong;
    for (const auto& [key, member] : value.items()) {
      if (keyword == "properties" && rule.contains(key)) need(rule.at(key), member, key);
      if (keyword == "additionalProperties" && rule.is_object()) need(rule, member, key);
      if (keyword == "additionalProperties" && rule == false && !schema.at("properties").contains(key))
        return at + ": unknown " + key;
    }
    return wrong;
  }
  static bool has_type(const ordered_json& value, const std::string& type) {
    if (type == "integer") return value.is_number_integer();
    if (type == "number") return value.is_number();
    if (type == "boolean") return value.is_boolean();
    return type == value.type_name();
  }

  const ordered_json& root_;
};

ordered_json json_of(const ConfigNode& config) { return ordered_json::parse(config.to_json()); }
ordered_json json_of(const std::string& yaml) { return json_of(ConfigNode::parse(yaml, "test")); }

/// Which `weft describe` has the keys of a shipped file.
std::string kind_of(const fs::path& file, const ConfigNode& config) {
  if (file.parent_path().filename() == "tasks") return "task";
  if (config.has("factors")) return "ablation";
  return config.has("physics") ? "physics" : "experiment";
}

TEST(JsonSchema, EveryShippedConfigIsValid) {
  std::map<std::string, ordered_json> schemas;
  std::map<std::string, int> files;
  for (const char* folder : {"tasks", "experiments"}) {
    for (const auto& entry : fs::directory_iterator(fs::path(WEFT_SOURCE_DIR) / "configs" / folder)) {
      if (entry.path().extension() != ".yaml") continue;
      const ConfigNode merged = ConfigNode::load(entry.path());
      const std::string kind = kind_of(entry.path(), merged);
      ++files[kind];
      if (!schemas.contains(kind)) schemas[kind] = schema_of(kind);
      const Validator validator(schemas[kind]);
      EXPECT_THAT(validator.check(json_of(merged)), IsEmpty()) << entry.path();
      // As an editor sees it: what it extends is not there.
      std::ifstream stream(entry.path());
      const std::string text{std::istreambuf_iterator<char>(stream), {}};
      EXPECT_THAT(validator.check(json_of(text)), IsEmpty()) << entry.path();
    }
  }
  for (const char* kind : {"task", "experiment", "physics", "ablation"}) EXPECT_GE(files[kind], 2) << kind;
}

TEST(JsonSchema, WhatWeftRefusesIsNotValid) {
  const ordered_json schema = schema_of("task");
  const Validator validator(schema);
  const std::string good = "planning: {instances: 8}\n";
  EXPECT_THAT(validator.check(json_of(good)), IsEmpty());
  const std::pair<const char*, const char*> wrong[] = {
      {"plannning: {}", "config: unknown plannning"},
      {"planning: {instance: 8}", "config.planning: unknown instance"},
      {"planning: {instances: 0}", "config.planning.instances: minimum"},
      {"planning: {instances: 5000}", "config.planning.instances: maximum"},
      {"planning: {instances: 1.5}", "config.planning.instances: type"},
      {"planning: {instances: \"8\"}", "config.planning.instances: type"},
      {"planning: 8", "config.planning: type"},
      {"planning: {loss: means}", "config.planning.loss: enum"},
      {"manipulation: {displacement_m: [0.1, 11]}", "config.manipulation.displacement_m.item: maximum"},
      {"manipulation: {displacement_m: [0.1]}", "config.manipulation.displacement_m: anyOf"},
      {"manipulation: {displacement_m: 0.1}", "config.manipulation.displacement_m: type"},
      {"optimiser: rpop", "config.optimiser: anyOf"},
      {"optimiser: {plugin: rprop, params: {patiens: 3}}", "config.optimiser.params: unknown patiens"},
      {"optimiser: {plugin: rprop, params: {patience: many}}", "config.optimiser.params.patience: type"},
      {"optimiser: {plugin: rprop, parameters: {}}", "config.optimiser: unknown parameters"},
      {"data: {}", "config: unknown data"},
  };
  for (const auto& [yaml, what] : wrong) EXPECT_EQ(validator.check(json_of(yaml)), what) << yaml;
}

TEST(JsonSchema, PartsAndStepsOfAReproductionAreChecked) {
  const ordered_json schema = schema_of("reproduce");
  const Validator validator(schema);
  const ConfigNode shipped = ConfigNode::load(WEFT_SOURCE_DIR "/configs/reproduce.yaml");
  EXPECT_THAT(validator.check(json_of(shipped)), IsEmpty());
  EXPECT_EQ(validator.check(json_of("parts: {a: {steps: {s: {sed: 3}}}}")), "config.parts.a.steps.s: unknown sed");
  EXPECT_EQ(validator.check(json_of("parts: {a: {steps: {s: {seed: -2}}}}")), "config.parts.a.steps.s.seed: minimum");
  EXPECT_EQ(validator.check(json_of("parts: {a: {steps: {s: {command: fold}}}}")),
            "config.parts.a.steps.s.command: enum");
}

TEST(JsonSchema, WhatWeftAcceptsIsValid) {
  const ordered_json schema = schema_of("task");
  const Validator validator(schema);
  for (const char* yaml :
       {"extends: other.yaml\nplanning:", "knowledge: true", "knowledge: \"true\"", "seed:", "description: 5",
        "manipulation: {displacement_m: []}", "optimiser: rprop", "optimiser: optimiser/rprop",
        "optimiser: {params: {patience: 3}}", "optimiser: {plugin: ./libmine.so, params: {any: 1}}",
        "optimiser: {plugin: rprop, version: 1.0.0, params: {patience: 3}}", "garment: a.yaml",
        "garment: {mesh: a.obj}"})
    EXPECT_THAT(validator.check(json_of(yaml)), IsEmpty()) << yaml;
}

TEST(JsonSchema, DescribesAKeyAsDescribeDoes) {
  const ordered_json task = schema_of("task");
  EXPECT_EQ(task.at("$schema"), "https://json-schema.org/draft/2020-12/schema");
  const auto& planning = task.at("properties").at("planning").at("properties");
  const ordered_json horizon = planning.at("horizon");
  EXPECT_EQ(horizon.at("default"), 25);
  EXPECT_EQ(horizon.at("minimum"), 1);
  EXPECT_THAT(horizon.at("description").get<std::string>(), HasSubstr(" Unit: segments."));
  EXPECT_EQ(task.at("properties").at("trajectory").at("default"), "arc");
  const ordered_json arc = schema_of("arc");
  EXPECT_EQ(arc.at("properties"), task.at("$defs").at("trajectory.arc").at("properties"));
  const test::Outcome scene = test::run_shell("'" WEFT_PROGRAM "' describe scene --json-schema");
  EXPECT_EQ(scene.code, 2);
  EXPECT_THAT(scene.output, HasSubstr("--json-schema: there is none of scene files"));
}

}  // namespace
}  // namespace weft
