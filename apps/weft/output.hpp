#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "context.hpp"
#include "experiments/sweep_rows.hpp"
#include "identity/identity.hpp"
#include "sdk/files.hpp"
#include "simulation/task_config.hpp"

namespace weft::app {

/// The folder of a result: what --out names, or results/<name>. It need not exist. @throws ConfigError if it is a file.
std::filesystem::path result_folder(const Context& context, const std::string& name);
/// Refuses a folder that holds results of another identity, as its provenance.json has it. Changes nothing on the disk.
/// @throws ConfigError naming what differs, unless --accept-changed was given.
void require_unmixed(const Context& context, const std::filesystem::path& folder, const Identity& now);

/// The same for commands that replace all that they wrote before: only results of another command are refused.
void require_command(const Context& context, const std::filesystem::path& folder, const std::string& command);

/// The folder of a result. It is made before the work, so that no work is lost for want of a place, and goes again with
/// this object if it was not there before and is still empty.
class PlacedFolder {
 public:
  /// @throws ConfigError if no file can be written in it.
  explicit PlacedFolder(const std::filesystem::path& folder);
  ~PlacedFolder();
  PlacedFolder(const PlacedFolder&) = delete;
  PlacedFolder& operator=(const PlacedFolder&) = delete;

 private:
  std::vector<std::filesystem::path> made_;  ///< the innermost first
};

/// A text that is written at once, in a folder that is made if needed, and taken back unless keep() is called: a command
/// that is refused later leaves the disk as it was.
class PlacedText {
 public:
  PlacedText(std::filesystem::path file, const std::string& text);
  ~PlacedText();
  PlacedText(const PlacedText&) = delete;
  PlacedText& operator=(const PlacedText&) = delete;
  void keep() { is_kept_ = true; }

 private:
  std::filesystem::path file_;
  std::string earlier_;
  bool is_kept_ = false, has_new_folder_ = false;
};

/// The installation or build tree that this program belongs to: it lies in <prefix>/bin.
std::filesystem::path tree_of_weft();
/// A text file of that tree. @param file from share/weft. @throws Error if it cannot be read.
std::string shipped_text(const std::filesystem::path& file);

/// Today's date in UTC: "2026-12-01".
std::string today();

/// A whole file; empty if it cannot be read.
std::string text_of_file(const std::filesystem::path& file);

/// session.h5 of the path that a user gives: the file, or the folder of a run. @throws ConfigError when there is none.
std::filesystem::path session_file(const std::string& given);

/// Version, commit, plugins used and the identity: enough, with the resolved config, to repeat a run exactly. The same
/// text on every machine.
std::string provenance_json(const PluginRegistry& registry, std::uint64_t seed, const Identity& identity);

/// Makes the resolved config of a task independent of where its files lie: the garment is garment.obj beside it, the
/// material space is in the config itself, every plugin slot has every default, and plugin_path has the folders that the
/// plugins came from.
/// @param params the config's keys: describe_params<...>().
ConfigNode self_contained(const ConfigNode& resolved, const std::vector<ParamInfo>& params, const Task& task,
                          const PluginRegistry& registry);
/// Writes the garment.obj of self_contained(), also under another name.
void write_garment(const Task& task, const std::filesystem::path& folder, const std::string& name = "garment.obj");

/// Says which rows of a sweep belong to something else than the others, and which are not asked for. The former is also
/// said with --quiet, on stderr.
void say_mixed(const Context& context, const SweepPlan& plan, const std::vector<SweepRow>& rows,
               const SweepFolder& earlier);

/// Writes folder/report.html from the results in the folder. Says where the page is, or why there is none.
void write_page(const Context& context, const std::filesystem::path& folder);

}  // namespace weft::app
