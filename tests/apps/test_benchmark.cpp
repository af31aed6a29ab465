// `weft benchmark`: the rows, what is made of their samples, and the smallest size as people run it. No test compares times.
#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "experiments/benchmark/run.hpp"
#include "report/measurement.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

using benchmark::Measured;
using benchmark::Row;
using nlohmann::ordered_json;
using test::Folder;
using test::Outcome;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
std::string text_of(const std::filesystem::path& file) {
  std::ifstream stream(file);
  return {std::istreambuf_iterator<char>(stream), {}};
}
Measured frames(int vertices, const std::vector<double>& cpu_ms) {
  Measured one{
      {{"part", "frames"}, {"motion", "resting"}, {"simulator", "cloth"}, {"fabric", "basic"}, {"vertices", vertices}}};
  for (const double ms : cpu_ms)
    one.samples.push_back(
        {{"reset_cpu_ms", 0.0}, {"cpu_ms", ms}, {"wall_ms", 2.0 * ms}, {"frames", 100}, {"peak_mb", 10.0 + ms}});
  return one;
}

TEST(BenchmarkRows, PartsAndSizesAreThoseOfThePlan) {
  benchmark::Plan plan;
  plan.kernels = {"v2", "v3"};
  plan.processors = 3;
  const auto rows = benchmark::rows_of(plan);
  std::map<std::string, int> counts;
  std::set<int> vertices, processes;
  for (const Row& row : rows) {
    ++counts[row.at("part").get<std::string>()];
    if (row.contains("vertices")) vertices.insert(row.at("vertices").get<int>());
    if (row.contains("processes")) processes.insert(row.at("processes").get<int>());
  }
  EXPECT_THAT(vertices, ElementsAre(256, 1024, 4096, 16384, 65536));
  EXPECT_THAT(processes, ElementsAre(1, 2, 3));
  EXPECT_EQ(counts["frames"], 5 * 3 * 3 * 2);
  EXPECT_EQ(counts["training"], 2);
  EXPECT_EQ(counts["planning"], (9 + 3) * 2 + 1);
  plan.parts = {"folds"};
  EXPECT_EQ(benchmark::rows_of(plan).size(), 3u);
}

TEST(BenchmarkRows, CostOfALargerSizeFollowsFromTheGrowthOfSmallerOnes) {
  const Row row = frames(4096, {}).row;
  EXPECT_EQ(benchmark::expected_seconds(row, {}), 0.0);
  // 0.1 and 0.8 s for a run of 256 and 1,024 vertices grow with the exponent 1.5, so 6.4 s.
  EXPECT_NEAR(benchmark::expected_seconds(row, {frames(256, {1.0}), frames(1024, {8.0})}), 6.4, 1e-9);
  auto other = frames(1024, {8.0});
  other.row["fabric"] = "denim";
  EXPECT_EQ(benchmark::expected_seconds(row, {other, frames(16384, {8.0})}), 0.0);
  auto left_out = frames(1024, {});
  left_out.left_out = std::string(benchmark::kTooLong) + "used 600 s";
  EXPECT_TRUE(std::isinf(benchmark::expected_seconds(row, {left_out})));
}

TEST(BenchmarkTables, HaveMediansGrowthSpreadAndWhatWasLeftOut) {
  auto refused = frames(16384, {});
  refused.left_out = "bullet refuses it";
  const auto tables = benchmark::tables_of("frames", {frames(256, {1.0, 3.0, 1.1}), frames(1024, {8.8}), refused});
  ASSERT_EQ(tables.size(), 4u);
  EXPECT_EQ(tables[0]["label"], "frames/resting");
  const auto& cells = tables[0]["rows"][0];
  EXPECT_EQ(cells[0], "cloth");
  EXPECT_DOUBLE_EQ(cells[2].get<double>(), 1.1);
  EXPECT_DOUBLE_EQ(cells[3].get<double>(), 8.8);
  EXPECT_TRUE(cells[4].is_null());
  EXPECT_NEAR(cells[5].get<double>(), 1.5, 1e-9);                // 8.8 / 1.1 = 8 = 4^1.5
  EXPECT_NEAR(cells[6].get<double>(), 100.0 * 2.0 / 1.1, 1e-9);  // 1 to 3 over the median
  EXPECT_NEAR(cells[7].get<double>(), 2.0, 1e-9);
  EXPECT_EQ(tables[1]["label"], "frames/growth");
  EXPECT_EQ(tables[2]["rows"][0], ordered_json::array({"`cloth`, 256 vertices", 13.0}));
  EXPECT_EQ(tables[3]["rows"][0], ordered_json::array({"cloth, basic", "resting", "16384", "bullet refuses it"}));
  EXPECT_TRUE(benchmark::tables_of("folds", {refused}).empty());
}

TEST(BenchmarkTables, RowsAreReadBackAsTheyWereWritten) {
  auto refused = frames(16384, {});
  refused.left_out = "no";
  const auto json = benchmark::to_json({frames(256, {1.0, 2.0}), refused, frames(1024, {})});
  ASSERT_EQ(json.size(), 2u);  // what was neither measured nor left out is to be measured
  EXPECT_EQ(json[0]["repeats"], 2);
  EXPECT_EQ(json[0]["most"]["cpu_ms"], 2.0);
  EXPECT_EQ(benchmark::to_json(benchmark::measured_of(json)), json);
}

/// Every row of the smallest size, as people run it; then the folder goes on, and refuses what does not belong there.
TEST(Benchmark, QuickMeasuresEveryRow) {
  const Folder folder;
  const std::string out = " --out '" + (folder / "speed").string() + "' --jobs 2 ";
  const Outcome first = weft_command("benchmark frames --quick --limit 60" + out);
  ASSERT_EQ(first.code, 0) << first.output;
  const auto frames_only = ordered_json::parse(text_of(folder / "speed/speed.json"));
  const Outcome all = weft_command("benchmark --quick --limit 60 --json" + out);
  ASSERT_EQ(all.code, 0) << all.output;
  const auto json = ordered_json::parse(all.output);
  EXPECT_EQ(json, ordered_json::parse(text_of(folder / "speed/speed.json")));
  EXPECT_EQ(text_of(folder / "speed/speed.md"), measurement_page(json));

  benchmark::Plan plan;
  plan.is_quick = true;
  plan.processors = 2;
  plan.kernels = {"v2", "v3", "v4", "amx"};
  std::set<std::string> rows;
  std::size_t measured = 0;
  for (const auto& one : json.at("rows")) {
    rows.insert(one.at("row").dump());
    const std::string name = benchmark::name_of(one.at("row"));
    if (one.contains("left_out")) {
      // Bullet refuses fabrics, and a processor or build lacks instructions or libtorch.
      const bool may_lack = one["row"].value("simulator", "") == "bullet" || one["row"].contains("kernels") ||
                            (one["row"]["part"] == "training" && !WEFT_HAS_TORCH);
      EXPECT_TRUE(may_lack) << name << ": " << one["left_out"];
      continue;
    }
    ++measured;
    EXPECT_EQ(one.at("repeats"), 1) << name;
    for (const char* wanted : {"cpu_ms", "wall_ms", "peak_mb"}) EXPECT_TRUE(one.at("median").contains(wanted)) << name;
    for (const auto& [number, value] : one.at("median").items())
      EXPECT_TRUE(std::isfinite(value.get<double>()) && value.get<double>() > 0.0) << name << ": " << number;
  }
  for (const Row& row : benchmark::rows_of(plan)) EXPECT_TRUE(rows.contains(row.dump())) << row.dump();
  EXPECT_EQ(rows.size(), benchmark::rows_of(plan).size());
  EXPECT_GE(measured, 18u + 2u + 1u);  // cloth, folds, sessions at the least
  std::set<std::string> labels;
  for (const auto& table : json.at("tables")) labels.insert(table.at("label").get<std::string>());
  for (const char* label : {"frames/resting", "frames/hanging", "frames/folding", "frames/growth", "frames/memory",
                            "folds/folds", "folds/memory", "planning/gradient", "planning/sessions", "planning/memory"})
    EXPECT_TRUE(labels.contains(label)) << label;
  EXPECT_EQ(labels.contains("training/step"), WEFT_HAS_TORCH == 1);
  EXPECT_EQ(json.at("steps").size(), 4u);

  // What the first command measured was kept; another config is refused, and nothing changes.
  for (const auto& one : frames_only.at("rows"))
    EXPECT_NE(std::find(json.at("rows").begin(), json.at("rows").end(), one), json.at("rows").end()) << one.dump();
  const Outcome other = weft_command("benchmark folds --quick --set goal.random.min_distance_mm=6" + out);
  EXPECT_EQ(other.code, 2);
  EXPECT_THAT(other.output, HasSubstr("holds measurements of something else"));
  EXPECT_THAT(other.output, HasSubstr("goal.random.min_distance_mm 5 -> 6"));
  EXPECT_EQ(ordered_json::parse(text_of(folder / "speed/speed.json")), json);
  EXPECT_THAT(weft_command("benchmark nonsense").output, HasSubstr("nonsense"));
}

}  // namespace
}  // namespace weft
