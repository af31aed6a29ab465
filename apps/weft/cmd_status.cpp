#include <algorithm>
#include <nlohmann/json.hpp>

#include "cluster/job_states.hpp"
#include "commands.hpp"
#include "options.hpp"
#include "sdk/listed.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

/// The submissions of a folder, or of the folder that a model file lies in. @throws ConfigError without any.
std::vector<Submission> submissions_of(const std::string& given) {
  const fs::path folder = fs::is_regular_file(given) ? fs::absolute(given).parent_path() : fs::path(given);
  if (!fs::is_directory(folder)) throw ConfigError(folder.string() + ": no such folder");
  auto all = read_submissions(folder);
  if (all.empty())
    throw ConfigError(folder.string() + ": no jobs were submitted for it; `weft ablate ... --on slurm` would do so");
  return all;
}

int status(const Context& context, const std::string& folder) {
  std::optional<Slurm> slurm;
  std::string problem;
  try {
    slurm.emplace();
  } catch (const ConfigError& error) {
    problem = error.what();
  }
  bool is_well = true;
  auto all = nlohmann::ordered_json::array();
  for (const Submission& submission : submissions_of(folder)) {
    std::optional<std::vector<SlurmJob>> jobs;
    if (slurm) jobs = slurm->jobs(submission.names(), problem);
    if (jobs) keep_ended_jobs(submission, *jobs);
    const JobStates states = job_states(submission, jobs);
    is_well = is_well && (states.is_done() || !states.is_over);
    std::string text = status_text(submission, states);
    if (!jobs) text += "  Slurm does not answer, so this is what the jobs wrote themselves: " + problem + "\n";
    text.pop_back();
    context.say(text);
    all.push_back(nlohmann::ordered_json::parse(states_json(submission, states)));
  }
  if (context.json) context.output() << all.dump(2) << '\n';
  return is_well ? 0 : 1;
}

int cancel(const Context& context, const std::string& folder) {
  const Slurm slurm;
  Context::catch_signals();
  for (const Submission& seen : submissions_of(folder)) {
    // Not while its jobs are being submitted: those that follow would go on.
    Claims claims(seen.scripts.folder / "claims");
    claim_submission(claims, seen.scripts.folder, context.cancel_flag());
    auto now = read_submission(seen.scripts.folder);
    if (!now) continue;
    Submission& submission = *now;
    std::string problem;
    const auto jobs = slurm.jobs(submission.names(), problem);
    if (!jobs) throw Error("Slurm does not answer: " + problem);
    keep_ended_jobs(submission, *jobs);
    std::vector<std::string> going;
    for (const auto& job : *jobs)
      if (!job.has_ended() && std::find(going.begin(), going.end(), job.job()) == going.end())
        going.push_back(job.job());
    if (going.empty()) {
      context.say(submission.work.command + ": no job is in the queue");
      continue;
    }
    submission.is_cancelled = true;
    submission.save();
    slurm.cancel(going);
    context.say(submission.work.command + ": cancelled " + listed(going) +
                "; what is there stays, and the same command goes on");
  }
  return 0;
}

}  // namespace

void register_status(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("status", "What has become of work that was submitted with --on");
  add_output_options(*command, context);
  auto folder = std::make_shared<std::string>();
  command->add_option("folder", *folder, "Folder of the results, or the model file")->required();
  command->callback([&context, folder] { context.action = [&context, folder] { return status(context, *folder); }; });
}

void register_cancel(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("cancel", "End the jobs that were submitted with --on; results stay");
  add_output_options(*command, context);
  auto folder = std::make_shared<std::string>();
  command->add_option("folder", *folder, "Folder of the results, or the model file")->required();
  command->callback([&context, folder] { context.action = [&context, folder] { return cancel(context, *folder); }; });
}

}  // namespace weft::app
