#include "cluster/slurm.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdlib>
#include <sstream>
#include <utility>

#include "processes/child_process.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

constexpr double kPatience = 120.0;  ///< s; Slurm's commands give up by themselves before

bool is_in_path(const std::string& program) {
  const char* path = std::getenv("PATH");
  std::istringstream folders(path != nullptr ? path : "/usr/bin:/bin");
  for (std::string folder; std::getline(folders, folder, ':');)
    if (::access((fs::path(folder.empty() ? "." : folder) / program).c_str(), X_OK) == 0) return true;
  return false;
}

struct ToolEnd {
  bool is_good = false;
  std::string output, errors;
};

ToolEnd run_tool(std::vector<std::string> words) {
  const std::string name = words.front();
  ChildOptions options;
  options.command = std::move(words);
  options.keep_errors = true;
  ChildProcess child(options);
  child.close_input();
  ToolEnd end;
  const auto deadline = seconds_from_now(kPatience);
  std::string line;
  for (ChildProcess::Outcome outcome; (outcome = child.read_line(line, deadline)) != ChildProcess::Outcome::ended;) {
    if (outcome != ChildProcess::Outcome::done) {
      end.errors = name + " did not end within " + std::to_string(static_cast<int>(kPatience)) + " s";
      return end;
    }
    end.output += line + '\n';
  }
  end.output += child.unread();
  const auto how = child.wait_until(deadline);
  end.errors = child.errors();
  while (!end.errors.empty() && std::isspace(static_cast<unsigned char>(end.errors.back())) != 0) end.errors.pop_back();
  end.is_good = how && how->exit_code == 0;
  if (!end.is_good && end.errors.empty()) end.errors = name + " " + (how ? how->text() : std::string("did not end"));
  return end;
}

}  // namespace

int SlurmJob::task() const {
  const auto mark = id.find('_');
  return mark == std::string::npos ? 0 : std::atoi(id.c_str() + mark + 1);
}

bool SlurmJob::has_ended() const {
  static constexpr std::array kGoingOn = {"PENDING",   "RUNNING",     "CONFIGURING",  "COMPLETING", "SUSPENDED",
                                          "REQUEUED",  "REQUEUE_FED", "REQUEUE_HOLD", "RESIZING",   "SIGNALING",
                                          "STAGE_OUT", "STOPPED",     "RESV_DEL_HOLD"};
  return std::find(kGoingOn.begin(), kGoingOn.end(), state) == kGoingOn.end();
}

std::vector<SlurmJob> parse_squeue(const std::string& text) {
  std::vector<SlurmJob> jobs;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream fields(line);
    SlurmJob job;
    if (std::getline(fields, job.id, '|') && std::getline(fields, job.name, '|') &&
        std::getline(fields, job.state, '|') && std::getline(fields, job.node, '|')) {
      std::getline(fields, job.reason);
      jobs.push_back(std::move(job));
    }
  }
  return jobs;
}

std::string slurm_failure_text(const SlurmJob& job) {
  static constexpr std::array<std::pair<const char*, const char*>, 9> kTexts{{
      {"NODE_FAIL", "its node failed"},
      {"TIMEOUT", "it reached its time limit and did not end when it was asked to"},
      {"OUT_OF_MEMORY", "it used more memory than it had asked for"},
      {"PREEMPTED", "another job took its place"},
      {"DEADLINE", "its deadline passed"},
      {"BOOT_FAIL", "its node did not boot"},
      {"CANCELLED", "it was cancelled"},
      {"REVOKED", "it was revoked"},
      {"FAILED", "it failed"},
  }};
  for (const auto& [state, text] : kTexts) {
    if (job.state != state) continue;
    // The reason of a cancelled job is why it was waiting before.
    const bool says_more =
        !job.reason.empty() && job.reason != "None" && job.reason != "NonZeroExitCode" && job.state != "CANCELLED";
    return says_more ? std::string(text) + " (" + job.reason + ")" : text;
  }
  return "";
}

Slurm::Slurm() {
  for (const char* program : {"sbatch", "squeue", "scontrol", "scancel"}) {
    if (!is_in_path(program))
      throw ConfigError("--on slurm: " + std::string(program) +
                        " is not in PATH; run this on a machine of the cluster from which jobs are submitted");
  }
}

std::string Slurm::submit(const fs::path& script, const std::vector<std::string>& options) const {
  std::vector<std::string> words = {"sbatch", "--parsable"};
  words.insert(words.end(), options.begin(), options.end());
  words.push_back(script.string());
  const ToolEnd end = run_tool(words);
  if (!end.is_good) {
    const bool is_array = end.errors.find("Invalid job array specification") != std::string::npos;
    throw Error("sbatch refused " + script.string() + ": " + end.errors +
                (is_array
                     ? "; an array has fewer tasks than Slurm's MaxArraySize (1001 unless an administrator raised it): "
                       "lower `tasks` of the profile"
                     : ""));
  }
  const std::string id = end.output.substr(0, end.output.find_first_of(";\n"));
  if (id.empty() || id.find_first_not_of("0123456789") != std::string::npos)
    throw Error("sbatch answered '" + end.output + "' to " + script.string() + ", must be the number of a job");
  return id;
}

std::optional<std::vector<SlurmJob>> Slurm::jobs(const std::vector<std::string>& names, std::string& problem) const {
  std::string list;
  for (const auto& name : names) list += (list.empty() ? "" : ",") + name;
  const ToolEnd end = run_tool(
      {"squeue", "--me", "--noheader", "--array", "--states=all", "--name=" + list, "--format", kSqueueFormat});
  if (end.is_good) return parse_squeue(end.output);
  problem = end.errors;
  return std::nullopt;
}

void Slurm::cancel(const std::vector<std::string>& ids) const {
  std::vector<std::string> words = {"scancel", "--quiet"};
  words.insert(words.end(), ids.begin(), ids.end());
  const ToolEnd end = run_tool(words);
  if (!end.is_good) throw Error("scancel: " + end.errors);
}

}  // namespace weft
