#include "cluster/job_states.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>

#include "sdk/files.hpp"
#include "sdk/json_text.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kEnded = "ended-jobs.json";

/// What a job wrote about itself: see the scripts.
struct JobRecord {
  std::vector<std::string> nodes;                      ///< of each start
  int ends = 0, requeues = 0, kills = 0, resumed = 0;  ///< resumed: starts after it was asked to end
  bool has_ended = false, gave_up = false;             ///< of the last start
  int code = 0, stops = 0;                             ///< of the last end; stops: how often it was asked to end

  /// Whether another start follows the last end, as the script decides it. A launcher may have an exit code of its own.
  bool goes_back() const {
    return has_ended && !gave_up && (code == kStartAgain || (stops > 0 && code != 0 && code != kOthersAtWork));
  }
  bool is_final() const { return gave_up || (has_ended && !goes_back()); }
  bool is_good() const { return has_ended && code == 0; }
};

JobRecord read_record(const fs::path& file) {
  JobRecord record;
  std::ifstream stream(file);
  for (std::string line; std::getline(stream, line);) {
    const auto value = [&](const std::string& key) {
      const auto at = line.find(" " + key + "=");
      if (at == std::string::npos) return std::string();
      const auto begin = at + key.size() + 2;
      return line.substr(begin, line.find(' ', begin) - begin);
    };
    if (line.starts_with("began ")) {
      record.nodes.push_back(value("node"));
      if (record.goes_back()) ++record.resumed;
      record.has_ended = record.gave_up = false;
    } else if (line.starts_with("ended ")) {
      ++record.ends;
      record.has_ended = true;
      record.code = std::atoi(value("code").c_str());
      record.stops = std::atoi(value("stops").c_str());
    } else if (line.starts_with("requeued")) {
      ++record.requeues;
    } else if (line.starts_with("killed ")) {
      ++record.kills;
    } else if (line.starts_with("gave-up")) {
      record.gave_up = true;
    }
  }
  return record;
}

/// The last error that a log has, from its end; empty without one.
std::string last_error(const fs::path& log) {
  std::ifstream stream(log, std::ios::binary);
  if (!stream) return "";
  constexpr std::streamoff kMost = 1 << 16;
  stream.seekg(0, std::ios::end);
  stream.seekg(std::max<std::streamoff>(0, static_cast<std::streamoff>(stream.tellg()) - kMost));
  std::string found;
  for (std::string line; std::getline(stream, line);)
    if (line.starts_with("error: ") || line.find("slurmstepd") == 0) found = line;
  return found.substr(0, 400);
}

std::map<std::string, SlurmJob> ended_before(const Submission& submission) {
  std::map<std::string, SlurmJob> jobs;
  std::ifstream stream(submission.scripts.folder / kEnded, std::ios::binary);
  const auto json = parse_json_if_valid(std::string{std::istreambuf_iterator<char>(stream), {}});
  if (!json.is_object()) return jobs;
  for (const auto& [id, texts] : json.items()) {
    if (!texts.is_array() || texts.size() != 3 ||
        !std::all_of(texts.begin(), texts.end(), [](const auto& text) { return text.is_string(); }))
      continue;
    // id, name, state, reason, node
    jobs[id] = {id, "", texts[0].get<std::string>(), texts[1].get<std::string>(), texts[2].get<std::string>()};
  }
  return jobs;
}

/// Reasons why a job waits that pass by themselves.
bool passes_by_itself(const std::string& reason) {
  static constexpr std::array kUsual = {"None",
                                        "Priority",
                                        "Resources",
                                        "Dependency",
                                        "BeginTime",
                                        "Cleaning",
                                        "JobArrayTaskLimit",
                                        "QOSMaxJobsPerUserLimit",
                                        "AssocMaxJobsLimit"};
  return reason.empty() || std::find(kUsual.begin(), kUsual.end(), reason) != kUsual.end();
}

std::string started_text(const JobRecord& record) {
  std::string nodes;
  for (const auto& node : record.nodes) nodes += (nodes.empty() ? "" : ", ") + node;
  std::string why;
  const auto add = [&](int count, const std::string& what) {
    if (count > 0) why += (why.empty() ? "" : "; ") + std::to_string(count) + " x " + what;
  };
  add(record.resumed, "after Slurm asked it to end, as before a time limit");
  const auto without_end = static_cast<int>(record.nodes.size()) - record.ends - (record.has_ended ? 0 : 1);
  add(without_end, "after it ended without a word: its node failed, or it was requeued");
  add(record.kills, "after weft was ended by a signal from outside");
  return "was started " + std::to_string(record.nodes.size() + static_cast<std::size_t>(record.kills)) + " times (" +
         nodes + "): " + why;
}

/// Looks at the jobs of one submission.
class Look {
 public:
  Look(const Submission& submission, const std::optional<std::vector<SlurmJob>>& jobs)
      : submission_(submission), known_(ended_before(submission)), answers_(jobs.has_value()) {
    if (jobs)
      for (const auto& job : *jobs) known_[job.id] = job;
    std::error_code none;
    all_done_ = fs::exists(submission.scripts.folder / "tasks" / (submission.array + ".all-done"), none);
  }

  JobStates states() {
    states_.units = submission_.work.files.units;
    states_.total = submission_.work.total;
    states_.done = submission_.units_there();
    if (!submission_.array.empty())
      for (std::int64_t task = 1; task <= submission_.tasks; ++task) look_at_task(static_cast<int>(task));
    // A file is there from the first evaluation of a fit on, and may be an earlier one's: only the job's end says that all is
    // done.
    const bool last_is_good = submission_.scripts.is_shared
                                  ? look_at_merge()
                                  : read_record(submission_.scripts.record(submission_.array + "_1")).is_good() &&
                                        states_.failed + states_.waiting + states_.running == 0;
    const bool report_goes_on = is_going_on(submission_.report);
    states_.is_over = answers_ && states_.waiting + states_.running == 0 && states_.merge != "waiting" &&
                      states_.merge != "running" && !report_goes_on;
    // A merge ends with 0 only if everything is there; files are counted for people.
    if (last_is_good && submission_.scripts.is_shared) states_.done = states_.total;
    states_.work_is_done = last_is_good && states_.done >= states_.total;
    return std::move(states_);
  }

 private:
  const SlurmJob* known(const std::string& id) const {
    const auto found = known_.find(id);
    return found == known_.end() ? nullptr : &found->second;
  }
  bool is_going_on(const std::string& id) const {
    const SlurmJob* job = id.empty() ? nullptr : known(id);
    return job != nullptr && !job->has_ended();
  }

  void look_at_task(int task) {
    const std::string id = submission_.array + "_" + std::to_string(task);
    const std::string name = submission_.scripts.is_shared ? "task " + std::to_string(task) : "the job";
    const JobRecord record = read_record(submission_.scripts.record(id));
    const SlurmJob* job = known(id);
    if (record.nodes.size() > 1 || record.kills > 0) states_.notes.push_back(name + " " + started_text(record));
    if (job != nullptr && !job->has_ended()) {
      const bool runs = job->state == "RUNNING" || job->state == "COMPLETING" || job->state == "CONFIGURING";
      ++(runs ? states_.running : states_.waiting);
      if (runs) return;
      if (job->reason != "None") states_.waiting_for = job->reason;
      if (!passes_by_itself(job->reason)) states_.troubles.push_back(name + " does not start: " + job->reason);
      return;
    }
    if (!answers_ && job == nullptr && !record.is_final()) {  // as far as can be seen
      ++(record.nodes.empty() || record.has_ended ? states_.waiting : states_.running);
      return;
    }
    const std::string why = why_failed(record, job);
    ++(why.empty() ? states_.ended : states_.failed);
    if (why.empty() && !record.nodes.empty() && !record.has_ended)
      states_.notes.push_back(name + " ended without a word on " + record.nodes.back() + "; the others did its work");
    if (!why.empty()) say_failure(name, JobKind::task, id, why, record, job);
  }

  /// @return whether it ended with 0.
  bool look_at_merge() {
    if (submission_.merge.empty()) return false;
    const JobRecord record = read_record(submission_.scripts.record(submission_.merge));
    const SlurmJob* job = known(submission_.merge);
    if (job != nullptr && !job->has_ended()) {
      states_.merge = job->state == "PENDING" ? "waiting" : "running";
      if (job->state == "PENDING" && !passes_by_itself(job->reason))
        states_.troubles.push_back("the merge does not start: " + job->reason);
      return false;
    }
    if (!answers_ && job == nullptr && !record.is_final()) {
      states_.merge = record.nodes.empty() || record.has_ended ? "waiting" : "running";
      return false;
    }
    const std::string why = why_failed(record, job);
    states_.merge = !why.empty() ? "failed" : record.is_good() ? "done" : "cancelled";
    if (!why.empty()) say_failure("the merge", JobKind::merge, submission_.merge, why, record, job);
    return why.empty() && record.is_good();
  }

  /// Why a job that is not in the queue did not do its work; empty if it did.
  std::string why_failed(const JobRecord& record, const SlurmJob* job) const {
    const std::string slurm = job != nullptr ? slurm_failure_text(*job) : "";
    if (was_spared(record, job)) return "";
    if (submission_.is_cancelled && job != nullptr && job->state == "CANCELLED") return "";
    if (record.gave_up)
      return "it was asked to end again and again, as before a time limit; its profile allows no more restarts";
    if (record.has_ended) {
      if (record.code == 0 || record.code == kOthersAtWork) return "";
      if (job != nullptr && job->state == "CANCELLED" && record.stops > 0) return slurm;  // which asked it to end
      if (record.code == kStartAgain || record.requeues > 0)
        return "it was to be started again, and was not" + (slurm.empty() ? "" : ": " + slurm);
      if (record.code > 128) return "weft was ended by " + ended_by(record.code - 128) + " again and again";
      return "weft ended with exit code " + std::to_string(record.code);
    }
    if (!slurm.empty()) return slurm;
    if (!record.nodes.empty()) return "it ended without a word: its node, or its script, was killed";
    return "it never started";
  }
  /// Whether a task was waiting to start, for the first time or again, when the others had done everything: then it was
  /// cancelled.
  bool was_spared(const JobRecord& record, const SlurmJob* job) const {
    if (!all_done_ || record.gave_up) return false;
    if (record.nodes.empty() || (record.has_ended && record.requeues > 0)) return true;
    return !record.has_ended && job != nullptr && job->state == "CANCELLED";  // a failed node's
  }
  static std::string ended_by(int signal) { return "signal " + std::to_string(signal); }

  void say_failure(const std::string& name, JobKind kind, const std::string& id, const std::string& why,
                   const JobRecord& record, const SlurmJob* job) {
    std::string node = record.nodes.empty() ? (job != nullptr ? job->node : "") : record.nodes.back();
    const fs::path log = submission_.scripts.log(kind, id);
    const std::string error = last_error(log);
    std::string text = name + " failed" + (node.empty() ? "" : " on " + node) + ": " + why;
    if (!error.empty()) text += "\n    " + error;
    if (fs::exists(log)) text += "\n    log: " + log.string();
    states_.troubles.push_back(text);
  }

  const Submission& submission_;
  std::map<std::string, SlurmJob> known_;
  bool answers_, all_done_ = false;
  JobStates states_;
};

}  // namespace

JobStates job_states(const Submission& submission, const std::optional<std::vector<SlurmJob>>& jobs) {
  return Look(submission, jobs).states();
}

void keep_ended_jobs(const Submission& submission, const std::vector<SlurmJob>& jobs) {
  auto kept = ended_before(submission);
  bool has_new = false;
  for (const auto& job : jobs) {
    if (!job.has_ended()) {
      has_new = kept.erase(job.id) > 0 || has_new;  // it was started again
      continue;
    }
    SlurmJob& one = kept[job.id];
    has_new = has_new || one.state != job.state || one.reason != job.reason;
    one = job;
  }
  if (!has_new) return;
  ordered_json json = ordered_json::object();
  for (const auto& [id, job] : kept) json[id] = {job.state, job.reason, job.node};
  try {
    write_text(submission.scripts.folder / kEnded, json.dump(1) + "\n");
  } catch (const WriteError&) {  // it only says more about jobs that failed
  }
}

std::string states_json(const Submission& submission, const JobStates& s) {
  return ordered_json{
             {"command", submission.work.command},
             {"units", s.units},
             {"done", s.done},
             {"total", s.total},
             {"tasks", {{"running", s.running}, {"waiting", s.waiting}, {"ended", s.ended}, {"failed", s.failed}}},
             {"waiting_for", s.waiting_for},
             {"merge", s.merge},
             {"jobs", submission.ids()},
             {"is_over", s.is_over},
             {"is_done", s.is_done()},
             {"troubles", s.troubles},
             {"notes", s.notes}}
             .dump(2, ' ', false, ordered_json::error_handler_t::replace) +
         "\n";
}

std::string progress_text(const JobStates& s) {
  std::string text;
  if (!s.units.empty()) text = std::to_string(s.done) + " of " + std::to_string(s.total) + " " + s.units + "; ";
  std::string tasks;
  const auto add = [&](int count, const std::string& what) {
    if (count > 0) tasks += (tasks.empty() ? "" : ", ") + std::to_string(count) + " " + what;
  };
  add(s.running, "running");
  add(s.waiting, "waiting" + (s.waiting_for.empty() ? "" : " (" + s.waiting_for + ")"));
  add(s.ended, "ended");
  add(s.failed, "failed");
  text += "tasks: " + (tasks.empty() ? "none" : tasks);
  if (!s.merge.empty()) text += "; merge " + s.merge;
  return text;
}

std::string status_text(const Submission& submission, const JobStates& s) {
  std::string text = submission.work.command + ": " + progress_text(s) + "\n";
  for (const auto& trouble : s.troubles) text += "  " + trouble + "\n";
  for (const auto& note : s.notes) text += "  " + note + "\n";
  const std::string folder = submission.work.results.string();
  if (submission.is_cancelled && s.is_over && !s.is_done()) {
    text += "  it was cancelled; the same command goes on\n";
  } else if (s.is_done()) {
    text += "  done: " + folder + "\n";
  } else if (s.is_over) {
    text += s.done < s.total ? "  not all is there; the same command submits only what is left\n"
                             : "  all " + s.units + " are there, but not all is well; the logs say why\n";
  }
  return text;
}

}  // namespace weft
