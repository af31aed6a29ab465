#pragma once
#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "cluster/job_scripts.hpp"
#include "cluster/slurm.hpp"
#include "processes/claims.hpp"

namespace weft {

/// How finished units of work are counted: files of these folders whose names begin and end so.
struct UnitFiles {
  std::string units;                  ///< "cells"; empty: the work is one unit, whose result is in `result`
  std::vector<std::string> folders;   ///< from the results' folder
  std::string begins, ends, but_not;  ///< of names; but_not: ends of names that do not count
  std::filesystem::path result;       ///< the file without which one unit of work is not done
};

/// Work for a cluster.
struct ClusterWork {
  std::string command;                 ///< of weft: "evaluate planning"
  std::string label;                   ///< of its folder: "evaluate-planning"
  std::filesystem::path results;       ///< the folder of the results
  std::vector<std::string> arguments;  ///< of weft, without what is about the cluster
  UnitFiles files;
  std::int64_t total = 1, left = 1;  ///< units of work, and those of them that are not there
  bool has_ranks = false;            ///< the command can use several ranks

  bool is_shared() const { return !files.units.empty(); }
};

/// The jobs of one command for one folder of results: RESULTS/slurm/LABEL/ with the scripts, their logs, the records of
/// the tasks, and submission.json.
struct Submission {
  ClusterWork work;
  JobScripts scripts;
  std::string profile_name;
  std::int64_t tasks = 0;              ///< of the array; 0: there is nothing to do for one
  std::filesystem::path submitted_as;  ///< the folder of the results when it was submitted
  std::int64_t there = 0;              ///< unit files when it was submitted, also those that were not asked for
  std::string array, merge, report;    ///< ids; empty: not submitted
  bool is_cancelled = false;

  Submission() = default;
  /// @param program that the tasks start, for a profile that names none.
  Submission(ClusterWork work, const ClusterChoice& choice, const std::string& program);

  std::vector<std::string> names() const;  ///< of its jobs
  std::vector<std::string> ids() const;    ///< of those that were submitted
  std::int64_t units_there() const;        ///< of total
  void save() const;
};

/// RESULTS/slurm.
std::filesystem::path cluster_folder(const std::filesystem::path& results);
/// The submission of RESULTS/slurm/LABEL; nothing without one. @throws ConfigError for a damaged one.
std::optional<Submission> read_submission(const std::filesystem::path& folder);
/// The submissions that a folder of results has. @throws ConfigError for a damaged one.
std::vector<Submission> read_submissions(const std::filesystem::path& results);

/// What a submission would do, for people: each script under its name.
std::string dry_run_text(const Submission& submission);

/// Claims the submission of a folder's jobs. A claim that a process of another machine left when it was killed is taken over
/// after a minute. @param stop ends the waiting if it becomes true; may be null.
/// @throws ConfigError if another process has it; Error if it was stopped.
void claim_submission(Claims& claims, const std::filesystem::path& folder, const std::atomic<bool>* stop);

enum class SubmitEnd {
  submitted,
  followed,      ///< its jobs are in the queue already
  nothing_left,  ///< an earlier submission of the same command has done all
};
/// Writes the scripts and submits them, unless the jobs of an earlier call of the same command have not ended, or have done
/// everything. An earlier call that was killed while it submitted is completed.
/// @param submission gets the ids, or becomes the earlier one. @param prepare writes what the jobs need to find. It is called
/// before the first of them is submitted, and if none is, not at all.
/// @throws ConfigError if jobs of another command are in the queue for this folder, or another process submits them now;
/// Error if Slurm does not answer. @param stop as in claim_submission().
SubmitEnd submit(Submission& submission, const Slurm& slurm, const std::function<void()>& prepare,
                 const std::atomic<bool>* stop = nullptr);

}  // namespace weft
