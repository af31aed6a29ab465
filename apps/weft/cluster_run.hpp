#pragma once
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "cluster/submission.hpp"
#include "context.hpp"
#include "identity/identity.hpp"

namespace weft::app {

/// The options of commands that may run on a cluster.
struct ClusterOptions {
  std::string on;        ///< --on slurm[:PROFILE]
  bool dry_run = false;  ///< --dry-run
  bool detach = false;   ///< --detach

  bool is_given() const { return !on.empty(); }
};
void add_cluster_options(CLI::App& command, ClusterOptions& options);

/// A command that is one unit of work. @param result the file without which it is not done; its folder has the results.
ClusterWork single_work(const std::string& command, const std::string& label, const std::filesystem::path& result);

/// The ranks that the profile of --on asks for. @throws as read_cluster_choice().
std::int64_t ranks_of_profile(const ClusterOptions& options, const ClusterWork& work);

/// Submits a command's work, unless its jobs are in the queue already, and follows it until it ends.
/// @param work without `arguments`: they are those of this call. @param prepare writes what the tasks need to find, after
/// everything was checked. @return the command's exit code.
int run_on_cluster(const Context& context, const ClusterOptions& options, ClusterWork work,
                   const std::function<void()>& prepare);

/// What was planned for work on a cluster belongs to an identity, so that every machine takes the same numeric variants: it
/// is kept beside the scripts of the jobs. @param label of the work.
void write_planned_identity(const std::filesystem::path& results, const std::string& label, const Identity& identity);
/// Unknown if nothing was planned.
Identity planned_identity(const std::filesystem::path& results, const std::string& label);

}  // namespace weft::app
