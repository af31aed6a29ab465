#pragma once
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "weft/host.hpp"
#include "weft/params.hpp"

namespace weft {

/// One library on the search path: its kind, name and version, or why it was refused.
struct PluginEntry {
  std::filesystem::path file;
  std::string kind, name, version;
  std::string refusal;                         ///< empty: it loads
  std::vector<std::filesystem::path> shadows;  ///< from list(): libraries of this kind and name that are never taken
};

/// Finds plugins in the `plugin_path` of the config, then in WEFT_PLUGIN_PATH, then in the build or install folder. The
/// first library of a kind and name wins: in a folder libweft_KIND_NAME.so, then those of other names. A library stays loaded while one of its objects or this registry lives.
/// Thread-safe.
class PluginRegistry {
 public:
  explicit PluginRegistry(std::vector<std::filesystem::path> search_path = {});
  ~PluginRegistry();
  static std::vector<std::filesystem::path> default_search_path();
  /// The folders that are searched, in this order.
  const std::vector<std::filesystem::path>& search_path() const;

  /// Everything on the search path, sorted by kind and name; refused libraries last. Each entry is what find() takes.
  std::vector<PluginEntry> list() const;
  /// The entry of a name ("arc" or "trajectory/arc") or of a library file.
  /// @throws PluginError with the nearest name, the folders searched and what was refused in them, or with both sides of
  /// a refusal and the remedy.
  PluginEntry find(const std::string& name_or_file, const std::string& kind = "") const;
  /// The entry of a slot: {plugin: NAME, params: {...}}, or a bare NAME. @throws PluginError, ConfigError.
  PluginEntry entry(const std::string& kind, const ConfigNode& slot) const;
  std::vector<ParamInfo> params(const PluginEntry& entry) const;
  /// Visits the plugin's parameters, with their defaults.
  void visit_params(const PluginEntry& entry, ParamVisitor& visitor) const;

  /// Checks {plugin: NAME, params: {...}} (or a bare NAME) and fills in every default, also in nested slots. Creates no
  /// plugin. @throws ConfigError, PluginError.
  ConfigNode resolve(const std::string& kind, const ConfigNode& slot) const;
  /// A copy of the config in which every slot that `params` declares is resolved. A null slot stays null. A slot that
  /// names its default stays as it is if this build lacks that plugin: a command that never creates it can do without.
  ConfigNode resolve_slots(const ConfigNode& config, const std::vector<ParamInfo>& params) const;
  /// The nodes of a config that name files, in declared order: first its own, then those of the plugins in its slots.
  std::vector<ConfigNode> files(const ConfigNode& config, const std::vector<ParamInfo>& params) const;
  /// The same for a slot: {plugin: NAME, params: {...}}, or a bare NAME.
  std::vector<ConfigNode> files(const std::string& kind, const ConfigNode& slot) const;
  /// The object, whose deleter keeps the library loaded, and where it came from.
  std::pair<std::shared_ptr<void>, PluginEntry> create(const std::string& kind, const ConfigNode& slot,
                                                       Host& host) const;
  /// Every plugin that was created, sorted by kind and name.
  std::vector<PluginEntry> used() const;
  /// Every plugin that a slot named, also one that was never created: a saved config must find these again.
  std::vector<PluginEntry> named() const;

 private:
  struct Impl;
  /// The plugin's name as saved configs write it, and its entry. @throws as resolve().
  std::pair<std::string, PluginEntry> look_up(const std::string& kind, const ConfigNode& slot) const;
  /// Whether a slot names its default plugin and that one is not on the search path, or was refused.
  bool lacks_default(const ParamInfo& info, const ConfigNode& slot) const;
  std::unique_ptr<Impl> impl_;
};

}  // namespace weft
