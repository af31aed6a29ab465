#include "loader/processors.hpp"

#include <sched.h>

#include <cstdlib>
#include <map>
#include <string>
#include <thread>

#include "unit/test_support.hpp"

namespace weft {
namespace {

using test::Folder;

constexpr const char* kMounts =
    "21 20 0:5 / /proc rw - proc proc rw\n"
    "30 20 0:26 / /sys/fs/cgroup/unified rw - cgroup2 cgroup2 rw\n"
    "31 20 0:27 / /sys/fs/cgroup/cpu rw,relatime shared:9 - cgroup cgroup rw,cpu,cpuacct\n"
    "32 20 0:28 / /sys/fs/cgroup/cpuset rw - cgroup cgroup rw,cpuset\n";

TEST(Processors, WithoutControlGroupsThereIsNoQuota) {
  const Folder root;
  EXPECT_FALSE(processor_quota(root.path()));
  root.write("proc/self/cgroup", "0::/job\n");
  EXPECT_FALSE(processor_quota(root.path()));
  root.write("proc/self/mountinfo", kMounts);
  EXPECT_FALSE(processor_quota(root.path()));
}

TEST(Processors, VersionTwoTakesTheLeastQuotaOnTheWayUp) {
  const Folder root;
  root.write("proc/self/cgroup", "0::/user/job/step\n");
  root.write("proc/self/mountinfo", kMounts);
  root.write("sys/fs/cgroup/unified/user/job/step/cpu.max", "max 100000\n");
  EXPECT_FALSE(processor_quota(root.path()));
  root.write("sys/fs/cgroup/unified/user/job/cpu.max", "250000 100000\n");
  root.write("sys/fs/cgroup/unified/user/cpu.max", "800000 100000\n");
  EXPECT_EQ(processor_quota(root.path()), 2.5);
  root.write("sys/fs/cgroup/unified/user/cpu.max", "50000 100000\n");
  EXPECT_EQ(processor_quota(root.path()), 0.5);
}

TEST(Processors, VersionOneReadsTheCpuController) {
  const Folder root;
  root.write("proc/self/cgroup", "3:cpuset:/\n2:cpu,cpuacct:/slurm/job_7\n0::/\n");
  root.write("proc/self/mountinfo", kMounts);
  root.write("sys/fs/cgroup/cpu/slurm/job_7/cpu.cfs_quota_us", "-1\n");
  root.write("sys/fs/cgroup/cpu/slurm/job_7/cpu.cfs_period_us", "100000\n");
  EXPECT_FALSE(processor_quota(root.path()));
  root.write("sys/fs/cgroup/cpu/slurm/job_7/cpu.cfs_quota_us", "400000\n");
  EXPECT_EQ(processor_quota(root.path()), 4.0);
}

TEST(Processors, AContainerSeesItsPartOfTheHierarchy) {
  const Folder root;
  // The path is the host's; the mount begins at the container's own group.
  root.write("proc/self/cgroup", "0::/docker/abc/inner\n");
  root.write("proc/self/mountinfo", "30 20 0:26 /docker/abc /sys/fs/cgroup rw - cgroup2 cgroup rw\n");
  root.write("sys/fs/cgroup/cpu.max", "300000 100000\n");
  EXPECT_EQ(processor_quota(root.path()), 3.0);
  root.write("sys/fs/cgroup/inner/cpu.max", "100000 100000\n");
  EXPECT_EQ(processor_quota(root.path()), 1.0);
  // Or it shows the path of its own name space, which the mount does not have.
  root.write("proc/self/cgroup", "0::/elsewhere\n");
  EXPECT_EQ(processor_quota(root.path()), 3.0);
}

TEST(Processors, AffinityLimitsThem) {
  EXPECT_GE(allowed_processors(), 1);
  cpu_set_t before;
  ASSERT_EQ(sched_getaffinity(0, sizeof(before), &before), 0);
  std::thread([&] {  // the mask is the thread's own
    int first = 0;
    while (!CPU_ISSET(first, &before)) ++first;
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(first, &one);
    ASSERT_EQ(sched_setaffinity(0, sizeof(one), &one), 0);
    EXPECT_EQ(allowed_processors(), 1);
  })
      .join();
}

using Values = std::map<std::string, std::string>;
/// Sets variables of Slurm's; they are gone after the test.
class SlurmVariables {
 public:
  explicit SlurmVariables(const Values& values) {
    for (const char* name : kNames) unsetenv(name);
    for (const auto& [name, value] : values) setenv(name.c_str(), value.c_str(), 1);
  }
  ~SlurmVariables() {
    for (const char* name : kNames) unsetenv(name);
  }
  SlurmVariables(const SlurmVariables&) = delete;
  SlurmVariables& operator=(const SlurmVariables&) = delete;

 private:
  static constexpr const char* kNames[] = {"SLURM_JOB_ID", "SLURM_CPUS_PER_TASK", "SLURM_CPUS_ON_NODE",
                                           "SLURM_MEM_PER_NODE", "SLURM_MEM_PER_CPU"};
};

TEST(Processors, OfATaskOfSlurmAreThoseThatItAskedFor) {
  {
    const SlurmVariables task(
        Values{{"SLURM_JOB_ID", "7"}, {"SLURM_CPUS_PER_TASK", "1"}, {"SLURM_CPUS_ON_NODE", "64"}});
    EXPECT_EQ(processors_of_slurm(), 1);
    EXPECT_EQ(allowed_processors(), 1);
  }
  {
    const SlurmVariables task(Values{{"SLURM_JOB_ID", "7"}, {"SLURM_CPUS_ON_NODE", "5"}});
    EXPECT_EQ(processors_of_slurm(), 5);
  }
  {
    const SlurmVariables no_job(Values{{"SLURM_CPUS_PER_TASK", "1"}});  // left in a shell
    EXPECT_EQ(processors_of_slurm(), std::nullopt);
  }
  const SlurmVariables odd(Values{{"SLURM_JOB_ID", "7"}, {"SLURM_CPUS_PER_TASK", "-3"}, {"SLURM_CPUS_ON_NODE", "2x"}});
  EXPECT_EQ(processors_of_slurm(), std::nullopt);
  EXPECT_GE(allowed_processors(), 1);
}

TEST(Processors, MemoryOfATaskOfSlurm) {
  {
    const SlurmVariables task(Values{{"SLURM_JOB_ID", "7"}, {"SLURM_MEM_PER_NODE", "2048"}});
    EXPECT_EQ(memory_of_slurm_mb(), 2048);
  }
  {
    const SlurmVariables task(Values{{"SLURM_JOB_ID", "7"}, {"SLURM_MEM_PER_CPU", "512"}, {"SLURM_CPUS_ON_NODE", "4"}});
    EXPECT_EQ(memory_of_slurm_mb(), 2048);
  }
  const SlurmVariables none(Values{{"SLURM_JOB_ID", "7"}, {"SLURM_MEM_PER_NODE", "0"}});  // 0: all of the node's
  EXPECT_EQ(memory_of_slurm_mb(), std::nullopt);
}

}  // namespace
}  // namespace weft
