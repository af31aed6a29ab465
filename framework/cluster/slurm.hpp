#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace weft {

/// A job, or a task of an array, as Slurm knows it.
struct SlurmJob {
  std::string id;                                                 ///< "12", or "12_3" for task 3 of array 12
  std::string name;                                               ///< of the job
  std::string state;                                              ///< "PENDING", "RUNNING", "NODE_FAIL", ...
  std::string reason;                                             ///< why it is pending, or why it ended; "None"
  std::string node;                                               ///< empty while it is pending
  std::string job() const { return id.substr(0, id.find('_')); }  ///< "12"
  int task() const;                                               ///< 3; 0 if it is not of an array
  bool has_ended() const;
};
/// Reads what squeue prints with kSqueueFormat.
std::vector<SlurmJob> parse_squeue(const std::string& text);
inline constexpr const char* kSqueueFormat = "%i|%j|%T|%N|%r";

/// What became of a job, in words: "its node failed", "it reached its time limit". Empty if that is no failure.
std::string slurm_failure_text(const SlurmJob& job);

/// Slurm's commands. They are found in PATH and asked nothing that needs Slurm's accounting.
class Slurm {
 public:
  /// @throws ConfigError if sbatch, squeue, scontrol or scancel is not in PATH.
  Slurm();

  /// Submits a script. @param options of sbatch besides those in the script. @return the job's id.
  /// @throws Error with what sbatch said.
  std::string submit(const std::filesystem::path& script, const std::vector<std::string>& options) const;
  /// The user's jobs of these names that slurmctld knows: those that have not ended, and, for some minutes, those that have.
  /// @param problem what squeue said if the result is nothing: slurmctld did not answer.
  std::optional<std::vector<SlurmJob>> jobs(const std::vector<std::string>& names, std::string& problem) const;
  /// Cancels jobs; those that have ended do not matter. @throws Error with what scancel said.
  void cancel(const std::vector<std::string>& ids) const;
};

}  // namespace weft
