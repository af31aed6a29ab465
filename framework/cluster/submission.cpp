#include "cluster/submission.hpp"

#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <thread>

#include "cluster/job_states.hpp"
#include "sdk/files.hpp"
#include "sdk/fingerprint.hpp"
#include "sdk/json_text.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kSchema = "weft-submission-1";
constexpr const char* kRecord = "submission.json";

fs::path whole_path(const fs::path& path) {
  const fs::path whole = fs::absolute(path).lexically_normal();
  return whole.has_filename() ? whole : whole.parent_path();
}

/// Without what separates names in a question to squeue, or fields in its answer.
std::string name_for_slurm(const std::string& label) {
  std::string name;
  for (const char c : label) {
    const bool is_plain = std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '-' || c == '_' || c == '.';
    name += is_plain ? c : '_';
  }
  return name;
}

/// Slurm reads a backslash in the name of a log as an order to take nothing in it for a pattern, and leaves it out.
void require_path_for_slurm(const fs::path& folder) {
  for (const unsigned char c : folder.string()) {
    if (c == '\\' || c < 0x20 || c == 0x7f)
      throw ConfigError(folder.string() +
                        ": Slurm cannot write logs to a folder with a backslash or a control character " +
                        "in its path; choose another --out");
  }
}

/// Variables that decide what weft finds, where the command was given.
std::vector<std::string> weft_variables() {
  std::vector<std::string> found;
  if (const char* path = std::getenv("WEFT_PLUGIN_PATH"); path != nullptr && *path != '\0')
    found.push_back(std::string("WEFT_PLUGIN_PATH=") + path);
  return found;
}

std::int64_t count_files(const fs::path& results, const UnitFiles& files) {
  std::int64_t count = 0;
  for (const auto& folder : files.folders) {
    std::error_code none;
    for (const auto& entry : fs::directory_iterator(results / folder, none)) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with(files.begins) && name.ends_with(files.ends) &&
          (files.but_not.empty() || !name.ends_with(files.but_not)))
        ++count;
    }
  }
  return count;
}

std::int64_t unit_files_there(const ClusterWork& work) {
  if (work.is_shared()) return count_files(work.results, work.files);
  return fs::exists(work.files.result) ? 1 : 0;
}

ordered_json to_json(const Submission& s) {
  const auto& files = s.work.files;
  return {{"schema", kSchema},
          {"command", s.work.command},
          {"label", s.work.label},
          {"arguments", s.work.arguments},
          {"results", s.work.results.string()},
          {"working_folder", s.scripts.working_folder.string()},
          {"program", s.scripts.default_program},
          {"name", s.scripts.name},
          {"profile", s.profile_name},
          {"restarts", s.scripts.profile.restarts},
          {"poll_s", s.scripts.profile.poll_s},
          {"units",
           {{"name", files.units},
            {"folders", files.folders},
            {"begins", files.begins},
            {"ends", files.ends},
            {"but_not", files.but_not},
            {"result", files.result.string()}}},
          {"total", s.work.total},
          {"left", s.work.left},
          {"there", s.there},
          {"tasks", s.tasks},
          {"array", s.array},
          {"merge", s.merge},
          {"report", s.report},
          {"cancelled", s.is_cancelled}};
}

/// @param folder that holds the record: the results may have been moved since.
Submission from_json(const ordered_json& json, const fs::path& folder) {
  Submission s;
  if (json.at("schema") != kSchema) throw ConfigError("has the schema " + json.at("schema").dump());
  s.work.command = json.at("command").get<std::string>();
  s.work.label = json.at("label").get<std::string>();
  s.work.arguments = json.at("arguments").get<std::vector<std::string>>();
  s.work.results = folder.parent_path().parent_path();
  const auto& units = json.at("units");
  s.work.files.units = units.at("name").get<std::string>();
  s.work.files.folders = units.at("folders").get<std::vector<std::string>>();
  s.work.files.begins = units.at("begins").get<std::string>();
  s.work.files.ends = units.at("ends").get<std::string>();
  s.work.files.but_not = units.at("but_not").get<std::string>();
  s.work.files.result = units.at("result").get<std::string>();
  s.work.total = json.at("total").get<std::int64_t>();
  s.work.left = json.at("left").get<std::int64_t>();
  s.submitted_as = json.at("results").get<std::string>();
  s.scripts.name = json.at("name").get<std::string>();
  s.scripts.command = s.work.command;
  s.scripts.folder = folder;
  s.scripts.results = s.work.results;
  s.scripts.working_folder = json.at("working_folder").get<std::string>();
  s.scripts.arguments = s.work.arguments;
  s.scripts.is_shared = s.work.is_shared();
  s.scripts.default_program = json.at("program").get<std::string>();
  s.scripts.profile.restarts = json.at("restarts").get<std::int64_t>();
  s.scripts.profile.poll_s = json.at("poll_s").get<std::int64_t>();
  s.profile_name = json.at("profile").get<std::string>();
  s.there = json.at("there").get<std::int64_t>();
  s.tasks = json.at("tasks").get<std::int64_t>();
  s.array = json.at("array").get<std::string>();
  s.merge = json.at("merge").get<std::string>();
  s.report = json.at("report").get<std::string>();
  s.is_cancelled = json.at("cancelled").get<bool>();
  return s;
}

/// Submits those of the jobs that have no id yet, and records each id as soon as there is one.
void submit_missing(Submission& s, const Slurm& slurm) {
  const auto submit_one = [&](JobKind kind, std::string& id, const std::string& after) {
    if (!id.empty()) return;
    std::vector<std::string> options;
    if (!after.empty()) options.push_back("--dependency=afterany:" + after);
    id = slurm.submit(s.scripts.folder / JobScripts::file_name(kind), options);
    s.save();
  };
  if (s.tasks > 0) submit_one(JobKind::task, s.array, "");
  if (s.scripts.is_shared) submit_one(JobKind::merge, s.merge, s.array);
  submit_one(JobKind::report, s.report, s.scripts.is_shared ? s.merge : s.array);
}

}  // namespace

fs::path cluster_folder(const fs::path& results) { return results / "slurm"; }

Submission::Submission(ClusterWork given, const ClusterChoice& choice, const std::string& program)
    : work(std::move(given)), profile_name(choice.profile_name) {
  work.results = whole_path(work.results);
  if (!work.files.result.empty()) work.files.result = whole_path(work.files.result);
  scripts.command = work.command;
  scripts.folder = cluster_folder(work.results) / work.label;
  scripts.results = work.results;
  scripts.working_folder = whole_path(".");
  scripts.arguments = work.arguments;
  scripts.environment = weft_variables();
  scripts.is_shared = work.is_shared();
  scripts.has_ranks = work.has_ranks;
  scripts.default_program = program;
  scripts.profile = choice.profile;
  require_path_for_slurm(scripts.folder);
  submitted_as = work.results;
  // The same for every call with this folder and command, by whatever path: jobs that were submitted are found by it.
  Fingerprint place;
  std::error_code none;
  const fs::path real = fs::weakly_canonical(scripts.folder, none);
  place.add((real.empty() ? scripts.folder : real).string());
  scripts.name = "weft-" + name_for_slurm(work.label) + "-" + place.hex().substr(0, 8);
  there = unit_files_there(work);
  tasks = work.is_shared() ? std::min(work.left, scripts.profile.tasks) : 1;
}

std::vector<std::string> Submission::names() const {
  return {scripts.job_name(JobKind::task), scripts.job_name(JobKind::merge), scripts.job_name(JobKind::report)};
}

std::vector<std::string> Submission::ids() const {
  std::vector<std::string> all;
  for (const auto* id : {&array, &merge, &report})
    if (!id->empty()) all.push_back(*id);
  return all;
}

std::int64_t Submission::units_there() const {
  const std::int64_t now = unit_files_there(work);
  if (!work.is_shared()) return now;
  return std::clamp<std::int64_t>(work.total - work.left + now - there, 0, work.total);
}

void Submission::save() const { write_text(scripts.folder / kRecord, to_json(*this).dump(2) + "\n"); }

std::optional<Submission> read_submission(const fs::path& folder) {
  const fs::path file = folder / kRecord;
  const auto text = whole_text_if_there(file);
  if (!text) return std::nullopt;
  try {
    return from_json(parse_json(*text), folder);
  } catch (const ordered_json::exception& error) {
    throw ConfigError(file.string() + ": is damaged: " + error.what());
  } catch (const Error& error) {
    throw ConfigError(file.string() + ": " + error.what());
  }
}

std::vector<Submission> read_submissions(const fs::path& results) {
  std::vector<fs::path> folders;
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(cluster_folder(whole_path(results)), none))
    folders.push_back(entry.path());
  std::sort(folders.begin(), folders.end());
  std::vector<Submission> all;
  for (const auto& folder : folders)
    if (auto one = read_submission(folder)) all.push_back(std::move(*one));
  return all;
}

std::string dry_run_text(const Submission& s) {
  std::string text;
  const auto add = [&](JobKind kind, const std::string& how) {
    text += "== " + (s.scripts.folder / JobScripts::file_name(kind)).string() + " (" + how + ")\n" +
            s.scripts.text(kind, s.tasks) + "\n";
  };
  if (s.tasks > 0) add(JobKind::task, std::to_string(s.tasks) + (s.tasks == 1 ? " task" : " tasks"));
  if (s.scripts.is_shared) add(JobKind::merge, s.tasks > 0 ? "after the array, however it ends" : "at once");
  add(JobKind::report, s.scripts.is_shared ? "after the merge, however it ends" : "after the job, however it ends");
  return text;
}

namespace {

/// The jobs of these names that Slurm knows. @throws Error if it does not answer: submitting might do it twice.
std::vector<SlurmJob> ask(const std::vector<std::string>& names, const Slurm& slurm) {
  std::string problem;
  auto jobs = slurm.jobs(names, problem);
  if (!jobs) throw Error("Slurm does not say whether jobs of this folder are in the queue: " + problem);
  return std::move(*jobs);
}

/// The id of the job of this kind that has not ended; empty without one.
/// @param submissions whose names its name may be one of.
std::string id_of(const std::vector<SlurmJob>& jobs, JobKind kind, const std::vector<const Submission*>& submissions) {
  for (const auto& job : jobs)
    for (const Submission* one : submissions)
      if (!job.has_ended() && job.name == one->scripts.job_name(kind)) return job.job();
  return "";
}

/// Whether the folder of these results is a copy of the one that the jobs were submitted for. Where that cannot be seen, as
/// on a machine that calls it by another path, it is not.
bool is_copied(const Submission& earlier) {
  std::error_code none;
  return fs::exists(earlier.submitted_as, none) && !fs::equivalent(earlier.submitted_as, earlier.work.results, none) &&
         !none;
}

}  // namespace

void claim_submission(Claims& claims, const fs::path& folder, const std::atomic<bool>* stop) {
  while (!claims.take("submit")) {
    if (claims.is_held("submit"))
      throw ConfigError(folder.string() + ": another weft is submitting or cancelling its jobs just now");
    if (stop != nullptr && *stop) throw Error("stopped while it waited for " + folder.string());
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
}

SubmitEnd submit(Submission& submission, const Slurm& slurm, const std::function<void()>& prepare,
                 const std::atomic<bool>* stop) {
  const fs::path folder = submission.scripts.folder;
  ask(submission.names(), slurm);  // before anything changes
  make_writable_folder(folder / "logs");
  make_writable_folder(folder / "tasks");
  Claims claims(folder / "claims");
  claim_submission(claims, folder, stop);

  auto earlier = read_submission(folder);
  // Another machine may call this folder by another path, and so its jobs by another name.
  std::vector<const Submission*> both{&submission};
  auto names = submission.names();
  if (earlier && !is_copied(*earlier)) {
    both.push_back(&*earlier);
    for (auto& name : earlier->names()) names.push_back(std::move(name));
  }
  const auto jobs = ask(names, slurm);
  const bool is_same = earlier && earlier->work.arguments == submission.work.arguments;
  const std::string array = id_of(jobs, JobKind::task, both), merge = id_of(jobs, JobKind::merge, both),
                    report = id_of(jobs, JobKind::report, both);
  if (!array.empty() || !merge.empty()) {
    if (!is_same || earlier->is_cancelled) {
      throw ConfigError(folder.string() + ": jobs of " + (is_same ? "a cancelled" : "another") +
                        " command are in the queue for this folder; wait for them, or run `weft cancel " +
                        submission.work.results.string() + "`");
    }
    submission = std::move(*earlier);
    // What a call that was killed between sbatch and its record has submitted.
    if (submission.array.empty()) submission.array = array;
    if (submission.merge.empty()) submission.merge = merge;
    if (submission.report.empty()) submission.report = report;
    submission.save();
    submit_missing(submission, slurm);
    return SubmitEnd::followed;
  }
  const bool is_there = submission.work.is_shared() ? submission.work.left == 0 : submission.there > 0;
  if (is_same && is_there && job_states(*earlier, jobs).is_done()) {
    submission = std::move(*earlier);
    return SubmitEnd::nothing_left;
  }
  prepare();
  submission.there = unit_files_there(submission.work);  // rows that are to be run again are gone
  for (const JobKind kind : {JobKind::task, JobKind::merge, JobKind::report}) {
    if (kind == JobKind::merge && !submission.scripts.is_shared) continue;
    const auto tasks = std::max<std::int64_t>(1, submission.tasks);
    write_text(folder / JobScripts::file_name(kind), submission.scripts.text(kind, tasks));
  }
  submission.save();
  submit_missing(submission, slurm);
  return SubmitEnd::submitted;
}

}  // namespace weft
