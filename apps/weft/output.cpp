#include "output.hpp"

#include <cstdio>
#include <ctime>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <set>

#include "commit.hpp"
#include "identity/sha256.hpp"
#include "meshes/garment_writer.hpp"
#include "report/page.hpp"
#include "sdk/files.hpp"

namespace weft::app {

namespace fs = std::filesystem;

fs::path session_file(const std::string& given) {
  const fs::path file = fs::is_directory(given) ? fs::path(given) / "session.h5" : fs::path(given);
  if (!fs::exists(file)) throw ConfigError(file.string() + ": no such file, must be session.h5 or the folder of a run");
  return file;
}

fs::path tree_of_weft() { return fs::read_symlink("/proc/self/exe").parent_path().parent_path(); }

std::string shipped_text(const fs::path& file) {
  const fs::path path = tree_of_weft() / "share/weft" / file;
  std::ifstream stream(path, std::ios::binary);
  if (!stream) throw Error(path.string() + ": cannot be read; it belongs to every installation and build of weft");
  return {std::istreambuf_iterator<char>(stream), {}};
}

std::string today() {
  const std::time_t now = std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  char text[16];
  std::strftime(text, sizeof(text), "%Y-%m-%d", &utc);
  return text;
}

std::string text_of_file(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

fs::path result_folder(const Context& context, const std::string& name) {
  const fs::path folder = context.out.empty() ? fs::path("results") / name : fs::path(context.out);
  if (fs::exists(folder) && !fs::is_directory(folder))
    throw ConfigError("--out " + folder.string() + ": the folder cannot be made: it is a file");
  return folder;
}

void require_unmixed(const Context& context, const fs::path& folder, const Identity& now) {
  const fs::path file = folder / "provenance.json";
  if (!context.accept_changed && fs::exists(file)) require_identity(folder.string(), read_identity(file), now, false);
}

void require_command(const Context& context, const fs::path& folder, const std::string& command) {
  const fs::path file = folder / "provenance.json";
  if (context.accept_changed || !fs::exists(file)) return;
  const auto changes = identity_of_command(command).changes_since(read_identity(file));
  if (changes.size() == 1 && changes.front().starts_with("they are of the command "))
    throw ConfigError(changed_message(folder.string(), changes));
}

PlacedFolder::PlacedFolder(const fs::path& folder) {
  std::error_code ignored;
  for (fs::path one = fs::absolute(folder).lexically_normal(); !fs::exists(one, ignored); one = one.parent_path())
    if (one.has_filename()) made_.push_back(one);
  make_writable_folder(folder);
}

PlacedFolder::~PlacedFolder() {
  std::error_code not_empty;
  for (const auto& folder : made_)
    if (!fs::remove(folder, not_empty)) return;
}

PlacedText::PlacedText(fs::path file, const std::string& text) : file_(std::move(file)) {
  const fs::path folder = file_.has_parent_path() ? file_.parent_path() : fs::path(".");
  has_new_folder_ = !fs::exists(folder);
  make_writable_folder(folder);
  earlier_ = text_of_file(file_);
  write_text(file_, text);
}

PlacedText::~PlacedText() {
  if (is_kept_) return;
  std::error_code ignored;
  try {
    if (earlier_.empty())
      fs::remove(file_, ignored);
    else
      write_text(file_, earlier_);
  } catch (const Error&) {  // the error that led here is the one to report
  }
  if (has_new_folder_) fs::remove(file_.parent_path(), ignored);  // fails unless it is empty
}

std::string provenance_json(const PluginRegistry& registry, std::uint64_t seed, const Identity& identity) {
  auto plugins = nlohmann::ordered_json::array();
  for (const auto& entry : registry.used()) {
    plugins.push_back({{"kind", entry.kind},
                       {"name", entry.name},
                       {"version", entry.version},
                       {"sha256", sha256_of_file(entry.file)}});
  }
  nlohmann::ordered_json json{
      {"weft", WEFT_VERSION}, {"commit", commit()}, {"compiler", __VERSION__}, {"seed", seed}, {"plugins", plugins}};
  if (identity.is_known()) json["identity"] = nlohmann::ordered_json::parse(identity.to_json());
  return json.dump(2) + "\n";
}

namespace {

/// The folders of the plugins that configs named, but for the one that is always searched.
ConfigNode plugin_folders(const PluginRegistry& registry) {
  std::set<fs::path> needed;
  for (const auto& entry : registry.named()) needed.insert(fs::absolute(entry.file).parent_path().lexically_normal());
  needed.erase(fs::absolute(PluginRegistry::default_search_path().back()).lexically_normal());
  std::vector<ConfigNode> folders;
  for (const auto& folder : registry.search_path()) {  // in the order in which they were searched
    const fs::path whole = fs::absolute(folder).lexically_normal();
    const fs::path name = whole.has_filename() ? whole : whole.parent_path();
    if (needed.erase(name) > 0) folders.push_back(ConfigNode::quoted(name.string()));
  }
  return ConfigNode::sequence(std::move(folders));
}

}  // namespace

ConfigNode self_contained(const ConfigNode& resolved, const std::vector<ParamInfo>& params, const Task& task,
                          const PluginRegistry& registry) {
  const ConfigNode config = registry.resolve_slots(resolved.with("garment", garment_node("garment.obj", *task.garment))
                                                       .with("material", write_material_space(task.material)),
                                                   params);
  const ConfigNode folders = plugin_folders(registry);
  const bool had_some = config.has("plugin_path") && config.at("plugin_path").size() > 0;
  return folders.size() > 0 || had_some ? config.with("plugin_path", folders) : config;
}

void write_garment(const Task& task, const fs::path& folder, const std::string& name) {
  write_garment_meshes(folder / name, *task.garment);
}

void say_mixed(const Context& context, const SweepPlan& plan, const std::vector<SweepRow>& rows,
               const SweepFolder& earlier) {
  const std::string mixed = mixed_rows_text(plan, rows), others = other_rows_text(earlier.others);
  if (!mixed.empty()) std::fputs(mixed.c_str(), stderr);
  if (!others.empty()) context.say(others);
}

void write_page(const Context& context, const fs::path& folder) {
  const std::string why_not = write_report(folder);
  context.say(why_not.empty() ? "to look at it, open " + (folder / "report.html").string()
                              : "no report.html: " + why_not);
}

}  // namespace weft::app
