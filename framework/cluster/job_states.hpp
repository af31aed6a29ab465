#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "cluster/submission.hpp"

namespace weft {

/// What has become of a submission: from Slurm, and from what the tasks wrote themselves, since Slurm forgets ended jobs
/// after some minutes.
struct JobStates {
  std::string units;                                    ///< "cells"; empty: one unit of work
  std::int64_t done = 0, total = 0;                     ///< units of work
  int waiting = 0, running = 0, ended = 0, failed = 0;  ///< array tasks
  std::string waiting_for;                              ///< Slurm's reason why tasks wait
  std::string merge;                  ///< "waiting", "running", "done", "failed", "cancelled"; empty: there is none
  bool is_over = false;               ///< no job is in the queue; false if Slurm does not answer
  bool work_is_done = false;          ///< all units are there, and the last job ended with 0
  std::vector<std::string> troubles;  ///< which task failed, where, why, and its log
  std::vector<std::string> notes;     ///< what was overcome: tasks that were started again

  bool is_done() const { return work_is_done; }
};

/// @param jobs the answer of Slurm::jobs(); nothing: Slurm does not answer.
JobStates job_states(const Submission& submission, const std::optional<std::vector<SlurmJob>>& jobs);

/// Keeps how jobs of the submission ended, beside the records of its tasks, for a time when Slurm has forgotten it.
void keep_ended_jobs(const Submission& submission, const std::vector<SlurmJob>& jobs);

/// The same as JSON, with the ids of the jobs.
std::string states_json(const Submission& submission, const JobStates& states);
/// One line: "6 of 8 cells; 2 tasks running, 1 waiting (Resources)".
std::string progress_text(const JobStates& states);
/// That line, troubles, notes, and what to do.
std::string status_text(const Submission& submission, const JobStates& states);

}  // namespace weft
