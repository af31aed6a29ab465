#include <cmath>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "conformance/conformance.hpp"

namespace weft::app {
namespace {

struct Arguments {
  std::string name, kind, tolerances;
  std::vector<std::string> laws;
  bool list = false;
};

/// JSON has no infinity, and a law that threw has no measure.
nlohmann::ordered_json number(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
}

int list(const Context& context, const std::string& kind) {
  const auto laws = list_laws(kind);
  if (context.json) {
    auto array = nlohmann::ordered_json::array();
    for (const auto& law : laws) array.push_back({{"law", law.law}, {"text", law.text}, {"bound", law.bound}});
    std::cout << nlohmann::ordered_json{{"kind", kind}, {"laws", array}}.dump(2) << '\n';
    return 0;
  }
  for (const auto& law : laws) std::printf("%-44s <= %-8g %s\n", law.law.c_str(), law.bound, law.text.c_str());
  return 0;
}

int check(const Context& context, const Arguments& arguments) {
  if (arguments.list && arguments.name.empty()) {
    if (arguments.kind.empty()) throw ConfigError("weft conformance --list: name a plugin or give --kind");
    return list(context, arguments.kind);
  }
  if (arguments.name.empty()) throw ConfigError("weft conformance: name a plugin or a library file");
  const auto registry = context.registry();
  const PluginEntry entry = registry->find(arguments.name, arguments.kind);
  if (arguments.list) return list(context, entry.kind);

  // Tolerances live with the plugin: libNAME.so, libNAME.conformance.yaml.
  std::filesystem::path file = arguments.tolerances;
  if (file.empty()) {
    file = entry.file;
    file.replace_extension(".conformance.yaml");
    if (!std::filesystem::exists(file)) file.clear();
  }
  ConfigNode tolerances = file.empty() ? ConfigNode() : ConfigNode::load(file);
  for (const auto& assignment : context.overrides) tolerances = apply_override(tolerances, assignment);

  const auto host = context.host(registry, context.seed.value_or(0), true);
  const ConfigNode slot = ConfigNode::mapping({{"plugin", ConfigNode::quoted(entry.file.string())}});
  const auto results = check_conformance(*host, entry.kind, slot, tolerances, arguments.laws);
  int failures = 0;
  for (const auto& r : results) failures += r.passed ? 0 : 1;

  if (context.json) {
    auto array = nlohmann::ordered_json::array();
    for (const auto& r : results) {
      array.push_back({{"law", r.law},
                       {"text", r.text},
                       {"measured", number(r.measured)},
                       {"bound", r.bound},
                       {"passed", r.passed},
                       {"detail", r.detail}});
    }
    std::cout << nlohmann::ordered_json{{"kind", entry.kind},       {"name", entry.name},
                                        {"version", entry.version}, {"file", entry.file.string()},
                                        {"passed", failures == 0},  {"laws", array}}
                     .dump(2)
              << '\n';
    return failures == 0 ? 0 : 1;
  }
  for (const auto& r : results) {
    if (r.passed && context.quiet) continue;
    std::printf("%s %-44s %-12.4g <= %-8g%s%s\n", r.passed ? "pass" : "FAIL", r.law.c_str(), r.measured, r.bound,
                r.detail.empty() ? "" : "  ", r.detail.c_str());
    if (!r.passed) std::printf("     %s\n", r.text.c_str());
  }
  context.say(entry.kind + "/" + entry.name + " " + entry.version + ": " + std::to_string(results.size() - failures) +
              " of " + std::to_string(results.size()) + " laws hold");
  return failures == 0 ? 0 : 1;
}

}  // namespace

void register_conformance(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("conformance", "Check a plugin against the laws of its kind");
  add_common_options(*command, context);
  auto arguments = std::make_shared<Arguments>();
  command->add_option("name", arguments->name, "Plugin name, kind/name, or library file");
  command->add_option("--kind", arguments->kind, "simulator, predictor, trajectory or optimiser");
  command->add_option("--law", arguments->laws, "Check this law only (repeatable)")->allow_extra_args(false);
  command->add_option("--tolerances", arguments->tolerances, "File of bounds; default: the one beside the library")
      ->check(CLI::ExistingFile);
  command->add_flag("--list", arguments->list, "List the laws without checking them");
  command->callback(
      [&context, arguments] { context.action = [&context, arguments] { return check(context, *arguments); }; });
}

}  // namespace weft::app
