#include "loader/processors.hpp"

#include <sched.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace weft {
namespace {

namespace fs = std::filesystem;

int processors_of_affinity() {
  // The mask must be as large as the kernel's, which is not known: EINVAL until it is.
  for (int processors = CPU_SETSIZE; processors <= (1 << 20); processors *= 2) {
    cpu_set_t* mask = CPU_ALLOC(processors);
    if (mask == nullptr) break;
    const std::size_t size = CPU_ALLOC_SIZE(processors);
    const int count = sched_getaffinity(0, size, mask) == 0 ? CPU_COUNT_S(size, mask) : 0;
    CPU_FREE(mask);
    if (count > 0) return count;
  }
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::istringstream stream(text);
  for (std::string part; std::getline(stream, part, separator);) parts.push_back(part);
  return parts;
}
bool names(const std::string& list, const std::string& name) {
  const auto parts = split(list, ',');
  return std::find(parts.begin(), parts.end(), name) != parts.end();
}

/// The control group of this process in one hierarchy, and where the hierarchy is mounted.
struct Group {
  fs::path mount, folder;
};

/// @param version 1: the hierarchy of the cpu controller.
std::optional<Group> find_group(const fs::path& root, int version) {
  // A line of /proc/self/cgroup is ID:CONTROLLERS:PATH; version 2 has the id 0 and no controllers.
  std::optional<std::string> path;
  std::ifstream groups(root / "proc/self/cgroup");
  for (std::string line; std::getline(groups, line);) {
    const auto first = line.find(':'), second = line.find(':', first + 1);
    if (second == std::string::npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1);
    if (version == 2 ? controllers.empty() : names(controllers, "cpu")) path = line.substr(second + 1);
  }
  if (!path) return std::nullopt;
  // A line of mountinfo is ID PARENT DEVICE ROOT MOUNT OPTIONS ... - TYPE SOURCE OPTIONS.
  std::ifstream mounts(root / "proc/self/mountinfo");
  for (std::string line; std::getline(mounts, line);) {
    const auto dash = line.find(" - ");
    if (dash == std::string::npos) continue;
    const auto before = split(line.substr(0, dash), ' '), behind = split(line.substr(dash + 3), ' ');
    if (before.size() < 5 || behind.size() < 3) continue;
    if (version == 2 ? behind[0] != "cgroup2" : behind[0] != "cgroup" || !names(behind[2], "cpu")) continue;
    // In a container the mount may show a part of the hierarchy that begins at ROOT.
    const fs::path mount = root / fs::path(before[4]).relative_path();
    const fs::path below = fs::path(*path).lexically_relative(before[3]);
    if (below.empty() || below == "." || *below.begin() == "..") return Group{mount, mount};
    return Group{mount, (mount / below).lexically_normal()};
  }
  return std::nullopt;
}

/// The quota that one folder of the hierarchy sets, in processors.
std::optional<double> quota_in(const fs::path& folder, int version) {
  double quota = -1.0, period = -1.0;
  if (version == 2) {
    std::ifstream(folder / "cpu.max") >> quota >> period;  // "max 100000" without a limit
  } else {
    std::ifstream(folder / "cpu.cfs_quota_us") >> quota;  // -1 without a limit
    std::ifstream(folder / "cpu.cfs_period_us") >> period;
  }
  if (quota <= 0.0 || period <= 0.0) return std::nullopt;
  return quota / period;
}

}  // namespace

std::optional<double> processor_quota(const fs::path& root) {
  std::optional<double> least;
  for (const int version : {2, 1}) {
    const auto group = find_group(root, version);
    if (!group) continue;
    for (fs::path folder = group->folder;; folder = folder.parent_path()) {
      if (const auto quota = quota_in(folder, version)) least = std::min(*quota, least.value_or(*quota));
      if (folder == group->mount || !folder.has_relative_path()) break;
    }
  }
  return least;
}

namespace {

/// A variable that Slurm sets in its jobs, as a positive number.
std::optional<std::int64_t> slurm_number(const char* name) {
  const char* text = std::getenv(name);
  std::int64_t value = 0;
  if (std::getenv("SLURM_JOB_ID") == nullptr || text == nullptr) return std::nullopt;
  const char* end = text + std::strlen(text);
  const auto [stop, error] = std::from_chars(text, end, value);
  if (error != std::errc() || stop != end || value <= 0) return std::nullopt;
  return value;
}

}  // namespace

std::string processor_name() {
  constexpr std::pair<const char*, const char*> kSets[] = {
      {"avx2", "AVX2"}, {"avx512f", "AVX-512"}, {"avx512_bf16", "AVX-512 BF16"}, {"amx_bf16", "AMX BF16"}};
  std::string name = "a processor without a name", sets;
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line) && !line.empty();) {  // the first processor's
    const auto colon = line.find(": ");
    if (colon == std::string::npos) continue;
    const std::string value = line.substr(colon + 2);
    if (line.starts_with("model name")) name = value;
    if (!line.starts_with("flags")) continue;
    for (const auto& [flag, set] : kSets)
      if ((" " + value + " ").find(std::string(" ") + flag + " ") != std::string::npos)
        sets += (sets.empty() ? "" : ", ") + std::string(set);
  }
  return sets.empty() ? name : name + " (" + sets + ")";
}

std::optional<int> processors_of_slurm() {
  constexpr std::int64_t kMost = 1 << 20;
  for (const char* name : {"SLURM_CPUS_PER_TASK", "SLURM_CPUS_ON_NODE"})
    if (const auto number = slurm_number(name)) return static_cast<int>(std::min(*number, kMost));
  return std::nullopt;
}

std::optional<std::int64_t> memory_of_slurm_mb() {
  if (const auto node = slurm_number("SLURM_MEM_PER_NODE")) return node;
  const auto each = slurm_number("SLURM_MEM_PER_CPU"), processors = slurm_number("SLURM_CPUS_ON_NODE");
  if (!each) return std::nullopt;
  return *each * processors.value_or(1);
}

int allowed_processors() {
  const int processors = std::min(processors_of_affinity(), processors_of_slurm().value_or(1 << 20));
  const auto quota = processor_quota();
  if (!quota || *quota >= processors) return processors;
  return std::max(1, static_cast<int>(std::ceil(*quota)));
}

}  // namespace weft
