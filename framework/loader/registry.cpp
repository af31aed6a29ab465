#include "loader/registry.hpp"

#include <dlfcn.h>
#include <link.h>

#include <algorithm>
#include <boost/dll/shared_library.hpp>
#include <cfenv>
#include <clocale>
#include <cstdlib>
#include <map>
#include <mutex>
#include <new>
#include <set>
#include <sstream>

#include "loader/instructions.hpp"
#include "loader/plugin_info.hpp"
#include "loader/where.hpp"
#include "processes/crash_report.hpp"
#include "sdk/files.hpp"
#include "weft/config.hpp"
#include "weft/plugin.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
namespace dll = boost::dll;

using CreateFunction = void*(Host*, const ConfigNode*);
using DestroyFunction = void(void*);
using VisitFunction = void(ParamVisitor*);

/// "./x", "/x" and "x.so" are files; all others are names.
bool is_file_name(const std::string& name) {
  return name.ends_with(".so") || name.starts_with("/") || name.starts_with("./") || name.starts_with("../");
}

/// Size of an exported object in its library's symbol table; 0 if unknown.
std::size_t exported_size(const void* address) {
  Dl_info info;
  void* symbol = nullptr;
  if (dladdr1(address, &info, &symbol, RTLD_DL_SYMENT) == 0 || symbol == nullptr) return 0;
  return static_cast<const ElfW(Sym)*>(symbol)->st_size;
}

// clang's address sanitizer puts the guard behind a global into its size.
#if defined(__clang__) && defined(__has_feature)
constexpr bool kPadsGlobals = __has_feature(address_sanitizer);
#else
constexpr bool kPadsGlobals = false;
#endif

/// A library that passed all checks that need no C++ call.
struct Library {
  PluginEntry entry;
  dll::shared_library handle;
};

/// @return what the dynamic linker says if that fails.
std::string load(dll::shared_library& library, const fs::path& file) {
  // Boost adds the text of errno, which dlopen() does not set.
  const std::string path = fs::absolute(file).string();
  void* opened = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (opened == nullptr) {
    const char* reason = dlerror();
    const std::string text = reason == nullptr ? "the dynamic linker gives no reason" : reason;
    return text.starts_with(path + ": ") ? text.substr(path.size() + 2) : text;
  }
  library.load(boost::filesystem::path(path), dll::load_mode::rtld_now | dll::load_mode::rtld_local);
  dlclose(opened);  // `library` holds it now
  return "";
}

/// @throws PluginError with the reason, both sides and the remedy.
std::shared_ptr<const Library> open_library(const fs::path& file) {
  const auto refuse = [&](const std::string& reason) -> void {
    throw PluginError(file.string() + ": refused: " + reason);
  };
  std::error_code ignored;
  if (!fs::exists(file, ignored)) refuse("no such file");
  if (const std::string reason = no_library(file); !reason.empty()) refuse(reason);
  if (const std::string missing = missing_instructions(file); !missing.empty()) {
    refuse("was compiled for instructions that this processor has not (" + missing +
           "); use another machine, or build it without MARCH or -march");
  }
  auto library = std::make_shared<Library>();
  library->entry.file = file;
  std::string detail;
  std::fenv_t numbers;
  std::fegetenv(&numbers);
  try {
    const std::string name = "library " + file.string();
    const PluginCall entry(name.c_str(), "loading");
    detail = load(library->handle, file);
    // A library that it needs may have set the user's locale; weft writes numbers with a point.
    std::setlocale(LC_NUMERIC, "C");
  } catch (const std::exception& failure) {
    detail = failure.what();
  }
  // A library linked with -ffast-math, or another that it needs, makes small numbers zero in the thread that loads it.
  std::fesetenv(&numbers);
  if (!library->handle.is_loaded()) {
    if (const std::string why = other_abi_in(file); !why.empty()) refuse(why);
    refuse("cannot be loaded as a shared library: " + detail);
  }
  for (const char* symbol :
       {"weft_plugin_info", "weft_plugin_create", "weft_plugin_destroy", "weft_plugin_visit_params"}) {
    if (!library->handle.has(symbol)) {
      refuse(std::string("does not export ") + symbol +
             "; export one plugin with WEFT_PLUGIN(...) from weft/plugin.hpp");
    }
  }
  const auto& info = library->handle.get<const WeftPluginInfo>("weft_plugin_info");
  const std::size_t size = exported_size(&info);
  if (size != 0 && (kPadsGlobals ? size < sizeof(WeftPluginInfo) : size != sizeof(WeftPluginInfo))) {
    refuse("weft_plugin_info has " + std::to_string(size) + " bytes, this weft's has " +
           std::to_string(sizeof(WeftPluginInfo)) + "; rebuild it with this weft's headers");
  }
  library->entry = checked_plugin_info(info, file);
  announce_plugin(library->entry.kind + " " + library->entry.name, &info);
  return library;
}

struct Candidate {
  fs::path file;
  std::string kind, name;  ///< by the file's name; empty: only the library itself knows
};

/// The libraries of a folder in the order in which they are searched: those of weft_add_plugin() first, whose names say
/// what they are, so that looking for one need not load the others.
std::vector<Candidate> candidates_in(const fs::path& folder) {
  std::vector<Candidate> candidates;
  std::error_code error;
  for (const auto& item : fs::directory_iterator(folder, error)) {
    if (item.path().extension() != ".so") continue;
    auto [kind, name] = named_by(item.path());
    candidates.push_back({item.path(), std::move(kind), std::move(name)});
  }
  std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return std::pair(a.kind.empty(), a.file) < std::pair(b.kind.empty(), b.file);
  });
  return candidates;
}

}  // namespace

struct PluginRegistry::Impl {
  std::vector<fs::path> search_path;
  mutable std::mutex mutex;
  mutable std::map<fs::path, std::shared_ptr<const Library>> open;  // by canonical file
  mutable std::map<fs::path, std::string> refused;
  mutable std::map<std::string, PluginEntry> used;
  mutable std::map<std::string, PluginEntry> named;

  std::vector<PluginEntry> copy_of(const std::map<std::string, PluginEntry>& those) const {
    const std::lock_guard lock(mutex);
    std::vector<PluginEntry> entries;
    for (const auto& [key, entry] : those) entries.push_back(entry);
    return entries;
  }

  std::shared_ptr<const Library> library(const fs::path& file) const {
    std::error_code ignored;
    const fs::path key = fs::weakly_canonical(file, ignored);
    const std::lock_guard lock(mutex);
    if (const auto found = open.find(key); found != open.end()) return found->second;
    if (const auto found = refused.find(key); found != refused.end()) throw PluginError(found->second);
    try {
      return open[key] = open_library(file);
    } catch (const PluginError& error) {
      open.erase(key);
      refused[key] = error.what();
      throw;
    }
  }

  /// Every library on the search path that may be of this kind and name (empty: any), in the order of the search. The
  /// first one that is wins. This one order decides what run, describe and plugins take. Refused ones are passed on too.
  template <class Each>
  void search(const std::string& kind, const std::string& name, Each&& each) const {
    std::set<fs::path> seen;  // a folder may be given twice, and a library may be linked to
    for (const auto& folder : search_path) {
      for (const auto& candidate : candidates_in(folder)) {
        if (!candidate.kind.empty() && !name.empty() && candidate.name != name) continue;
        if (!candidate.kind.empty() && !kind.empty() && candidate.kind != kind) continue;
        std::error_code ignored;
        if (!seen.insert(fs::weakly_canonical(candidate.file, ignored)).second) continue;
        std::shared_ptr<const Library> found;
        std::string refusal;
        try {
          found = library(candidate.file);
        } catch (const PluginError& error) {
          refusal = error.what();
        }
        const bool fits =
            !found || ((name.empty() || found->entry.name == name) && (kind.empty() || found->entry.kind == kind));
        if (fits && !each(found, candidate.file, refusal)) return;
      }
    }
  }

  /// Why nothing of this kind (empty: any) and name was found.
  std::string not_found(const std::string& kind, const std::string& name) const {
    std::vector<std::string> known, refusals;
    search(kind, "", [&](const auto& found, const fs::path&, const std::string& refusal) {
      if (found)
        known.push_back(found->entry.name);
      else
        refusals.push_back(refusal);
      return true;
    });
    std::string searched, reasons;
    for (const auto& folder : search_path) {
      std::error_code ignored;
      searched += (searched.empty() ? "" : ", ") + folder.string() +
                  (fs::is_directory(folder, ignored) ? "" : " which is no folder");
    }
    constexpr std::size_t most = 3;  // the others are in `weft plugins`
    for (std::size_t i = 0; i < std::min(most, refusals.size()); ++i) reasons += "; " + refusals[i];
    if (refusals.size() > most)
      reasons += "; " + std::to_string(refusals.size() - most) + " more were refused, `weft plugins` says why";
    return "no " + (kind.empty() ? "plugin" : kind + " plugin") + " is called '" + name + "'" +
           nearest_hint(name, known) + " (searched " + searched + ")" + reasons;
  }

  std::shared_ptr<const Library> find(const std::string& kind, const std::string& name) const {
    std::shared_ptr<const Library> winner;
    std::string refusal;
    search(kind, name, [&](const auto& found, const fs::path& file, const std::string& why) {
      winner = found;
      if (!found && refusal.empty() && named_by(file).second == name) refusal = why;
      return !found;
    });
    if (!winner && !refusal.empty()) throw PluginError(refusal);
    if (!winner) throw PluginError(not_found(kind, name));
    return winner;
  }
};

PluginRegistry::PluginRegistry(std::vector<fs::path> search_path) : impl_(std::make_unique<Impl>()) {
  impl_->search_path = std::move(search_path);
  for (auto& folder : default_search_path()) impl_->search_path.push_back(std::move(folder));
}
PluginRegistry::~PluginRegistry() = default;

std::vector<fs::path> PluginRegistry::default_search_path() {
  std::vector<fs::path> folders;
  if (const char* variable = std::getenv("WEFT_PLUGIN_PATH")) {
    std::istringstream stream(variable);
    for (std::string folder; std::getline(stream, folder, ':');) {
      if (!folder.empty()) folders.emplace_back(folder);
    }
  }
  folders.push_back(library_folder() / "weft" / "plugins");
  return folders;
}

const std::vector<fs::path>& PluginRegistry::search_path() const { return impl_->search_path; }

std::vector<PluginEntry> PluginRegistry::list() const {
  std::map<std::pair<std::string, std::string>, PluginEntry> good;
  std::vector<PluginEntry> entries, bad;
  impl_->search("", "", [&](const auto& found, const fs::path& file, const std::string& refusal) {
    if (!found) {
      bad.emplace_back();
      bad.back().file = file;
      bad.back().refusal = refusal;
      return true;
    }
    const auto [winner, is_new] = good.try_emplace({found->entry.kind, found->entry.name}, found->entry);
    if (!is_new) winner->second.shadows.push_back(file);
    return true;
  });
  for (auto& [key, entry] : good) entries.push_back(std::move(entry));
  entries.insert(entries.end(), bad.begin(), bad.end());
  return entries;
}

PluginEntry PluginRegistry::find(const std::string& name_or_file, const std::string& kind) const {
  const auto require_kind = [](const std::string& wanted) {
    const auto& kinds = plugin_kinds();
    if (!wanted.empty() && std::find(kinds.begin(), kinds.end(), wanted) == kinds.end())
      throw PluginError("'" + wanted + "' is not a kind of plugin, must be " + one_of(kinds) +
                        nearest_hint(wanted, kinds));
  };
  require_kind(kind);
  if (is_file_name(name_or_file)) {
    const auto& entry = impl_->library(name_or_file)->entry;
    if (!kind.empty() && entry.kind != kind) {
      throw PluginError(name_or_file + ": is a " + entry.kind + " plugin, must be a " + kind);
    }
    return entry;
  }
  std::string wanted_kind = kind;
  std::string name = name_or_file;
  if (const auto slash = name.find('/'); slash != std::string::npos) {
    wanted_kind = name.substr(0, slash);
    name = name.substr(slash + 1);
    require_kind(wanted_kind);
  }
  return impl_->find(wanted_kind, name)->entry;
}

namespace {

/// Calls into a library and rethrows its exceptions as exceptions of the framework. An exception whose type is defined
/// in the library must not outlive the library.
template <class Call>
void guarded(const Library& library, const std::string& doing, Call&& call) {
  const std::string what = library.entry.file.string() + ": " + doing + " " + library.entry.name + " failed: ";
  try {
    call();
  } catch (const ReadError& error) {
    throw ReadError(error.what());
  } catch (const ConfigError& error) {
    throw ConfigError(error.what());
  } catch (const PluginError& error) {
    throw PluginError(error.what());
  } catch (const ShapeError& error) {
    throw ShapeError(error.what());
  } catch (const Unsupported& error) {
    throw Unsupported(error.what());
  } catch (const Diverged& error) {
    throw Diverged(error.what());
  } catch (const Error& error) {
    throw Error(error.what());
  } catch (const std::bad_alloc&) {
    throw OutOfMemory(what + "there was not enough memory");
  } catch (const std::exception& error) {
    throw PluginError(what + error.what());
  } catch (...) {
    throw PluginError(what + "it threw something that is not a std::exception");
  }
}

/// Passes our visitor to a library's parameter declarations.
void visit_library(const Library& library, ParamVisitor& visitor) {
  guarded(library, "reading the parameters of",
          [&] { library.handle.get<VisitFunction>("weft_plugin_visit_params")(&visitor); });
}
void visit_erased(void* library, ParamVisitor& visitor) {
  visit_library(*static_cast<const Library*>(library), visitor);
}

}  // namespace

std::vector<ParamInfo> PluginRegistry::params(const PluginEntry& entry) const {
  const auto library = impl_->library(entry.file);
  return describe_params_erased(const_cast<Library*>(library.get()), visit_erased);
}

void PluginRegistry::visit_params(const PluginEntry& entry, ParamVisitor& visitor) const {
  visit_library(*impl_->library(entry.file), visitor);
}

std::pair<std::string, PluginEntry> PluginRegistry::look_up(const std::string& kind, const ConfigNode& slot) const {
  ConfigNode given_name = slot;
  ConfigNode version;
  if (!slot.is_scalar()) {
    slot.refuse_unknown_keys({"plugin", "params", "version"});
    given_name = slot.at("plugin");
    version = slot.find("version").value_or(ConfigNode());
  }
  std::string name = given_name.as_string();
  if (is_file_name(name)) name = fs::absolute(given_name.as_path()).lexically_normal().string();
  PluginEntry entry;
  try {
    entry = find(name, kind);
  } catch (const PluginError& error) {
    const std::string path = given_name.path().empty() ? kind : given_name.path();
    throw PluginError(given_name.where() + ": " + path + ": " + error.what());
  }
  if (!version.is_null() && version.as_string() != entry.version) {
    throw PluginError(version.where() + ": " + version.path() + " = " + version.as_string() + ", but " +
                      entry.file.string() + " is " + name + " " + entry.version);
  }
  const std::lock_guard lock(impl_->mutex);
  impl_->named[entry.kind + "/" + entry.name] = entry;
  return {std::move(name), std::move(entry)};
}

PluginEntry PluginRegistry::entry(const std::string& kind, const ConfigNode& slot) const {
  return look_up(kind, slot).second;
}

ConfigNode PluginRegistry::resolve(const std::string& kind, const ConfigNode& slot) const {
  const auto [name, entry] = look_up(kind, slot);
  const auto library = impl_->library(entry.file);
  const ConfigNode resolved =
      read_params_erased(place(slot, "params"), const_cast<Library*>(library.get()), visit_erased);
  const ConfigNode params = resolve_slots(resolved, this->params(entry));
  // Keep the name rather than the file, unless the slot gives a file. A saved config then runs on another machine.
  return ConfigNode::mapping({{"plugin", ConfigNode::quoted(name)}, {"params", params}});
}

bool PluginRegistry::lacks_default(const ParamInfo& info, const ConfigNode& slot) const {
  const ConfigNode name = slot.is_mapping() && slot.has("plugin") ? slot.at("plugin") : slot;
  if (!name.is_scalar() || name.as_string() != info.default_value) return false;
  try {
    find(info.default_value, info.slot);
    return false;
  } catch (const PluginError&) {
    return true;
  }
}

ConfigNode PluginRegistry::resolve_slots(const ConfigNode& config, const std::vector<ParamInfo>& params) const {
  ConfigNode resolved = config;
  for (const auto& info : params) {
    if (info.kind != ParamKind::slot) continue;
    const ConfigNode slot = place(config, info.name);
    if (!slot.is_null() && !lacks_default(info, slot)) resolved = resolved.with(info.name, resolve(info.slot, slot));
  }
  return resolved;
}

std::vector<ConfigNode> PluginRegistry::files(const ConfigNode& config, const std::vector<ParamInfo>& params) const {
  std::vector<ConfigNode> own, nested;
  for (const auto& info : params) {
    const ConfigNode node = place(config, info.name);
    if (node.is_null()) continue;
    if (info.kind == ParamKind::slot) {
      if (lacks_default(info, node)) continue;
      for (auto& file : files(info.slot, node)) nested.push_back(std::move(file));
    } else if (info.kind == ParamKind::file || info.kind == ParamKind::file_or_mapping) {
      if (node.is_scalar() && !node.as_string().empty()) own.push_back(node);
    }
  }
  own.insert(own.end(), nested.begin(), nested.end());
  return own;
}

std::vector<ConfigNode> PluginRegistry::files(const std::string& kind, const ConfigNode& slot) const {
  return files(place(slot, "params"), params(look_up(kind, slot).second));
}

std::pair<std::shared_ptr<void>, PluginEntry> PluginRegistry::create(const std::string& kind, const ConfigNode& slot,
                                                                     Host& host) const {
  const ConfigNode resolved = resolve(kind, slot);
  const auto library = impl_->library(find(resolved.at("plugin").as_string(), kind).file);
  const ConfigNode params = resolved.at("params");
  const std::string label = kind + " " + library->entry.name;
  void* object = nullptr;
  {
    const PluginCall entry(label.c_str(), "its constructor");
    guarded(*library, "creating",
            [&] { object = library->handle.get<CreateFunction>("weft_plugin_create")(&host, &params); });
  }
  if (object == nullptr) {
    throw PluginError(library->entry.file.string() + ": creating " + library->entry.name +
                      " failed: it returned nothing");
  }
  const auto destroy = [library, label](void* dying) {
    const PluginCall entry(label.c_str(), "its destructor");
    library->handle.get<DestroyFunction>("weft_plugin_destroy")(dying);
  };
  {
    const std::lock_guard lock(impl_->mutex);
    impl_->used[library->entry.kind + "/" + library->entry.name] = library->entry;
  }
  return {std::shared_ptr<void>(object, destroy), library->entry};
}

std::vector<PluginEntry> PluginRegistry::used() const { return impl_->copy_of(impl_->used); }

std::vector<PluginEntry> PluginRegistry::named() const { return impl_->copy_of(impl_->named); }

}  // namespace weft
