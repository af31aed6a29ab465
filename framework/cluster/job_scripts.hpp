#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "cluster/profile.hpp"

namespace weft {

/// Exit codes of weft that the scripts understand, besides 0 (done), 1 (failed) and 2 (wrong use).
inline constexpr int kOthersAtWork = 3;  ///< this process has done its share; other ones are at work on the rest
inline constexpr int kStartAgain = 75;   ///< stopped by SIGTERM; the same command goes on (EX_TEMPFAIL of sysexits.h)

/// A script for sbatch.
enum class JobKind {
  task,    ///< of an array; it does a share of the work, or all of it
  merge,   ///< after the array: does what no task has done, and writes the tables
  report,  ///< after all others: says what became of them
};

/// What the scripts of a submission say.
struct JobScripts {
  std::string name;                      ///< of the array's job; that of the others has "-merge" or "-report" after it
  std::string command;                   ///< "evaluate planning"
  std::filesystem::path folder;          ///< absolute: scripts, logs and the tasks' records
  std::filesystem::path results;         ///< absolute: what `weft status` is asked about
  std::filesystem::path working_folder;  ///< absolute: where the command was given
  std::vector<std::string> arguments;    ///< of weft
  std::vector<std::string> environment;  ///< NAME=VALUE of weft's own variables where the command was given
  bool is_shared = true;                 ///< the tasks share the work; else one task does it, and there is no merge
  bool has_ranks = false;                ///< the command can use the profile's `ranks`
  std::string default_program;           ///< for a profile without `program`
  ClusterProfile profile;

  std::string job_name(JobKind kind) const;
  static std::string file_name(JobKind kind);  ///< "array.sh", "merge.sh", "report.sh"
  /// @param tasks of the array; only for JobKind::task.
  std::string text(JobKind kind, std::int64_t tasks = 1) const;
  /// The file of a job's output. @param id "12_3" of a task, "13" of another job.
  std::filesystem::path log(JobKind kind, const std::string& id) const;
  /// What the job itself wrote: began, ended, requeued.
  std::filesystem::path record(const std::string& id) const;
};

}  // namespace weft
