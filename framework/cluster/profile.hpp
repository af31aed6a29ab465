#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "weft/params.hpp"

namespace weft {

/// What one asks a cluster for, and how weft is started there: a file `NAME.yaml`. Every number that is 0 and every text
/// that is empty leaves the choice to the cluster.
struct ClusterProfile {
  std::string description, partition, account, qos, constraint;
  std::int64_t time_limit_min = 0, memory_mb = 0, cpus = 1;
  std::int64_t tasks = 16, tasks_at_a_time = 0, ranks = 1;
  std::int64_t grace_s = 60, restarts = 20, poll_s = 10;
  std::vector<std::string> sbatch, modules, setup, environment;
  std::string launcher, container, program;

  template <class Visitor>
  void visit(Visitor& v) {
    v("description", description, "A description of the profile for people.");
    v("partition", partition, "Partition of the jobs; empty: the cluster's default.");
    v("account", account, "Account that pays for them; empty: the user's default.");
    v("qos", qos, "Quality of service; empty: the default.");
    v("constraint", constraint, "Features that the nodes must have, such as avx2; empty: any node.");
    v("time_limit_min", time_limit_min, range(0, 1000000, "min"),
      "Time limit of one start of a task, which goes on in another one; 0: the partition's default.");
    v("memory_mb", memory_mb, range(0, 100000000, "MB"), "Memory of a task; 0: the partition's default.");
    v("cpus", cpus, range(1, 1024), "Processors of a task, and so cells or examples that it works on at a time.");
    v("tasks", tasks, range(1, 100000), "Array tasks at most; there are never more than units of work.");
    v("tasks_at_a_time", tasks_at_a_time, range(0, 100000), "Array tasks that may run at the same time; 0: all.");
    v("ranks", ranks, range(1, 256), "Processes of `weft train`, each with `cpus` processors.");
    v("grace_s", grace_s, range(10, 3600, "s"),
      "Slurm asks a task to end this long before its time limit; it is then started again.");
    v("restarts", restarts, range(0, 10000), "Starts of a task after its first one, at most.");
    v("poll_s", poll_s, range(1, 3600, "s"), "weft asks Slurm this often while it follows the jobs.");
    v("sbatch", sbatch, "Further options of sbatch, one a line of the script, such as --exclude=n7.");
    v("modules", modules, "Environment modules that are loaded first.");
    v("setup", setup, "Lines of shell that are run before weft.");
    v("environment", environment, "Environment variables, NAME=VALUE.");
    v("launcher", launcher, "Words before the command, such as srun; empty: none, but srun for more than one rank.");
    v("container", container, "Words that start a program in a container, such as apptainer exec weft.sif.");
    v("program", program, "weft as it is called on the nodes; empty: the file of the program that submits.");
  }
};

/// What `--on` names.
struct ClusterChoice {
  std::string profile_name;            ///< empty: no file, all defaults
  std::filesystem::path profile_file;  ///< empty: all defaults
  ClusterProfile profile;
};
/// Reads `slurm` or `slurm:PROFILE`. PROFILE is the path of a file if it has a slash or ends in .yaml. Otherwise PROFILE.yaml
/// is looked for in `folders`, in order. `slurm` alone takes `default.yaml` if one of them has it.
/// @throws ConfigError for another system, for a profile that is not found (naming those that are), and for wrong keys.
ClusterChoice read_cluster_choice(const std::string& on, const std::vector<std::filesystem::path>& folders);

}  // namespace weft
