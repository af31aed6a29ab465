#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <regex>
#include <sstream>

#include "experiments/ablation.hpp"
#include "loader/registry.hpp"
#include "session/session.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::MatchesRegex;
using ::testing::Not;
using ::testing::StartsWith;

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
std::string text_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}
const std::string kTask = WEFT_SOURCE_DIR "/configs/tasks/tshirt_fold.yaml";
/// A fold of a coarse towel, planned with the simulator in seconds. A test adds the other keys.
const std::string kTowelTask = "garment: " WEFT_SOURCE_DIR
                               "/configs/garments/towel_coarse.yaml\n"
                               "material: " WEFT_SOURCE_DIR
                               "/configs/fabrics/basic.yaml\n"
                               "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
                               "predictor: {plugin: rollout}\n"
                               "goal: {random: {min_distance_mm: 10}}\n"
                               "settle: {max_frames: 30}\n";

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
                                "plugins --jobs -1", "run task.yaml --seed -1",
                                "run task.yaml --seed 9223372036854775808", "evaluate", "run", "plugins extra words"}) {
    const Outcome outcome = weft_command(arguments);
    EXPECT_EQ(outcome.code, 2) << arguments;
    EXPECT_FALSE(outcome.output.empty()) << arguments;
    EXPECT_THAT(weft_command(std::string(arguments) + " 2>/dev/null").output, IsEmpty()) << arguments;
  }
}

TEST(Program, OutputThatCannotBeWrittenIsAnError) {
  for (const char* arguments : {"plugins", "plugins --json", "describe arc", "describe arc --json"}) {
    const Outcome outcome = weft_command(std::string(arguments) + " >/dev/full");
    EXPECT_EQ(outcome.code, 1) << arguments;
    EXPECT_THAT(outcome.output, StartsWith("error: the output cannot be written")) << arguments;
  }
  // Without stdout and stderr: no file of the result gets their numbers, so none holds what is printed.
  EXPECT_EQ(weft_command("plugins >&- 2>&- <&-").code, 0);
}

TEST(Program, RefusalsNameTheArgumentAndWhatIsAllowed) {
  const std::string experiments = WEFT_SOURCE_DIR "/configs/experiments/";
  const std::pair<std::string, std::string> cases[] = {
      {"pln x", "'pln' is not a command of weft, must be one of run, plan, "},
      {"pln x", "; nearest: plan\n"},
      {"bogus --help", "'bogus' is not a command of weft, must be one of "},
      {"evaluate fig3 x.yaml", "'fig3' is not a command of weft evaluate, must be one of "},
      {"garment towl --out x.obj", "'towl' is not a command of weft garment, must be one of towel, tshirt, "},
      {"plan x.yaml --session y --segment 0", "--segment: 0, must be at least 1"},
      {"garment import nofile.obj", "nofile.obj: no such file"},
      {"garment import x.fbx", "x.fbx: must be an .obj, .ply, .stl, .gltf or .glb mesh"},
      {"garment import x.obj --remesh 0", "--remesh: 0, must be in ["},
      {"garment import x.obj --fine 0.01", "--fine needs --remesh EDGE"},
      {"garment import x.obj --name left", "--name = left, must be NAME=VERTEX"},
      {"garment import x.obj --grasp 1", "--grasp"},
      {"garment show nofile.obj --name a=1", "nofile.obj: no such file"},
      {"garment towel --out x.obj --width nan", "--width: nan, must be in ["},
      {"evaluate planning x.yaml --widths nan", "--widths: nan, must be in [0, 1]"},
      {"evaluate planning x.yaml --widths 0.1 0.2 0.1", "--widths names 0.1 twice"},
      {"evaluate estimation '" + kTask + "' --goals fresh fresh", "--goals names fresh twice"},
      {"export nofile", "nofile: no such file, must be session.h5 or the folder of a run"},
      {"export nofile --png abc", "--png: abc, must be last, all, or the number of a frame"},
      {"conformance ./nope.so", "./nope.so: refused: no such file"},
      {"conformance arc --kind bogus", "'bogus' is not a kind of plugin, must be one of simulator, predictor, "},
      {"describe arc/arc", "'arc' is not a kind of plugin, must be one of simulator, predictor, "},
      {"describe tasks", "no plugin is called 'tasks'"},
      {"describe tasks", "; nearest: task\n"},
      {"describe arc --set r_min_m=3", "--set: r_min_m is not a known key"},
      {"describe arc --seed 3", "--seed"},
      {"dataset info . --set a=1", "--set"},
      {"garment towel --out x.obj --set a=1", "--set"},
      {"run '" + experiments + "tshirt.yaml'",
       "data is not a known key; the file is an experiment, which `weft generate`"},
      {"displacement '" + experiments + "horizon.yaml'", "the file is an ablation, which `weft ablate` reads"},
      {"ablate '" + kTask + "'", "the file is a task, which `weft run` reads"},
      {"run '" + kTask + "' --set material=" WEFT_SOURCE_DIR "/configs/fabrics/denim.yaml", "the file is a fabric"},
      {"displacement '" + kTask + "' --set true_material=[0.5,0.5]",
       "error: --set: true_material = [0.5, 0.5], must be a list of 4 numbers"},
      {"displacement '" + kTask + "' --set estimation.deviation_scale=[1,2]",
       "error: --set: estimation.deviation_scale = [1, 2], must be a list of 4 numbers"},
      {"evaluate estimation '" + kTask + "' --set predictor.params.model=/none.h5",
       "--set: predictor.params.model = /none.h5: /none.h5: does not exist"},
      {"evaluate physics '" + experiments + "physics.yaml' --set physics.folds.count=0 --set 'physics.tests=[folds]'",
       "--set: physics.tests = [folds] leaves no case to run"},
  };
  for (const auto& [arguments, expected] : cases) {
    const Outcome outcome = weft_command(arguments);
    EXPECT_EQ(outcome.code, 2) << arguments;
    EXPECT_THAT(outcome.output, HasSubstr(expected)) << arguments;
  }
}

/// A sheet of 60 x 60 cm in 36 quads, standing, with y up.
std::string sheet_in_centimetres() {
  std::string vertices, faces;
  for (int j = 0; j <= 6; ++j) {
    for (int i = 0; i <= 6; ++i) vertices += "v " + std::to_string(10 * i) + " 97 " + std::to_string(10 * j) + "\n";
  }
  for (int j = 0; j < 6; ++j) {
    for (int i = 1; i <= 6; ++i) {
      const int a = 7 * j + i;
      faces += "f";
      for (const int v : {a, a + 1, a + 8, a + 7}) faces += ' ' + std::to_string(v);
      faces += '\n';
    }
  }
  return vertices + faces;
}

TEST(Program, ImportsAGarmentWithATaskThatFolds) {
  const Folder folder;
  const std::string file = folder.write("my sheet.obj", sheet_in_centimetres()).string();
  const std::string out = (folder / "out").string();
  const Outcome import = weft_command("garment import '" + file + "' --json --name 'middle=nearest(0.3,-0.3)' --out '" +
                                      out + "' 2>/dev/null");
  ASSERT_EQ(import.code, 0) << import.output;
  const auto json = nlohmann::json::parse(import.output);
  EXPECT_EQ(json.at("garment"), "my_sheet");
  EXPECT_TRUE(json.at("foldable"));
  EXPECT_EQ(json.at("faces"), 72);
  EXPECT_EQ(json.at("named").at("middle"), 24);
  EXPECT_EQ(json.at("grasp"), nlohmann::json({"left_top", "left_bottom"}));
  // Tuned: a fold in two moves the hands by about the width, and the folded half lies on the other one.
  EXPECT_NEAR(json.at("displacement_m").at(0), 0.6, 0.1);
  EXPECT_LT(json.at("misfit_mm"), 60.0);
  for (const auto& name : json.at("files"))
    EXPECT_TRUE(std::filesystem::exists(folder / "out" / std::string(name))) << name;
  EXPECT_EQ(nlohmann::json::parse(text_of(folder / "out/import.json")).at("vertex_of").size(), 49u);
  EXPECT_THAT(text_of(folder / "out/my_sheet.yaml"),
              HasSubstr("# Made by: weft garment import my sheet.obj --out out --name middle="));
  const Outcome run =
      weft_command("run '" + out +
                   "/my_sheet_fold.yaml' --seed 1 --set planning.instances=1 --set "
                   "planning.iterations=1 --set planning.replan_iterations=0 --set settle.max_frames=30 "
                   "--out '" +
                   out + "/run'");
  EXPECT_EQ(run.code, 0) << run.output;
  // The experiment is one that generate accepts.
  EXPECT_EQ(weft_command("generate '" + out + "/my_sheet_experiment.yaml' --examples 1 --out '" + out + "/data'").code,
            0);

  const Outcome again = weft_command("garment import '" + out + "/my_sheet.yaml' --out '" + out + "'");
  EXPECT_EQ(again.code, 2);
  EXPECT_THAT(again.output, HasSubstr("would replace the file that is imported; name another folder with --out"));
  const Outcome show =
      weft_command("garment show '" + out + "/my_sheet.yaml' --name 'hem=nearest(0.6,-0.61)' --name top=1");
  EXPECT_EQ(show.code, 0);
  EXPECT_THAT(show.output, AllOf(StartsWith("name: my_sheet\nmesh: my_sheet.obj\n"), HasSubstr("hem: 48\n"),
                                 HasSubstr("middle: 24\n"), HasSubstr("top: 0\n")));
  const Outcome as_json = weft_command("garment show '" + out + "/my_sheet.yaml' --name top=1 --json 2>/dev/null");
  EXPECT_EQ(nlohmann::json::parse(as_json.output).at("vertices").at("top"), 0);
  const Outcome wrong = weft_command("garment show '" + out + "/my_sheet.obj' --name top=50");
  EXPECT_EQ(wrong.code, 2);
  EXPECT_THAT(wrong.output, HasSubstr("has only 49 vertices"));
}

/// A tube that stands, 0.2 m wide and 0.3 m high.
std::string standing_tube() {
  std::string vertices, faces;
  constexpr int around = 16, along = 8;
  for (int j = 0; j <= along; ++j) {
    for (int i = 0; i < around; ++i) {
      const double angle = 2.0 * M_PI * i / around;
      vertices += "v " + std::to_string(0.1 * std::cos(angle)) + ' ' + std::to_string(0.08 * std::sin(angle)) + ' ' +
                  std::to_string(0.3 * j / along) + '\n';
    }
  }
  for (int j = 0; j < along; ++j) {
    for (int i = 0; i < around; ++i) {
      const int a = j * around + i + 1, b = j * around + (i + 1) % around + 1;
      faces += 'f';
      for (const int v : {a, b, b + around, a + around}) faces += ' ' + std::to_string(v);
      faces += '\n';
    }
  }
  return vertices + faces;
}

TEST(Program, LaysAGarmentThatIsDrawnAsItIsWornAndFoldsIt) {
  const Folder folder;
  const std::string file = folder.write("tube.obj", standing_tube()).string(), out = (folder / "out").string();
  const Outcome import =
      weft_command("garment import '" + file + "' --up z --no-tuning --json --out '" + out + "' 2>/dev/null");
  ASSERT_EQ(import.code, 0) << import.output;
  const auto json = nlohmann::json::parse(import.output);
  EXPECT_TRUE(json.at("foldable"));
  EXPECT_EQ(json.at("grasp"), nlohmann::json({"left_top", "left_bottom"}));
  for (const auto& name : json.at("files"))
    EXPECT_TRUE(std::filesystem::exists(folder / "out" / std::string(name))) << name;
  EXPECT_TRUE(std::filesystem::exists(folder / "out/tube_rest.obj"));
  EXPECT_THAT(text_of(folder / "out/tube.yaml"), AllOf(HasSubstr("from: file"), HasSubstr("bend: true")));
  const Outcome run = weft_command("run '" + out +
                                   "/tube_fold.yaml' --seed 1 --set planning.instances=1 --set planning.iterations=1 "
                                   "--set planning.replan_iterations=0 --set settle.max_frames=30 --out '" +
                                   out + "/run'");
  EXPECT_EQ(run.code, 0) << run.output;
  const Outcome fold = weft_command("garment fold '" + out + "/tube_fold.yaml' --json 2>/dev/null");
  EXPECT_EQ(fold.code, 0) << fold.output;
  const auto folded = nlohmann::json::parse(fold.output);
  EXPECT_EQ(folded.at("crossings"), 0);
  EXPECT_TRUE(folded.at("released"));
  EXPECT_LT(folded.at("width_share"), 0.75);
  // What was saved is the same garment: a plan of the recorded session accepts it.
  EXPECT_EQ(
      weft_command("plan '" + out + "/run/config.yaml' --session '" + out + "/run/session.h5' --out '" + out + "/plan'")
          .code,
      0);
  // The result is imported without a change.
  const Outcome again = weft_command("garment import '" + out + "/tube.yaml' --no-tuning --out '" + out + "/again'");
  EXPECT_EQ(again.code, 0) << again.output;
  EXPECT_EQ(text_of(folder / "out/again/tube.obj"), text_of(folder / "out/tube.obj"));
  EXPECT_EQ(text_of(folder / "out/again/tube_rest.obj"), text_of(folder / "out/tube_rest.obj"));

  const Outcome standing = weft_command("garment import '" + file + "' --up z --no-lay --out '" + out + "/standing'");
  EXPECT_EQ(standing.code, 0) << standing.output;
  EXPECT_THAT(standing.output, HasSubstr("to lay it: weft garment lay"));
  EXPECT_FALSE(std::filesystem::exists(folder / "out/standing/tube_fold.yaml"));
  const Outcome laid =
      weft_command("garment lay '" + out + "/standing/tube.yaml' --json --out '" + out + "/laid' 2>/dev/null");
  ASSERT_EQ(laid.code, 0) << laid.output;
  const auto facts = nlohmann::json::parse(laid.output);
  EXPECT_EQ(facts.at("crossings"), 0);
  EXPECT_LT(facts.at("height_m"), 0.03) << "it was 0.16 m high on its back";
  EXPECT_LT(facts.at("median_strain"), 0.02);
}

TEST(Program, NamesWherePiecesOfAGarmentCross) {
  const Folder folder;
  // A square through the tube's wall.
  const std::string file =
      folder
          .write("tube.obj", standing_tube() +
                                 "v 0.05 -0.04 0.1\nv 0.18 -0.04 0.11\nv 0.18 0.05 0.12\nv 0.05 0.05 0.1\n"
                                 "f -4 -3 -2 -1\n")
          .string();
  const std::string out = (folder / "out").string();
  const Outcome crossed = weft_command("garment import '" + file + "' --up z --no-tuning --out '" + out + "/two'");
  EXPECT_EQ(crossed.code, 1) << crossed.output;
  EXPECT_THAT(crossed.output, AllOf(HasSubstr("so does the mesh as drawn, in "), HasSubstr(", such as edge "),
                                    HasSubstr("two pieces cross there"), HasSubstr("(--piece)")));
  const Outcome one =
      weft_command("garment import '" + file + "' --up z --no-tuning --piece 1 --out '" + out + "/one'");
  EXPECT_EQ(one.code, 0) << one.output;
}

TEST(Program, MakesGarmentsOfTwoLayers) {
  const Folder folder;
  const std::string shirt = (folder / "shirt.obj").string();
  const Outcome made = weft_command("garment tshirt --two-layers --edge 0.05 --out '" + shirt + "'");
  ASSERT_EQ(made.code, 0) << made.output;
  EXPECT_THAT(text_of(folder / "shirt.yaml"),
              AllOf(HasSubstr("from: mesh"), HasSubstr("layers: sides"), HasSubstr("back_collar")));
  std::map<std::string, int> vertices;
  std::istringstream obj(text_of(shirt));
  for (std::string line; std::getline(obj, line);)
    if (line.starts_with("v ")) ++vertices[line];
  const auto pairs = std::count_if(vertices.begin(), vertices.end(), [](const auto& v) { return v.second == 2; });
  EXPECT_GT(pairs, 5) << "at the openings";
  EXPECT_LT(pairs, static_cast<std::ptrdiff_t>(vertices.size()) / 5) << "inside, the back has vertices of its own";
  folder.write(
      "scene.yaml",
      "garment: shirt.yaml\nfabric: {density_kg_per_m2: 0.15, stretch_n_per_m: {warp: 110, weft: 165, shear: 55}, bend_n_m: {warp: 2.0e-5, weft: 2.0e-5}, thickness_m: 0.002}\nduration_s: 0.2\n");
  const std::string out = (folder / "out").string();
  const Outcome run = weft_command("simulate '" + (folder / "scene.yaml").string() + "' --out '" + out + "'");
  ASSERT_EQ(run.code, 0) << run.output;
  const auto summary = nlohmann::json::parse(text_of(folder / "out/summary.json"));
  EXPECT_EQ(summary.at("intersections"), 0);
  // The front lies on the back, at 4 mm. Where a vertex of the back lies under faces that rise from a seam, it bulges by one more.
  EXPECT_NEAR(summary.at("max_z_m"), 0.0051, 4e-4);
  // The saved scene gives the same bits.
  const Outcome again = weft_command("simulate '" + out + "/config.yaml' --out '" + out + "/again'");
  ASSERT_EQ(again.code, 0) << again.output;
  EXPECT_EQ(text_of(folder / "out/again/summary.json"), text_of(folder / "out/summary.json"));
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
  const auto unused = folder.write("unused.yaml", "extends: " + kTask + "\ncorrection: {simulator: clooth}\n");
  EXPECT_THAT(refused(unused.string()), AllOf(HasSubstr("unused.yaml:2: "), HasSubstr("'clooth'; nearest: cloth")));
  const auto yaml = folder.write("yaml.yaml", "a: [1\n");
  EXPECT_THAT(refused(yaml.string()), AllOf(HasSubstr("yaml.yaml:"), HasSubstr("not valid YAML")));
  EXPECT_THAT(refused(kTask, "--set planning.instances=none"),
              HasSubstr("--set: planning.instances = none, must be a whole number"));
  EXPECT_THAT(refused(kTask, "--set planning"), HasSubstr("--set planning: must be key.path=value"));
}

TEST(Program, ASavedConfigRepeatsTheRunBitForBit) {
  const Folder folder;
  const auto task =
      folder.write("task.yaml", kTowelTask +
                                    "optimiser: {plugin: rprop}\n"
                                    "planning: {instances: 2, iterations: 2, replan_iterations: 1, horizon: 12}\n");
  const auto run = [&](const std::filesystem::path& config, const char* out, const std::string& options) {
    const Outcome outcome =
        weft_command("run '" + config.string() + "' --quiet --out '" + (folder / out).string() + "' " + options);
    ASSERT_EQ(outcome.code, 0) << outcome.output;
  };
  run(task, "first", "--seed 12 --jobs 2 --set planning.iterations=3 --set correction.simulator=cloth");
  // The saved config holds every default, also of plugins in groups.
  const ConfigNode saved = ConfigNode::load(folder / "first/config.yaml");
  const PluginRegistry plugins;
  EXPECT_EQ(plugins.resolve_slots(saved, describe_params<SessionParams>()).to_yaml(), saved.to_yaml());
  EXPECT_TRUE(saved.at("correction").at("simulator").at("params").has("max_substeps"));
  run(folder / "first/config.yaml", "again", "--jobs 1");
  EXPECT_EQ(text_of(folder / "again/config.yaml"), text_of(folder / "first/config.yaml"));
  const auto first = Hdf5File::open(folder / "first/session.h5"), again = Hdf5File::open(folder / "again/session.h5");
  const auto rounds = first.list("/rounds");
  ASSERT_GE(rounds.size(), 2u);
  ASSERT_EQ(again.list("/rounds"), rounds);
  std::vector<std::string> arrays{"/frames", "/goal", "/default_shape", "/final_shape", "/true_material"};
  for (const auto& round : rounds)
    for (const auto& array : first.list("/rounds/" + round)) arrays.push_back("/rounds/" + round + "/" + array);
  for (const auto& array : arrays) {
    EXPECT_EQ(first.shape(array), again.shape(array)) << array;
    EXPECT_EQ(first.read(array), again.read(array)) << array;
  }
}

TEST(Program, ASessionThatCannotBeWrittenIsAnErrorWithTheReason) {
  const Folder folder;
  const auto task = folder.write(
      "task.yaml", kTowelTask + "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
  const std::string run = "'" WEFT_PROGRAM "' run '" + task.string() + "' --quiet --out '";
  // A limit on the size of files, here 4 KiB, fails as a full disk does.
  const Outcome limited =
      test::run_shell("unset WEFT_PLUGIN_PATH; ulimit -f 8; " + run + (folder / "out").string() + "'");
  EXPECT_EQ(limited.code, 1);
  EXPECT_THAT(limited.output,
              HasSubstr("error: " + (folder / "out/session.h5").string() + ": cannot be written: File too large"));
  EXPECT_FALSE(std::filesystem::exists(folder / "out"));
}

TEST(Program, APlaceThatTakesNoFilesIsRefusedBeforeTheWork) {
  const Folder folder;
  const auto task = folder.write(
      "task.yaml", kTowelTask + "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
  const std::string physics =
      "'" WEFT_SOURCE_DIR "/configs/experiments/physics.yaml' --set 'physics.tests=[free fall]'";
  for (const std::string& arguments : {"run '" + task.string() + "'", "plan '" + task.string() + "'",
                                       "estimate '" + task.string() + "'", "evaluate physics " + physics}) {
    const Outcome nowhere = weft_command(arguments + " --out /proc/self/out");
    EXPECT_EQ(nowhere.code, 2) << arguments;
    EXPECT_THAT(nowhere.output, StartsWith("error: /proc/self/out: the folder cannot be made: ")) << arguments;
  }
}

TEST(Program, ResultsOfAnotherCommandAreNotWrittenOver) {
  const Folder folder;
  const auto task = folder.write(
      "task.yaml", kTowelTask + "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
  const std::string out = " --quiet --out '" + (folder / "out").string() + "'";
  ASSERT_EQ(weft_command("plan '" + task.string() + "'" + out).code, 0);
  const std::string before = text_of(folder / "out" / "provenance.json");
  const std::string scene = "'" WEFT_SOURCE_DIR "/configs/experiments/scenes/incline.yaml'";
  for (const std::string& other :
       {"run '" + task.string() + "'", "estimate '" + task.string() + "'", "simulate " + scene}) {
    const Outcome refused = weft_command(other + out);
    EXPECT_EQ(refused.code, 2) << other;
    EXPECT_THAT(refused.output, AllOf(HasSubstr("command plan, this one is "), HasSubstr("--accept-changed"))) << other;
    EXPECT_EQ(text_of(folder / "out" / "provenance.json"), before) << other;
    EXPECT_FALSE(std::filesystem::exists(folder / "out" / "frames")) << other;
  }
  EXPECT_EQ(weft_command("plan '" + task.string() + "'" + out + " --set planning.noise=0.2").code, 0);
}

TEST(Program, AFolderOfResultsInThePlaceOfAConfigIsNamed) {
  const Folder folder;
  folder.write("out/config.yaml", kTowelTask);
  EXPECT_THAT(weft_command("run '" + (folder / "out").string() + "'").output,
              HasSubstr("out: is a folder, must be a YAML file; it holds " + (folder / "out/config.yaml").string()));
}

TEST(Program, ASceneThatIsRefusedLeavesEarlierFrames) {
  const Folder folder;
  const std::string simulate = "simulate '" WEFT_SOURCE_DIR
                               "/configs/experiments/scenes/incline.yaml' --quiet --out '" +
                               (folder / "out").string() + "' --set duration_s=0.05";
  ASSERT_EQ(weft_command(simulate).code, 0);
  const auto frames = [&] {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder / "out" / "frames"))
      names.push_back(entry.path().filename().string());
    std::sort(names.begin(), names.end());
    return names;
  };
  const auto before = frames();
  ASSERT_FALSE(before.empty());
  const Outcome refused = weft_command(simulate + " --set simulator.params.max_substeps=1");
  EXPECT_EQ(refused.code, 2) << refused.output;
  EXPECT_EQ(frames(), before);
}

TEST(Program, ThreadsAreThoseOfTheProcessorsItMayUse) {
  const Folder folder;
  const auto task = folder.write(
      "task.yaml", kTowelTask + "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
  const Outcome run = test::run_shell(
      "unset WEFT_PLUGIN_PATH; taskset -c $(taskset -cp $$ | sed 's/.*: //; s/[-,].*//') '" WEFT_PROGRAM "' run '" +
      task.string() + "' --out '" + (folder / "out").string() + "'");
  ASSERT_EQ(run.code, 0) << run.output;
  EXPECT_THAT(run.output, HasSubstr(", 1 thread\n"));
}

TEST(Program, ThePlanAloneIsCorrectedAsTheSessionsFirst) {
  const Folder folder;
  const auto task =
      folder.write("task.yaml", kTowelTask +
                                    "planning: {instances: 1, iterations: 2, replan_iterations: 0, horizon: 8}\n"
                                    "knowledge: \"true\"\n"
                                    "correction: {simulations: 3, later_simulations: 0}\n"
                                    "seed: 12\n");
  for (const std::string command : {"run", "plan"}) {
    const Outcome outcome =
        weft_command(command + " '" + task.string() + "' --out '" + (folder / command).string() + "'");
    ASSERT_EQ(outcome.code, 0) << outcome.output;
    EXPECT_THAT(outcome.output, ContainsRegex("corrected from [0-9.]+ mm, 3 simulated"));
  }
  const auto plan = nlohmann::json::parse(text_of(folder / "plan/plan.json"));
  const auto summary = nlohmann::json::parse(text_of(folder / "run/summary.json"));
  EXPECT_EQ(plan["correction"], summary["corrections"][0]);
  EXPECT_EQ(plan["predicted_error_mm"], plan["correction"]["corrected_mm"]);
  std::vector<double> controls;
  for (const auto& row : plan["controls"])
    for (const double value : row) controls.push_back(value);
  EXPECT_EQ(controls, Hdf5File::open(folder / "run/session.h5").read("/rounds/000/controls"));
}

TEST(Program, PlanAndEstimateAloneDoWhatTheSessionDid) {
  const Folder folder;
  const auto task =
      folder.write("task.yaml", kTowelTask +
                                    "planning: {instances: 1, iterations: 2, replan_iterations: 1, horizon: 8}\n"
                                    "estimation: {instances: 1, iterations: 1, later_iterations: 1}\n"
                                    "observation: {noise_m: 0.001}\n"
                                    "knowledge: estimate\n"
                                    "seed: 12\n");
  const auto command = [&](const std::string& name, const std::string& options) {
    const Outcome outcome =
        weft_command(name + " '" + task.string() + "' --quiet --out '" + (folder / name).string() + "' " + options);
    EXPECT_EQ(outcome.code, 0) << outcome.output;
  };
  const auto json = [&](const char* file) { return nlohmann::json::parse(text_of(folder / file)); };
  command("run", "");
  const auto recorded = Hdf5File::open(folder / "run/session.h5");
  const std::string session = "--session '" + (folder / "run").string() + "'";
  const auto expect_plan = [&](const std::string& options, const std::string& round) {
    command("plan", options);
    std::vector<double> controls;
    const auto plan = json("plan/plan.json");
    for (const auto& row : plan["controls"])
      for (const double value : row) controls.push_back(value);
    EXPECT_EQ(controls, recorded.read("/rounds/" + round + "/controls")) << options;
  };
  expect_plan("", "000");
  expect_plan(session, "000");
  expect_plan(session + " --segment 3", "002");
  EXPECT_EQ(weft_command("plan '" + task.string() + "' " + session + " --segment 99").code, 2);

  command("estimate", session);
  const nlohmann::json estimates = json("estimate/estimate.json")["estimates"];
  const auto centre = recorded.read("/estimates/centre");
  ASSERT_EQ(4 * estimates.size(), centre.size());
  // Frames are recorded in single precision. Another noise or history would move an estimate by tenths.
  for (std::size_t i = 0; i < centre.size(); ++i)
    EXPECT_NEAR(estimates[i / 4]["centre"][i % 4].get<double>(), centre[i], 0.02) << i;
  command("estimate", "--set planning.horizon=8");
  EXPECT_GE(json("estimate/estimate.json")["estimates"].size(), 4u);
}

TEST(Program, TheShippedTaskFoldsWithTheShippedModel) {
  const Folder folder;
  const Outcome outcome =
      weft_command("run '" + kTask + "' --seed 5003 --quiet --out '" + folder.path().string() + "'");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  const auto summary = nlohmann::json::parse(text_of(folder / "summary.json"));
  // The error was 1.2 mm when the model was made. A damaged or foreign model ends tens of millimetres off.
  EXPECT_LT(summary["error_mm"].get<double>(), 10.0);
  EXPECT_GT(summary["default_error_mm"].get<double>(), 40.0);
  // The plugins that it used. The config names more: the simulator of corrections in another world.
  std::string used;
  const auto provenance = nlohmann::json::parse(text_of(folder / "provenance.json"));
  for (const auto& plugin : provenance.at("plugins"))
    used += plugin["kind"].get<std::string>() + "/" + plugin["name"].get<std::string>() + " ";
  EXPECT_EQ(used, "optimiser/rprop predictor/emd simulator/cloth trajectory/arc ");
}

TEST(Program, EvaluatePhysicsWritesWhatItPrints) {
  const Folder folder;
  const std::string command = "evaluate physics " WEFT_SOURCE_DIR "/configs/experiments/physics.yaml --out '" +
                              (folder / "out").string() + "' --set 'physics.tests=[free fall, rest]'";
  const Outcome outcome = weft_command(command);
  EXPECT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, AllOf(HasSubstr("ok   free fall"), HasSubstr("2 comparisons, 0 outside their bound")));
  std::ifstream file(folder / "out/physics.json");
  const auto json = nlohmann::json::parse(file);
  EXPECT_EQ(json.at("comparisons"), 2);
  for (const auto& row : json.at("rows")) {
    EXPECT_TRUE(row.at("passed").get<bool>());
    EXPECT_LE(row.at("error").get<double>(), row.at("bound").get<double>());
  }
  const Outcome unknown = weft_command(command + " --set 'physics.tests=[freefall]'");
  EXPECT_EQ(unknown.code, 2);
  EXPECT_THAT(unknown.output, HasSubstr("physics.tests.0 = freefall, must be one of elastica, "));
}

TEST(Program, EvaluatePhysicsKeepsWhatItMeasuredBefore) {
  const Folder folder;
  const std::string command = "evaluate physics " WEFT_SOURCE_DIR "/configs/experiments/physics.yaml --jobs 1 --out '" +
                              (folder / "out").string() + "' --set ";
  const auto result = [&] {
    std::ifstream file(folder / "out/physics.json");
    return std::string{std::istreambuf_iterator<char>(file), {}};
  };
  ASSERT_EQ(weft_command(command + "'physics.tests=[free fall]'").code, 0);
  const std::string measured = result();
  const Outcome again = weft_command(command + "'physics.tests=[free fall]'");
  EXPECT_EQ(again.code, 0) << again.output;
  EXPECT_THAT(again.output, AllOf(HasSubstr("everything was measured before"), HasSubstr("1 comparisons, 0 outside"),
                                  Not(HasSubstr("ok   free fall"))));
  EXPECT_EQ(result(), measured);
  // Others are measured, where that is accepted.
  const Outcome other = weft_command(command + "'physics.tests=[free fall, rest]' --accept-changed");
  EXPECT_EQ(other.code, 0) << other.output;
  EXPECT_THAT(other.output, HasSubstr("2 comparisons, 0 outside"));
  // A case that did not run may run this time.
  std::string crashed = result();
  const std::string quantity = "\"quantity\": \"";
  const auto at = crashed.find(quantity) + quantity.size();
  crashed.replace(at, crashed.find('"', at) - at, "crashed");
  std::ofstream(folder / "out/physics.json") << crashed;
  EXPECT_THAT(weft_command(command + "'physics.tests=[free fall, rest]'").output, HasSubstr("ok   free fall"));
}

TEST(Program, AblateComparesArmsAndResumes) {
  const Folder folder;
  folder.write("task.yaml",
               kTowelTask + "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
  const auto file =
      folder.write("ablation.yaml",
                   "task: task.yaml\n"
                   "factors:\n"
                   "  planned:\n"
                   "    \"no\": {}\n"
                   "    \"yes\": {optimiser: {plugin: mppi, params: {samples: 4}}, planning.iterations: 1}\n"
                   "seeds: [1]\n");
  const auto ablate = [&](const std::string& options = "") {
    return weft_command("ablate '" + file.string() + "' --out '" + (folder / "out").string() + "' --jobs 2 " + options);
  };
  const Outcome first = ablate();
  ASSERT_EQ(first.code, 0) << first.output;
  EXPECT_THAT(first.output, AllOf(HasSubstr("2 arms, 1 seed,"), HasSubstr("2/2  "), HasSubstr("error_mm")));
  const std::string csv = text_of(folder / "out" / "ablation.csv");
  const auto json = nlohmann::json::parse(text_of(folder / "out" / "ablation.json"));
  EXPECT_THAT(first.output, AllOf(HasSubstr("silhouette_iou"), HasSubstr("success_10mm")));
  EXPECT_THAT(csv, HasSubstr(",max_error_mm,grasped_error_mm,named_error_mm,silhouette_iou,"));
  EXPECT_GT(json["arms"][0]["metrics"]["silhouette_iou"]["mean"].get<double>(), 0.0);
  EXPECT_EQ(json["arms"][0]["metrics"]["success_30mm"]["mean"].get<double>(),
            json["arms"][0]["metrics"]["error_mm"]["mean"].get<double>() <= 30.0 ? 1.0 : 0.0);
  EXPECT_EQ(json["arms"][1]["baseline"], "no");
  EXPECT_EQ(json["arms"][1]["unpaired"], 0);
  const auto loss = [&](int arm) { return json["arms"][arm]["metrics"]["first_plan_loss"]["mean"].get<double>(); };
  EXPECT_LE(loss(1), loss(0));
  EXPECT_GT(json["arms"][1]["metrics"]["evaluations"]["difference"]["mean"].get<double>(), 0.0);
  const Outcome again = ablate();
  EXPECT_EQ(again.code, 0);
  EXPECT_THAT(again.output, Not(HasSubstr("2/2  ")));  // nothing ran
  EXPECT_EQ(text_of(folder / "out" / "ablation.csv"), csv);
  const Outcome other = ablate("--set set.planning.noise=0.5");
  EXPECT_EQ(other.code, 2);
  EXPECT_THAT(other.output, AllOf(HasSubstr("planning.noise "), HasSubstr(" -> 0.5"), HasSubstr("--accept-changed")));
  const Outcome wrong = ablate("--set factors.planned.no.optimiser=rpop");
  EXPECT_EQ(wrong.code, 2);
  EXPECT_THAT(wrong.output, AllOf(HasSubstr("arm 'no'"), HasSubstr("nearest: rprop")));
}

TEST(Program, ASweepThatIsAskedToStopEndsWithItsTable) {
  const Folder folder;
  folder.write("task.yaml",
               kTowelTask + "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
  const auto file = folder.write("ablation.yaml",
                                 "task: task.yaml\n"
                                 "factors: {noise: {low: {planning.noise: 0.1}, high: {planning.noise: 0.4}}}\n"
                                 "seeds: {first: 1, count: 500}\n");
  for (const char* signal : {"TERM", "HUP", "INT"}) {
    const std::string out = (folder / signal).string();
    // A shell makes its background processes ignore SIGINT; weft takes the signal all the same.
    const Outcome outcome = test::run_shell("'" WEFT_PROGRAM "' ablate '" + file.string() + "' --out '" + out +
                                            "' --jobs 2 & weft=$!\n"
                                            "until ls '" +
                                            out +
                                            "'/cells/*.json >/dev/null 2>&1 || ! kill -0 $weft; do sleep 0.05; done\n"
                                            "kill -" +
                                            signal + " $weft; wait $weft");
    EXPECT_EQ(outcome.code, 1) << signal << outcome.output;
    EXPECT_THAT(outcome.output,
                AllOf(HasSubstr("stopping; "), HasSubstr("error_mm"), HasSubstr("interrupted; run the same")))
        << signal;
    EXPECT_TRUE(std::filesystem::exists(out + "/ablation.csv")) << signal;
    EXPECT_FALSE(std::filesystem::exists(out + "/claims")) << signal;
  }
}

TEST(Program, APlanOrASessionThatIsAskedToStopSaysSo) {
  const Folder folder;
  const auto task =
      folder.write("task.yaml", kTowelTask + "planning: {instances: 1, iterations: 90000, horizon: 12}\n");
  // Also before the first segment, while the goal is made.
  for (const char* pause : {"0", "0.003", "0.006", "0.01", "0.1"}) {
    for (const char* command : {"run", "plan"}) {
      const std::string out = (folder / command).string();
      const Outcome outcome =
          test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + std::string(command) + " '" + task.string() +
                          "' --out '" + out +
                          "' & weft=$!\n"
                          "until test -d '" +
                          out + "' || ! kill -0 $weft; do :; done; sleep " + pause + "\nkill -TERM $weft; wait $weft");
      EXPECT_EQ(outcome.code, 1) << command << " " << pause << outcome.output;
      EXPECT_THAT(outcome.output, HasSubstr("interrupted")) << command << " " << pause;
      EXPECT_FALSE(std::filesystem::exists(out + "/plan.json"));
      std::filesystem::remove_all(folder / "run");
    }
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "plan"));  // a plan that was cut short is not kept
}

TEST(Program, AJobOfSlurmThatIsAskedTwiceEndsInOrder) {
  const Folder folder;
  const auto task =
      folder.write("task.yaml", kTowelTask + "planning: {instances: 1, iterations: 90000, horizon: 12}\n");
  const auto asked_twice = [&](const std::string& job) {
    return test::run_shell("unset WEFT_PLUGIN_PATH SLURM_JOB_ID; " + job + " '" WEFT_PROGRAM "' run '" + task.string() +
                           "' --out '" + (folder / "run").string() + "' & weft=$!\nuntil test -d '" +
                           (folder / "run").string() +
                           "'; do :; done; sleep 0.1; kill -TERM $weft; sleep 0.01; kill -TERM $weft; wait $weft");
  };
  // slurmd and the script of a cancelled job both ask.
  const Outcome job = asked_twice("SLURM_JOB_ID=7");
  EXPECT_EQ(job.code, 75) << job.output;
  EXPECT_THAT(job.output, AllOf(HasSubstr("stopping\n"), HasSubstr("interrupted")));
  std::filesystem::remove_all(folder / "run");
  EXPECT_EQ(asked_twice("").code, 143);
}

/// Simulations without a search: they end between two frames, and write nothing.
TEST(Program, ASimulationThatIsAskedToStopEndsAndLeavesNothing) {
  const Folder folder;
  const std::string configs = WEFT_SOURCE_DIR "/configs/", out = "'" + (folder / "out").string() + "'";
  const std::string commands[] = {
      "displacement '" + configs + "tasks/tshirt_fold.yaml'",
      "garment import '" + configs + "garments/tshirt.obj' --units m --up z --out " + out,
      "garment lay '" + configs + "garments/tshirt.yaml' --out " + out,
      "garment fold '" + configs + "tasks/tshirt_fold.yaml' --mesh " + out,
  };
  for (const std::string& command : commands) {
    Outcome outcome;
    for (const char* pause : {"0.2", "0.4", "0.8", "1.6", "3.2"}) {
      outcome = test::run_shell("unset WEFT_PLUGIN_PATH; timeout --preserve-status -s TERM " + std::string(pause) +
                                " '" WEFT_PROGRAM "' " + command);
      if (outcome.code != 128 + 15) break;  // on a busy machine weft may not have begun
    }
    EXPECT_EQ(outcome.code, 1) << command << outcome.output;
    EXPECT_THAT(outcome.output, AllOf(HasSubstr("stopping; "), HasSubstr("error: interrupted"))) << command;
    EXPECT_FALSE(std::filesystem::exists(folder / "out")) << command;
  }
  // Nor does an import whose fabric is refused write half of its files.
  const auto fabric = folder.write("fabric.yaml", "nominal: {density_kg_per_m2: -1}\n");
  const Outcome refused = weft_command(commands[1] + " --fabric '" + fabric.string() + "'");
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.output, HasSubstr(fabric.string() + ":1: "));
  EXPECT_FALSE(std::filesystem::exists(folder / "out"));
}

TEST(Program, EvaluatePhysicsGoesOnWithTheCasesThatHaveEnded) {
  const Folder folder;
  const auto config = [&](const char* edge) {
    return folder.write("physics.yaml",
                        kTowelTask + "physics: {tests: [free fall, hanging, drape], garment_edge_m: " + edge + "}\n");
  };
  const std::string out = (folder / "out").string(), checkpoint = out + "/physics.checkpoint.json",
                    evaluate = "evaluate physics '" + config("0.05").string() + "' --jobs 1 --out ";
  const Outcome whole = weft_command(evaluate + "'" + (folder / "whole").string() + "'");
  ASSERT_LE(whole.code, 1) << whole.output;
  for (const std::string how : {"", " --in-process"}) {
    const Outcome stopped = test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + evaluate + "'" + out + "'" +
                                            how + " & weft=$!\nuntil test -e '" + checkpoint +
                                            "' || ! kill -0 $weft; do :; done; kill -TERM $weft; wait $weft");
    ASSERT_EQ(stopped.code, 1) << stopped.output;
    EXPECT_THAT(stopped.output, HasSubstr("interrupted; run the same command again to finish it"));
    ASSERT_TRUE(std::filesystem::exists(checkpoint));
    EXPECT_FALSE(std::filesystem::exists(out + "/physics.json"));
    auto json = nlohmann::ordered_json::parse(text_of(checkpoint));
    EXPECT_LT(json["cases"].size(), 3u);
    // What has ended is taken as it stands, and only if it belongs to the same config.
    json["cases"][0]["rows"][0]["note"] = "from the checkpoint";
    folder.write("out/physics.checkpoint.json", json.dump());
    config("0.06");
    const Outcome changed = weft_command(evaluate + "'" + out + "'" + how);
    EXPECT_EQ(changed.code, 2);
    EXPECT_THAT(changed.output, HasSubstr("physics.garment_edge_m 0.05 -> 0.06"));
    config("0.05");
    const Outcome finished = weft_command(evaluate + "'" + out + "'" + how);
    EXPECT_EQ(finished.code, whole.code) << finished.output;
    auto found = nlohmann::json::parse(text_of(out + "/physics.json")),
         wanted = nlohmann::json::parse(text_of(folder / "whole/physics.json"));
    EXPECT_EQ(found["rows"][0]["note"], "from the checkpoint");
    found["rows"][0]["note"] = wanted["rows"][0]["note"];
    EXPECT_EQ(found, wanted);
    EXPECT_FALSE(std::filesystem::exists(checkpoint));
    std::filesystem::remove_all(out);
  }
}

TEST(Program, TwoProcessesThatEvaluatePhysicsDoItOnce) {
  const Folder folder;
  const auto config =
      folder.write("physics.yaml", kTowelTask + "physics: {tests: [free fall, hanging], garment_edge_m: 0.05}\n");
  const std::string evaluate = "'" WEFT_PROGRAM "' evaluate physics '" + config.string() + "' --jobs 1 --out '" +
                               (folder / "out").string() + "'";
  const Outcome both = test::run_shell("unset WEFT_PLUGIN_PATH; " + evaluate + " & " + evaluate + "; wait");
  const auto times = [&](const std::string& text) {
    int count = 0;
    for (auto at = both.output.find(text); at != std::string::npos; at = both.output.find(text, at + 1)) ++count;
    return count;
  };
  EXPECT_EQ(times("everything was measured before"), 1) << both.output;
  EXPECT_EQ(times("results in"), 2) << both.output;
  EXPECT_FALSE(std::filesystem::exists(folder / "out/claims"));
}

TEST(Program, WhatASimulatorCannotHonourIsSaid) {
  const Folder folder;
  const auto task =
      folder.write("task.yaml", kTowelTask +
                                    "simulator: {plugin: bullet}\noptimiser: {plugin: rprop}\n"
                                    "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 12}\n");
  const auto warned = AllOf(HasSubstr("warning: bullet: "), HasSubstr("poisson = "));
  const Outcome run = weft_command("run '" + task.string() + "' --quiet --out '" + (folder / "run").string() + "'");
  ASSERT_EQ(run.code, 0) << run.output;
  EXPECT_THAT(run.output, warned);
  const auto summary = nlohmann::json::parse(text_of(folder / "run" / "summary.json"));
  EXPECT_THAT(summary["warnings"].dump(), HasSubstr("poisson = "));
  const Outcome generate =
      weft_command("generate '" + task.string() + "' --examples 1 --out '" + (folder / "data").string() + "'");
  EXPECT_EQ(generate.code, 0);
  EXPECT_THAT(generate.output, warned);
}

TEST(Program, AblateComparesSimulatorsOnThePhysicsSuite) {
  const Folder folder;
  folder.write("suite.yaml", kTowelTask +
                                 "physics: {tests: [free fall, paired folds], folds: {count: 0, paired: 1}}\n"
                                 "other: {plugin: cloth}\n");
  const auto file = folder.write("ablation.yaml",
                                 "task: suite.yaml\n"
                                 "measure: physics\n"
                                 "factors:\n"
                                 "  simulator:\n"
                                 "    cloth: {simulator: {plugin: cloth}}\n"
                                 "    bullet: {simulator: {plugin: bullet}}\n");
  const std::string command = "ablate '" + file.string() + "' --out '" + (folder / "out").string() + "' --jobs 2 ";
  const Outcome first = weft_command(command);
  ASSERT_EQ(first.code, 0) << first.output;
  EXPECT_THAT(first.output, AllOf(HasSubstr("2 arms, 2 cases"), HasSubstr("4/4  "), HasSubstr("mean vertex distance"),
                                  HasSubstr("warning: bullet: ")));
  const auto json = nlohmann::json::parse(text_of(folder / "out" / "ablation.json"));
  EXPECT_EQ(json["cases"], (nlohmann::json{"paired folds, seed 1", "free fall, irregular sheet"}));
  const auto times = nlohmann::json::parse(text_of(folder / "out" / "times.json"));
  for (const auto& arm : times["ablation.json"]["arms"])
    EXPECT_GT(arm["metrics"]["paired folds: CPU ms per frame"]["mean"], 0.0) << arm;
  for (const auto& arm : json["arms"]) {
    const auto& metrics = arm["metrics"];
    EXPECT_EQ(metrics["free fall: within bounds"]["mean"], 1.0) << arm;
    EXPECT_EQ(metrics["paired folds: edge/triangle crossings"]["mean"], 0.0) << arm;
    EXPECT_FALSE(metrics.contains("paired folds: CPU ms per frame")) << arm;
  }
  // Distances to `other` are given only for another simulator.
  const auto distance = [&](int arm) { return json["arms"][arm]["metrics"]["paired folds: mean vertex distance mm"]; };
  EXPECT_EQ(distance(0)["n"], 0);
  EXPECT_EQ(distance(1)["n"], 1);
  EXPECT_GT(distance(1)["mean"], 0.01);
  EXPECT_LT(distance(1)["mean"], 100.0);

  const std::string csv = text_of(folder / "out" / "ablation.csv");
  EXPECT_THAT(weft_command(command).output, Not(HasSubstr("4/4  ")));  // nothing ran
  EXPECT_EQ(text_of(folder / "out" / "ablation.csv"), csv);
  std::filesystem::remove_all(folder / "out" / "cells");
  const Outcome broken = weft_command(command + "--set factors.simulator.bullet.simulator.plugin=bulet");
  EXPECT_EQ(broken.code, 2);
  EXPECT_THAT(broken.output, AllOf(HasSubstr("arm 'bullet'"), HasSubstr("bulet")));
}

TEST(Program, ShippedAblationsAreRead) {
  const AblationPlan simulators =
      read_ablation(ConfigNode::load(WEFT_SOURCE_DIR "/configs/experiments/simulators.yaml"));
  EXPECT_EQ(simulators.arms.size(), 2u);
  EXPECT_EQ(std::count_if(simulators.cases.begin(), simulators.cases.end(),
                          [](const std::string& name) { return name.starts_with("paired folds, "); }),
            50);

  for (const char* name : {"optimisers", "optimisers_coarse", "trajectories", "instances", "horizon", "predictor"}) {
    const std::filesystem::path file = std::filesystem::path(WEFT_SOURCE_DIR) / "configs/experiments" / name;
    const AblationPlan plan = read_ablation(ConfigNode::load(file.string() + ".yaml"));
    EXPECT_GE(plan.arms.size(), 3u) << name;
    EXPECT_GE(plan.seeds.size(), 3u) << name;
  }
}

TEST(Program, PluginsListsEveryShippedPlugin) {
  const Outcome text = weft_command("plugins");
  EXPECT_EQ(text.code, 0);
  EXPECT_THAT(text.output, HasSubstr("trajectory  arc"));
  const Folder folder;
  folder.write("broken.so", "no library");
  EXPECT_THAT(weft_command("plugins --set plugin_path=[" + folder.path().string() + "]").output,
              HasSubstr("broken.so"));

  const Outcome json = weft_command("plugins --json 2>/dev/null");
  EXPECT_EQ(json.code, 0);
  const auto array = nlohmann::json::parse(json.output);
  ASSERT_TRUE(array.is_array());
  std::string names;
  for (const auto& entry : array) {
    EXPECT_EQ(entry.at("refusal"), "") << entry.at("file");
    names += entry.at("kind").get<std::string>() + "/" + entry.at("name").get<std::string>() + " ";
  }
  for (const char* name : {"simulator/cloth", "predictor/rollout", "trajectory/arc", "trajectory/spline",
                           "trajectory/fling", "trajectory/drag", "trajectory/keyframes", "optimiser/rprop",
                           "optimiser/ceres", "optimiser/nlopt", "optimiser/mppi"}) {
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
  EXPECT_THAT(weft_command("describe ablation").output, HasSubstr("resamples"));
  EXPECT_THAT(
      weft_command("describe scene").output,
      AllOf(StartsWith("scene file, for weft simulate\n"), HasSubstr("  duration_s  "), HasSubstr("default (none)"),
            HasSubstr("  grasps.N.keyframes.N.offset_m list of 3 numbers (x, y, z) m, in [-1000, 1000]")));
  const auto experiment = nlohmann::json::parse(weft_command("describe experiment --json 2>/dev/null").output);
  std::map<std::string, nlohmann::json> keys;
  for (const auto& key : experiment.at("params")) keys[key.at("name")] = key;
  EXPECT_EQ(keys["estimation.deviation_scale"].at("length"), 4);
  EXPECT_EQ(keys["correction.simulator"].at("slot"), "simulator");
  EXPECT_EQ(keys["estimation.method"].at("choices").size(), 3u);
  // The keys of the task and of how examples are made: a dataset's identity consists of them.
  for (const char* name : {"seed", "garment", "settle.max_frames", "trajectory", "data.jitter"})
    EXPECT_EQ(keys[name].at("decides"), "examples") << name;
  for (const char* name : {"planning.iterations", "goal.horizon", "predictor", "dataset"})
    EXPECT_EQ(keys[name].at("decides"), "results") << name;
  for (const char* name : {"description", "threads", "plugin_path"})
    EXPECT_EQ(keys[name].at("decides"), "nothing") << name;
  const Outcome unknown = weft_command("describe ark");
  EXPECT_EQ(unknown.code, 2);
  EXPECT_THAT(unknown.output,
              AllOf(StartsWith("error: no plugin is called 'ark'; nearest: arc"), HasSubstr("searched")));
  EXPECT_EQ(weft_command("describe no/such/library.so").code, 2);
}

TEST(Program, NewWritesAPluginOfEachKind) {
  const Folder folder;
  for (const auto& [kind, class_name] : std::map<std::string, std::string>{{"simulator", "SoftTouchSimulator"},
                                                                           {"predictor", "SoftTouchPredictor"},
                                                                           {"trajectory", "SoftTouchTrajectory"},
                                                                           {"optimiser", "SoftTouchOptimiser"}}) {
    const auto out = folder / kind;
    std::filesystem::create_directories(out);  // an empty folder is taken
    const Outcome outcome = weft_command("new " + kind + " soft_touch --out '" + out.string() + "'");
    ASSERT_EQ(outcome.code, 0) << outcome.output;
    EXPECT_THAT(outcome.output, AllOf(HasSubstr("\n  cmake -S " + out.string() + " -B "), HasSubstr("\n  ctest ")));
    for (const char* file : {"CMakeLists.txt", "README.md", "check.hpp", "soft_touch.cpp", "test_soft_touch.cpp"})
      EXPECT_FALSE(std::regex_search(text_of(out / file), std::regex("@[A-Z]+@"))) << file;
    EXPECT_THAT(text_of(out / "soft_touch.cpp"), HasSubstr(", " + class_name + ", Params, \"soft_touch\", \"1.0.0\")"));
    // The law of the README is one of this kind; `weft conformance` would refuse another.
    const std::string readme = text_of(out / "README.md");
    const auto law = readme.find("--law ") + 6;
    EXPECT_THAT(weft_command("conformance --list --kind " + kind).output,
                HasSubstr(readme.substr(law, readme.find(' ', law) - law) + " "));
  }
}

TEST(Program, NewWritesAllOfItsFilesOrNone) {
  const Folder folder;
  const std::string make = "new simulator soft --out '" + (folder / "soft").string() + "'";
  // A limit on the size of files fails as a full disk does.
  const Outcome limited = test::run_shell("ulimit -f 1; '" WEFT_PROGRAM "' " + make);
  EXPECT_EQ(limited.code, 1);
  EXPECT_THAT(limited.output, HasSubstr("cannot be written: File too large"));
  EXPECT_FALSE(std::filesystem::exists(folder / "soft"));
  EXPECT_EQ(weft_command(make).code, 0);
}

TEST(Program, NewRefusesWhatItCannotWrite) {
  const Folder folder;
  folder.write("full/notes.txt", "mine");
  folder.write("file", "mine");
  const auto refused = [&](const std::string& arguments, const std::string& expected) {
    const Outcome outcome = weft_command("new " + arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_THAT(outcome.output, AllOf(StartsWith("error: "), HasSubstr(expected)));
  };
  const std::string out = " --out '" + (folder / "new").string() + "'";
  refused("trajektory swing" + out,
          "'trajektory' is not a kind of plugin, must be one of simulator, predictor, trajectory, ");
  refused("trajektory swing" + out, "; nearest: trajectory\n");
  for (const std::string name : {"Swing", "3d", "_swing", "my-swing", "'my swing'", "../swing"})
    refused("trajectory " + name + out,
            "cannot be the name of a plugin, must be a lower-case letter and then at most 62 ");
  refused("trajectory " + std::string(64, 'a') + out, "cannot be the name of a plugin");
  refused("trajectory arc" + out, "there is already a trajectory plugin called arc: ");
  refused("trajectory swing --out '" + (folder / "full").string() + "'", "full: exists and is not an empty folder");
  refused("trajectory swing --out '" + (folder / "file").string() + "'", "file: exists and is not an empty folder");
  refused("trajectory swing --out '" + (folder / "file/new").string() + "'", "file/new: ");
  EXPECT_FALSE(std::filesystem::exists(folder / "new"));
  EXPECT_EQ(text_of(folder / "full/notes.txt"), "mine");
  // A name of another kind is free, and --force takes one that is not.
  EXPECT_EQ(weft_command("new optimiser arc" + out).code, 0);
  EXPECT_EQ(weft_command("new trajectory arc --force --out '" + (folder / "forced").string() + "'").code, 0);
  EXPECT_EQ(weft_command("new trajectory").code, 2);
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
