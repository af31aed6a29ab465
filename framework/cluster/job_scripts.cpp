#include "cluster/job_scripts.hpp"

#include <algorithm>
#include <cctype>
#include <string_view>

#include "processes/shell_word.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

/// A file name in which Slurm fills in what a percent sign begins.
std::string without_patterns(const std::string& path) {
  std::string text;
  for (const char c : path) text += c == '%' ? std::string("%%") : std::string(1, c);
  return text;
}

std::string option(const std::string& name, const std::string& value) {
  return "#SBATCH --" + name + "=" + shell_word(value) + "\n";
}
std::string option_if(const std::string& name, const std::string& value) {
  return value.empty() ? "" : option(name, value);
}
std::string option_if(const std::string& name, std::int64_t value) {
  return value == 0 ? "" : option(name, std::to_string(value));
}

/// Passes SIGTERM on to weft, which is the child.
constexpr const char* kAskChild = R"(ask_to_end() { kill -TERM "$child" 2>/dev/null; }
)";
/// srun, which is the child, kills its processes when it gets SIGTERM. scancel signals them, and not this script.
constexpr const char* kAskStep =
    R"(ask_to_end() { scancel --quiet --signal=TERM "$id" || kill -TERM "$child" 2>/dev/null; }
)";

/// Runs weft, asks it to end when SIGTERM comes, and decides by its exit code. What is run comes as the function `work`.
constexpr const char* kRun = R"(stops=0
child=
trap 'stops=$((stops + 1)); if [ -n "$child" ]; then ask_to_end; fi' TERM
kills=0
while :; do
  if [ "$stops" -gt 0 ]; then code=75; break; fi  # before it began
  work &
  child=$!
  if [ "$stops" -gt 0 ]; then ask_to_end; fi  # the signal came between these two lines
  while :; do  # wait also ends when a signal comes
    seen=$stops
    wait "$child"
    code=$?
    if [ "$seen" = "$stops" ]; then break; fi
  done
  child=
  # Ended from outside, such as by the kernel when the memory was full: it starts again here, three times at most.
  if [ "$code" -le 128 ] || [ "$stops" -gt 0 ] || [ "$kills" -ge 3 ]; then break; fi
  kills=$((kills + 1))
  record "killed signal=$((code - 128)) node=$node"
  echo "weft was ended by signal $((code - 128)) from outside; it starts again"
done
record "ended code=$code stops=$stops node=$node"
if [ "$code" = 75 ] || { [ "$stops" -gt 0 ] && [ "$code" != 0 ] && [ "$code" != 3 ]; }; then
  if [ "$restart" -ge "$most_restarts" ]; then
    record "gave-up restarts=$restart"
    echo "asked to end again, after $restart restarts, as many as the profile allows"
    exit 1
  fi
  for _ in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do  # slurmctld may be away for a while
    state=$(squeue --noheader --format=%T --jobs="$id" 2>/dev/null)
    if [ "$state" = RUNNING ]; then
      record "requeued node=$node"
      echo "asked to end, as before a time limit: this task goes back to the queue"
      if scontrol requeue "$id"; then sleep 60; fi  # Slurm ends this script
    elif [ -n "$state" ]; then
      break  # Slurm ends it: it was cancelled, or Slurm itself starts it again
    fi
    sleep 2
  done
  exit 75
fi
)";

constexpr const char* kAfterTask = R"(if [ "$code" = 0 ]; then
  # All is there. Tasks that have not started have nothing to do.
  : 2>/dev/null >>"$folder/tasks/$SLURM_ARRAY_JOB_ID.all-done"
  scancel --quiet --state=PENDING "$SLURM_ARRAY_JOB_ID"
fi
if [ "$code" = 3 ]; then code=0; fi  # other tasks are at work on the rest
)";

}  // namespace

std::string JobScripts::job_name(JobKind kind) const {
  if (kind == JobKind::task) return name;
  return name + (kind == JobKind::merge ? "-merge" : "-report");
}

std::string JobScripts::file_name(JobKind kind) {
  if (kind == JobKind::task) return "array.sh";
  return kind == JobKind::merge ? "merge.sh" : "report.sh";
}

fs::path JobScripts::log(JobKind kind, const std::string& id) const {
  const std::string begin = kind == JobKind::task ? "task-" : kind == JobKind::merge ? "merge-" : "report-";
  return folder / "logs" / (begin + id + ".log");
}

fs::path JobScripts::record(const std::string& id) const { return folder / "tasks" / (id + ".txt"); }

std::string JobScripts::text(JobKind kind, std::int64_t tasks) const {
  const bool is_task = kind == JobKind::task, is_report = kind == JobKind::report;
  const bool many_ranks = is_task && has_ranks && profile.ranks > 1;
  std::string s = "#!/bin/bash\n# weft " + command + ": ";
  if (is_task)
    s += is_shared ? "the tasks of an array, each of which does work that no other one has claimed" : "the work";
  if (kind == JobKind::merge) s += "after the array, what no task has done, and the tables";
  if (is_report) s += "after all others, what became of them";
  s += ". Submitted with `sbatch`.\n";
  s += option("job-name", job_name(kind));
  if (is_task) {
    const std::string limit = profile.tasks_at_a_time > 0 ? "%" + std::to_string(profile.tasks_at_a_time) : "";
    s += option("array", "1-" + std::to_string(tasks) + limit);
  }
  const std::string pattern = is_task ? "%A_%a" : "%j";
  s += option("output", without_patterns((folder / "logs").string()) + "/" + log(kind, pattern).filename().string());
  s += "#SBATCH --open-mode=append\n#SBATCH --requeue\n";
  s += option_if("partition", profile.partition) + option_if("account", profile.account);
  s += option_if("qos", profile.qos) + option_if("constraint", profile.constraint);
  const std::int64_t minutes = is_report && profile.time_limit_min > 0
                                   ? std::min<std::int64_t>(10, profile.time_limit_min)
                                   : profile.time_limit_min;
  s += option_if("time", minutes);
  if (!is_report) s += option("signal", "B:TERM@" + std::to_string(profile.grace_s));
  s += option_if("mem", profile.memory_mb);
  s += option("ntasks", std::to_string(many_ranks ? profile.ranks : 1));
  s += option("cpus-per-task", std::to_string(is_report ? 1 : profile.cpus));
  for (const auto& line : profile.sbatch) s += "#SBATCH " + line + "\n";

  s += "\nset -u\nfolder=" + shell_word(folder.string()) + "\n";
  s += is_task ? "id=${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}\n" : "id=$SLURM_JOB_ID\n";
  s += "node=${SLURMD_NODENAME:-$(hostname)}\nrestart=${SLURM_RESTART_COUNT:-0}\n";
  s += "most_restarts=" + std::to_string(profile.restarts) + "\n";
  s += "record() { printf '%s\\n' \"$*\" 2>/dev/null >>\"$folder/tasks/$id.txt\"; }\n";
  s += "record \"began restart=$restart node=$node\"\n\n";
  s += "export TMPDIR=${SLURM_TMPDIR:-${TMPDIR:-/tmp}}\n";
  s += "if [ ! -w \"$TMPDIR\" ]; then TMPDIR=/tmp; fi  # the folder of the machine that submitted\n";
  for (const auto* list : {&environment, &profile.environment}) {
    for (const auto& line : *list) {
      const auto mark = line.find('=');
      s += "export " + line.substr(0, mark) + "=" + shell_word(line.substr(mark + 1)) + "\n";
    }
  }
  s += R"(fail() { echo "error: $*"; record "ended code=1 stops=0 node=$node"; exit 1; })"
       "\n";
  s += "set +u\n";  // modules and people's lines read variables that are not set
  for (const auto& module : profile.modules)
    s += "module load " + shell_word(module) + " || fail " + shell_word("module load " + module + " failed") + "\n";
  for (const auto& line : profile.setup) s += line + "\n";
  s += "set -u\n";
  s += "cd " + shell_word(working_folder.string()) + " || fail " +
       shell_word("this node has no folder " + working_folder.string()) + "\n";

  std::string words = profile.launcher;
  if (is_report) words.clear();
  if (many_ranks && words.empty()) words = "srun";
  const bool is_srun = words == "srun" || words.starts_with("srun ");
  // srun does not take it over from the job.
  if (is_srun) s += "export SRUN_CPUS_PER_TASK=${SLURM_CPUS_PER_TASK:-" + std::to_string(profile.cpus) + "}\n";
  if (!profile.container.empty()) words += (words.empty() ? "" : " ") + profile.container;
  words += (words.empty() ? "" : " ") + shell_word(profile.program.empty() ? default_program : profile.program);
  if (is_report) {
    s += words + " status " + shell_word(results.string()) + "\n";
    s += "record \"ended code=$? stops=0 node=$node\"\n";
    return s;
  }
  for (const auto& argument : arguments) words += " " + shell_word(argument);
  if (is_task && is_shared) words += " --share";
  s += "work() { exec " + words + "; }\n\n" + (is_srun ? kAskStep : kAskChild) + kRun;
  if (is_task && is_shared) s += kAfterTask;
  s += "exit \"$code\"\n";
  return s;
}

}  // namespace weft
