#include <nlohmann/json.hpp>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::MatchesRegex;
using ::testing::StartsWith;

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
const std::string kTask = WEFT_SOURCE_DIR "/configs/tasks/tshirt_fold.yaml";

TEST(Program, HelpAndVersionExitWithZero) {
  const Outcome help = weft_command("--help");
  EXPECT_EQ(help.code, 0);
  for (const char* command : {"run", "plugins", "describe", "conformance"})
    EXPECT_THAT(help.output, HasSubstr(command));
  EXPECT_EQ(weft_command("plugins --help").code, 0);
  const Outcome version = weft_command("--version");
  EXPECT_EQ(version.code, 0);
  EXPECT_THAT(version.output, MatchesRegex("weft [0-9]+\\.[0-9]+\\.[0-9]+ \\(.+\\)\n"));
}

TEST(Program, WrongUseExitsWithTwoAndSaysWhy) {
  for (const char* arguments : {"", "fold", "plugins --frobnicate", "describe", "plugins --jobs many",
                                "plugins --jobs -1", "run", "plugins extra words"}) {
    const Outcome outcome = weft_command(arguments);
    EXPECT_EQ(outcome.code, 2) << arguments;
    EXPECT_FALSE(outcome.output.empty()) << arguments;
    EXPECT_THAT(weft_command(std::string(arguments) + " 2>/dev/null").output, IsEmpty()) << arguments;
  }
}

TEST(Program, ABadConfigExitsWithTwoBeforeAnyWork) {
  const Folder folder;
  const auto refused = [&](const std::string& config, const std::string& options = "") {
    const Outcome outcome = weft_command("run '" + config + "' --out '" + (folder / "out").string() + "' " + options);
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_FALSE(std::filesystem::exists(folder / "out")) << outcome.output;
    return outcome.output;
  };
  EXPECT_THAT(refused((folder / "none.yaml").string()),
              AllOf(StartsWith("error: "), HasSubstr("none.yaml: no such file")));
  const auto key = folder.write("key.yaml", "extends: " + kTask + "\nplaning: {}\n");
  EXPECT_THAT(refused(key.string()), HasSubstr("key.yaml:2: planing is not a known key; nearest: planning"));
  const auto range = folder.write("range.yaml", "extends: " + kTask + "\nplanning:\n  instances: 0\n");
  EXPECT_THAT(refused(range.string()), HasSubstr("range.yaml:3: planning.instances = 0, must be in [1, 4096]"));
  const auto plugin = folder.write("plugin.yaml", "extends: " + kTask + "\ntrajectory: {plugin: ark}\n");
  EXPECT_THAT(refused(plugin.string()), AllOf(HasSubstr("plugin.yaml:2: "), HasSubstr("'ark'; nearest: arc")));
  const auto yaml = folder.write("yaml.yaml", "a: [1\n");
  EXPECT_THAT(refused(yaml.string()), AllOf(HasSubstr("yaml.yaml:"), HasSubstr("not valid YAML")));
  EXPECT_THAT(refused(kTask, "--set planning.instances=none"),
              HasSubstr("--set planning.instances: planning.instances = none, must be a whole number"));
  EXPECT_THAT(refused(kTask, "--set planning"), HasSubstr("--set planning: must be key.path=value"));
}

TEST(Program, PluginsListsEveryShippedPlugin) {
  const Outcome text = weft_command("plugins");
  EXPECT_EQ(text.code, 0);
  EXPECT_THAT(text.output, HasSubstr("trajectory  arc"));

  const Outcome json = weft_command("plugins --json 2>/dev/null");
  EXPECT_EQ(json.code, 0);
  const auto array = nlohmann::json::parse(json.output);
  ASSERT_TRUE(array.is_array());
  std::string names;
  for (const auto& entry : array) {
    EXPECT_EQ(entry.at("refusal"), "") << entry.at("file");
    names += entry.at("kind").get<std::string>() + "/" + entry.at("name").get<std::string>() + " ";
  }
  for (const char* name : {"simulator/cloth", "predictor/rollout", "trajectory/arc", "optimiser/rprop"}) {
    EXPECT_THAT(names, HasSubstr(name));
  }
}

TEST(Program, DescribeShowsParametersWithUnitsRangesAndDefaults) {
  const Outcome text = weft_command("describe arc");
  EXPECT_EQ(text.code, 0);
  EXPECT_THAT(text.output, AllOf(StartsWith("trajectory/arc "), HasSubstr("r_min_m"), HasSubstr("default 0.01")));
  const auto json = nlohmann::json::parse(weft_command("describe trajectory/arc --json 2>/dev/null").output);
  EXPECT_EQ(json.at("name"), "arc");
  bool found = false;
  for (const auto& p : json.at("params")) {
    if (p.at("name") != "r_min_m") continue;
    found = true;
    EXPECT_EQ(p.at("unit"), "m");
    EXPECT_EQ(p.at("default"), "0.01");
  }
  EXPECT_TRUE(found);
  EXPECT_THAT(weft_command("describe arc --markdown").output, StartsWith("| parameter | type |"));
  const Outcome unknown = weft_command("describe ark");
  EXPECT_EQ(unknown.code, 2);
  EXPECT_THAT(unknown.output,
              AllOf(StartsWith("error: no plugin is called 'ark'; nearest: arc"), HasSubstr("searched")));
  EXPECT_EQ(weft_command("describe no/such/library.so").code, 2);
}

TEST(Program, ConformanceReportsOneLinePerLaw) {
  const Outcome text = weft_command("conformance arc");
  EXPECT_EQ(text.code, 0) << text.output;
  EXPECT_THAT(text.output, HasSubstr("starts_at_the_grasp_points"));
  EXPECT_EQ(weft_command("conformance ark").code, 2);
  EXPECT_EQ(weft_command("conformance arc --law no_such_law").code, 2);
  EXPECT_EQ(weft_command("conformance arc --set r_min_m=3").code, 2);
}

}  // namespace
}  // namespace weft
