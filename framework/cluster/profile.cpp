#include "cluster/profile.hpp"

#include <algorithm>
#include <cctype>
#include <set>

#include "sdk/listed.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

constexpr const char* kDefaultProfile = "default";

/// The names of the profiles in the folders.
std::vector<std::string> profile_names(const std::vector<fs::path>& folders) {
  std::set<std::string> names;
  for (const auto& folder : folders) {
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(folder, none))
      if (entry.path().extension() == ".yaml") names.insert(entry.path().stem().string());
  }
  return {names.begin(), names.end()};
}

bool has_control_character(const std::string& text) {
  return std::any_of(text.begin(), text.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; });
}

/// The texts become lines of a script: one line each.
void check_profile(const ConfigNode& config, const ClusterProfile& profile) {
  const auto check = [&](const char* key, const std::string& text) {
    if (has_control_character(text)) place(config, key).fail("must be one line without control characters");
  };
  check("partition", profile.partition);
  check("account", profile.account);
  check("qos", profile.qos);
  check("constraint", profile.constraint);
  check("launcher", profile.launcher);
  check("container", profile.container);
  check("program", profile.program);
  const auto check_list = [&](const char* key, const std::vector<std::string>& texts) {
    for (std::size_t i = 0; i < texts.size(); ++i)
      check((std::string(key) + "." + std::to_string(i)).c_str(), texts[i]);
  };
  check_list("sbatch", profile.sbatch);
  check_list("modules", profile.modules);
  check_list("setup", profile.setup);
  check_list("environment", profile.environment);
  for (std::size_t i = 0; i < profile.sbatch.size(); ++i)
    if (!profile.sbatch[i].starts_with("-"))
      must_be(place(config, "sbatch." + std::to_string(i)), "an option of sbatch, such as --exclusive");
  for (std::size_t i = 0; i < profile.environment.size(); ++i) {
    const std::string& line = profile.environment[i];
    const std::string name = line.substr(0, line.find('='));
    const bool is_name =
        !name.empty() && name.size() < line.size() && std::isdigit(static_cast<unsigned char>(name.front())) == 0 &&
        std::all_of(name.begin(), name.end(), [](unsigned char c) { return std::isalnum(c) != 0 || c == '_'; });
    if (!is_name) must_be(place(config, "environment." + std::to_string(i)), "NAME=VALUE");
  }
  if (profile.time_limit_min > 0 && profile.grace_s >= 60 * profile.time_limit_min)
    place(config, "grace_s").fail("= " + std::to_string(profile.grace_s) + ", must be less than time_limit_min");
}

}  // namespace

ClusterChoice read_cluster_choice(const std::string& on, const std::vector<fs::path>& folders) {
  const auto colon = on.find(':');
  if (on.substr(0, colon) != "slurm") throw ConfigError("--on = " + on + ", must be slurm or slurm:PROFILE");
  ClusterChoice choice;
  choice.profile_name = colon == std::string::npos ? "" : on.substr(colon + 1);
  if (colon != std::string::npos && choice.profile_name.empty())
    throw ConfigError("--on = " + on + ", must have a profile's name after the colon");
  const std::string& name = choice.profile_name;
  if (name.find('/') != std::string::npos || name.ends_with(".yaml")) {
    choice.profile_file = name;
  } else {
    for (const auto& folder : folders) {
      const fs::path file = folder / ((name.empty() ? kDefaultProfile : name) + std::string(".yaml"));
      if (!fs::is_regular_file(file)) continue;
      choice.profile_file = file;
      break;
    }
    if (choice.profile_file.empty() && !name.empty()) {
      const auto known = profile_names(folders);
      std::vector<std::string> searched;
      for (const auto& folder : folders) searched.push_back(folder.string());
      throw ConfigError("--on = " + on + ": no profile is called " + name + "; " +
                        (known.empty() ? "there is none" : "there are: " + listed(known)) +
                        " (searched: " + listed(searched) + ")" + nearest_hint(name, known));
    }
  }
  if (choice.profile_file.empty()) return choice;
  const ConfigNode config = ConfigNode::load(choice.profile_file);
  read_params(config, choice.profile);
  check_profile(config, choice.profile);
  return choice;
}

}  // namespace weft
