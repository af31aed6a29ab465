#pragma once
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "loader/registry.hpp"
#include "weft/config.hpp"
#include "weft/params.hpp"
#include "weft/task.hpp"

/// What a result belongs to. Two results may stand in one table, and a folder may be continued, if their identities are
/// equal (docs/trust.md).
namespace weft {

/// The resolved config, the contents of every file that it names, the plugin libraries, their numeric variants (which
/// are keys of the config) and the version of weft. Names and places of files are not part of it.
class Identity {
 public:
  Identity() = default;  ///< unknown: of a result from before identities were recorded
  /// @param json from to_json(). @throws ConfigError if it is not.
  static Identity from_json(const std::string& json);

  bool is_known() const { return !json_.empty(); }
  /// 32 hexadecimal digits; equal for equal identities. Empty if unknown.
  const std::string& hash() const { return hash_; }
  std::string to_json() const { return json_; }
  /// What is different here, one line each: "fabrics/basic.yaml: nominal.density_kg_per_m2 0.15 -> 0.6", with the names of
  /// this one's files. Empty if both are equal.
  std::vector<std::string> changes_since(const Identity& earlier) const;

 private:
  friend struct IdentityInput;
  friend Identity make_identity(const struct IdentityInput& input);
  std::string json_, hash_;
  std::map<std::string, std::string> files_;  // names of files by the key that their contents are under; not saved
};

/// A config, and how it was resolved.
struct IdentityInput {
  const ConfigNode& given;     ///< as it was written; its nodes name the files
  const ConfigNode& resolved;  ///< from read_params()
  const std::vector<ParamInfo>& params;
  const Task& task;
  const PluginRegistry& registry;
  /// Which keys belong to the identity, among those that decide a result.
  std::function<bool(const ParamInfo&)> keep = [](const ParamInfo&) { return true; };
  /// What belongs to it besides: names and texts, such as {"cases", "test split of ..."}.
  std::vector<std::pair<std::string, std::string>> besides = {};
  /// Folders of examples that are read, and files that the config does not name.
  std::vector<std::filesystem::path> data = {};
  /// The folds that follow one another, which `resolved` has as a bare list in `manipulations`. Of each one what differs from
  /// `resolved` belongs to the identity, under "manipulations.K."; without folds the list itself does.
  struct Fold {
    ConfigNode given, resolved;
  };
  std::vector<Fold> folds = {};
};
/// @throws ConfigError, PluginError for a file or plugin that is missing.
Identity make_identity(const IdentityInput& input);

/// What all results of a sweep's folder share; each cell has an identity of its own.
Identity identity_of_command(const std::string& command);

/// A config in which every plugin that was to choose its numeric variant itself gets the one that it had in an earlier
/// result of the folder. So a folder is continued with one variant on every machine.
/// @param recorded of the folder; the first one that has the plugin in the same place counts.
/// @param where for messages: a machine that cannot run the variant refuses the config there.
ConfigNode with_recorded_variants(const ConfigNode& config, const std::vector<ParamInfo>& params,
                                  const PluginRegistry& registry, const std::vector<Identity>& recorded,
                                  const std::string& where);

/// The identity in a provenance.json; unknown if the file is absent or holds none. @throws ConfigError if it is damaged.
Identity read_identity(const std::filesystem::path& provenance_file);
/// The identity in the text of a provenance.json. @param where for messages.
Identity identity_in(const std::string& provenance, const std::string& where);

/// The message that refuses to mix results: what holds the others, what changed, and the remedies.
std::string changed_message(const std::string& holder, const std::vector<std::string>& changes);
/// @param holder of the earlier results, for the message.
/// @throws ConfigError with changed_message() unless both are equal or the change is accepted.
void require_identity(const std::string& holder, const Identity& earlier, const Identity& now, bool accept_changed);

}  // namespace weft
