#pragma once
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "loader/registry.hpp"
#include "weft/error.hpp"
#include "weft/host.hpp"
#include "weft/task.hpp"

/// Targets for the fuzzer: each reads hostile input as the command line reads it, without running anything.
namespace weft::fuzz {

// One function per target; its name is that of its folder in inputs/. Each takes any bytes. weft::Error means that the
// input was refused; every other exception, crash or hang is a finding.
void task(std::string_view yaml);
void experiment(std::string_view yaml);
void scene(std::string_view yaml);
void obj(std::string_view text);
void fabric(std::string_view json);
void torchscript(std::string_view yaml);
void plugin_info(std::string_view bytes);
void session(std::string_view edits);
void dataset(std::string_view edits);
void model(std::string_view edits);
void damaged(std::string_view bytes);

struct Target {
  const char* name;
  void (*run)(std::string_view input);
};
inline constexpr Target kTargets[] = {{"task", task},
                                      {"experiment", experiment},
                                      {"scene", scene},
                                      {"obj", obj},
                                      {"fabric", fabric},
                                      {"torchscript", torchscript},
                                      {"plugin_info", plugin_info},
                                      {"session", session},
                                      {"dataset", dataset},
                                      {"model", model},
                                      {"damaged", damaged}};

/// What hostile files name and are compared with: a square of cloth, a fabric, a task and an experiment in a folder in
/// memory, the plugins, and the task in memory.
class World {
 public:
  World();
  ~World();
  std::filesystem::path file(const std::string& name) const { return folder_ / name; }
  /// Writes a file of the folder. @return its path.
  std::filesystem::path write(const std::string& name, std::string_view bytes) const;

  std::shared_ptr<const PluginRegistry> registry;
  std::unique_ptr<Host> host;
  Task task;

 private:
  std::filesystem::path folder_;
};
World& world();

/// Runs `read`, which may refuse the input. @return the reason, or empty.
template <class Read>
std::string refusal(Read&& read) {
  try {
    read();
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

/// Ends the process with a message: what was found.
[[noreturn]] void finding(const std::string& message);

/// Opens a file of a kind ("session", "dataset", "model") and uses what it holds.
void use_session(const std::filesystem::path& file);
void use_dataset(const std::filesystem::path& file);
void use_model(const std::filesystem::path& file);
/// Writes a valid file of these kinds.
void make_session(const std::filesystem::path& file);
void make_dataset(const std::filesystem::path& file);
void make_model(const std::filesystem::path& file);

/// What `weft_fuzz_inputs --serve` answers if the process that opened a file died of it, before how it ended; and what it
/// has then written to stderr after that one's reports.
inline const std::string kDied = "died: ", kReportEnds = "== a process has ended\n";

/// Keys of tasks, experiments and scenes, and words of the formats: what a mutator may insert.
std::vector<std::string> words_of_target(std::string_view target);

}  // namespace weft::fuzz
