#include "ranks.hpp"

#include <sys/prctl.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <csignal>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string_view>

#include "processes/child_process.hpp"
#include "processes/worker_process.hpp"

namespace weft::app {
namespace {

constexpr int kMostRanks = 256;                       // as many as there may be parts of a batch
constexpr double kTimeToEnd = 30.0;                   // s, for the ranks that are left when one has died
constexpr const char* kParent = "WEFT_RANKS_PARENT";  // set for ranks that `weft train --ranks` started

std::optional<std::string> variable(const char* name) {
  const char* value = std::getenv(name);
  return value != nullptr && *value != '\0' ? std::optional<std::string>(value) : std::nullopt;
}

/// @throws ConfigError if the variable is not set to a number in [least, most].
int number_in_variable(const char* name, int least, int most) {
  const std::string text = variable(name).value_or("");
  int number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size() || number < least || number > most) {
    throw ConfigError("environment variable " + std::string(name) + " = '" + text + "', must be a number in [" +
                      std::to_string(least) + ", " + std::to_string(most) + "]");
  }
  return number;
}

/// How a launcher tells its processes who they are.
struct Launcher {
  const char *rank, *size;
  std::vector<const char*> job;  ///< variables that tell one start from all others
  const char *local, *wanted;    ///< variables that are equal when all ranks are on one machine; wanted may be a number
};

const std::vector<Launcher>& launchers() {
  static const std::vector<Launcher> all{
      {"WEFT_RANK", "WEFT_RANKS", {"WEFT_RANKS_JOB"}, kParent, kParent},
      {"OMPI_COMM_WORLD_RANK",
       "OMPI_COMM_WORLD_SIZE",
       {"PMIX_NAMESPACE"},
       "OMPI_COMM_WORLD_LOCAL_SIZE",
       "OMPI_COMM_WORLD_SIZE"},
      // In a batch script that runs without srun there are SLURM_PROCID and SLURM_NTASKS, but only one process.
      {"SLURM_PROCID",
       "SLURM_STEP_NUM_TASKS",
       {"SLURM_JOB_ID", "SLURM_STEP_ID", "SLURM_RESTART_COUNT"},
       "SLURM_STEP_NUM_NODES",
       "1"},
  };
  return all;
}

}  // namespace

FitRanks ranks_of_process(const std::filesystem::path& model) {
  FitRanks ranks;
  const auto is_ours = [](const Launcher& one) { return variable(one.rank) && variable(one.size); };
  const auto launcher = std::find_if(launchers().begin(), launchers().end(), is_ours);
  if (launcher == launchers().end()) return ranks;
  ranks.size = number_in_variable(launcher->size, 1, kMostRanks);
  if (ranks.size == 1) return {};
  ranks.rank = number_in_variable(launcher->rank, 0, ranks.size - 1);
  std::string job;
  for (const char* name : launcher->job) job += "-" + variable(name).value_or("0");
  for (char& c : job) {
    if (std::string_view("./\\ \t\n").find(c) != std::string_view::npos) c = '_';
  }
  const std::filesystem::path folder = model.has_parent_path() ? model.parent_path() : ".";
  ranks.meeting = folder / ("." + model.filename().string() + ".ranks" + job);
  const auto local = variable(launcher->local);
  ranks.is_one_machine = local && local == variable(launcher->wanted).value_or(launcher->wanted);
  ranks.interface = variable("WEFT_INTERFACE").value_or("");
  if (variable(kParent)) ::prctl(PR_SET_PDEATHSIG, SIGTERM);
  return ranks;
}

int run_ranks(const Context& context, const std::vector<std::string>& arguments, int ranks,
              const std::function<bool()>& cancelled) {
  if (ranks > kMostRanks)
    throw ConfigError("--ranks " + std::to_string(ranks) + ", must be at most " + std::to_string(kMostRanks));
  const std::string job = std::to_string(::getpid());
  std::vector<std::unique_ptr<ChildProcess>> children;
  for (int r = 0; r < ranks; ++r) {
    ChildOptions options;
    options.command = this_program(arguments);
    if (r > 0) options.command.emplace_back("--quiet");
    options.environment = {{"WEFT_RANK", std::to_string(r)},
                           {"WEFT_RANKS", std::to_string(ranks)},
                           {"WEFT_RANKS_JOB", job},
                           {kParent, job}};
    options.own_group = true;  // ^C comes here; they get a SIGTERM, after which they stop between two iterations
    children.push_back(std::make_unique<ChildProcess>(options));
    children.back()->close_input();
    if (r > 0) children.back()->close_output();
  }
  std::vector<std::optional<ChildEnd>> ends(children.size());
  std::optional<MonotonicTime> give_up;
  const auto failed = [](const std::optional<ChildEnd>& end) { return end && end->exit_code != 0; };
  bool is_told = false, has_output = true;
  while (std::any_of(ends.begin(), ends.end(), [](const auto& end) { return !end; })) {
    if (has_output) {
      std::string line;
      const auto outcome = children.front()->read_line(line, seconds_from_now(0.2));
      has_output = outcome == ChildProcess::Outcome::done || outcome == ChildProcess::Outcome::late;
      if (outcome == ChildProcess::Outcome::done) {
        if (context.json)
          Context::output() << line << '\n';
        else
          context.say(line);
        continue;
      }
    }
    const bool is_over = give_up && std::chrono::steady_clock::now() > *give_up;
    for (std::size_t r = 0; r < children.size(); ++r) {
      if (ends[r]) continue;
      if (is_over) children[r]->kill(SIGKILL);
      ends[r] = children[r]->wait_until(seconds_from_now(has_output ? 0.0 : 0.05));
      if (!failed(ends[r])) continue;
      if (ends[r]->signal != 0 && !is_over) context.complain("rank " + std::to_string(r) + " " + ends[r]->text());
      if (!give_up) give_up = seconds_from_now(kTimeToEnd);
    }
    if (cancelled() && !is_told) {
      is_told = true;
      for (const auto& child : children) child->kill(SIGTERM);
    }
  }
  if (ends.front()->exit_code > 0) return ends.front()->exit_code;
  return std::any_of(ends.begin(), ends.end(), failed) ? 1 : 0;
}

}  // namespace weft::app
