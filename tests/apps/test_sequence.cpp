// Several folds in one session, as people run them: files, messages, repeats, ablations.
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
nlohmann::json json_of(const fs::path& file) {
  std::ifstream stream(file);
  return nlohmann::json::parse(stream);
}

/// The towel in thirds, coarse and with hardly a search.
std::string thirds(const Folder& folder) {
  return folder
      .write("thirds.yaml", "extends: " WEFT_SOURCE_DIR
                            "/configs/tasks/towel_thirds.yaml\n"
                            "garment: " WEFT_SOURCE_DIR
                            "/configs/garments/towel_coarse.yaml\n"
                            "planning: {instances: 1, iterations: 1, replan_iterations: 0, horizon: 12}\n"
                            "goal: {random: {min_distance_mm: 1}}\n"
                            "settle: {max_frames: 120}\n")
      .string();
}

TEST(Sequence, EveryFoldIsAResultAndItsConfigRepeatsIt) {
  const Folder folder;
  const fs::path out = folder / "out";
  const Outcome run = weft_command("run '" + thirds(folder) + "' --seed 5 --jobs 2 --out '" + out.string() + "'");
  ASSERT_EQ(run.code, 0) << run.output;
  EXPECT_THAT(run.output, AllOf(HasSubstr("fold 1 of 2"), HasSubstr("fold 2 of 2")));
  const auto steps = json_of(out / "summary.json").at("steps");
  ASSERT_EQ(steps.size(), 2u);
  for (int k = 0; k < 2; ++k) {
    const fs::path step = out / ("step_" + std::to_string(k + 1));
    for (const char* file : {"session.h5", "config.yaml", "provenance.json", "times.json", "report.html"})
      EXPECT_TRUE(fs::exists(step / file)) << step / file;
    EXPECT_EQ(json_of(step / "summary.json").at("error_mm"), steps[k].at("error_mm"));
    EXPECT_EQ(steps[k].at("folder"), step.filename().string());
  }
  // Three layers cover less than two.
  EXPECT_LT(steps[1].at("coverage"), steps[0].at("coverage"));

  // A later fold alone, from the recorded one before; and the whole from its own config.
  const fs::path second = folder / "second", whole = folder / "whole";
  ASSERT_EQ(
      weft_command("run '" + (out / "step_2/config.yaml").string() + "' --quiet --out '" + second.string() + "'").code,
      0);
  EXPECT_EQ(json_of(second / "summary.json"), json_of(out / "step_2/summary.json"));
  ASSERT_EQ(weft_command("run '" + (out / "config.yaml").string() + "' --quiet --out '" + whole.string() + "'").code,
            0);
  EXPECT_EQ(json_of(whole / "summary.json"), json_of(out / "summary.json"));
}

TEST(Sequence, CommandsThatTakeOneFoldSaySo) {
  const Folder folder;
  for (const char* command : {"plan", "estimate"}) {
    const Outcome outcome =
        weft_command(std::string(command) + " '" + thirds(folder) + "' --out '" + (folder / command).string() + "'");
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_THAT(outcome.output, AllOf(HasSubstr("manipulations has several folds"), HasSubstr(command)));
  }
}

TEST(Sequence, AnAblationHasTheErrorOfEveryFold) {
  const Folder folder;
  thirds(folder);
  const auto config = folder.write("compare.yaml",
                                   "task: thirds.yaml\n"
                                   "factors: {knowledge: {\"true\": {knowledge: \"true\"}, none: {knowledge: none}}}\n"
                                   "baseline: none\nseeds: [5]\n");
  const Outcome outcome =
      weft_command("ablate '" + config.string() + "' --quiet --jobs 2 --out '" + (folder / "compared").string() + "'");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  std::ifstream csv(folder / "compared/ablation.csv");
  const std::string table{std::istreambuf_iterator<char>(csv), {}};
  EXPECT_THAT(table, AllOf(HasSubstr("step_1_error_mm"), HasSubstr("step_2_error_mm")));
}

}  // namespace
}  // namespace weft
