#pragma once
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

/// Several processes, on one or several machines with one file system, share the work of a folder.
namespace weft {

/// The claims of one process. A claim is a file folder/NAME.claim: it says that a process is at work on NAME. It is made
/// with O_EXCL, so that one process gets it, and touched every few seconds while that process lives. A claim is dead
/// when its process has ended on this machine, or when another process has seen it unchanged for a minute; then that one
/// may take it. Clocks of different machines are never compared.
///
/// A process that only slept does not know that its claim was taken, and finishes its work too. So results must be
/// files that are renamed into place, and equal whoever makes them. Thread-safe.
class Claims {
 public:
  struct Options {
    double touch_every_s = 5.0;
    double dead_after_s = 60.0;
    /// Names what process numbers are unique in. Claims of another machine are judged by their touches alone.
    std::string machine = this_machine();
  };

  explicit Claims(std::filesystem::path folder);
  Claims(std::filesystem::path folder, Options options);
  /// Gives up all claims, and removes the folder if it is empty.
  ~Claims();
  Claims(const Claims&) = delete;
  Claims& operator=(const Claims&) = delete;

  /// @return how many processes have claimed it until now, this one included: more than 1 if the others died at it.
  ///   Nothing: a living process has it.
  /// @throws Error naming the file and the reason if no claim can be made there.
  std::optional<int> take(const std::string& name);
  /// Whether another process is known to be alive and at work on it: it runs on this machine, or it has touched its claim
  /// since this process first saw that. So a claim of another machine is known to be held after some seconds, or dead
  /// after dead_after_s.
  bool is_held(const std::string& name);
  /// Gives up a claim that take() gave.
  void release(const std::string& name);

  /// Boot and process name space.
  static std::string this_machine();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Takes a claim, or waits until the process that has it gives it up or dies.
/// @param waiting called once, when it begins to wait. @param cancelled asked twice a second. @return false: cancelled.
bool take_in_turn(Claims& claims, const std::string& name, const std::function<void()>& waiting,
                  const std::function<bool()>& cancelled);

/// Temporary files, FILE.tmp..., that were in a folder before this process began: killed processes left them, or another
/// process is about to rename them.
class Leftovers {
 public:
  /// @param folder need not exist.
  explicit Leftovers(const std::filesystem::path& folder);
  /// Removes those of a file. Call it with a claim on the work that makes the file: then no other process writes them.
  void remove(const std::filesystem::path& file);

 private:
  std::map<std::string, std::vector<std::filesystem::path>> by_name_;
};

}  // namespace weft
