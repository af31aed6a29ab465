// evaluate planning and evaluate estimation as people use them, on a coarse towel with an untrained network. They write
// complete results, survive being killed, and repeat.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "learning/dataset_files.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/dataset.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

using nlohmann::json;
using test::Folder;
using test::Outcome;
using ::testing::HasSubstr;

const std::string kConfig = "'" WEFT_SOURCE_DIR "/configs/experiments/towel_small.yaml' ";
const std::string kQuick =
    "--set predictor.params.untrained=true --set planning='{instances: 2, iterations: 2, replan_iterations: 1}' "
    "--set estimation='{instances: 2, iterations: 2, later_iterations: 1}' --set goal.random.min_distance_mm=5 "
    "--set max_segments=12 ";

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
Outcome killed_command(double seconds, const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; timeout -s KILL " + std::to_string(seconds) + " '" WEFT_PROGRAM "' " +
                         arguments);
}
std::string quoted(const std::filesystem::path& path) { return "'" + path.string() + "'"; }
json read(const std::filesystem::path& file) {
  std::ifstream stream(file);
  return json::parse(stream);
}
/// A result without its times.
json without_seconds(json value) {
  if (value.is_object()) {
    for (auto it = value.begin(); it != value.end();) {
      if (it.key().find("seconds") != std::string::npos)
        it = value.erase(it);
      else
        *it = without_seconds(*it), ++it;
    }
  } else if (value.is_array()) {
    for (auto& item : value) item = without_seconds(item);
  }
  return value;
}

TEST(EvaluatePlanning, IsResumedAfterBeingKilledAndRepeats) {
  const Folder folder;
  const std::string command = "evaluate planning " + kConfig + kQuick + "--cases 2 --widths 0.1 1 --seed 3 ";
  const Outcome whole = weft_command(command + "--jobs 2 --out " + quoted(folder / "whole"));
  ASSERT_EQ(whole.code, 0) << whole.output;
  EXPECT_THAT(whole.output, HasSubstr("4/4"));
  for (const double seconds : {0.05, 0.1, 0.15, 0.25, 0.6})
    killed_command(seconds, command + "--jobs 1 --quiet --out " + quoted(folder / "parts"));
  // On a slow machine three of the kills may have met one case, which then counts as lost.
  const Outcome rest = weft_command(command + "--jobs 1 --json --retry-failed --out " + quoted(folder / "parts"));
  ASSERT_EQ(rest.code, 0) << rest.output;
  const json result = read(folder / "whole/planning.json");
  EXPECT_EQ(without_seconds(json::parse(rest.output)), without_seconds(result));
  EXPECT_EQ(result["goals"], "fresh");
  EXPECT_EQ(result["cases"].size(), 4u);
  EXPECT_EQ(result["by_width"][1]["width"], 1.0);
  EXPECT_EQ(result["by_width"][1]["n"], 2);
  const auto shapes = Hdf5File::open(folder / "whole/cases.h5");
  EXPECT_EQ(shapes.shape("/planning/finals")[0], 4);
  EXPECT_EQ(shapes.shape("/planning/goals")[0], 2);
  // A run with another config is refused in the same folder.
  const Outcome other = weft_command(command + "--set planning.noise=2 --out " + quoted(folder / "whole"));
  EXPECT_EQ(other.code, 2);
  EXPECT_THAT(other.output, HasSubstr("planning.noise "));
}

/// Files in a folder and what they hold; none when there is no such folder.
std::map<std::string, std::string> files_of(const std::filesystem::path& folder) {
  std::map<std::string, std::string> all;
  if (!std::filesystem::exists(folder)) return all;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    std::ifstream stream(entry.path(), std::ios::binary);
    all[entry.path().filename().string()] = {std::istreambuf_iterator<char>(stream), {}};
  }
  return all;
}

TEST(EvaluateEstimation, FreshCasesAreResumedAfterBeingKilledAndRepeat) {
  const Folder folder;
  const std::string command =
      "evaluate estimation " + kConfig + kQuick + "--cases 4 --goals fresh --seed 5 --jobs 1 --quiet ";
  const Outcome whole = weft_command(command + "--out " + quoted(folder / "whole"));
  ASSERT_EQ(whole.code, 0) << whole.output;
  const json result = read(folder / "whole/estimation.json");
  EXPECT_EQ(result["goals"], "fresh");
  EXPECT_EQ(result["n"], 4);
  EXPECT_TRUE(result["complete"]);
  // Each case has its own material and manipulation.
  EXPECT_NE(result["cases"][0]["true_material"], result["cases"][1]["true_material"]);
  for (const auto& one : result["cases"]) EXPECT_GE(one["knowledge"].size(), 4u);

  // Killed as soon as the first case is written.
  const auto cells = folder / "parts/fresh/cells";
  test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + command + "--out " + quoted(folder / "parts") +
                  " & pid=$!; for i in $(seq 3000); do ls " + quoted(cells) +
                  "/seed*[0-9a-f].json >/dev/null 2>&1 && break; sleep 0.01; done; kill -KILL $pid; wait $pid");
  const auto kept = files_of(cells);
  ASSERT_GE(kept.size(), 1u);
  EXPECT_FALSE(std::filesystem::exists(folder / "parts/estimation.json"));
  const Outcome rest = weft_command(command + "--out " + quoted(folder / "parts"));
  ASSERT_EQ(rest.code, 0) << rest.output;
  EXPECT_EQ(without_seconds(read(folder / "parts/estimation.json")), without_seconds(result));
  const auto all = files_of(cells);
  for (const auto& [name, content] : kept) {
    if (name.find(".tmp") == std::string::npos && name.find(".times.") == std::string::npos) {
      EXPECT_EQ(all.at(name), content) << name << " was made again";
    }
  }
}

TEST(EvaluatePlanning, GoalsOfASplitAreWhatItsExamplesBecame) {
  const Folder folder;
  ASSERT_EQ(weft_command("generate " + kConfig + "--examples 24 --quiet --out " + quoted(folder / "data")).code, 0);
  const Outcome outcome = weft_command("evaluate planning " + kConfig + kQuick +
                                       "--cases 2 --widths 0.5 --goals test train --quiet --data " +
                                       quoted(folder / "data") + " --out " + quoted(folder / "out"));
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  const json result = read(folder / "out/planning.json");
  EXPECT_EQ(result["goals"], "test");
  ASSERT_EQ(result["cases"].size(), 2u);
  const json& train = result["columns"]["train"];
  EXPECT_EQ(train["goals"], "train");
  for (const json* column : {&result, &train}) {
    ASSERT_EQ((*column)["by_width"].size(), 1u);
    EXPECT_EQ((*column)["by_width"][0]["n"], 2);
    EXPECT_GT((*column)["by_width"][0]["mean_mm"].get<double>(), 0.0);
  }
  // The goal is the example's last shape, since controls and material are the example's.
  const Dataset data = load_dataset(folder / "data");
  const auto goals = Hdf5File::open(folder / "out/cases.h5").read_float("/planning/goals");
  const auto size = static_cast<std::size_t>(data.header.vertices * 3);
  ASSERT_EQ(goals.size(), 2 * size);
  std::set<std::size_t> found;
  for (std::size_t g = 0; g < 2; ++g) {
    for (const auto i : data.select(Split::test)) {
      const auto& shapes = data.examples[i].shapes;
      float largest = 0.0f;
      for (std::size_t c = 0; c < size; ++c)
        largest = std::max(largest, std::abs(goals[g * size + c] - shapes[shapes.size() - size + c]));
      if (largest < 1e-5f) found.insert(i);
    }
  }
  EXPECT_EQ(found.size(), 2u) << "goals that are a test example's last shape";
}

TEST(EvaluateEstimation, ComparesMethodsOnHeldOutAndOnTrainingExamples) {
  const Folder folder;
  ASSERT_EQ(weft_command("generate " + kConfig + "--examples 40 --quiet --out " + quoted(folder / "data")).code, 0);
  const std::string command = "evaluate estimation " + kConfig + kQuick +
                              "--cases 2 --goals test train --methods posterior plain --data " +
                              quoted(folder / "data");
  const Outcome outcome = weft_command(command + " --out " + quoted(folder / "out"));
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("deviation_scale=["));
  const json result = read(folder / "out/estimation.json");
  EXPECT_EQ(result["method"], "posterior");
  EXPECT_EQ(result["goals"], "test");
  EXPECT_EQ(result["n"], 2);
  for (const char* property : {"friction", "bend", "stretch", "thickness"}) {
    EXPECT_TRUE(result["properties"][property]["abs_error"]["median"].is_number());
    EXPECT_TRUE(result["columns"]["train"]["plain"]["properties"][property]["interval_score"].is_number());
  }
  EXPECT_EQ(result["cases"].size(), 2u);
  EXPECT_GE(result["cases"][0]["knowledge"].size(), 5u);
  EXPECT_EQ(result["calibration"]["deviation_scale"].size(), 4u);
  // One shape of the manipulation per estimate, also for the one before the first segment.
  const auto shapes = Hdf5File::open(folder / "out/cases.h5");
  std::vector<std::int64_t> first{0};
  for (const auto& one : result["cases"])
    first.push_back(first.back() + static_cast<std::int64_t>(one["knowledge"].size()));
  EXPECT_EQ(shapes.read_int("/estimation/first"), first);
  EXPECT_EQ(shapes.shape("/estimation/shapes")[0], first.back());
  const Outcome again = weft_command(command + " --json --out " + quoted(folder / "out"));  // all rows are there
  EXPECT_EQ(without_seconds(json::parse(again.output)), without_seconds(result));
}

TEST(EvaluateEstimation, CasesAreExecutedInAnotherWorld) {
  const Folder folder;
  ASSERT_EQ(weft_command("generate " + kConfig + "--examples 24 --quiet --out " + quoted(folder / "data")).code, 0);
  const std::string command = "evaluate estimation " + kConfig + kQuick +
                              "--cases 1 --seed 5 --jobs 1 --quiet --data " + quoted(folder / "data");
  for (const std::string source : {"fresh", "test"}) {
    const auto shapes_of = [&](const std::string& name, const std::string& world) {
      const auto out = folder / (source + name);
      const Outcome outcome = weft_command(command + " --goals " + source + world + " --out " + quoted(out));
      EXPECT_EQ(outcome.code, 0) << outcome.output;
      return std::pair{read(out / "estimation.json")["cases"][0]["true_material"],
                       Hdf5File::open(out / "cases.h5").read_float("/estimation/shapes")};
    };
    const auto in_task = shapes_of("-task", ""), same = shapes_of("-same", " --set world.spread=0");
    const auto other = shapes_of("-other", " --set world.spread=0.2");
    EXPECT_EQ(in_task, same) << source;
    EXPECT_EQ(in_task.first, other.first) << source;
    ASSERT_EQ(in_task.second.size(), other.second.size()) << source;
    EXPECT_NE(in_task.second, other.second) << source;
  }
}

TEST(Evaluate, RefusesWhatCannotWorkBeforeAnyWork) {
  const Folder folder;
  const auto refused = [&](const std::string& arguments) {
    const Outcome outcome = weft_command("evaluate " + arguments + " --out " + quoted(folder / "out"));
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_FALSE(std::filesystem::exists(folder / "out/fresh"));
    return outcome.output;
  };
  EXPECT_THAT(refused("planning " + kConfig), HasSubstr("model"));
  EXPECT_THAT(refused("planning " + kConfig + kQuick + "--goals test"), HasSubstr("--data"));
  EXPECT_THAT(refused("planning " + kConfig + kQuick + "--goals tset"), HasSubstr("tset"));
  EXPECT_THAT(refused("planning " + kConfig + kQuick + "--widths 2"), HasSubstr("2"));
  EXPECT_THAT(refused("estimation " + kConfig + kQuick + "--set estimation.method=best"), HasSubstr("plain"));
  EXPECT_THAT(refused("estimation " + kConfig + kQuick + "--set world.simulator=none"), HasSubstr("none"));
  EXPECT_THAT(refused("estimation " + kConfig + kQuick + "--set estimation.deviation_scale=[1]"),
              HasSubstr("4 numbers"));
}

}  // namespace
}  // namespace weft
