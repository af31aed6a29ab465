#include <sys/prctl.h>

#include <cmath>
#include <csignal>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "conformance/isolated.hpp"
#include "loader/where.hpp"
#include "options.hpp"
#include "processes/child_process.hpp"
#include "processes/crash_report.hpp"

namespace weft::app {
namespace {

struct Arguments {
  std::string name, kind, tolerances;
  std::vector<std::string> laws;
  double limit_s = kLawLimitSeconds;
  bool list = false;
  bool in_process = false;  ///< no child processes
  bool in_child = false;    ///< this is the process of one law
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
    context.output() << nlohmann::ordered_json{{"kind", kind}, {"laws", array}}.dump(2) << '\n';
    return 0;
  }
  for (const auto& law : laws) std::printf("%-44s <= %-8g %s\n", law.law.c_str(), law.bound, law.text.c_str());
  return 0;
}

/// What is checked, and against which bounds.
struct Check {
  PluginEntry entry;
  std::filesystem::path tolerances_file;
  ConfigNode tolerances;
};

Check read_check(const Context& context, const Arguments& arguments, const PluginRegistry& registry) {
  Check check{registry.find(arguments.name, arguments.kind), arguments.tolerances, {}};
  // Tolerances live with the plugin: libNAME.so, libNAME.conformance.yaml.
  if (check.tolerances_file.empty()) {
    check.tolerances_file = check.entry.file;
    check.tolerances_file.replace_extension(".conformance.yaml");
    if (!std::filesystem::exists(check.tolerances_file)) check.tolerances_file.clear();
  }
  if (!check.tolerances_file.empty()) check.tolerances = ConfigNode::load(check.tolerances_file);
  for (const auto& assignment : context.overrides) check.tolerances = apply_override(check.tolerances, assignment);
  return check;
}

ConfigNode slot_of(const PluginEntry& entry) {
  return ConfigNode::mapping({{"plugin", ConfigNode::quoted(entry.file.string())}});
}

/// The process of one law: checks it, and writes its answer. A child whose parent died has nobody to answer to.
int check_here(const Context& context, const Arguments& arguments) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  install_crash_report(kCrashReportFile, write_where);
  Context::keep_output();
  try {
    const auto registry = context.registry();
    const Check check = read_check(context, arguments, *registry);
    const auto host = context.host(registry, context.seed.value_or(0), PluginChecks::results);
    for (const auto& law :
         check_conformance(*host, check.entry.kind, slot_of(check.entry), check.tolerances, arguments.laws))
      context.output() << answer_of(law) << std::endl;
  } catch (const ConfigError& error) {
    context.output() << answer_of(error) << std::endl;
  } catch (const PluginError& error) {
    context.output() << answer_of(error) << std::endl;
  }
  return 0;
}

/// The command of the process of one law, but for the law.
std::vector<std::string> child_command(const Context& context, const Arguments& arguments, const Check& check) {
  std::vector<std::string> command = {"/proc/self/exe", "conformance", check.entry.file.string(), "--in-child"};
  if (!arguments.tolerances.empty()) command.insert(command.end(), {"--tolerances", arguments.tolerances});
  for (const auto& assignment : context.overrides) command.insert(command.end(), {"--set", assignment});
  if (context.seed) command.insert(command.end(), {"--seed", std::to_string(*context.seed)});
  if (context.jobs > 0) command.insert(command.end(), {"--jobs", std::to_string(context.jobs)});
  return command;
}

void print(const Context& context, const LawResult& r) {
  if (context.json || (r.passed && context.quiet)) return;
  std::printf("%s %-44s %-12.4g <= %-8g%s%s\n", r.passed ? "pass" : "FAIL", r.law.c_str(), r.measured, r.bound,
              r.detail.empty() ? "" : "  ", r.detail.c_str());
  if (!r.passed) std::printf("     %s\n", r.text.c_str());
  std::fflush(stdout);
}

int check(const Context& context, const Arguments& arguments) {
  if (arguments.list && arguments.name.empty()) {
    if (arguments.kind.empty()) throw ConfigError("weft conformance --list: name a plugin or give --kind");
    return list(context, arguments.kind);
  }
  if (arguments.name.empty()) throw ConfigError("weft conformance: name a plugin or a library file");
  if (arguments.in_child) return check_here(context, arguments);
  const auto registry = context.registry();
  const Check check = read_check(context, arguments, *registry);
  const PluginEntry& entry = check.entry;
  if (arguments.list) return list(context, entry.kind);

  const std::vector<std::string> command = child_command(context, arguments, check);
  auto results = planned_laws(entry.kind, check.tolerances, arguments.laws);
  std::size_t failures = 0;
  std::unique_ptr<Host> host;
  if (arguments.in_process) host = context.host(registry, context.seed.value_or(0), PluginChecks::results);
  for (auto& law : results) {
    law = host ? check_conformance(*host, entry.kind, slot_of(entry), check.tolerances, {law.law}).front()
               : check_in_child(command, law, arguments.limit_s);
    failures += law.passed ? 0 : 1;
    print(context, law);
  }

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
    context.output() << nlohmann::ordered_json{{"kind", entry.kind},       {"name", entry.name},
                                               {"version", entry.version}, {"file", entry.file.string()},
                                               {"passed", failures == 0},  {"laws", array}}
                            .dump(2)
                     << '\n';
    return failures == 0 ? 0 : 1;
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
  command
      ->add_option("--limit", arguments->limit_s,
                   "Seconds of CPU time that a law may use, and may wait without using any; tenfold with a sanitizer")
      ->check(within(0.1, 1e6))
      ->capture_default_str();
  command->add_flag("--in-process", arguments->in_process,
                    "Check the laws in this process, for a debugger; a crash or hang then ends the check");
  command->add_flag("--in-child", arguments->in_child)->group("");  // not in --help
  command->add_flag("--list", arguments->list, "List the laws without checking them");
  command->callback(
      [&context, arguments] { context.action = [&context, arguments] { return check(context, *arguments); }; });
}

}  // namespace weft::app
