#pragma once
#include <filesystem>
#include <optional>

namespace weft {

/// Processors that this program may use, at least 1: those of its affinity mask (taskset, cpusets), and no more than its
/// control groups' quota of CPU time allows, rounded up (containers, systemd, Slurm).
int allowed_processors();

/// The quota of CPU time of this process, in processors: the least one of its control group and the groups around it,
/// version 1 or 2. nullopt: no limit, or no control groups.
/// @param root where the system's /proc and /sys lie; "/" but in tests.
std::optional<double> processor_quota(const std::filesystem::path& root = "/");

}  // namespace weft
