#pragma once
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

namespace weft {

/// Processors that this program may use, at least 1: those of its affinity mask (taskset, cpusets), and no more than its
/// control groups' quota of CPU time allows, rounded up (containers, systemd), and than Slurm gave to it.
int allowed_processors();

/// The processor of this machine and what of its instruction set decides weft's speed: "Intel(R) Xeon(R) ... (AVX2, AVX-512)".
std::string processor_name();

/// What Slurm gave to the task that this program runs in: SLURM_CPUS_PER_TASK, or SLURM_CPUS_ON_NODE without it. nullopt: it
/// does not run in a job of Slurm.
std::optional<int> processors_of_slurm();
/// The memory that Slurm gave to it on this node, MB: SLURM_MEM_PER_NODE, or SLURM_MEM_PER_CPU times its processors. nullopt: no
/// limit, or no job of Slurm.
std::optional<std::int64_t> memory_of_slurm_mb();

/// The quota of CPU time of this process, in processors: the least one of its control group and the groups around it,
/// version 1 or 2. nullopt: no limit, or no control groups.
/// @param root where the system's /proc and /sys lie; "/" but in tests.
std::optional<double> processor_quota(const std::filesystem::path& root = "/");

}  // namespace weft
