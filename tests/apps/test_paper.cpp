// --table and --figures of `weft ablate`: what papers need besides the results.
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using test::Folder;
using test::Outcome;
using ::testing::HasSubstr;

Outcome weft_command(const std::string& arguments, const std::string& before = "unset WEFT_PLUGIN_PATH;") {
  return test::run_shell(before + " '" WEFT_PROGRAM "' " + arguments);
}
std::string text_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// One fold of a coarse towel by the default control: two arms that differ in nothing that takes time.
struct Sweep {
  Folder folder;
  std::string command;
  Sweep() {
    const std::string configs = WEFT_SOURCE_DIR "/configs/";
    folder.write("task.yaml", "garment: " + configs + "garments/towel_coarse.yaml\nmaterial: " + configs +
                                  "fabrics/basic.yaml\n"
                                  "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
                                  "predictor: {plugin: rollout}\ngoal: {random: {min_distance_mm: 10}}\n"
                                  "settle: {max_frames: 30}\n"
                                  "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
    const auto file = folder.write("ablation.yaml",
                                   "task: task.yaml\nfactors: {noise: {low: {planning.noise: 0.1}, high: "
                                   "{planning.noise: 0.2}}}\nseeds: [1]\n");
    command = "ablate '" + file.string() + "' --quiet --jobs 2 --out '" + (folder / "out").string() + "' ";
  }
};

TEST(Paper, TablesAndFiguresAreWrittenAlsoAfterTheFact) {
  const Sweep sweep;
  const fs::path out = sweep.folder / "out";
  Outcome outcome = weft_command(sweep.command);
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_FALSE(fs::exists(out / "tables.md"));
  const std::string results = text_of(out / "ablation.json");

  const bool drawn = fs::exists(WEFT_BINARY_DIR "/share/weft/report/figures.mjs");  // a build without node has none
  outcome = weft_command(sweep.command + "--table markdown,latex" + (drawn ? " --figures svg" : ""));
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_EQ(text_of(out / "ablation.json"), results);
  EXPECT_THAT(text_of(out / "tables.md"), HasSubstr("\n| noise | n | failed | mean | 95 % |"));
  EXPECT_THAT(text_of(out / "tables.tex"), HasSubstr("\\label{tab:ablation-error-mm}"));
  if (!drawn) return;
  EXPECT_THAT(text_of(out / "figures/ablation-error_mm.svg"), HasSubstr(">high</text>"));
  EXPECT_THAT(text_of(out / "figures/ablation-error_mm-difference.csv"),
              HasSubstr("arm,n,mean,low_95,high_95\nhigh,1,"));
}

TEST(Paper, FiguresThatCannotBeDrawnAreRefusedBeforeAnyWork) {
  const Sweep sweep;
  const std::pair<const char*, const char*> cases[] = {
      {"--figures png", "png not in {svg,pdf}"},
      {"--figures svg", "svg: figures need node, which is not in PATH"},
      {"--table word", "word not in {markdown,latex}"}};
  for (const auto& [option, what] : cases) {
    const Outcome refused = weft_command(sweep.command + option, "PATH=/nowhere");
    EXPECT_EQ(refused.code, 2);
    EXPECT_THAT(refused.output, HasSubstr(what));
  }
  EXPECT_FALSE(fs::exists(sweep.folder / "out"));
}

}  // namespace
}  // namespace weft
