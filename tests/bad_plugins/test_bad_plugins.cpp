#include <cfenv>
#include <limits>
#include <map>

#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/plugin.hpp"
#include "weft/trajectory.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using test::message_of;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::StartsWith;

const fs::path kFolder = WEFT_BAD_PLUGINS;

// Libraries that are refused before any C++ call, and the part of the message that gives the reason.
const std::map<std::string, std::string>& refusals() {
  static const std::map<std::string, std::string> map = {
      {"missing_symbol",
       "does not export weft_plugin_create; export one plugin with WEFT_PLUGIN(...) from weft/plugin.hpp"},
      {"wrong_kind", "is of kind 'teapot', must be simulator, predictor, trajectory or optimiser"},
      {"wrong_interface_version", "has interface version 999 of trajectory, this weft has " +
                                      std::to_string(Trajectory::kVersion) + "; rebuild it with this weft's headers"},
      {"wrong_abi", "built as 'weft1 gxxabi1002 cxx11abi0 eigen3.3.9 align16', this weft is '" WEFT_ABI_TAG
                    "'; build it with weft_add_plugin()"},
      {"glibcxx_debug", " glibcxx_debug', this weft is '" WEFT_ABI_TAG "'"},
      {"index_int", " index int', this weft is '" WEFT_ABI_TAG "'"},
      {"no_mark", "weft_plugin_info does not start with 'weftplu'"},
      {"wrong_size", "weft_plugin_info has 32 bytes, this weft's has " + std::to_string(sizeof(WeftPluginInfo))},
      {"no_name", "has no name"},
      {"bad_name", "is called 'a/b c', must be letters, digits, _ and -"},
      {"bad_version", "has the version '1.0??[31m', must be letters, digits"},
      {"wrong_type_size", "in it Variable has " + std::to_string(sizeof(Variable) + 8) + " bytes, in this weft " +
                              std::to_string(sizeof(Variable)) + "; rebuild it"},
      {"other_processor", "was compiled for instructions that this processor has not ("},
      {"not_a_library", "is no library: it does not begin like an ELF file"},
      {"empty", "is empty; copy it or build it again"},
      {"lfs_pointer", "is a Git LFS pointer, not the file itself; run `git lfs pull` in its repository"},
      {"cut_short", "was cut short: it has 5000 bytes, must have at least "},
      {"undefined_symbol",
       "refused: cannot be loaded as a shared library: undefined symbol: _Z24weft_nobody_defines_thisd"},
  };
  return map;
}

PluginRegistry registry() { return PluginRegistry({kFolder}); }

TEST(BadPlugins, EachIsRefusedWithItsOwnReason) {
  for (const auto& [name, reason] : refusals()) {
    const std::string file = (kFolder / (name + ".so")).string();
    EXPECT_THAT(message_of<PluginError>([&] { registry().find(file); }),
                AllOf(StartsWith(file + ": refused: "), HasSubstr(reason)));
  }
}

TEST(BadPlugins, ALibraryThatChangesArithmeticAsItIsLoadedChangesNone) {
  const PluginRegistry own({kFolder});
  own.find((kFolder / "good.so").string());
  EXPECT_EQ(std::fegetround(), FE_TONEAREST);
  const volatile double smallest = std::numeric_limits<double>::denorm_min();
  EXPECT_GT(smallest * 2.0, 0.0);
}

TEST(BadPlugins, ListShowsEveryRefusalAndTheGoodOnesFirst) {
  std::map<std::string, std::string> listed;
  bool after_refusal = false, has_good = false;
  for (const auto& entry : registry().list()) {
    if (!entry.refusal.empty()) {
      after_refusal = true;
      listed[entry.file.stem()] = entry.refusal;
    } else {
      EXPECT_FALSE(after_refusal) << entry.name;
      has_good = has_good || entry.name == "good";
    }
  }
  EXPECT_TRUE(has_good);
  EXPECT_EQ(listed.size(), refusals().size());
  for (const auto& [name, reason] : refusals()) EXPECT_THAT(listed[name], HasSubstr(reason)) << name;
}

TEST(BadPlugins, TheGoodOneAmongThemWorks) {
  const auto plugins = std::make_shared<PluginRegistry>(std::vector<fs::path>{kFolder});
  const auto host = make_host(plugins, {.threads = 1});
  EXPECT_EQ(host->create<Trajectory>(ConfigNode::scalar("good"))->hands(), 2);
}

TEST(BadPlugins, ALibraryThatDiesAsItIsLoadedIsNamed) {
  const std::string folder = (kFolder / "at_load").string();
  const auto outcome = test::run_shell("WEFT_PLUGIN_PATH='" + folder + "' '" WEFT_PROGRAM "' plugins");
  EXPECT_NE(outcome.code, 0);
  EXPECT_THAT(outcome.output,
              HasSubstr("error: SIGABRT (Aborted) in library " + folder + "/aborts_at_load.so, loading"));
}

TEST(BadPlugins, ThoseThatFailLaterSayWhichLibraryAndWhy) {
  const auto create = [](const std::string& name) {
    const auto plugins = std::make_shared<PluginRegistry>(std::vector<fs::path>{kFolder});
    make_host(plugins, {.threads = 1})->create<Trajectory>(ConfigNode::scalar(name));
  };
  const auto file = [](const std::string& name) { return (kFolder / (name + ".so")).string(); };
  EXPECT_EQ(message_of<PluginError>([&] { create("throws_at_create"); }),
            file("throws_at_create") + ": creating throws_at_create failed: the constructor gave up");
  EXPECT_EQ(message_of<PluginError>([&] { create("throws_no_exception"); }),
            file("throws_no_exception") +
                ": creating throws_no_exception failed: it threw something that is not a std::exception");
  EXPECT_EQ(message_of<ConfigError>([&] { create("throws_own_error"); }), "throws_own_error: an error of its own");
  EXPECT_EQ(message_of<PluginError>([&] { create("returns_null"); }),
            file("returns_null") + ": creating returns_null failed: it returned nothing");
  EXPECT_EQ(
      message_of<PluginError>([&] { create("throws_in_params"); }),
      file("throws_in_params") + ": reading the parameters of throws_in_params failed: no list of parameters today");
}

test::Outcome run(const std::string& arguments) {
  return test::run_shell("WEFT_PLUGIN_PATH='" + kFolder.string() + "' '" WEFT_PROGRAM "' " + arguments);
}

TEST(BadPlugins, TheProgramListsThemAllAndExitsWithZero) {
  const auto list = run("plugins");
  EXPECT_EQ(list.code, 0) << list.output;
  for (const auto& [name, reason] : refusals()) EXPECT_THAT(list.output, HasSubstr(reason)) << name;
  EXPECT_THAT(list.output, HasSubstr("trajectory  good"));
}

TEST(BadPlugins, TheProgramRefusesEachWithExitCodeTwo) {
  for (const auto& [name, reason] : refusals()) {
    const auto describe = run("describe '" + (kFolder / (name + ".so")).string() + "'");
    EXPECT_EQ(describe.code, 2) << name << ": " << describe.output;
    EXPECT_THAT(describe.output, AllOf(StartsWith("error: "), HasSubstr(reason))) << name;
  }
  const auto params = run("describe throws_in_params");
  EXPECT_EQ(params.code, 2);
  EXPECT_THAT(params.output, HasSubstr("no list of parameters today"));
}

}  // namespace
}  // namespace weft
