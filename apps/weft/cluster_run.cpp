#include "cluster_run.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <set>
#include <thread>

#include "cluster/job_states.hpp"
#include "output.hpp"
#include "processes/worker_process.hpp"
#include "progress_line.hpp"
#include "sdk/listed.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

/// Where profiles are looked for, in order.
std::vector<fs::path> profile_folders(const fs::path& results) {
  std::vector<fs::path> folders = {results / "slurm", fs::path("configs") / "slurm",
                                   tree_of_weft() / "share/weft/configs/slurm"};
  const char *config = std::getenv("XDG_CONFIG_HOME"), *home = std::getenv("HOME");
  if (config != nullptr && *config != '\0')
    folders.push_back(fs::path(config) / "weft");
  else if (home != nullptr)
    folders.push_back(fs::path(home) / ".config/weft");
  return folders;
}

/// The words of this call that its tasks get: all but those about the cluster and about what is printed here. Rows that are
/// to be run again are removed when the work is planned, so that a task that starts late does not do it once more.
std::vector<std::string> words_of_tasks(const std::vector<std::string>& words, bool keeps_retry) {
  const auto is = [](const std::string& word, const std::string& name) {
    return word == name || word.starts_with(name + "=");
  };
  std::vector<std::string> kept;
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (is(words[i], "--on")) {
      if (words[i] == "--on") ++i;  // its value
    } else if (words[i] == "--dry-run" || words[i] == "--detach" || words[i] == "--json" || words[i] == "--quiet") {
      continue;
    } else if (is(words[i], "--retry-failed") && !keeps_retry) {
      continue;
    } else {
      kept.push_back(words[i]);
    }
  }
  return kept;
}

/// Waits for the next look. @return false if the user asked to stop.
bool wait_seconds(const Context& context, double seconds) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  while (std::chrono::steady_clock::now() < end) {
    if (*context.cancel_flag()) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  return !*context.cancel_flag();
}

void print_log(const Context& context, const fs::path& log) {
  if (context.quiet || context.json) return;
  std::ifstream stream(log, std::ios::binary);
  if (stream) std::cout << stream.rdbuf() << std::flush;
  std::cout.clear();  // an empty file sets the fail bit
}

/// Follows the jobs until none is left. @return the exit code.
int follow(const Context& context, const Submission& submission, const Slurm& slurm) {
  const std::string folder = submission.work.results.string();
  ProgressLine line(context);
  std::set<std::string> said;
  JobStates states;
  for (;;) {
    std::string problem;
    const auto jobs = slurm.jobs(submission.names(), problem);
    if (jobs) keep_ended_jobs(submission, *jobs);
    states = job_states(submission, jobs);
    for (const auto& trouble : states.troubles) {
      if (!said.insert(trouble).second) continue;
      line.end();
      context.complain(trouble);
    }
    line.show(progress_text(states) + (jobs ? "" : "; Slurm does not answer: " + problem));
    if (states.is_over) break;
    if (!wait_seconds(context, static_cast<double>(submission.scripts.profile.poll_s))) {
      line.end();
      context.say("the jobs go on; `weft status " + folder + "` shows them, `weft cancel " + folder + "` ends them");
      return 1;
    }
  }
  line.end();
  const bool is_shared = submission.scripts.is_shared;
  print_log(context, is_shared ? submission.scripts.log(JobKind::merge, submission.merge)
                               : submission.scripts.log(JobKind::task, submission.array + "_1"));
  if (context.json)
    context.output() << states_json(submission, states);
  else
    context.say(status_text(submission, states));
  return states.is_done() ? 0 : 1;
}

/// Whether jobs that are in the queue were submitted with the profile of this call, as far as its name and their script tell
/// it. Its `tasks` are not seen there.
bool has_profile_of(const Submission& submission, const Submission& call) {
  if (submission.profile_name != call.profile_name) return false;
  if (submission.submitted_as != call.work.results) return true;  // by another path, so the whole script differs
  JobScripts wanted = call.scripts;
  wanted.working_folder = submission.scripts.working_folder;
  wanted.default_program = submission.scripts.default_program;
  const JobKind kind = submission.tasks > 0 ? JobKind::task : JobKind::merge;
  std::ifstream stream(submission.scripts.folder / JobScripts::file_name(kind), std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(stream), {}};
  return text.empty() || text == wanted.text(kind, submission.tasks);
}

fs::path plan_file(const fs::path& results, const std::string& label) {
  return cluster_folder(results) / label / "identity.json";
}

}  // namespace

void add_cluster_options(CLI::App& command, ClusterOptions& options) {
  auto* on = command.add_option("--on", options.on, "Run on a cluster: slurm, or slurm:PROFILE, such as slurm:short")
                 ->type_name("SYSTEM[:PROFILE]");
  command
      .add_flag("--dry-run", options.dry_run, "With --on: print the scripts of the jobs, and submit and write nothing")
      ->needs(on);
  command.add_flag("--detach", options.detach, "With --on: end as soon as the jobs are submitted")->needs(on);
}

ClusterWork single_work(const std::string& command, const std::string& label, const fs::path& result) {
  ClusterWork work;
  work.command = command;
  work.label = label;
  work.results = result.has_parent_path() ? result.parent_path() : fs::path(".");
  work.files.result = result;
  return work;
}

std::int64_t ranks_of_profile(const ClusterOptions& options, const ClusterWork& work) {
  return read_cluster_choice(options.on, profile_folders(work.results)).profile.ranks;
}

int run_on_cluster(const Context& context, const ClusterOptions& options, ClusterWork work,
                   const std::function<void()>& prepare) {
  const auto has = [&](const char* word) {
    return std::find(context.words.begin(), context.words.end(), word) != context.words.end();
  };
  if (has("--share")) throw ConfigError("--share is what the tasks of --on do; leave it out");
  if (has("--fail-fast"))
    throw ConfigError("--fail-fast ends one process, and the other tasks of --on would go on; leave it out");
  work.arguments = words_of_tasks(context.words, work.command == "generate");
  const ClusterChoice choice = read_cluster_choice(options.on, profile_folders(work.results));
  Submission submission(std::move(work), choice, this_program({}).front());
  if (options.dry_run) {
    context.say(dry_run_text(submission));
    return 0;
  }
  const Slurm slurm;
  Context::catch_signals();
  const Submission call = submission;
  const SubmitEnd end = submit(submission, slurm, prepare, context.cancel_flag());
  const std::string folder = submission.work.results.string();
  if (end == SubmitEnd::nothing_left) {
    context.say("everything is there; nothing was submitted: " + folder);
    return 0;
  }
  context.say((end == SubmitEnd::followed ? "the jobs are in the queue already: " : "submitted jobs ") +
              listed(submission.ids()) + "; scripts and logs in " + submission.scripts.folder.string());
  if (end == SubmitEnd::followed && !has_profile_of(submission, call)) {
    context.complain(
        "the jobs keep what they were submitted with, " +
        (submission.profile_name.empty() ? "the default profile" : "the profile " + submission.profile_name) +
        " as it was then; to change it, run `weft cancel " + folder + "` and this command again");
  }
  if (options.detach) {
    context.say("`weft status " + folder + "` shows them, `weft cancel " + folder + "` ends them");
    return 0;
  }
  return follow(context, submission, slurm);
}

void write_planned_identity(const fs::path& results, const std::string& label, const Identity& identity) {
  make_writable_folder(plan_file(results, label).parent_path());
  write_text(plan_file(results, label), identity.to_json());
}

Identity planned_identity(const fs::path& results, const std::string& label) {
  const auto text = whole_text_if_there(plan_file(results, label));
  if (!text) return {};
  try {
    return Identity::from_json(*text);
  } catch (const Error& error) {
    throw ConfigError(plan_file(results, label).string() + ": " + error.what());
  }
}

}  // namespace weft::app
