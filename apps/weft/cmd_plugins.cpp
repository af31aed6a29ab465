#include <algorithm>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "cluster/profile.hpp"
#include "commands.hpp"
#include "experiments/ablation.hpp"
#include "experiments/experiment_config.hpp"
#include "experiments/physics/physics.hpp"
#include "experiments/reproduction.hpp"
#include "loader/json_schema.hpp"
#include "options.hpp"
#include "simulation/scene.hpp"
#include "simulation/surroundings.hpp"
#include "weft/config.hpp"

namespace weft::app {
namespace {

int list_plugins(const Context& context) {
  const auto registry = registry_of_overrides(context);
  const auto entries = registry->list();
  if (context.json) {
    auto array = nlohmann::ordered_json::array();
    for (const auto& e : entries) {
      std::vector<std::string> shadows;
      for (const auto& file : e.shadows) shadows.push_back(file.string());
      array.push_back({{"kind", e.kind},
                       {"name", e.name},
                       {"version", e.version},
                       {"file", e.file.string()},
                       {"shadows", shadows},
                       {"refusal", e.refusal}});
    }
    context.output() << array.dump(2) << '\n';
    return 0;
  }
  for (const auto& e : entries) {
    if (e.refusal.empty()) {
      std::printf("%-11s %-14s %-8s %s\n", e.kind.c_str(), e.name.c_str(), e.version.c_str(), e.file.c_str());
      for (const auto& file : e.shadows) std::printf("%-11s not used: %s\n", "", file.c_str());
    } else {
      std::printf("%s\n", e.refusal.c_str());
    }
  }
  if (entries.empty()) {
    std::string folders;
    for (const auto& folder : PluginRegistry::default_search_path()) folders += " " + folder.string();
    std::printf("no plugin in%s\n", folders.c_str());
  }
  return 0;
}

/// Config files whose keys can be described like a plugin's parameters.
struct FileKind {
  const char* name;
  const char* read_by;
  std::vector<ParamInfo> (*params)();
  void (*visit)(ParamVisitor& visitor) = nullptr;  ///< null: no JSON Schema
  /// A key with a mapping by names that people give, the keys of its values, and again for a key of these.
  struct Named {
    const char* key;
    void (*visit)(ParamVisitor& visitor);
  };
  std::vector<Named> named = {};
};
template <class Params>
void visit_params(ParamVisitor& visitor) {
  Params params;
  params.visit(visitor);
}
template <class Params>
FileKind file_kind(const char* name, const char* read_by) {
  return {name, read_by, describe_params<Params>, visit_params<Params>};
}
const FileKind kFileKinds[] = {
    file_kind<SessionParams>("task", "weft run, weft plan, weft estimate"),
    file_kind<ExperimentParams>("experiment", "weft generate, weft train, weft calibrate, weft evaluate"),
    file_kind<PhysicsExperimentParams>("physics", "weft evaluate physics"),
    file_kind<AblationParams>("ablation", "weft ablate"),
    {"reproduce",
     "weft reproduce",
     describe_reproduction,
     visit_params<ReproduceParams>,
     {{"parts", visit_params<PartParams>}, {"steps", visit_params<StepParams>}}},
    {"scene", "weft simulate", describe_scene},
    {"obstacles", "scene.obstacles of tasks, obstacles of scenes", describe_obstacles},
    file_kind<ClusterProfile>("slurm", "--on slurm:PROFILE"),
};

std::string file_kind_names() {
  std::string names;
  for (const auto& kind : kFileKinds) names += (names.empty() ? "" : ", ") + std::string(kind.name);
  return names;
}

/// PluginRegistry::find(), with an error that also names the kinds of files.
PluginEntry find(const PluginRegistry& registry, const std::string& name) {
  try {
    return registry.find(name);
  } catch (const PluginError& error) {
    std::vector<std::string> kinds;
    for (const auto& kind : kFileKinds) kinds.emplace_back(kind.name);
    const std::string what = error.what(), hint = nearest_hint(name, kinds);
    if (hint.empty() || what.find("; nearest: ") != std::string::npos) throw;
    throw PluginError(what + hint);
  }
}

/// The kind of file of this name; null if there is none.
const FileKind* file_kind_named(const std::string& name) {
  const auto* kind =
      std::find_if(std::begin(kFileKinds), std::end(kFileKinds), [&](auto& one) { return one.name == name; });
  return kind == std::end(kFileKinds) ? nullptr : kind;
}

int describe_as_schema(const Context& context, const std::string& name) {
  const auto registry = registry_of_overrides(context);
  nlohmann::ordered_json schema;
  if (const FileKind* file = file_kind_named(name)) {
    if (file->visit == nullptr)
      throw ConfigError("--json-schema: there is none of " + name + " files; weft describe " + name +
                        " lists the keys");
    schema = json_schema("weft " + name + " file", file->visit, true, *registry);
    nlohmann::ordered_json* level = &schema;
    for (const auto& named : file->named) {
      nlohmann::ordered_json below = json_schema("", named.visit, false, *registry);
      for (const char* key : {"$schema", "$comment", "title", "$defs"}) below.erase(key);
      nlohmann::ordered_json& mapping = (*level)["properties"][named.key];
      mapping["type"] = "object";
      mapping["additionalProperties"] = std::move(below);
      level = &mapping["additionalProperties"];
    }
  } else {
    const auto entry = find(*registry, name);
    const auto visit = [&](ParamVisitor& visitor) { registry->visit_params(entry, visitor); };
    schema = json_schema("params of " + entry.kind + " " + entry.name + " " + entry.version, visit, false, *registry);
  }
  context.output() << schema.dump(2) << '\n';
  return 0;
}

int describe(const Context& context, const std::string& name, bool markdown) {
  const FileKind* file = file_kind_named(name);
  nlohmann::ordered_json about;
  std::string title;
  std::vector<ParamInfo> params;
  if (file != nullptr) {
    about = {{"kind", "file"}, {"name", name}, {"read_by", file->read_by}};
    title = name + " file, for " + file->read_by;
    params = file->params();
  } else {
    const auto registry = registry_of_overrides(context);
    const auto entry = find(*registry, name);
    about = {{"kind", entry.kind}, {"name", entry.name}, {"version", entry.version}, {"file", entry.file.string()}};
    title = entry.kind + "/" + entry.name + " " + entry.version + "  (" + entry.file.string() + ")";
    params = registry->params(entry);
  }
  if (context.json) {
    auto array = nlohmann::ordered_json::array();
    for (const auto& p : params) {
      array.push_back({{"name", p.name},
                       {"type", p.type},
                       {"unit", p.unit},
                       {"range", p.range},
                       {"default", p.default_value},
                       {"text", p.text},
                       {"decides", to_string(p.decides)}});
      if (!p.slot.empty()) array.back()["slot"] = p.slot;
      if (!p.choices.empty()) array.back()["choices"] = p.choices;
      if (p.length.count > 0) array.back()["length"] = p.length.count;
    }
    about["params"] = array;
    context.output() << about.dump(2) << '\n';
  } else if (markdown) {
    std::cout << params_markdown(params);
  } else {
    std::printf("%s\n", title.c_str());
    for (const auto& p : params) {
      const std::string unit = p.unit.empty() ? "" : " " + p.unit, range = p.range.empty() ? "" : ", " + p.range;
      std::printf("  %-26s %s%s%s; default %s\n      %s\n", p.name.c_str(), p.type.c_str(), unit.c_str(), range.c_str(),
                  p.default_value.empty() ? "(none)" : p.default_value.c_str(), p.text.c_str());
    }
    if (params.empty()) std::printf("  no parameters\n");
  }
  return 0;
}

void add_search_options(CLI::App& command, Context& context) {
  command.add_option("--set", context.overrides, "plugin_path=[FOLDER, ...]: folders searched for plugins first")
      ->allow_extra_args(false)
      ->type_name("KEY=VALUE");
  add_output_options(command, context);
}

}  // namespace

void register_plugins(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("plugins", "List the plugins that load, and those that do not and why");
  add_search_options(*command, context);
  command->callback([&context] { context.action = [&context] { return list_plugins(context); }; });
}

void register_describe(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand(
      "describe", "Show the parameters of a plugin, or the keys of a config file, with units, ranges and defaults");
  add_search_options(*command, context);
  auto name = std::make_shared<std::string>();
  auto markdown = std::make_shared<bool>(false), schema = std::make_shared<bool>(false);
  command
      ->add_option("name", *name,
                   "Plugin name, kind/name, or library file; or " + file_kind_names() + ": the keys of such files")
      ->required();
  command->add_flag("--markdown", *markdown, "Print the table for the plugin's README");
  command->add_flag("--json-schema", *schema, "Print a JSON Schema, with which editors check and complete such files")
      ->excludes("--markdown");
  command->callback([&context, name, markdown, schema] {
    context.action = [&context, name, markdown, schema] {
      return *schema ? describe_as_schema(context, *name) : describe(context, *name, *markdown);
    };
  });
}

}  // namespace weft::app
