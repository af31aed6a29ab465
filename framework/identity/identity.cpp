#include "identity/identity.hpp"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "identity/sha256.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kSchema = "weft identity 1";
constexpr std::size_t kMostChanges = 20;  // in a message

/// "fabrics/basic.yaml": enough to find the file, and the same on every machine.
std::string short_name(const fs::path& file) {
  const fs::path whole = fs::absolute(file).lexically_normal();
  return (whole.parent_path().filename() / whole.filename()).generic_string();
}

bool is_yaml(const fs::path& file) { return file.extension() == ".yaml" || file.extension() == ".yml"; }

/// SHA-256 of what a garment is: its numbers, not the spelling of its file.
std::string mesh_hash(const Garment& garment) {
  Sha256 hash;
  const auto add = [&](const auto& matrix) {
    const std::int64_t size = matrix.size();
    hash.add(&size, sizeof size);
    hash.add(matrix.data(), sizeof(*matrix.data()) * static_cast<std::size_t>(size));
  };
  add(garment.positions);
  add(garment.rest);
  add(garment.faces);
  if (!garment.form.empty()) {
    add(garment.form.frames);
    add(Eigen::Map<const Vector>(garment.form.layers.data(), static_cast<Index>(garment.form.layers.size())));
    add(garment.form.seams);
  }
  return hash.hex();
}

/// The keys of `one` that `other` lacks or has another value for. Nothing: both are equal.
std::optional<ordered_json> differences(const ordered_json& one, const ordered_json& other) {
  if (one == other) return std::nullopt;
  if (!one.is_object() || !other.is_object()) return one;
  ordered_json all = ordered_json::object();
  for (const auto& [name, value] : one.items()) {
    const auto found = other.find(name);
    const auto own = found == other.end() ? std::optional(value) : differences(value, *found);
    if (own) all[name] = *own;
  }
  return all;
}

/// Numbers however they are spelled: 5 is 5.0.
void spell_alike(ordered_json& json) {
  if (json.is_number_integer()) json = json.get<double>();
  if (json.is_structured())
    for (auto& value : json) spell_alike(value);
}

class Collector {
 public:
  explicit Collector(const IdentityInput& input) : input_(input) {}

  ordered_json document() {
    const ConfigNode resolved = input_.registry.resolve_slots(input_.resolved, input_.params);
    ordered_json config = keys(resolved, input_.given, input_.params, input_.keep, "");
    if (!input_.folds.empty()) config["manipulations"] = folds(config);
    for (const auto& [name, text] : input_.besides) config[name] = text;
    for (std::size_t i = 0; i < input_.data.size(); ++i) {
      const std::string key = "data " + std::to_string(i + 1);
      config[key] = file(ConfigNode::quoted(input_.data[i].string()), key);
    }
    return {{"schema", kSchema}, {"weft", WEFT_VERSION}, {"config", config}, {"plugins", plugins_}};
  }
  const std::map<std::string, std::string>& files() const { return files_; }

 private:
  /// @param config of the whole session.
  ordered_json folds(const ordered_json& config) {
    ordered_json all = ordered_json::object();
    for (std::size_t k = 0; k < input_.folds.size(); ++k) {
      const auto& [given, resolved] = input_.folds[k];
      const std::string number = std::to_string(k);
      ordered_json own = keys(input_.registry.resolve_slots(resolved, input_.params), given, input_.params, input_.keep,
                              "manipulations." + number + ".");
      own.erase("manipulations");
      all[number] = differences(own, config).value_or(ordered_json::object());
    }
    return all;
  }

  /// @param written the mapping as it was written, which may lack keys. @param path of the mapping, with a dot.
  ordered_json keys(const ConfigNode& resolved, const ConfigNode& written, const std::vector<ParamInfo>& params,
                    const std::function<bool(const ParamInfo&)>& keep, const std::string& path) {
    ordered_json all = ordered_json::object();
    for (const auto& info : params) {
      if (info.decides == Decides::nothing || !keep(info)) continue;
      const std::string key = path + info.name;
      const ConfigNode node = place(resolved, info.name);
      switch (info.kind) {
        case ParamKind::slot:
          all[info.name] = slot(info.slot, node, place(written, info.name), key);
          break;
        case ParamKind::file:
          all[info.name] = file(node, key);
          break;
        case ParamKind::file_or_mapping:
          name_files(place(written, info.name), key, 0);
          all[info.name] = contents(info.name, node);
          break;
        default:
          all[info.name] = ordered_json::parse(node.to_json());
      }
    }
    return all;
  }

  ordered_json slot(const std::string& kind, const ConfigNode& node, const ConfigNode& written,
                    const std::string& key) {
    if (node.is_null()) return nullptr;
    const PluginEntry entry = input_.registry.find(node.at("plugin").as_string(), kind);
    plugins_[kind + "/" + entry.name] = {{"version", entry.version}, {"sha256", sha256_of_file(entry.file)}};
    const auto all = [](const ParamInfo&) { return true; };
    return {{"plugin", entry.name},
            {"params", keys(node.at("params"), written.is_scalar() ? ConfigNode() : place(written, "params"),
                            input_.registry.params(entry), all, key + ".params.")}};
  }

  ordered_json file(const ConfigNode& node, const std::string& key) {
    const std::string name = node.as_string();
    if (name.empty()) return "";
    std::error_code ignored;
    const std::string hash = fs::is_directory(name, ignored) ? sha256_of_dataset(name) : sha256_of_file(name);
    files_[key] = short_name(name);
    return "sha256 " + hash;
  }

  /// The task's garment and material, as they were read; of others the whole mapping.
  ordered_json contents(const std::string& name, const ConfigNode& node) const {
    const Garment* garment = input_.task.garment.get();
    if (name == "material") return ordered_json::parse(write_material_space(input_.task.material).to_json());
    if (name == "garment" && garment != nullptr) {
      return {{"name", garment->name}, {"vertices", garment->vertices}, {"mesh", "sha256 " + mesh_hash(*garment)}};
    }
    const ConfigNode all = whole(node, 0);
    if (all.is_scalar() && !all.as_string().empty()) return file_hash(all);
    auto json = ordered_json::parse(all.to_json());
    spell_alike(json);
    return json;
  }

  static std::string file_hash(const ConfigNode& file) { return "sha256 " + sha256_of_file(file.as_path()); }

  /// A mapping with the keys of the YAML files that it lies in or begins with. Of a file that is no YAML the hash stands for its keys;
  /// where it is all there is, it stays a name.
  static ConfigNode whole(const ConfigNode& node, int depth) {
    constexpr int kMostFiles = 8;
    if (depth > kMostFiles) node.fail("leads through more than " + std::to_string(kMostFiles) + " files");
    if (node.is_scalar() && is_yaml(node.as_path())) return whole(ConfigNode::load(node.as_path()), depth + 1);
    if (!node.is_mapping() || !node.has("file")) return node;
    const ConfigNode base = whole(node.at("file"), depth + 1);
    return base.is_mapping() ? base.merged(node.without("file"))
                             : node.with("file", ConfigNode::quoted(file_hash(base)));
  }

  /// Notes the files behind a key: the one that it names, and those that are named in it.
  void name_files(const ConfigNode& node, const std::string& key, int depth) {
    std::error_code ignored;
    if (depth > 8) return;
    if (node.is_mapping()) {
      // {file: basic.yaml, friction: 0.2} has the keys of basic.yaml, but for friction.
      const bool has_base = node.has("file");
      if (has_base) name_files(node.at("file"), key, depth + 1);
      for (const auto& name : node.keys()) {
        if (name == "file") continue;
        if (has_base) files_[key + "." + name] = "";
        name_files(node.at(name), key + "." + name, depth + 1);
      }
    } else if (node.is_scalar() && !node.as_string().empty() && fs::is_regular_file(node.as_path(), ignored)) {
      files_[key] = short_name(node.as_path());
      if (is_yaml(node.as_path())) name_files(ConfigNode::load(node.as_path()), key, depth + 1);
    }
  }

  const IdentityInput& input_;
  ordered_json plugins_ = ordered_json::object();
  std::map<std::string, std::string> files_;
};

/// What is compared. Keys are sorted, so that their order in a config does not count.
std::string hash_of(const ordered_json& document) {
  nlohmann::json compared;
  for (const char* key : {"weft", "config", "plugins"}) compared[key] = nlohmann::json::parse(document.at(key).dump());
  return sha256(compared.dump()).substr(0, 32);
}

/// @throws ConfigError unless the document holds what is compared and shown.
void check_document(const ordered_json& document) {
  const auto is_plugin = [](const ordered_json& plugin) {
    return plugin.is_object() && plugin.contains("version") && plugin["version"].is_string() &&
           plugin.contains("sha256") && plugin["sha256"].is_string();
  };
  const auto &config = document.at("config"), &plugins = document.at("plugins");
  if (!document.at("weft").is_string() || !config.is_object() || !plugins.is_object() ||
      (config.contains("command") && !config["command"].is_string()) ||
      !std::all_of(plugins.begin(), plugins.end(), is_plugin)) {
    throw ConfigError("is not an identity: must have weft, config and plugins: {KIND/NAME: {version, sha256}}");
  }
}

/// The leaves of a JSON value by dotted key. A list is a leaf.
void flatten(const ordered_json& json, const std::string& key, std::map<std::string, std::string>& leaves) {
  if (json.is_object() && !json.empty()) {
    for (const auto& [name, value] : json.items()) flatten(value, key.empty() ? name : key + "." + name, leaves);
  } else {
    leaves[key] = json.is_string() ? json.get<std::string>() : json.dump();
  }
}

std::string shortened(const std::string& text) { return text.size() <= 60 ? text : text.substr(0, 57) + "..."; }

/// The name of the file that a key's value is from, and the rest of the key. The innermost file counts.
std::pair<std::string, std::string> file_behind(const std::string& key,
                                                const std::map<std::string, std::string>& files) {
  std::string best;
  for (const auto& [place, name] : files) {
    const bool is_behind = key == place || key.starts_with(place + ".");
    if (is_behind && place.size() >= best.size()) best = place;
  }
  if (best.empty() || files.at(best).empty()) return {"", key};
  return {files.at(best), key.size() > best.size() ? key.substr(best.size() + 1) : ""};
}

std::string config_change(const std::string& key, const std::string* was, const std::string* is,
                          const std::map<std::string, std::string>& files) {
  const auto [file, rest] = file_behind(key, files);
  const auto is_hash = [](const std::string* value) { return value != nullptr && value->starts_with("sha256 "); };
  if (is_hash(was) && is_hash(is)) return (file.empty() ? key : file) + ": other contents (" + key + ")";
  const std::string values =
      (was != nullptr ? shortened(*was) : "absent") + " -> " + (is != nullptr ? shortened(*is) : "absent");
  if (file.empty() || rest.empty()) return key + " " + values;
  return file + ": " + rest + " " + values;
}

}  // namespace

Identity make_identity(const IdentityInput& input) {
  Identity identity;
  Collector collector(input);
  const ordered_json document = collector.document();
  identity.json_ = document.dump(2) + "\n";
  identity.hash_ = hash_of(document);
  identity.files_ = collector.files();
  return identity;
}

Identity Identity::from_json(const std::string& json) {
  Identity identity;
  try {
    const ordered_json document = parse_json(json);
    if (document.at("schema") != kSchema)
      throw ConfigError("has the schema '" + document.at("schema").get<std::string>() + "', this program reads '" +
                        kSchema + "'");
    check_document(document);
    identity.hash_ = hash_of(document);
    identity.json_ = document.dump(2) + "\n";
  } catch (const ordered_json::exception& error) {
    throw ConfigError(std::string("is not an identity: ") + error.what());
  }
  return identity;
}

namespace {

/// The value at a path of nested mappings; null if there is none.
ordered_json value_at(const ordered_json& config, const std::vector<std::string>& path) {
  ordered_json value = config;
  for (const auto& key : path) {
    if (!value.is_object() || !value.contains(key)) return nullptr;
    value = ordered_json(value[key]);
  }
  return value;
}

/// Sets the variants in the slots of `config`, which lies at `path` of the recorded configs.
ConfigNode set_variants(const ConfigNode& config, const std::vector<ParamInfo>& params, const PluginRegistry& registry,
                        const std::vector<ordered_json>& recorded, const std::vector<std::string>& path,
                        const std::string& where) {
  ConfigNode result = config;
  for (const auto& info : params) {
    std::vector<std::string> here = path;
    here.push_back(info.name);
    const ConfigNode given = place(config, info.name);
    if (info.is_variant && (given.is_null() || given.as_string() == "auto")) {
      for (const auto& one : recorded) {
        const ordered_json value = value_at(one, here);
        if (!value.is_string()) continue;
        result = result.with(
            info.name,
            place(ConfigNode::parse("{" + info.name + ": \"" + value.get<std::string>() + "\"}", where), info.name));
        break;
      }
    }
    if (info.kind != ParamKind::slot || given.is_null()) continue;
    const ConfigNode name = given.is_scalar() ? given : given.at("plugin");
    const PluginEntry entry = registry.entry(info.slot, given);
    std::vector<ordered_json> same;  // those that have this plugin here
    for (const auto& one : recorded) {
      std::vector<std::string> plugin = here;
      plugin.push_back("plugin");
      if (value_at(one, plugin) == entry.name) same.push_back(one);
    }
    here.push_back("params");
    const ConfigNode own = given.is_scalar() ? ConfigNode() : place(given, "params");
    const ConfigNode changed = set_variants(own, registry.params(entry), registry, same, here, where);
    if (changed.to_yaml() == own.to_yaml()) continue;
    const ConfigNode slot = given.is_scalar() ? ConfigNode::mapping({{"plugin", name}}) : given;
    result = result.with(info.name, slot.with("params", changed));
  }
  return result;
}

}  // namespace

ConfigNode with_recorded_variants(const ConfigNode& config, const std::vector<ParamInfo>& params,
                                  const PluginRegistry& registry, const std::vector<Identity>& recorded,
                                  const std::string& where) {
  std::vector<ordered_json> configs;
  for (const auto& identity : recorded)
    if (identity.is_known()) configs.push_back(ordered_json::parse(identity.to_json()).at("config"));
  return configs.empty() ? config : set_variants(config, params, registry, configs, {}, where);
}

Identity identity_of_command(const std::string& command) {
  return Identity::from_json(ordered_json{
      {"schema", kSchema}, {"weft", ""}, {"config", {{"command", command}}}, {"plugins", ordered_json::object()}}
                                 .dump());
}

std::vector<std::string> Identity::changes_since(const Identity& earlier) const {
  if (hash_ == earlier.hash_) return {};
  if (!earlier.is_known())
    return {"it was made by an earlier version of weft, which did not record what its results belong to"};
  if (!is_known()) return {"what this belongs to is not known"};
  const ordered_json was = ordered_json::parse(earlier.json_), is = ordered_json::parse(json_);
  std::vector<std::string> changes;
  std::map<std::string, std::string> old_keys, new_keys;
  flatten(was.at("config"), "", old_keys);
  flatten(is.at("config"), "", new_keys);
  if (was.at("config").value("command", "") != is.at("config").value("command", "")) {
    return {"they are of the command " + was.at("config").value("command", "unknown") + ", this one is " +
            is.at("config").value("command", "unknown")};
  }
  const auto find = [](const auto& keys, const std::string& key) {
    const auto found = keys.find(key);
    return found == keys.end() ? nullptr : &found->second;
  };
  std::map<std::string, std::string> all = old_keys;
  all.insert(new_keys.begin(), new_keys.end());
  for (const auto& [key, ignored] : all) {
    const std::string *before = find(old_keys, key), *now = find(new_keys, key);
    if (before != nullptr && now != nullptr && *before == *now) continue;
    changes.push_back(config_change(key, before, now, files_));
  }
  for (const auto& [name, plugin] : is.at("plugins").items()) {
    if (!was.at("plugins").contains(name)) continue;  // the config names another plugin; that was said above
    const auto& old = was.at("plugins").at(name);
    if (old.at("version") != plugin.at("version")) {
      changes.push_back("plugin " + name + ": version " + old.at("version").get<std::string>() + " -> " +
                        plugin.at("version").get<std::string>());
    } else if (old.at("sha256") != plugin.at("sha256")) {
      changes.push_back("plugin " + name + ": its library was built again with other code (version " +
                        plugin.at("version").get<std::string>() + ", sha256 " +
                        old.at("sha256").get<std::string>().substr(0, 8) + " -> " +
                        plugin.at("sha256").get<std::string>().substr(0, 8) + ")");
    }
  }
  if (was.at("weft") != is.at("weft")) {
    changes.push_back("weft " + was.at("weft").get<std::string>() + " -> " + is.at("weft").get<std::string>());
  }
  return changes;
}

Identity identity_in(const std::string& provenance, const std::string& where) {
  const ordered_json json = parse_json_if_valid(provenance);
  if (!json.is_object()) throw ConfigError(where + ": is not a provenance: no JSON object");
  const auto found = json.find("identity");
  if (found == json.end()) return {};
  try {
    return Identity::from_json(found->dump());
  } catch (const ConfigError& error) {
    throw ConfigError(where + ": identity " + error.what());
  }
}

Identity read_identity(const fs::path& file) {
  const auto text = whole_text_if_there(file);
  return text ? identity_in(*text, file.string()) : Identity();
}

std::string changed_message(const std::string& holder, const std::vector<std::string>& changes) {
  std::string text = holder + ": holds results that belong to something else:";
  for (std::size_t i = 0; i < std::min(changes.size(), kMostChanges); ++i) text += "\n  " + changes[i];
  if (changes.size() > kMostChanges) text += "\n  and " + std::to_string(changes.size() - kMostChanges) + " more";
  return text + "\nNothing was changed. Give another --out, or --accept-changed to go on all the same";
}

void require_identity(const std::string& holder, const Identity& earlier, const Identity& now, bool accept_changed) {
  if (accept_changed) return;
  const auto changes = now.changes_since(earlier);
  if (!changes.empty()) throw ConfigError(changed_message(holder, changes));
}

}  // namespace weft
