// The launcher with everything around it replaced: dpkg-query, apt-get, sudo, cmake, ninja and ctest are scripts that
// write down how they were called. Nothing is installed or built.
#include <sys/stat.h>

#include <fstream>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;

class Launcher : public ::testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(folder_ / "tree/cmake");
    fs::copy_file(WEFT_SOURCE_DIR "/weft", folder_ / "tree/weft");
    fs::copy_file(WEFT_SOURCE_DIR "/cmake/debian-packages.txt", folder_ / "tree/cmake/debian-packages.txt");
    const std::string tree = (folder_ / "tree").string(), build = tree + "/build/release";
    // Everything is installed, root runs it, the build makes a program that shows where and how it was called.
    unsetenv("CMAKE_BUILD_PARALLEL_LEVEL");
    tool("dpkg-query", "shift 3; for p; do echo \"installed $p\"; done");
    tool("id", "echo 0");
    tool("sudo", "exit 1");
    tool("apt-get", "echo \"apt-get $*\" >> '" + log_path() + "'");
    tool("ccache", "exit 0");
    tool("cmake", "echo \"cmake $*\" >> '" + log_path() + "'; case \"$*\" in *TESTS=ON*) t=ON;; *) t=OFF;; esac\n" +
                      "{ echo 'CMAKE_HOME_DIRECTORY:INTERNAL=" + tree + "'; echo \"WEFT_BUILD_TESTS:BOOL=$t\"; } > '" +
                      build + "/CMakeCache.txt'; touch '" + build + "/build.ninja'");
    tool("ninja", "echo \"ninja $*\" >> '" + log_path() + "'; echo 'ninja: no work to do.'; mkdir -p '" + build +
                      "/bin'; printf '#!/bin/sh\\necho \"weft in $PWD: $*\"\\nexit 7\\n' > '" + build +
                      "/bin/weft'; chmod +x '" + build + "/bin/weft'");
    tool("ctest", "echo \"ctest $*\"");
  }
  void tool(const std::string& name, const std::string& body) const {
    const auto file = folder_.write("tools/" + name, "#!/bin/sh\n" + body + "\n");
    chmod(file.c_str(), 0755);
  }
  std::string log_path() const { return (folder_ / "log").string(); }
  std::string log() const {
    return test::run_shell("cat '" + log_path() + "' 2>/dev/null; rm -f '" + log_path() + "'").output;
  }
  test::Outcome launch(const std::string& arguments, const std::string& from = "") const {
    const std::string where = from.empty() ? folder_.path().string() : from;
    return test::run_shell("cd '" + where + "' && PATH='" + (folder_ / "tools").string() + "':$PATH '" +
                           (folder_ / "tree/weft").string() + "' " + arguments);
  }
  test::Folder folder_;
};

TEST_F(Launcher, ConfiguresBuildsAndRunsInTheCallersFolder) {
  fs::create_directories(folder_ / "else where");
  const auto first = launch("run 'a b.yaml' --set x=1", folder_ / "else where");
  EXPECT_EQ(first.code, 7);  // the program's own
  EXPECT_THAT(first.output, HasSubstr("weft in " + (folder_ / "else where").string() + ": run a b.yaml --set x=1\n"));
  EXPECT_THAT(log(), AllOf(HasSubstr("-DCMAKE_BUILD_TYPE=Release"), HasSubstr("-DWEFT_BUILD_TESTS=OFF"),
                           HasSubstr("build/release weft_without_torch"), Not(HasSubstr("apt-get"))));
  // The second run prints nothing and configures nothing.
  const auto second = launch("plugins 2>&1 >/dev/null");
  EXPECT_THAT(second.output, IsEmpty());
  EXPECT_THAT(log(), AllOf(StartsWith("ninja "), Not(HasSubstr("cmake"))));
}

TEST_F(Launcher, BuildsWhatNeedsLibtorchOnFirstUse) {
  folder_.write("base.yaml", "predictor: {plugin: torchscript, params: {module: m.pt}}\n");
  folder_.write("task.yaml", "extends: \"base.yaml\"\nseed: 3\n");
  folder_.write("sweep.yaml", "task: task.yaml  # of every arm\nseeds: [1]\n");
  folder_.write("round.yaml", "extends: round.yaml\ntask: other.yaml\n");
  folder_.write("other.yaml", "predictor: {plugin: emd}\n");
  const auto target = [&](const std::string& arguments) {
    launch(arguments);
    return log();
  };
  for (const char* with : {"train x.yaml", "conformance torchscript", "plugins", "run task.yaml",
                           "run other.yaml --set predictor.plugin=torchscript", "ablate sweep.yaml", "describe emd"})
    EXPECT_THAT(target(with), HasSubstr("build/release weft_programs")) << with;
  for (const char* without :
       {"run other.yaml", "run missing.yaml", "simulate other.yaml", "ablate round.yaml", "--help", "completion bash"})
    EXPECT_THAT(target(without), HasSubstr("build/release weft_without_torch")) << without;
}

TEST_F(Launcher, LibtorchIsInstalledWhenACommandFirstNeedsIt) {
  tool("dpkg-query", "shift 3; for p; do case $p in libtorch-dev) ;; *) echo \"installed $p\";; esac; done; exit 1");
  EXPECT_EQ(launch("run task.yaml").code, 7);
  EXPECT_THAT(log(), AllOf(HasSubstr("cmake"), Not(HasSubstr("apt-get"))));
  // Configured without it, so the build must be configured again.
  std::ofstream((folder_ / "tree/build/release/CMakeCache.txt").string(), std::ios::app)
      << "WEFT_TORCH_CPU:FILEPATH=WEFT_TORCH_CPU-NOTFOUND\n";
  launch("run task.yaml");
  EXPECT_THAT(log(), Not(HasSubstr("cmake")));
  EXPECT_EQ(launch("train x.yaml").code, 7);
  EXPECT_THAT(log(), AllOf(HasSubstr("--no-install-recommends libtorch-dev\n"), HasSubstr("cmake"),
                           HasSubstr("build/release weft_programs")));
}

TEST_F(Launcher, TestBuildsTheTestsAndRunsThemAll) {
  launch("plugins");
  log();
  const auto test = launch("test -R unit");
  EXPECT_EQ(test.code, 0);
  EXPECT_THAT(test.output, HasSubstr("ctest --test-dir " + (folder_ / "tree/build/release").string() +
                                     " --output-on-failure -R unit"));
  EXPECT_THAT(log(), AllOf(HasSubstr("-DWEFT_BUILD_TESTS=ON"), HasSubstr("build/release all")));
  launch("plugins");  // and a tree with tests serves every other command
  EXPECT_THAT(log(), Not(HasSubstr("cmake")));
}

TEST_F(Launcher, InstallsWhatIsMissingAndSaysWhatAndWhy) {
  tool("dpkg-query",
       "shift 3; for p; do case $p in libhdf5-dev|libgtest-dev) ;; *) echo \"installed $p\";; esac; done; exit 1");
  const auto run = launch("plugins");
  EXPECT_EQ(run.code, 7);
  EXPECT_THAT(run.output,
              AllOf(HasSubstr("libhdf5-dev"), HasSubstr("recorded sessions"), Not(HasSubstr("libgtest-dev"))));
  EXPECT_THAT(test::run_shell("cat '" + (folder_ / "log").string() + "'").output,
              AllOf(HasSubstr("update"), HasSubstr("install -y --no-install-recommends libhdf5-dev\n")));
  log();
  launch("test");
  EXPECT_THAT(log(), HasSubstr("install -y --no-install-recommends libhdf5-dev libgtest-dev\n"));
}

TEST_F(Launcher, GetsAssimpForTheFilesThatNeedItAlone) {
  tool("dpkg-query", "shift 3; for p; do test $p = libassimp-dev || echo \"installed $p\"; done; exit 1");
  for (const char* without : {"plugins", "garment import 'my shirt.obj'", "garment show x.yaml", "run shirt.ply"}) {
    launch(without);
    EXPECT_THAT(log(), Not(HasSubstr("libassimp-dev"))) << without;
  }
  launch("garment import 'my shirt.PLY' --units cm");
  EXPECT_THAT(log(), HasSubstr("install -y --no-install-recommends libassimp-dev\n"));
  // A build that was configured without it is configured again.
  test::run_shell("echo 'assimp_DIR:PATH=assimp_DIR-NOTFOUND' >> '" +
                  (folder_ / "tree/build/release/CMakeCache.txt").string() + "'");
  launch("garment import shirt.obj");
  EXPECT_THAT(log(), Not(HasSubstr("cmake ")));
  launch("garment import shirt.stl");
  EXPECT_THAT(log(), HasSubstr("cmake -S "));
}

TEST_F(Launcher, WithoutRootPrintsTheOneLineToRun) {
  tool("dpkg-query", "exit 1");
  tool("id", "echo 1000");
  const auto run = launch("plugins");
  EXPECT_EQ(run.code, 2);
  EXPECT_THAT(
      run.output,
      AllOf(
          HasSubstr("\nsudo apt-get update && sudo apt-get install -y --no-install-recommends g++ cmake ninja-build "),
          HasSubstr("libcli11-dev")));
  EXPECT_THAT(log(), IsEmpty());
}

TEST_F(Launcher, WithSudoItUsesSudo) {
  tool("dpkg-query", "shift 3; for p; do test $p = cmake || echo \"installed $p\"; done; exit 1");
  tool("id", "echo 1000");
  tool("sudo", "shift; echo \"sudo $*\" >> '" + log_path() + "'; exec \"$@\"");
  EXPECT_EQ(launch("plugins").code, 7);
  EXPECT_THAT(log(), HasSubstr("sudo env DEBIAN_FRONTEND=noninteractive apt-get"));
}

TEST_F(Launcher, AFailedInstallationShowsWhy) {
  tool("dpkg-query", "exit 1");
  tool("apt-get", "echo 'E: Unable to locate package'; exit 100");
  const auto run = launch("plugins");
  EXPECT_EQ(run.code, 2);
  EXPECT_THAT(run.output, AllOf(HasSubstr("E: Unable to locate package"), HasSubstr("apt failed")));
}

TEST_F(Launcher, AFailedBuildShowsTheErrorsAndExitsWithOne) {
  tool("ninja", "echo '[1/2] Building x'; echo 'x.cpp:1: error: no'; exit 1");
  const auto run = launch("plugins");
  EXPECT_EQ(run.code, 1);
  EXPECT_THAT(run.output, AllOf(HasSubstr("x.cpp:1: error: no"), HasSubstr("the build failed")));
  fs::remove(folder_ / "tree/build/release/CMakeCache.txt");
  tool("cmake", "echo 'CMake Error: no HDF5'; exit 1");
  const auto configure = launch("plugins");
  EXPECT_EQ(configure.code, 1);
  EXPECT_THAT(configure.output, AllOf(HasSubstr("CMake Error: no HDF5"), HasSubstr("configuring failed")));
}

TEST_F(Launcher, AMovedTreeIsConfiguredAfresh) {
  launch("plugins");
  test::run_shell("sed -i 's#^CMAKE_HOME.*#CMAKE_HOME_DIRECTORY:INTERNAL=/somewhere/else#' '" +
                  (folder_ / "tree/build/release/CMakeCache.txt").string() + "'");
  log();
  launch("plugins");
  EXPECT_THAT(log(), HasSubstr("--fresh"));
}

TEST_F(Launcher, WorksThroughALink) {
  fs::create_symlink(folder_ / "tree/weft", folder_ / "link");
  const auto run = test::run_shell("PATH='" + (folder_ / "tools").string() + "':$PATH '" + (folder_ / "link").string() +
                                   "' plugins");
  EXPECT_EQ(run.code, 7) << run.output;
}

}  // namespace
}  // namespace weft
