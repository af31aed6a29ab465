// What the program promises of results (docs/trust.md), as people meet it. The cases of the field are named in comments.
#include <map>
#include <nlohmann/json.hpp>

#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
std::string quoted(const fs::path& path) { return "'" + path.string() + "'"; }

/// Every file below a folder and what it holds; folders hold nothing.
std::map<std::string, std::string> tree_of(const fs::path& folder) {
  std::map<std::string, std::string> all;
  if (!fs::exists(folder)) return all;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    std::string& content = all[fs::relative(entry.path(), folder).string()];
    if (!entry.is_regular_file()) continue;
    std::ifstream stream(entry.path(), std::ios::binary);
    content = {std::istreambuf_iterator<char>(stream), {}};
  }
  return all;
}

/// The files that two equal runs share: those without times.
std::map<std::string, std::string> without_times(std::map<std::string, std::string> tree) {
  std::erase_if(tree, [](const auto& entry) {
    const std::string& name = entry.first;
    return name.ends_with("times.json") || name.ends_with("times.csv") || name.ends_with("report.html");
  });
  return tree;
}

/// A fold of a coarse towel in a fabric of a file of its own, in a second.
class Files {
 public:
  Files() {
    fs::copy_file(WEFT_SOURCE_DIR "/configs/fabrics/basic.yaml", folder / "fabrics_source.yaml");
    write_density("0.15");
    folder.write("task.yaml", "garment: " WEFT_SOURCE_DIR
                              "/configs/garments/towel_coarse.yaml\n"
                              "material: fabrics/basic.yaml\n"
                              "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
                              "predictor: {plugin: rollout}\n"
                              "goal: {random: {min_distance_mm: 10}}\n"
                              "settle: {max_frames: 30}\n"
                              "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 8}\n");
    write_ablation("[1]");
  }
  void write_density(const std::string& density) const {
    std::ifstream stream(folder / "fabrics_source.yaml");
    std::string text{std::istreambuf_iterator<char>(stream), {}};
    const std::string was = "density_kg_per_m2: 0.15";
    text.replace(text.find(was), was.size(), "density_kg_per_m2: " + density);
    folder.write("fabrics/basic.yaml", text);
  }
  void write_ablation(const std::string& seeds, const std::string& horizons = "[8]") const {
    folder.write("exp.yaml", "task: task.yaml\nfactors:\n  planning.horizon: " + horizons + "\nseeds: " + seeds + "\n");
  }
  std::string ablate(const std::string& options = "") const {
    return "ablate " + quoted(folder / "exp.yaml") + " --out " + quoted(folder / "o") + " " + options;
  }
  Folder folder;
};

// Case 1: resume mixed results of two fabrics. Case 2: a refused command had overwritten the finished one's record.
TEST(Identity, AnotherFabricInTheFileIsNamedAndRefused) {
  const Files files;
  ASSERT_EQ(weft_command(files.ablate("--quiet")).code, 0);
  const auto before = tree_of(files.folder / "o");
  files.write_density("0.6");
  files.write_ablation("[1, 2]");
  const Outcome refused = weft_command(files.ablate());
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.output, AllOf(HasSubstr("fabrics/basic.yaml: nominal.density_kg_per_m2 0.15 -> 0.6\n"),
                                    HasSubstr("--accept-changed")));
  EXPECT_TRUE(tree_of(files.folder / "o") == before) << "the refused command changed the folder";
}

TEST(Identity, AcceptedChangesShowInTheTable) {
  const Files files;
  ASSERT_EQ(weft_command(files.ablate("--quiet")).code, 0);
  files.write_density("0.6");
  files.write_ablation("[1, 2]");
  const Outcome accepted = weft_command(files.ablate("--accept-changed"));
  ASSERT_EQ(accepted.code, 0) << accepted.output;
  EXPECT_THAT(accepted.output, AllOf(HasSubstr("MIXED: 1 of the 2 rows of 8 (seeds 1)"),
                                     HasSubstr("fabrics/basic.yaml: nominal.density_kg_per_m2 0.15 -> 0.6")));
  const auto tree = tree_of(files.folder / "o");
  const json table = json::parse(tree.at("ablation.json"));
  const json& mixed = table["arms"][0]["mixed"];
  ASSERT_EQ(mixed.size(), 1u);
  EXPECT_EQ(mixed[0]["seeds"], json{1});
  // Both identities are there, and the rows name them.
  const std::string earlier = mixed[0]["identity"];
  EXPECT_EQ(
      json::parse(tree.at("identities/" + earlier + ".json"))["config"]["material"]["nominal"]["density_kg_per_m2"],
      0.15);
  EXPECT_THAT(tree.at("ablation.csv"), HasSubstr("," + earlier + "\n"));
}

TEST(Identity, MoreSeedsAndArmsAddToAFolder) {
  const Files files;
  ASSERT_EQ(weft_command(files.ablate("--quiet")).code, 0);
  const auto before = tree_of(files.folder / "o/cells");
  files.folder.write("o/notes.txt", "mine");
  files.write_ablation("[2, 1]", "[6, 8]");
  const Outcome more = weft_command(files.ablate());
  ASSERT_EQ(more.code, 0) << more.output;
  EXPECT_THAT(more.output, AllOf(HasSubstr("4/4  "), Not(HasSubstr("1/4  "))));
  auto after = tree_of(files.folder / "o/cells");
  for (const auto& [name, content] : before) EXPECT_EQ(after[name], content) << name;
  // Fewer: the others stay, and are listed.
  files.write_ablation("[2]", "[6]");
  const Outcome fewer = weft_command(files.ablate());
  ASSERT_EQ(fewer.code, 0) << fewer.output;
  EXPECT_THAT(fewer.output, HasSubstr("3 rows of the folder are not asked for; they stay: seed1-"));
  EXPECT_TRUE(tree_of(files.folder / "o/cells") == after);
  EXPECT_EQ(tree_of(files.folder / "o").at("notes.txt"), "mine");
}

// Case 1 and 2 for the other commands.
TEST(Identity, EveryCommandRefusesAUsedFolder) {
  const Files files;
  const std::string task = quoted(files.folder / "task.yaml") + " ";
  const std::string commands[] = {
      "run " + task,
      "generate " + task + "--examples 1 ",
      "evaluate physics " + task + "--set 'physics.tests=[free fall]' ",
      "evaluate planning " + task + "--cases 1 --widths 0.5 ",
      "evaluate estimation " + task + "--cases 1 --set estimation.iterations=1 --set estimation.instances=1 ",
  };
  for (const std::string& command : commands) {
    files.write_density("0.15");
    const auto out = files.folder / "used";
    fs::remove_all(out);
    const Outcome first = weft_command(command + "--quiet --out " + quoted(out));
    ASSERT_LE(first.code, 1) << command << first.output;  // 1: not released
    const auto before = tree_of(out);
    ASSERT_FALSE(before.empty()) << command;
    files.write_density("0.6");
    const Outcome refused = weft_command(command + "--out " + quoted(out));
    EXPECT_EQ(refused.code, 2) << command;
    EXPECT_THAT(refused.output, HasSubstr("fabrics/basic.yaml: nominal.density_kg_per_m2 0.15 -> 0.6\n")) << command;
    EXPECT_TRUE(tree_of(out) == before) << command << "changed the folder";
    const Outcome accepted = weft_command(command + "--accept-changed --quiet --out " + quoted(out));
    EXPECT_LE(accepted.code, 1) << command << accepted.output;
    EXPECT_FALSE(tree_of(out) == before) << command;
  }
  // And what another command wrote.
  const Outcome other = weft_command(commands[0] + "--out " + quoted(files.folder / "used"));
  EXPECT_EQ(other.code, 2);
  EXPECT_THAT(other.output, HasSubstr("they are of the command evaluate estimation, this one is run"));
}

// Case 5, of every kind of file that weft reads: who has not run `git lfs pull` is told so, and nothing is written.
TEST(Identity, AGitLfsPointerInThePlaceOfAnyFileIsNamed) {
  const Files files;
  const std::string pointer =
      "version https://git-lfs.github.com/spec/v1\n"
      "oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\nsize 12345\n";
  for (const char* name : {"p.yaml", "p.obj", "p.json", "p.h5", "p.ply", "p.png", "p.pt", "data/shard-00000.h5"})
    files.folder.write(name, pointer);
  files.folder.write("mesh.yaml", "mesh: p.obj\nvertices: {left_bottom: 0, left_top: 16}\n");
  files.folder.write("rest.yaml", "mesh: " WEFT_SOURCE_DIR
                                  "/configs/garments/towel_coarse.obj\n"
                                  "vertices: {left_bottom: 0, left_top: 16}\n"
                                  "rest: {from: file, file: p.obj}\n");
  files.folder.write("scene.yaml", "garment: " WEFT_SOURCE_DIR
                                   "/configs/garments/towel_coarse.yaml\n"
                                   "duration_s: 0.1\nfabric: p.json\n");
  const auto at = [&](const char* name) { return "'" + (files.folder / name).string() + "'"; };
  const std::string task = quoted(files.folder / "task.yaml"), out = quoted(files.folder / "out"),
                    run = "run " + task + " --out " + out + " --set ";
  const std::pair<std::string, const char*> commands[] = {
      {"run " + at("p.yaml"), "p.yaml"},
      {run + "garment=" + at("p.yaml"), "p.yaml"},
      {run + "garment=" + at("mesh.yaml"), "p.obj"},
      {run + "garment=" + at("rest.yaml"), "p.obj"},
      {run + "material=" + at("p.yaml"), "p.yaml"},
      {run + "start.session=" + at("p.h5"), "p.h5"},
      {run + "goal.obj=" + at("p.obj"), "p.obj"},
      {run + "goal.example=" + at("p.h5"), "p.h5"},
      {run + "goal.mesh=" + at("p.obj") + " --set planning.loss=chamfer", "p.obj"},
      {run + "goal.points=" + at("p.ply") + " --set planning.loss=chamfer", "p.ply"},
      {run + "goal.mask.file=" + at("p.png") + " --set planning.loss=silhouette", "p.png"},
      {run + "predictor='{plugin: emd, params: {model: " + (files.folder / "p.h5").string() + "}}'", "p.h5"},
      {"simulate " + at("scene.yaml") + " --out " + out, "p.json"},
      {"garment import " + at("p.obj") + " --out " + out, "p.obj"},
      {"garment import " + at("p.ply") + " --out " + out, "p.ply"},
      {"garment show " + at("p.yaml"), "p.yaml"},
      {"dataset check " + at("data"), "shard-00000.h5"},
      {"evaluate prediction " + task + " --data " + at("data") + " --out " + out, "shard-00000.h5"},
      {"generate " + task + " --examples 2 --out " + at("data"), "shard-00000.h5"},
      {"export " + at("p.h5") + " --to csv --out " + out, "p.h5"},
  };
  for (const auto& [command, file] : commands) {
    const Outcome refused = weft_command(command);
    EXPECT_TRUE(refused.code == 1 || refused.code == 2) << command << refused.output;
    EXPECT_THAT(refused.output, AllOf(HasSubstr(file), HasSubstr("is a Git LFS pointer"), HasSubstr("git lfs pull")))
        << command;
    EXPECT_FALSE(fs::exists(files.folder / "out")) << command;
  }
  // What weft itself wrote into a folder.
  ASSERT_EQ(weft_command(files.ablate("--quiet")).code, 0);
  ASSERT_LE(weft_command("run " + task + " --quiet --out " + out).code, 1);
  std::vector<std::pair<fs::path, std::string>> own{
      {files.folder / "out/provenance.json", "run " + task + " --out " + out},
      {files.folder / "out/session.h5", "export " + out + " --to csv"}};
  for (const auto& folder : {"o/cells", "o/identities"})
    for (const auto& entry : fs::directory_iterator(files.folder / folder))
      own.emplace_back(entry.path(), files.ablate());
  EXPECT_GE(own.size(), 4u);
  for (const auto& [file, command] : own) {
    const std::string relative = fs::relative(file, files.folder.path()).string(),
                      before = tree_of(files.folder.path())[relative];
    files.folder.write(relative, pointer);
    const Outcome refused = weft_command(command);
    EXPECT_TRUE(refused.code == 1 || refused.code == 2) << command << refused.output;
    EXPECT_THAT(refused.output, AllOf(HasSubstr(file.filename().string()), HasSubstr("is a Git LFS pointer")))
        << command;
    EXPECT_EQ(tree_of(files.folder.path())[relative], pointer) << command << " wrote over " << relative;
    files.folder.write(relative, before);
  }
}

// Case 10: session.h5 of two equal runs differed in bytes.
TEST(Identity, EqualRunsWriteEqualFiles) {
  const Files files;
  const auto same = [&](const std::string& command) {
    const auto a = files.folder / "a", b = files.folder / "b";
    fs::remove_all(a);
    fs::remove_all(b);
    EXPECT_LE(weft_command(command + " --quiet --jobs 1 --out " + quoted(a)).code, 1) << command;
    EXPECT_LE(weft_command(command + " --quiet --jobs 2 --out " + quoted(b)).code, 1) << command;
    const auto one = without_times(tree_of(a)), two = without_times(tree_of(b));
    EXPECT_GE(one.size(), 3u) << command;
    for (const auto& [name, content] : one) {
      ASSERT_TRUE(two.contains(name)) << command << ": " << name;
      EXPECT_TRUE(two.at(name) == content) << command << ": " << name << " differs";
    }
    EXPECT_EQ(one.size(), two.size()) << command;
    EXPECT_TRUE(fs::exists(a / "times.json")) << command;
  };
  const std::string task = quoted(files.folder / "task.yaml");
  same("run " + task + " --set knowledge=estimate --set estimation.iterations=1 --set estimation.instances=1");
  same("ablate " + quoted(files.folder / "exp.yaml"));
  same("evaluate planning " + task + " --cases 2 --widths 0.5");
  same("evaluate physics " + task + " --set 'physics.tests=[free fall]'");
  same("generate " + task + " --examples 2");
  same("simulate " WEFT_SOURCE_DIR "/configs/experiments/scenes/incline.yaml");
}

TEST(Identity, JsonOutputHasTheTimesAgain) {
  const Files files;
  const Outcome run = weft_command("run " + quoted(files.folder / "task.yaml") + " --json --out " +
                                   quoted(files.folder / "r") + " 2>/dev/null");
  const json printed = json::parse(run.output), saved = json::parse(tree_of(files.folder / "r").at("summary.json"));
  EXPECT_EQ(printed["plan_seconds"].size(), printed["segments"].get<std::size_t>());
  EXPECT_FALSE(saved.contains("plan_seconds"));
  EXPECT_EQ(printed["error_mm"], saved["error_mm"]);
}

// What one fold of several has for itself counts as what the session has does: its plugin, its keys, but not its description.
TEST(Identity, TheFoldsOfASequenceCount) {
  const Files files;
  const auto library = files.folder / "plugins/libweft_trajectory_drag.so";
  fs::create_directories(library.parent_path());
  fs::copy_file(WEFT_TRAJECTORY_DRAG, library);
  const auto write = [&](const std::string& second) {
    files.folder.write("folds.yaml",
                       "extends: task.yaml\nplugin_path: [plugins]\nplanning: {horizon: 8}\n"
                       "manipulations: [{}, {trajectory: {plugin: drag}, " +
                           second + "}]\n");
  };
  files.folder.write("exp.yaml", "task: folds.yaml\nfactors:\n  planning.instances: [1]\nseeds: [1]\n");
  write("description: first");
  const Outcome made = weft_command(files.ablate("--quiet"));
  ASSERT_EQ(made.code, 0) << made.output;
  write("description: another");
  EXPECT_EQ(weft_command(files.ablate("--quiet")).code, 0);
  write("planning: {horizon: 9}");
  EXPECT_THAT(weft_command(files.ablate("--quiet")).output, HasSubstr("manipulations.1.planning.horizon absent -> 9"));
  write("description: first");
  std::ofstream(library, std::ios::app | std::ios::binary) << "x";
  const Outcome rebuilt = weft_command(files.ablate("--quiet"));
  EXPECT_EQ(rebuilt.code, 2);
  EXPECT_THAT(rebuilt.output, HasSubstr("plugin trajectory/drag: its library was built again"));
}

// A fabric that lies in a file behind a file counts by its numbers, not by its spelling.
TEST(Identity, AFabricOfThePhysicsSuiteCountsWithTheFilesBehindIt) {
  const Files files;
  const auto write_base = [&](const std::string& density) {
    files.folder.write("base.yaml",
                       "density_kg_per_m2: " + density +
                           "\nstretch_n_per_m: {warp: 110, weft: 165, shear: 55}\nfriction: 0.5\n"
                           "bend_n_m: {warp: 1.6e-5, weft: 2.4e-5}\nself_friction: 0.3\nthickness_m: 0.001\n");
  };
  files.folder.write("mine.yaml", "file: base.yaml\nfriction: 0.4\n");
  int number = 0;
  for (const std::string fabric : {"mine.yaml", "base.yaml", "{file: base.yaml, friction: 0.4}"}) {
    files.folder.write("physics.yaml",
                       "extends: task.yaml\nsimulator: {plugin: cloth}\n"
                       "physics: {tests: [bending length], fine_edge_m: 0.03, fabric: " +
                           fabric + "}\n");
    const auto out = files.folder / ("p" + std::to_string(++number));
    const std::string evaluate = "evaluate physics " + quoted(files.folder / "physics.yaml") + " --out " + quoted(out);
    write_base("0.15");
    const Outcome first = weft_command(evaluate);
    ASSERT_LE(first.code, 1) << first.output;
    write_base("0.150  # the same");
    EXPECT_THAT(weft_command(evaluate).output, HasSubstr("everything was measured before"));
    write_base("0.6");
    const Outcome other = weft_command(evaluate);
    EXPECT_EQ(other.code, 2);
    EXPECT_THAT(other.output, HasSubstr("density_kg_per_m2 0.15 -> 0.6")) << fabric;
  }
}

// Case 11: a plugin that came by WEFT_PLUGIN_PATH was not found again by `weft run config.yaml` of its own result.
TEST(Identity, ASavedConfigFindsItsPlugins) {
  const Files files;
  const auto plugins = files.folder / "my plugins";
  fs::create_directories(plugins);
  fs::copy_file(WEFT_TOY_PLUGINS "/paths/libweft_optimiser_momentum.so", plugins / "libweft_optimiser_momentum.so");
  const std::string run = "run " + quoted(files.folder / "task.yaml") + " --set optimiser=momentum --quiet --out ";
  const Outcome first = test::run_shell("WEFT_PLUGIN_PATH=" + quoted(plugins) + " '" WEFT_PROGRAM "' " + run +
                                        quoted(files.folder / "r"));
  ASSERT_LE(first.code, 1) << first.output;
  const std::string again = "run " + quoted(files.folder / "r/config.yaml") + " --quiet --out ";
  const Outcome second = weft_command(again + quoted(files.folder / "again"));
  ASSERT_EQ(second.code, first.code) << second.output;
  EXPECT_TRUE(without_times(tree_of(files.folder / "r")) == without_times(tree_of(files.folder / "again")));
  // The other commands that save a task's config, and a run of several folds.
  const auto finds_again = [&](const std::string& command, const fs::path& saved) {
    const Outcome made = test::run_shell("WEFT_PLUGIN_PATH=" + quoted(plugins) + " '" WEFT_PROGRAM "' " + command);
    ASSERT_LE(made.code, 1) << made.output;
    std::ifstream stream(saved);
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    EXPECT_THAT(text, AllOf(HasSubstr("momentum"), HasSubstr("my plugins"))) << command;
  };
  // Only the second fold needs the folder.
  fs::create_directories(files.folder / "drags");
  fs::copy_file(WEFT_TRAJECTORY_DRAG, files.folder / "drags/libweft_trajectory_drag.so");
  ASSERT_LE(test::run_shell("WEFT_PLUGIN_PATH=" + quoted(files.folder / "drags") + " '" WEFT_PROGRAM "' run " +
                            quoted(files.folder / "task.yaml") +
                            " --set 'manipulations=[{}, {trajectory: {plugin: drag}}]' --quiet --out " +
                            quoted(files.folder / "d"))
                .code,
            1);
  EXPECT_THAT(tree_of(files.folder / "d")["config.yaml"], HasSubstr("/drags]"));
  const std::string task = quoted(files.folder / "task.yaml") + " --set optimiser=momentum --quiet --out ";
  finds_again("evaluate planning --widths 0.5 --cases 1 " + task + quoted(files.folder / "e"),
              files.folder / "e/config.yaml");
  finds_again("run --set 'manipulations=[{}]' " + task + quoted(files.folder / "s"), files.folder / "s/config.yaml");
  finds_again("plan " + task + quoted(files.folder / "p"), files.folder / "p/config.yaml");
  fs::remove_all(plugins);
  const Outcome missing = weft_command(again + quoted(files.folder / "third"));
  EXPECT_EQ(missing.code, 2);
  EXPECT_THAT(missing.output, AllOf(HasSubstr("momentum"), HasSubstr("my plugins")));
  EXPECT_FALSE(fs::exists(files.folder / "third"));
}

}  // namespace
}  // namespace weft
