#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <utility>

#include "commands.hpp"
#include "output.hpp"
#include "processes/shell_word.hpp"
#include "sdk/files.hpp"
#include "weft/config.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

/// One per kind: the example plugin that becomes the new one, and what the README shows.
struct Template {
  const char* kind;
  const char* example;    ///< templates/KIND/EXAMPLE.cpp, and its plugin's name
  const char* its_class;  ///< the class in it
  const char* suffix;     ///< of the new class
  const char* law;        ///< of the README's commands, with
  const char* param;      ///< this parameter
  const char* value;
  const char* task;  ///< arguments of `weft run` on the shipped towel
};
constexpr Template kTemplates[] = {
    {"simulator", "mass_spring", "MassSpring", "Simulator", "nothing_sinks", "damping", "0.1",
     "--set simulator=@NAME@ \\\n  --set material=$WEFT/share/weft/configs/fabrics/basic_isotropic.yaml"},
    {"predictor", "follow", "Follow", "Predictor", "numbers_are_sound", "radius_m", "0.15",
     "--set predictor=@NAME@ --set optimiser=mppi"},
    {"trajectory", "min_jerk", "MinJerk", "Trajectory", "targets_pullback_is_exact", "lift", "0.3",
     "--set trajectory=@NAME@ \\\n  --set 'goal.controls=[0.0125, 0, 0.0005]'"},
    {"optimiser", "momentum", "Momentum", "Optimiser", "never_leaves_the_box", "repeat", "0.8",
     "--set optimiser=@NAME@"},
};

struct NewPlugin {
  std::string kind, name;
  bool force = false;
};

bool is_word_part(char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; }

/// Puts `by` in the place of `word`: of an identifier where it stands alone, of a @PLACE@ anywhere.
std::string replaced(const std::string& text, const std::string& word, const std::string& by) {
  const bool identifier = is_word_part(word.front());
  std::string result;
  std::size_t from = 0;
  for (std::size_t at; (at = text.find(word, from)) != std::string::npos; from = at + word.size()) {
    const std::size_t end = at + word.size();
    const bool inside = (at > 0 && is_word_part(text[at - 1])) || (end < text.size() && is_word_part(text[end]));
    result += text.substr(from, at - from) + (identifier && inside ? word : by);
  }
  return result + text.substr(from);
}

/// my_path, trajectory: MyPathTrajectory. The suffix keeps it apart from the names of weft.
std::string class_name(const std::string& name, const char* suffix) {
  std::string result;
  bool begins = true;
  for (const char c : name) {
    if (c != '_') result += begins ? static_cast<char>(std::toupper(static_cast<unsigned char>(c))) : c;
    begins = c == '_';
  }
  return result + suffix;
}

/// @throws ConfigError.
const Template& template_of(const std::string& kind) {
  std::vector<std::string> kinds;
  for (const Template& t : kTemplates) {
    if (kind == t.kind) return t;
    kinds.emplace_back(t.kind);
  }
  throw ConfigError("'" + kind + "' is not a kind of plugin, must be " + one_of(kinds) + nearest_hint(kind, kinds));
}

/// @throws ConfigError for a name that files, targets and configs cannot have, or that a plugin has already.
void check_name(const Context& context, const NewPlugin& wanted) {
  const std::string& name = wanted.name;
  constexpr std::size_t kLongest = 63;  // WeftPluginInfo::name and the zero behind it
  const auto allowed = [](char c) { return c == '_' || (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9'); };
  if (name.empty() || name.size() > kLongest || !std::all_of(name.begin(), name.end(), allowed) || name[0] < 'a')
    throw ConfigError("'" + name + "' cannot be the name of a plugin, must be a lower-case letter and then at most " +
                      std::to_string(kLongest - 1) + " lower-case letters, digits and underscores");
  if (wanted.force) return;
  for (const PluginEntry& entry : context.registry()->list()) {
    if (entry.refusal.empty() && entry.kind == wanted.kind && entry.name == name)
      throw ConfigError("there is already a " + entry.kind + " plugin called " + name + ": " + entry.file.string() +
                        "; take another name, or --force to replace it where yours is found first");
  }
}

int write_plugin(const Context& context, const NewPlugin& wanted) {
  const Template& chosen = template_of(wanted.kind);
  check_name(context, wanted);
  const std::string &kind = wanted.kind, &name = wanted.name;
  const fs::path folder = context.out.empty() ? fs::path(name) : fs::path(context.out);
  if (fs::exists(folder) && !(fs::is_directory(folder) && fs::is_empty(folder)))
    throw ConfigError(folder.string() + ": exists and is not an empty folder; name another one with --out");

  const std::string its_class = class_name(name, chosen.suffix), weft = shell_word(tree_of_weft().string());
  const std::pair<const char*, std::string> places[] = {
      // What holds other places comes first.
      {"@TASK@", chosen.task},
      {"@PARAM@", std::string(chosen.param) + ": " + chosen.value},
      {"@SETTING@", std::string(chosen.param) + "=" + chosen.value},
      {"@LIBRARY@", "libweft_" + kind + "_" + name + ".so"},
      {"@LAW@", chosen.law},
      {"@KIND@", kind},
      {"@CLASS@", its_class},
      {"@NAME@", name},
      {"@WEFT@", weft},
  };
  const auto filled = [&](const fs::path& file) {
    std::string text = shipped_text("templates" / fs::path(file));
    for (const auto& [place, value] : places) text = replaced(text, place, value);
    return text;
  };
  std::string source = shipped_text("templates" / fs::path(kind) / (std::string(chosen.example) + ".cpp"));
  source = replaced(replaced(source, chosen.example, name), chosen.its_class, its_class);
  const std::pair<std::string, std::string> files[] = {
      {"CMakeLists.txt", filled("CMakeLists.txt.in")},
      {"README.md", filled("README.md.in")},
      {"check.hpp", filled("check.hpp.in")},
      {name + ".cpp", filled(fs::path(kind) / "head.in") + source},
      {"test_" + name + ".cpp", filled(fs::path(kind) / "test.cpp.in")},
  };
  const PlacedFolder placed(folder);
  const TemporaryFolder made(folder);  // all of them or none: a folder that is not empty is refused
  for (const auto& [file, text] : files) write_text(made.path() / file, text);
  for (const auto& [file, text] : files) fs::rename(made.path() / file, folder / file);

  const std::string source_folder = shell_word(folder.string()), build = shell_word((folder / "build").string());
  context.say(folder.string() + ": a " + kind +
              " plugin that works as it stands; README.md says how to go on. Next:\n" + "  cmake -S " + source_folder +
              " -B " + build + " -DCMAKE_PREFIX_PATH=" + weft + "\n" + "  cmake --build " + build + "\n" +
              "  ctest --test-dir " + build + " --output-on-failure");
  return 0;
}

}  // namespace

void register_new(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand(
      "new", "Write the sources of a new plugin that builds, has a unit test and passes the laws of its kind");
  auto wanted = std::make_shared<NewPlugin>();
  command->add_option("kind", wanted->kind, "simulator, predictor, trajectory or optimiser")->required();
  command->add_option("name", wanted->name, "Name of the plugin: lower-case letters, digits, underscores")->required();
  command->add_option("--out", context.out, "Folder to write, new or empty; default: the name");
  command->add_flag("--force", wanted->force, "Accept the name of an existing plugin of this kind");
  command->add_flag("--quiet", context.quiet, "Print nothing but errors");
  command->callback(
      [&context, wanted] { context.action = [&context, wanted] { return write_plugin(context, *wanted); }; });
}

}  // namespace weft::app
